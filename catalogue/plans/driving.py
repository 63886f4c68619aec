"""How fast the drive of a machine turns, and the number of the machine file that says so.

A prescribed rotation has its speed. What a motor turns at is found by a run of the machine to its limit cycle; a number
of its curve moves that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from jointplay.catalogue.errors import PlanError
from jointplay.solver.machines.fault import HEALTHY
from jointplay.solver.machines.machine import Machine, has_known_effort, keep_by_machine
from jointplay.solver.machines.parts import ForceDrive, RotationDrive, TorqueDrive

DRIVE_SPEED = "drive.speed"
SPEED_FACTOR = "drive.speed_factor"
EFFORT_FACTOR = "drive.effort_factor"

#: Part of its speed by which a process load may slow a motor.
BORNE = 0.05
#: Acceleration of gravity [m/s2] that weights are meant with, also where a machine lies flat.
WEIGHT = 9.81


def nominal_drive_speed(machine: Machine) -> float:
    """Drive speed of the machine file [rad/s]; of a motor the mean of the machine without play in its limit cycle.

    Raises
    ------
    PlanError
        The drive does not turn, or not at one speed, so spectra cannot be compared by order.
    """
    drive = machine.drive
    if has_known_effort(machine):
        return _found_speed(machine)
    speed = drive.speed if isinstance(drive, RotationDrive) else None
    if isinstance(speed, float) and speed != 0.0:
        return speed
    shown = "none" if drive is None else f"kind {drive.kind}"
    rule = "a catalogue needs a drive of kind rotation with one speed that is not 0, or one that reaches a limit cycle"
    raise PlanError(machine.name, "drive", shown, rule)


@keep_by_machine(64)
def _found_speed(machine: Machine) -> float:
    # A second to load, and only motors need it: a server can begin without.
    from jointplay.solver.cases.case import Case, Settings
    from jointplay.solver.simulation.simulate import simulate

    history = simulate(machine, Case(HEALTHY), Settings(revolutions=5.0, motion=False, accuracy="draft"))
    if not history.drive_speed:
        assert machine.drive is not None
        told = " ".join(history.message.split()) or history.status.value
        rule = f"a catalogue needs a drive that reaches a limit cycle: {told}"
        raise PlanError(machine.name, "drive", f"kind {machine.drive.kind}", rule)
    return float(f"{history.drive_speed:.4g}")  # the same on every processor


def speed_path(machine: Machine) -> str | None:
    """Path of the number that makes a machine faster; None for a motor without a curve, whose load says its speed."""
    if isinstance(machine.drive, TorqueDrive | ForceDrive):
        return SPEED_FACTOR if machine.drive.curve else None
    return DRIVE_SPEED


def at_speed(machine: Machine, speed: float) -> dict[str, float]:
    """Parameters of a case that turns at a speed [rad/s], or as near to it as its motor's speeds are multiplied."""
    path = speed_path(machine)
    if path is None:
        return {}
    if path == DRIVE_SPEED:
        return {path: speed}
    assert isinstance(machine.drive, TorqueDrive | ForceDrive)
    return {path: machine.drive.speed_factor * speed / nominal_drive_speed(machine)}


def speed_of(machine: Machine, parameters: Mapping[str, float]) -> float:
    """Drive speed [rad/s] of a case as far as its numbers say it."""
    if not has_known_effort(machine):
        return parameters[DRIVE_SPEED]
    assert isinstance(machine.drive, TorqueDrive | ForceDrive)
    factor = parameters.get(SPEED_FACTOR, machine.drive.speed_factor) / machine.drive.speed_factor
    return nominal_drive_speed(machine) * factor


def driver_link(machine: Machine) -> str:
    """Link that the drive moves on the frame; empty where it moves two others, or where there is no drive."""
    joint = machine.joints.get(str(getattr(machine.drive, "joint", "")))
    others = [name for name in joint.links if name != machine.frame] if joint else []
    return others[0] if len(others) == 1 else ""


def load_scale(machine: Machine) -> float:
    """Force [N] that a process is compared with: of the moving links' weight, and of their mass on the driver's way.

    That is of the driven link's end. Of a motor it is no more than moves its speed by :data:`BORNE`: what stops it, or
    turns it round, is not the same machine under another load.
    """
    moving = sum(link.mass or 0.0 for name, link in machine.links.items() if name != machine.frame)
    drive = machine.drive
    joint = machine.joints.get(str(getattr(drive, "joint", "")))
    speed = drive.speed if isinstance(drive, RotationDrive) and isinstance(drive.speed, float) else 0.0
    speed = nominal_drive_speed(machine) if has_known_effort(machine) else speed
    driven = [name for name in joint.links if name != machine.frame] if joint else []
    ends = [math.dist(joint.at, end.at) for end in machine.joints.values() if joint and {*driven} & {*end.links}]
    reach = max(ends, default=0.0)
    scale = moving * (WEIGHT + reach * speed**2)
    if isinstance(drive, ForceDrive):
        most = max(abs(force) for _, force in drive.curve or ((0.0, drive.force or 0.0),))
        return min(scale, 2 * BORNE * drive.effort_factor * most)
    if isinstance(drive, TorqueDrive) and reach:
        # In phase with the way r sin it does pi F r of work in a turn, as much as a torque of F r / 2.
        return min(scale, 2 * _torque_borne(drive, speed) / reach)
    return scale


def _torque_borne(drive: TorqueDrive, speed: float) -> float:
    """Torque [N m] that a motor gives more when it turns slower by :data:`BORNE`."""
    if not drive.curve:
        return BORNE * abs(drive.torque or 0.0) * drive.effort_factor
    speeds, torques = zip(*drive.curve, strict=True)
    now, slower = np.interp([speed / drive.speed_factor, (1 - BORNE) * speed / drive.speed_factor], speeds, torques)
    return drive.effort_factor * abs(float(now - slower))
