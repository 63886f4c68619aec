"""A table of cases, those with equal equations together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from jointplay.solver.cases.history import Case, Settings
from jointplay.solver.cases.parameters import full_paths
from jointplay.solver.cases.preparation import Prepared, model_of, prepare
from jointplay.solver.cases.steps import Accuracy
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import contact_paths
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.fault import check_fault
from jointplay.solver.machines.machine import Machine


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
        contact = {path for joint in case.fault.joints for path in contact_paths(machine, joint)}
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
