"""A table of cases to histories of the frame: grouped by model, eight lanes at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import Case, History, Settings, Status
from jointplay.solver.cases.positions import mobility_of
from jointplay.solver.cases.preparation import Prepared
from jointplay.solver.cases.start import Start
from jointplay.solver.cases.steps import Accuracy
from jointplay.solver.equations.links import link_motion
from jointplay.solver.equations.model import Model
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.adaptive_runs import adaptive_runs
from jointplay.solver.simulation.gill_runs import gill_runs
from jointplay.solver.simulation.recorded import OVERSAMPLING, Run
from jointplay.solver.simulation.settling import settle
from jointplay.solver.spectra import sampling


def check_assembly(machine: Machine) -> None:
    """Refuse a machine that cannot be assembled at some angle of its drive.

    Raises
    ------
    AssemblyError
        Names the angle and the joint that stays open.
    """
    mobility_of(machine, (), {})


def simulate(
    machine: Machine, case: Case | Mapping[str, float] | None = None, settings: Settings | None = None
) -> History:
    """Simulate one case, or a fault alone: radial clearance [m] by joint; see :func:`simulate_batch`."""
    if not isinstance(case, Case):
        case = Case(Fault(case))
    return simulate_batch(machine, [case], settings)[0]


def start_of(machine: Machine, case: Case, settings: Settings | None = None) -> Start:
    """Where a case starts as drawn: coordinates and velocities at t = 0, in the order of its model's coordinates.

    Raises
    ------
    AssemblyError
        No start pose, contradicting velocities, or a machine that cannot be assembled at some drive angle.
    MachineError, SettingsError
        As for :func:`simulate_batch`.
    """
    group = next(groups(machine, [case], settings or Settings()))
    for _, error in group.failed:
        raise error
    return Start(group.ready[0].z, group.ready[0].v)


def simulate_batch(
    machine: Machine, cases: Sequence[Case], settings: Settings | None = None,
    progress: Callable[[int], None] | None = None, *, starts: Sequence[Start | None] | None = None,
    accuracies: Sequence[Accuracy] | None = None,
) -> list[History]:  # fmt: skip
    """Simulate a table of cases.

    Parameters
    ----------
    machine : Machine
    cases : sequence of Case
        Any mixture of fault states and parameters; grouped by clearance joints and by step inside.
    settings : Settings, optional
    progress : callable, optional
        Called with the number of cases done after each of them.
    starts : sequence of Start or None, optional
        Where and when each case starts instead of as :func:`start_of`, or settled; its coordinates must fulfil the
        closures. With :attr:`History.end` a run goes on; durations count from the start.
    accuracies : sequence of str, optional
        One a case, instead of that of the settings: few cases at another accuracy then fill lanes with all others.

    Returns
    -------
    list of History
        In the order of the cases. What fails numerically has a status, not an exception.

    Raises
    ------
    MachineError
        A fault or a parameter that the machine does not have, or something the solver does not model.
    SettingsError
        Settings that cannot be met; starts or accuracies that are not one a case.
    """
    settings = settings or Settings()
    for name, given_each in (("starts", starts), ("accuracies", accuracies)):
        if given_each is not None and len(given_each) != len(cases):
            raise SettingsError(f"{name}: {len(given_each)} for {len(cases)} cases: must be one a case")
    runs = gill_runs if settings.integrator == "gill" else adaptive_runs
    results: dict[int, History] = {}
    for group in groups(machine, cases, settings, accuracies):
        model = group.model
        for index, error in group.failed:
            results[index] = _fail(cases[index], Status.CANNOT_ASSEMBLE, str(error), settings)
        ready, free = [], []
        for case in group.ready:
            start = None if starts is None else starts[case.index]
            if start is None:
                free.append(case)
            else:
                ready.append(_start(case, start))
        ready += settle(machine, model, cases, free, settings, runs) if settings.settled else free
        if not ready:
            continue
        recorded = list(range(model.size)) if settings.links else [i for i in model.frame_indices if i is not None]
        for run in runs(machine, model, group.varying, ready, recorded, settings):
            index = run.case.index
            results[index] = _history(cases[index], model, run, recorded, settings)
            if progress is not None:
                progress(len(results))
    return [results[index] for index in range(len(cases))]


def _fail(case: Case, status: Status, message: str, settings: Settings) -> History:
    empty = np.zeros((0, 3))
    return History(
        case, status, message, np.zeros(0), empty, empty, empty, empty, settings.sample_rate, 0.0, 0.0, 0.0, 0.0
    )


def _start(case: Prepared, start: Start) -> Prepared:
    memory = start.memory if start.memory.size else case.memory
    return replace(case, z=start.z, v=start.v, memory=memory, begin=start.t)


def _end(run: Run) -> Start:
    n = run.case.z.size
    z, v, memory = np.split(run.final[1:], [n, 2 * n])
    return Start(z, v, float(run.final[0]), memory)


def _hold(run: Run, count: int) -> FloatArray:
    """Velocities of a case that failed, its last ones held for as long as the filter needs."""
    flat = run.v[:, :, sampling.head(OVERSAMPLING) :].swapaxes(1, 2).reshape(len(run.v), -1)[:, : run.samples]
    missing = (count - 1) * OVERSAMPLING + sampling.reach(OVERSAMPLING) + 1 - run.samples
    return sampling.phases(np.pad(flat, ((0, 0), (0, missing)), mode="edge"), OVERSAMPLING)


def _first_after(transient: float, sample_rate: float) -> int:
    """The first sample that is not before the end of the transient, which begins with the first sample."""
    last = math.floor(transient * sample_rate)
    return next(k for k in range(max(0, last - 1), last + 3) if k / sample_rate >= transient)


def _history(case: Case, model: Model, run: Run, recorded: list[int], settings: Settings) -> History:
    """Frame motion at the sample rate from what was recorded above it."""
    wanted = round(run.case.duration * settings.sample_rate) + 1
    head, count = sampling.head(OVERSAMPLING), min(wanted, -(-run.samples // OVERSAMPLING))
    first = 0 if settings.transient else min(count, _first_after(run.case.transient, settings.sample_rate))
    rows = {column: recorded.index(i) for column, i in enumerate(model.frame_indices) if i is not None}

    def frame(motion: FloatArray | None) -> FloatArray:
        if motion is None:
            return np.zeros((0, 3))
        columns = np.zeros((3, count - first))
        for column, row in rows.items():
            columns[column] = motion[row, first:count]
        return columns.T

    smooth = np.zeros((3, count - first))
    if count > first and rows:
        velocity, rate = run.v, settings.sample_rate * OVERSAMPLING
        if run.samples < (count - 1) * OVERSAMPLING + sampling.reach(OVERSAMPLING) + 1:
            velocity = _hold(run, count)
        if list(rows.items()) == [(0, 0), (1, 1), (2, 2)] and len(velocity) == 3:
            sampling.band_limited_acceleration(velocity, rate, count, smooth, first=first)
        else:
            some = velocity[list(rows.values())]
            smooth[list(rows)] = sampling.band_limited_acceleration(some, rate, count, first=first)
    t = run.case.begin + np.arange(first, count) / settings.sample_rate
    rates = run.v[:, 0, head:]
    remarks = [run.message, run.case.remark if run.status is Status.OK else ""]
    message = "; ".join(remark for remark in remarks if remark)
    links = None
    if settings.links and run.z is not None and run.memory is not None:
        z, v = run.z[:, first:count].T, rates[:, first:count].T
        links = link_motion(model, run.case.vector, t, z, v, run.memory[:, first:count].T)
    return History(
        case, run.status, message, t, frame(run.z),
        frame(None if run.z is None else rates), frame(run.a), smooth.T,
        settings.sample_rate, run.case.transient, run.case.speed, run.step, run.case.spent + run.seconds,
        links, _end(run),
    )  # fmt: skip
