"""A table of cases, those with equal equations together, and parameters as full paths within the file's bounds."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.preparation import Prepared, model_of, prepare
from jointplay.solver.cases.steps import Accuracy
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import CONTACT_NUMBERS, contact_numbers, contact_path, contact_paths
from jointplay.solver.errors import AssemblyError, MachineError
from jointplay.solver.machines.fault import check_fault
from jointplay.solver.machines.fields import nearest
from jointplay.solver.machines.joints import LEAST_RESTITUTION
from jointplay.solver.machines.machine import Machine, keep_by_machine

_OF_PINS = ("pin_radius", "film.viscosity")
_CONTACT = [f"contact.{name}" for name in CONTACT_NUMBERS if name not in ("clearance", "pin_radius", "viscosity")]
#: Shorthand for all joints with clearance.
SHORTHANDS = (*_CONTACT, *_OF_PINS)
#: Numbers of a joint that count while it has no clearance.
_CLOSED = {
    "turning": ("viscous", "journal_friction"),
    "sliding": ("viscous", "friction", "friction_velocity", "presliding"),
}
#: Last part of paths whose numbers must be greater than 0, and of those that must not be negative.
_POSITIVE = ("mass", "inertia", "friction_velocity", "presliding", "effort_factor", "speed_factor")
_NOT_NEGATIVE = (
    "damping",
    "friction",
    "viscous",
    "viscosity",
    "pin_radius",
    "stiffness",
    "free_length",
    "hysteresis",
    "journal_friction",
)


def _check(machine: Machine, path: str, value: float) -> float:
    if not math.isfinite(value):
        raise MachineError(machine.name, path, value, "must be finite")
    parts = path.split(".")
    name = parts[-2] if parts[-1].isdigit() and len(parts) > 1 else parts[-1]
    contact_stiffness = name == "stiffness" and "contact" in parts
    if (name in _POSITIVE or contact_stiffness) and value <= 0:
        raise MachineError(machine.name, path, value, "must be greater than 0")
    if name in _NOT_NEGATIVE and value < 0:
        raise MachineError(machine.name, path, value, "must not be negative")
    if name == "restitution" and not LEAST_RESTITUTION <= value <= 1:
        raise MachineError(machine.name, path, value, f"must be between {LEAST_RESTITUTION:g} and 1")
    return float(value)


@dataclass(frozen=True)
class _Known:
    """Numbers of a joint that can wear, by their paths from there.

    Attributes
    ----------
    all, closed : tuple of str
        Those that it has, and of these the ones that count while it has no clearance.
    contact : frozenset of str
        Names of the numbers of its contact law.
    paths : frozenset of str
        Full paths of those that are lane parameters in any case.
    """

    all: tuple[str, ...]
    closed: tuple[str, ...]
    contact: frozenset[str]
    paths: frozenset[str]


@keep_by_machine(64)
def _known(machine: Machine) -> dict[str, _Known]:
    """Numbers of all joints that can wear."""
    found = {}
    for name in machine.wearing_joints:
        joint = machine.joints[name]
        closed = _CLOSED[joint.kind]
        numbers = [short for short in SHORTHANDS if short not in _OF_PINS or joint.kind == "turning"]
        contact, paths = contact_numbers(joint), contact_paths(machine, name)
        found[name] = _Known((*numbers, *closed), closed, frozenset(contact), frozenset(paths))
    return found


def full_paths(machine: Machine, case: Case) -> dict[str, float]:
    """Parameters of a case by full path, and its clearances.

    Numbers of a contact that is closed in this case, and the resistance of a joint without clearance where it has some,
    have no effect there and are left out. A short path means the joints whose contact law has such a number.

    Parameters
    ----------
    machine : Machine
    case : Case

    Raises
    ------
    MachineError
        An unknown path, or a value outside the bounds of the machine file.
    """
    values: dict[str, float] = {}
    joints = _known(machine)
    for path, given in case.parameters.items():
        value = _check(machine, path, given)
        first, _, rest = path.partition(".")
        joint, _, number = rest.partition(".")
        if path in SHORTHANDS:
            name = path.rpartition(".")[2]
            if value and not any(name in known.contact for known in joints.values()):
                raise MachineError(machine.name, path, given, f"no contact law of this machine has a {name}")
            for worn in case.fault.joints:
                if name in joints[worn].contact:
                    values.setdefault(contact_path(worn, name), value)
        elif first == "joints" and joint in joints:
            known, name = joints[joint], number.rpartition(".")[2]
            if number not in known.all:
                raise MachineError(machine.name, path, given, f"no such number{nearest(number, known.all)}")
            if number not in known.closed and name not in known.contact:
                # Nothing is what every law has of the numbers that it does not have.
                if value:
                    raise MachineError(machine.name, path, given, f"the contact law of this joint has no {name}")
            elif (joint in case.fault) != (number in known.closed):
                values[path] = value
        else:
            values[path] = value
    for joint, clearance in case.fault.items():
        values[contact_path(joint, "clearance")] = clearance
    return values


@dataclass(frozen=True)
class Group:
    """Cases that share equations.

    Attributes
    ----------
    model : Model
    varying : tuple of str
        Numbers that are neither contact numbers nor the drive speed, by path.
    ready : list of Prepared
    failed : list of (int, AssemblyError)
        Places in the table of those that cannot start, and why.
    """

    model: Model
    varying: tuple[str, ...]
    ready: list[Prepared]
    failed: list[tuple[int, AssemblyError]]


def groups(
    machine: Machine, cases: Sequence[Case], settings: Settings, accuracies: Sequence[Accuracy] | None = None
) -> Iterator[Group]:
    """Prepare a table of cases, those with equal equations together.

    Parameters
    ----------
    machine, cases, settings, accuracies
        As :func:`jointplay.solver.simulation.simulate.simulate_batch`.

    Raises
    ------
    MachineError, SettingsError
        As :func:`jointplay.solver.simulation.simulate.simulate_batch`.
    """
    members: dict[tuple[tuple[str, ...], tuple[str, ...]], list[tuple[int, dict[str, float]]]] = defaultdict(list)
    for index, case in enumerate(cases):
        check_fault(case.fault, machine)
        values = full_paths(machine, case)
        contact = frozenset[str]().union(*(_known(machine)[joint].paths for joint in case.fault.joints))
        varying = tuple(sorted(path for path in values if path not in contact and path != "drive.speed"))
        members[case.fault.joints, varying].append((index, values))
    levels = {level: replace(settings, accuracy=level) for level in set(accuracies or ())}
    for (joints, varying), listed in members.items():
        model = model_of(machine, joints, varying)
        group = Group(model, varying, [], [])
        for index, values in listed:
            own = levels[accuracies[index]] if accuracies is not None else settings
            try:
                group.ready.append(prepare(machine, model, index, values, varying, own))
            except AssemblyError as error:
                group.failed.append((index, error))
        yield group
