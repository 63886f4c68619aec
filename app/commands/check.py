"""``jointplay check``: is the machine file right, and what does the program make of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from app.commands.machines import drive_of
from app.commands.parameters import json_option, print_json
from app.commands.tables import indented, table

if TYPE_CHECKING:
    from solver.account import Account
    from solver.fault import FaultState
    from solver.machine import Machine


@click.command("check")
@click.argument("machine")
@click.option("--fault", default="", metavar="A=0.2mm,F=50um", help="Radial clearance of worn joints; none by default.")
@click.option("--drawing", type=click.Path(path_type=Path), metavar="FILE.svg|.png", help="Draw the machine.")
@json_option
def command(machine: str, fault: str, drawing: Path | None, as_json: bool) -> None:
    """Validate MACHINE (a shipped machine's name, or a file) and show what it consists of."""
    if drawing is not None:
        from app.pictures import check_ending

        check_ending(drawing)
    from solver.account import account
    from solver.fault import parse_fault
    from solver.machine import resolve_machine
    from solver.simulate import check_assembly

    found = resolve_machine(machine)
    state = parse_fault(fault, found)
    sizes = account(found, state)
    check_assembly(found)
    if drawing is not None:
        from app.pictures import save_drawing

        save_drawing(found, state.joints, drawing)
    matrix = matrix_of(found, state)
    if as_json:
        print_json(document(found, state, sizes, matrix, drawing))
    else:
        click.echo(report(found, state, sizes, matrix))
        if drawing is not None:
            click.echo(f"\ndrawn: {drawing}")


def matrix_of(machine: Machine, fault: FaultState) -> tuple[tuple[str, ...], list[list[str]]] | str:
    """Return links and rows of the mechanism matrix, or why it cannot say this machine."""
    from solver.errors import MachineError
    from solver.matrix import MechanismMatrix

    try:
        matrix = MechanismMatrix.from_machine(machine, fault.joints)
    except MachineError as error:
        return error.rule
    return matrix.links, [list(row) for row in matrix.rows]


def document(
    machine: Machine,
    fault: FaultState,
    sizes: Account,
    matrix: tuple[tuple[str, ...], list[list[str]]] | str,
    drawing: Path | None,
) -> dict[str, object]:
    """Return everything as JSON values."""
    return {
        "name": machine.name,
        "content_key": machine.content_key,
        "frame": machine.frame,
        "links": list(machine.links),
        "turning_joints": list(machine.turning_joints),
        "sliding_joints": list(machine.sliding_joints),
        "sensors": [sensor.name for sensor in machine.sensors],
        "fault_um": {joint: clearance * 1e6 for joint, clearance in fault.items()},
        "degrees_of_freedom": sizes.freedoms,
        "integrated_degrees_of_freedom": sizes.integrated,
        "unknowns_3n_2j": sizes.full_unknowns,
        "coordinates": list(sizes.coordinates),
        "closures": list(sizes.closures),
        "operations": sizes.operations,
        "left_out": [{"what": what, "why": why} for what, why in sizes.left_out],
        "mechanism_matrix": None if isinstance(matrix, str) else {"links": list(matrix[0]), "rows": matrix[1]},
        "drawing": None if drawing is None else str(drawing),
    }


def report(
    machine: Machine, fault: FaultState, sizes: Account, matrix: tuple[tuple[str, ...], list[list[str]]] | str
) -> str:
    """Return everything as plain text."""
    size = len(sizes.coordinates) + len(sizes.closures)
    parts = [
        f"{machine.name}: a valid machine; drive: {drive_of(machine)}; fault: {fault.label}",
        "",
        links_of(machine),
        "",
        joints_of(machine, fault),
        "",
        f"degrees of freedom      F = {sizes.freedoms}, of which {sizes.integrated} are integrated",
        f"full system       3N + 2J = {sizes.full_unknowns} unknowns ({sizes.links} links, {sizes.joints} joints)",
        f"compiled system             {size} unknowns: {len(sizes.coordinates)} coordinates and "
        f"{len(sizes.closures)} reactions; {sizes.operations} operations an evaluation",
        f"  coordinates: {', '.join(sizes.coordinates)}",
        f"  closures: {', '.join(sizes.closures) or 'none'}",
        "left out:",
        *(f"  {what}: {why}" for what, why in sizes.left_out),
        "",
        "mechanism matrix:",
        f"  none: {matrix}" if isinstance(matrix, str) else indented(table(("", *matrix[0]), matrix_rows(*matrix))),
    ]
    return "\n".join(parts)


def links_of(machine: Machine) -> str:
    """Return the links as a table."""
    rows = []
    for name, link in machine.links.items():
        remarks = ["frame"] if name == machine.frame else []
        remarks += ["fixed"] if link.fixed else [f"{motion} locked" for motion in link.locked]
        mass = "-" if link.mass is None else f"{link.mass:g} kg"
        inertia = "-" if link.inertia is None else f"{link.inertia:g} kg m2"
        rows.append((name, mass, inertia, f"({link.cg[0]:g}, {link.cg[1]:g}) m", ", ".join(remarks)))
    return table(("link", "mass", "inertia", "centre of gravity", ""), rows)


def joints_of(machine: Machine, fault: FaultState) -> str:
    """Return the joints as a table."""
    rows = [
        (
            name,
            joint.kind,
            " on ".join(joint.links),
            f"({joint.at[0]:g}, {joint.at[1]:g}) m",
            f"{fault[name] * 1e6:.6g} um" if name in fault else "-",
        )
        for name, joint in machine.joints.items()
    ]
    return table(("joint", "kind", "links", "at", "radial clearance"), rows)


def matrix_rows(links: tuple[str, ...], rows: list[list[str]]) -> list[tuple[str, ...]]:
    """Return the rows of the matrix with their links."""
    return [(link, *row) for link, row in zip(links, rows, strict=True)]
