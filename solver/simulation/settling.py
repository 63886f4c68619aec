"""Worn machines that start with their suspension settled, by way of the healthy machine, which is shortest to simulate.

The start-up transient is mostly that of the suspension, and the frame of a worn machine swings nearly as that of the
healthy one. So the healthy machine runs through the transient, and the worn one starts with its frame moving as that
one's does then; it still has the transient of its contacts, :data:`SETTLED_REVOLUTIONS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from solver.cases.groups import Group, groups
from solver.cases.history import Case, Settings, Status
from solver.cases.preparation import Prepared
from solver.cases.start import start_with_frame
from solver.equations.drive import repeating_frequency
from solver.equations.model import Model
from solver.errors import AssemblyError, SettingsError
from solver.machines.fault import HEALTHY
from solver.machines.machine import Machine
from solver.simulation.recorded import OVERSAMPLING, Run
from solver.spectra import sampling

Array = NDArray[np.float64]

#: Dropped after such a start, in place of the suspension's transient; chosen from measured spectra, ``docs/solver.md``.
SETTLED_REVOLUTIONS = 1.0


def settled(
    machine: Machine, cases: Sequence[Case], group: Group, settings: Settings, runs: Callable[..., Iterator[Run]]
) -> list[Prepared]:
    """The cases of a group, those for which it saves time with another start and a shorter transient.

    Left as they are: the healthy machine, a fixed frame, machines that do not come round, and those in which more than
    the frame moves freely while nothing is worn. Where the healthy machine has no steady state, the remark says so.

    Parameters
    ----------
    machine : Machine
    cases : sequence of Case
        The table that the group was made of.
    group : Group
    settings : Settings
    runs : callable
        What integrates groups of cases, :func:`solver.simulation.adaptive_runs.adaptive_runs` or another.
    """
    worn = {place: case for place, case in enumerate(group.ready) if _gains(machine, group.model, case)}
    if not worn:
        return group.ready
    healthy = [replace(cases[case.index], fault=HEALTHY) for case in worn.values()]
    shortest = replace(settings, duration=None, revolutions=1e-6, motion=True, links=False, settled=False)
    ready, places = list(group.ready), list(worn)
    for other in groups(machine, healthy, shortest, [case.accuracy for case in worn.values()]):
        model, frame = other.model, [index for index in other.model.frame_indices if index is not None]
        for index, error in other.failed:
            ready[places[index]] = _as_drawn(worn[places[index]], str(error))
        if model.degrees_of_freedom != len(frame):
            continue
        for run in runs(machine, model, other.varying, other.ready, frame, shortest):
            place = places[run.case.index]
            ready[place] = _started(group.model, worn[place], run, shortest, settings.duration is None)
    return ready


def _gains(machine: Machine, model: Model, case: Prepared) -> bool:
    """Whether there is a steady state, and a transient that is longer than what is dropped anyhow."""
    if not model.clearance_joints or all(index is None for index in model.frame_indices):
        return False
    try:
        frequency = repeating_frequency(machine, case.speed)
    except SettingsError:
        return False
    return case.transient * frequency > SETTLED_REVOLUTIONS + 0.5


def _as_drawn(case: Prepared, reason: str) -> Prepared:
    remark = f"started as drawn: the healthy machine has no steady state ({reason})"
    return replace(case, remark="; ".join(filter(None, (case.remark, remark))))


def _started(model: Model, case: Prepared, run: Run, settings: Settings, shorter: bool) -> Prepared:
    """A worn machine after the run of the healthy one."""
    if run.status is not Status.OK:
        return _as_drawn(case, f"{run.status}: {run.message}")
    try:
        start = start_with_frame(model, case.vector, 0.0, case.z, *_end_of_transient(run, settings.sample_rate))
    except AssemblyError as error:
        return _as_drawn(case, str(error))
    transient = SETTLED_REVOLUTIONS * 2 * math.pi / abs(case.speed)
    duration = case.duration - (case.transient - transient if shorter else 0.0)
    return replace(case, z=start.z, v=start.v, transient=transient, duration=duration)


def _end_of_transient(run: Run, sample_rate: float) -> tuple[Array, Array]:
    """Displacement and velocity of the frame at the end of the healthy machine's transient, whole revolutions."""
    assert run.z is not None and run.a is not None
    last = run.case.transient * sample_rate
    first = min(math.floor(last), run.z.shape[1] - 2)
    pair, at = slice(first, first + 2), last - first
    z, v, a = run.z[:, pair], run.v[:, 0, sampling.head(OVERSAMPLING) :][:, pair], run.a[:, pair]
    return _cubic(z, v / sample_rate, at), _cubic(v, a / sample_rate, at)


def _cubic(values: Array, slopes: Array, at: float) -> Array:
    """Between two samples with slopes, (r, 2) each, 0 <= `at` <= 1 of the way from the first to the second."""
    left, right = values.T
    down, up = slopes.T
    back = 1 - at
    return np.asarray(back**2 * ((1 + 2 * at) * left + at * down) + at**2 * ((3 - 2 * at) * right - back * up))
