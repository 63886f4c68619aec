"""The ideal machine over the positions of its drive: does it close there, how fast are its contacts and friction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.change_points import ChangePoint, describe_change_point
from jointplay.solver.cases.rates import friction_rate
from jointplay.solver.cases.start import follow, walk, walk_round
from jointplay.solver.cases.steps import contact_mobility
from jointplay.solver.equations.drive import travel_range
from jointplay.solver.equations.model import MODELS_KEPT, Model, build_model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.machines.joints import Contact
from jointplay.solver.machines.machine import Machine, keep_by_machine
from jointplay.solver.machines.parts import RotationDrive, TravelDrive

#: Numbers by path, as a key of a cache.
_Numbers = tuple[tuple[str, float], ...]
#: Positions between the drawn one and the end of a travel.
_TRAVEL_STEPS = 120


def _top_speed(machine: Machine) -> float:
    """Fastest speed of a rotation, rad/s, with its sign; 1 for other drives."""
    drive = machine.drive
    if not isinstance(drive, RotationDrive):
        return 1.0
    return max((speed for _, speed in drive.speed), key=abs) if isinstance(drive.speed, tuple) else drive.speed


@keep_by_machine(MODELS_KEPT)
def _turning(machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...]) -> Model:
    """The model with a rotation at a constant speed of 1 rad/s, a lane parameter; other drives as they are."""
    drive = machine.drive
    if isinstance(drive, RotationDrive):
        drive = drive.model_copy(update={"speed": math.copysign(1.0, _top_speed(machine)), "ripple": ()})
    kept = tuple(path for path in varying if not path.startswith("drive.ripple."))
    return build_model(machine.model_copy(update={"drive": drive}), joints, kept)


def _drive_numbers(machine: Machine, values: Mapping[str, float]) -> _Numbers:
    """Numbers of a case that poses follow: those of a slide; a rotation is walked at 1 rad/s whatever its speed."""
    if not isinstance(machine.drive, TravelDrive):
        return ()
    return tuple(sorted((path, value) for path, value in values.items() if path.startswith("drive.")))


def _paths(numbers: _Numbers) -> tuple[str, ...]:
    return tuple(path for path, _ in numbers if path != "drive.speed")  # that is a lane parameter anyway


@keep_by_machine(MODELS_KEPT)
def _moving(machine: Machine) -> Machine:
    """What poses and mobilities follow from: no contacts, loads, ripple, in which variants of a machine differ."""
    drive = machine.drive
    if isinstance(drive, RotationDrive):
        drive = drive.model_copy(update={"ripple": ()})
    joints = {name: joint.model_copy(update={"contact": Contact()}) for name, joint in machine.joints.items()}
    return machine.model_copy(update={"joints": joints, "drive": drive, "loads": ()})


@keep_by_machine(MODELS_KEPT)
def _walked(
    machine: Machine, joints: tuple[str, ...], motion: _Numbers
) -> tuple[list[tuple[float, FloatArray]], list[str]]:
    """Twelve poses over one turn at 1 rad/s, or over one period of a slide with the numbers `motion`; remarks."""
    model = _turning(machine, joints, _paths(motion))
    p = model.vector(dict(motion))
    poses, passed = walk_round(model, p, 1.0)
    return poses[:: max(1, len(poses) // 12)], _remarks(model, p, passed)


def _remarks(model: Model, p: Sequence[float], passed: Sequence[ChangePoint]) -> list[str]:
    """What a user should know of change points."""
    subject = "without clearance the machine" if model.clearance_joints else "the machine"
    return [f"{subject} {describe_change_point(model, p, point)}" for point in passed]


@keep_by_machine(1024)
def _mobility(machine: Machine, joints: tuple[str, ...], motion: _Numbers, masses: _Numbers) -> Mapping[str, float]:
    numbers = motion + masses
    model = _turning(machine, joints, _paths(numbers))
    return contact_mobility(model, _walked(machine, joints, motion)[0], model.vector(dict(numbers)))


def mobility_of(machine: Machine, joints: tuple[str, ...], values: Mapping[str, float]) -> Mapping[str, float]:
    """Contact mobilities of a case, 1/kg, over twelve poses; also refuses what cannot be assembled.

    Parameters
    ----------
    machine : Machine
    joints : tuple of str
        Those with clearance.
    values : mapping of str to float
        Numbers by path that differ from the machine file.

    Raises
    ------
    AssemblyError
        Names the drive's position and the joint that stays open.
    """
    masses = tuple(sorted((path, value) for path, value in values.items() if path.startswith("links.")))
    return _mobility(_moving(machine), joints, _drive_numbers(machine, values), masses)


def grips_of(machine: Machine) -> Mapping[str, tuple[float, float]]:
    """Where the friction of each guide presses its surfaces together most over one period of the drive.

    Returns
    -------
    mapping of str to (float, float)
        By sliding joint with friction: the friction that is added to the normal force by a part of the friction, and
        how far the drive has gone there since the drawn pose, rad at a rotation and s at a slide.
    """
    model = _turning(_moving(machine), (), ())
    if model.rubbing is None:
        return {}
    p, rest = model.vector({}), np.zeros(model.size)
    found = []
    for t, z in walk(model, p, 1.0):
        friction, _, _, leverage, *_ = evaluate(model.rubbing_state, t, z, rest, p)
        found.append((t, friction[:, 0] * np.abs(leverage[:, 0])))
    each = {name: [(float(grips[i]), t) for t, grips in found] for i, name in enumerate(model.rubbing.joints)}
    # Positions that mirror each other differ by rounding: the first of them.
    return {name: max(grips, key=lambda grip: round(grip[0], 9)) for name, grips in each.items()}


def change_point_remarks(machine: Machine, joints: tuple[str, ...], values: Mapping[str, float]) -> list[str]:
    """What a user should know of change points that the drive passes or comes near; as :func:`mobility_of`."""
    return list(_walked(_moving(machine), joints, _drive_numbers(machine, values))[1])


def rubbing_rate(
    machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...], values: Mapping[str, float],
    mobility: Mapping[str, float],
) -> float:  # fmt: skip
    """Largest rate of friction of a case, 1/s.

    Parameters
    ----------
    machine : Machine
    joints : tuple of str
        Those with clearance.
    varying : tuple of str
        As :func:`jointplay.solver.cases.preparation.model_of`.
    values : mapping of str to float
        All lane parameters by path.
    mobility : mapping of str to float
        Of the clearance joints, 1/kg.
    """
    model = _turning(machine, joints, varying)
    poses = _walked(machine, joints, _drive_numbers(machine, values))[0]
    numbers = dict(values)
    if isinstance(machine.drive, RotationDrive):
        # A crank that stands is judged at 1 rad/s; the speed 0 of a slide is one: harmonics move it.
        top = numbers["drive.speed"] = values.get("drive.speed", _top_speed(machine)) or 1.0
        poses = [(t / abs(top), z) for t, z in poses]
    return friction_rate(model, poses, model.vector(numbers), numbers, mobility)


def check_travel(machine: Machine, joints: tuple[str, ...], values: Mapping[str, float], duration: float) -> list[str]:
    """Refuse a slide, or a link in space, that is driven to where the ideal machine does not close; remarks on change
    points on its way.

    Parameters
    ----------
    machine : Machine
    joints : tuple of str
        Those with clearance.
    values : mapping of str to float
        Numbers by path that differ from the machine file.
    duration : float
        Of the run, s.

    Raises
    ------
    AssemblyError
        Names the travel and the joint that stays open.
    """
    if not isinstance(machine.drive, TravelDrive) or machine.driven_link == machine.frame:
        return []
    low, high = travel_range(machine, dict(_drive_numbers(machine, values)), duration)
    return list(_check_ends(machine, joints, low, high))


@keep_by_machine(MODELS_KEPT)
def _check_ends(machine: Machine, joints: tuple[str, ...], low: float, high: float) -> list[str]:
    assert isinstance(machine.drive, TravelDrive)
    drive = machine.drive.model_copy(update={"speed": 1.0, "harmonics": ()})  # time is travel then
    model = build_model(machine.model_copy(update={"drive": drive}), joints, ())
    remarks = []
    for end in (low, high):
        p = model.vector({"drive.speed": math.copysign(1.0, end)})
        times = [abs(end) * k / _TRAVEL_STEPS for k in range(_TRAVEL_STEPS + 1)] if end else [0.0]
        remarks += _remarks(model, p, follow(model, p, times, abs(end))[1])
    return remarks
