"""What the program makes of a machine: for ``jointplay check``, the HTTP interface and the page alike."""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jointplay.solver.machines.fault import Fault
    from jointplay.solver.machines.machine import Machine
    from jointplay.solver.machines.matrix import MechanismMatrix
    from jointplay.solver.simulation.account import Account


def account_of(machine: Machine, fault: Fault, sizes: Account, arrays: bool = False, text: str = "") -> dict[str, Any]:
    """Return everything that there is to say of a machine as JSON values.

    Parameters
    ----------
    machine : Machine
        That can be assembled.
    fault : Fault
    sizes : Account
        Of both.
    arrays : bool
        Whether the paper's arrays are wanted with the mechanism matrix.
    text : str
        Of its file, which says what a machine does not: how a number was written.
    """
    from jointplay.solver.cases.answers import say_band
    from jointplay.solver.cases.remarks import find_remarks, suspension_modes
    from jointplay.solver.machines.matrix import MechanismMatrix
    from jointplay.solver.machines.remarks import speed_remarks
    from jointplay.solver.machines.yamlfile import read_tree

    matrix = matrix_of(machine, fault)
    written = read_tree(text, machine.name) if text else {}

    content: dict[str, Any] = {
        "name": machine.name,
        "content_key": machine.content_key,
        "frame": machine.frame,
        "links": list(machine.links),
        "turning_joints": list(machine.turning_joints),
        "sliding_joints": list(machine.sliding_joints),
        "sensors": [sensor.name for sensor in machine.sensors],
        "joints": fits_document(machine),
        "ground_motion": ground_of(machine),
        "fault_um": {joint: clearance * 1e6 for joint, clearance in fault.items()},
        "degrees_of_freedom": sizes.freedoms,
        "integrated_degrees_of_freedom": sizes.integrated,
        "unknowns_3n_2j": sizes.full_unknowns,
        "coordinates": list(sizes.coordinates),
        "closures": list(sizes.closures),
        "operations": sizes.operations,
        "left_out": [{"what": out.what, "why": out.why, "unknowns": out.unknowns} for out in sizes.left_out],
        "added": list(sizes.added),
        "open_reactions": list(sizes.open_reactions),
        "decoupled": sizes.decoupled,
        "frequency_response": None if machine.response is None else say_band(machine),
        "decoupling": sizes.decoupling and {"inertia_ratio": sizes.decoupling.ratio, "change": sizes.decoupling.change},
        "mechanism_matrix": None,
        "suspension_modes": [
            {"motion": mode.motion, "frequency_hz": mode.frequency, "damping_ratio": mode.damping_ratio}
            for mode in suspension_modes(machine)
        ],
        "notes": [*find_remarks(machine, fault), *speed_remarks(written)],
    }
    if isinstance(matrix, MechanismMatrix):
        content["mechanism_matrix"] = {
            "links": list(matrix.links),
            "rows": [list(row) for row in matrix.rows],
            **({"arrays": arrays_document(matrix)} if arrays else {}),
        }
    return content


def ground_of(machine: Machine) -> list[str]:
    """Return how the ground moves under supports, a line for each part of it."""
    lines = []
    for i, support in enumerate(machine.supports):
        for part in support.motion:
            x, y = (1e6 * size for size in part.displacement)
            often = f"order {part.order or 0:g}" if part.frequency is None else f"{part.frequency:g} Hz"
            how = "by a table" if part.over_time is not None else f"({x:.3g}, {y:.3g}) um at {often}"
            lines.append(f"supports.{i}, {support.kind} on {support.link}: {how}")
    return lines


def matrix_of(machine: Machine, fault: Fault) -> MechanismMatrix | str:
    """Return the mechanism matrix, or why it cannot say this machine."""
    from jointplay.solver.errors import MachineError
    from jointplay.solver.machines.matrix import MechanismMatrix

    try:
        return MechanismMatrix.from_machine(machine, fault.joints)
    except MachineError as error:
        return error.rule


def fits_document(machine: Machine) -> dict[str, object]:
    """Return what play each joint that can wear has as new and from which it is worn out, as JSON values."""
    return {
        name: {
            "fit": joint.new_fit.text,
            "play_as_new_um": [round(end * 1e6, 6) for end in joint.play_as_new],
            "limit": "default" if joint.limit is None else "given",
            "worn_out_from_um": round(joint.worn_out_from * 1e6, 6),
        }
        for name, joint in machine.joints.items()
        if name in machine.wearing_joints
    }


def arrays_document(matrix: MechanismMatrix) -> dict[str, object]:
    """Return the paper's arrays as JSON values, links counted from 1."""
    from jointplay.solver.machines.matrix import matrix_arrays

    arrays = matrix_arrays(matrix)
    return {
        "N": len(arrays.links), "NSP": arrays.springs, "NDP": arrays.dampers,
        "xi": arrays.xi, "n": arrays.n, "s": arrays.s, **arrays.counts, **arrays.neighbours,
    }  # fmt: skip


def drive_of(machine: Machine, speed: float | None = None) -> str:
    """Return the drive in a few words, with its speed: in rpm where it turns.

    Parameters
    ----------
    machine : Machine
    speed : float, optional
        Of one that turns, in place of that of its file [rad/s].
    """
    drive = machine.drive
    if drive is None:
        return "none"
    turns = drive.kind in ("rotation", "torque")
    speed = float(speed) if speed and turns else getattr(drive, "speed", None)
    if drive.kind == "position":
        x, y = drive.direction
        way = {(1.0, 0.0): "x", (0.0, 1.0): "y"}.get((x, y), f"({x:g}, {y:g})")
        how = f"at {speed:.6g} m/s" if isinstance(speed, float) and speed else "by position"
        return f"{drive.link} along {way} {how}"
    if drive.kind == "rotation" and isinstance(speed, float):
        return f"{drive.joint} at {speed * 30 / pi:.6g} rpm"
    if drive.kind == "translation" and isinstance(speed, float):
        return f"{drive.joint} at {speed:.6g} m/s"
    turning = f" at {speed * 30 / pi:.6g} rpm" if turns and isinstance(speed, float) else ""
    return f"{drive.joint} by {drive.kind}{turning}"
