"""``jointplay check``: is the machine file right, and what does the program make of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app.commands.parameters import fault_option, json_option, print_json
from jointplay.app.errors import OutputError
from jointplay.app.figures.machine_account import account_of, drive_of, ground_of, matrix_of
from jointplay.app.tables import indent, table

if TYPE_CHECKING:
    from jointplay.solver.machines.fault import Fault
    from jointplay.solver.machines.machine import Machine
    from jointplay.solver.machines.matrix import MechanismMatrix
    from jointplay.solver.simulation.account import Account


@click.command("check")
@click.argument("machine")
@fault_option
@click.option("--arrays", is_flag=True, help="Show the arrays that the paper derives from the mechanism matrix.")
@click.option("--drawing", type=click.Path(path_type=Path), metavar="FILE.svg|.png|.pdf", help="Draw the machine.")
@click.option(
    "--response",
    type=click.Path(path_type=Path),
    metavar="FILE.svg|.png|.pdf",
    help="Draw the frame's frequency response, with the orders of the drive.",
)
@json_option
def command(
    machine: str, fault: str | None, arrays: bool, drawing: Path | None, response: Path | None, as_json: bool
) -> None:
    """Validate MACHINE (a shipped machine's name, or a file); show what it consists of, and what is implausible."""
    if drawing is not None:
        from jointplay.app.figures.pictures import check_ending, save_drawing

        check_ending(drawing)
    if response is not None:
        from jointplay.app.figures import plots
        from jointplay.app.figures.responses import draw_response

        plots.check_ending(response)
    from jointplay.solver.errors import AssemblyError
    from jointplay.solver.machines.fault import parse_fault
    from jointplay.solver.machines.machine import load_machine, machine_text
    from jointplay.solver.simulation.account import account
    from jointplay.solver.simulation.simulate import check_assembly

    found = load_machine(machine)
    state = parse_fault(fault, found)
    try:
        sizes = account(found, state)
        check_assembly(found)
        content = account_of(found, state, sizes, arrays, machine_text(machine))
    except AssemblyError as error:
        if drawing is not None:
            save_drawing(found, state.joints, drawing, error.joint)
            click.echo(f"drawn as far as it goes: {drawing}", err=True)
        raise
    if drawing is not None:
        save_drawing(found, state.joints, drawing)
    if response is not None:
        if not found.has_response:
            rule = (
                "its file gives no frequency response of sensors (response: ..., or modes: ... of a frame that moves)"
            )
            raise OutputError(f"--response: {found.name}: {rule}")
        plots.save(draw_response(found), response)
    if as_json:
        drawn = {"drawing": drawing and str(drawing), "response_drawing": response and str(response)}
        print_json(content | drawn)
    else:
        click.echo(report(found, state, sizes, content, arrays))
        for note in content["notes"]:
            click.echo(f"note: {note}")
        if drawing or response:
            click.echo(f"\ndrawn: {', '.join(str(each) for each in (drawing, response) if each)}")


def report(machine: Machine, fault: Fault, sizes: Account, content: dict[str, Any], arrays: bool) -> str:
    """Return everything as plain text."""
    from jointplay.solver.cases.answers import say_band
    from jointplay.solver.machines.matrix import MechanismMatrix

    matrix = matrix_of(machine, fault)
    size = len(sizes.coordinates) + len(sizes.closures)
    filed = ", as the file gives it" if fault and dict(fault) == machine.clearances else ""
    parts = [
        f"{machine.name}: a valid machine; drive: {drive_of(machine)}; fault: {fault.label}{filed}",
        "",
        links_of(machine),
        "",
        joints_of(machine, fault),
        "",
        *(f"ground moves under {line}\n" for line in ["; ".join(ground_of(machine))] if line),
        f"degrees of freedom      F = {sizes.freedoms}, of which {sizes.integrated} are integrated",
        f"full system       3N + 2J = {sizes.full_unknowns} unknowns ({sizes.links} links, {sizes.joints} joints)",
        f"compiled system             {size} unknowns, {len(sizes.coordinates)} accelerations and "
        f"{len(sizes.closures)} reactions; {sizes.operations} operations an evaluation",
        f"  coordinates: {', '.join(sizes.coordinates) or 'none'}",
        f"  closures: {', '.join(sizes.closures) or 'none'}",
        *([f"  of these not among the 3N + 2J: {', '.join(sizes.added)}"] if sizes.added else []),
        f"left out, {sum(out.unknowns for out in sizes.left_out)} unknowns and terms of the forces:",
        *(f"  {out.what}: {out.why}" for out in sizes.left_out),
        *(
            [f"reactions without a value of their own: {', '.join(sizes.open_reactions)}"]
            if sizes.open_reactions
            else []
        ),
        *([f"frequency {say_band(machine)}"] if machine.response else []),
        *([f"{decoupled_of(sizes)}: {sizes.decoupling.say()}"] if sizes.decoupling else []),
        *modes_of(content["suspension_modes"]),
        "",
        "mechanism matrix:",
    ]
    if isinstance(matrix, MechanismMatrix):
        rows = [(link, *row) for link, row in zip(matrix.links, matrix.rows, strict=True)]
        parts.append(indent(table(("", *matrix.links), rows)))
        if arrays:
            parts += ["", arrays_of(matrix)]
    else:
        parts.append(f"  none: {matrix}")
    return "\n".join(parts)


def modes_of(modes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return how the frame swings on its supports, a line for each mode."""
    return [
        f"suspension mode in {mode['motion']}: {mode['frequency_hz']:.3g} Hz, damping ratio {mode['damping_ratio']:.2g}"
        for mode in modes
    ]


def decoupled_of(sizes: Account) -> str:
    """Return what is said of a frame's decoupling."""
    return "frame decoupled, nothing of it acts back" if sizes.decoupled else "were the frame decoupled"


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


def joints_of(machine: Machine, fault: Fault) -> str:
    """Return the joints as a table; clearances are radial, of guides half the play."""
    from jointplay.solver.machines.fits import in_um

    rows = []
    for name, joint in machine.joints.items():
        as_new = limit = "-"
        if name in machine.wearing_joints:
            as_new = str(joint.new_fit)
            limit = f"{in_um(joint.worn_out_from)} ({'default' if joint.limit is None else 'given'})"
        clearance = f"{fault[name] * 1e6:.6g} um" if name in fault else "-"
        at = f"({joint.at[0]:g}, {joint.at[1]:g}) m"
        rows.append((name, joint.kind, " on ".join(joint.links), at, as_new, limit, clearance))
    return table(("joint", "kind", "links", "at", "radial play as new", "worn out from", "radial clearance"), rows)


def arrays_of(matrix: MechanismMatrix) -> str:
    """Return the paper's arrays as tables: counts, neighbour lists (without the zeros that fill them up), factors."""
    from jointplay.solver.machines.matrix import matrix_arrays

    arrays = matrix_arrays(matrix)
    size = range(len(arrays.links))
    heads = [[str(i + 1), link] for i, link in enumerate(arrays.links)]
    counts = [[*heads[i], *(str(column[i]) for column in arrays.counts.values())] for i in size]
    lists = [
        [*heads[i], *(" ".join(str(j) for j in rows[i] if j) for rows in arrays.neighbours.values())] for i in size
    ]
    entries = {
        (i, j): [part[i][j] for part in (arrays.xi, arrays.n, arrays.s)]
        for i in size
        for j in size
        if i != j and matrix.rows[i][j] != "0"
    }
    factors = [
        [str(i + 1), str(j + 1), *("-" if x is None else str(x) for x in entry)] for (i, j), entry in entries.items()
    ]
    parts = [
        f"arrays of the matrix: N = {len(arrays.links)}, NSP = {arrays.springs}, NDP = {arrays.dampers}",
        table(("", "link", *arrays.counts), counts),
        "",
        table(("", "link", *arrays.neighbours), lists),
        "",
        table(("i", "j", "xi", "n", "s"), factors),
    ]
    return "\n".join([parts[0], *(indent(part) for part in parts[1:])])
