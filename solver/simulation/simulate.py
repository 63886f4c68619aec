"""A table of cases to histories of the frame: grouped by model, eight lanes at a time.

Worn machines start with their suspension settled, by way of the healthy machine, which is cheap to simulate. The
start-up transient is mostly that of the suspension, and the frame of a worn machine swings nearly as that of the
healthy one. So the healthy machine runs through the transient, and the worn one starts with its frame moving as that
one's does then. What is left is the transient of the contacts, and of what the wear adds to the frame's motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.answers import check_band
from jointplay.solver.cases.bending import Bending
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.decoupling import decouple
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import History
from jointplay.solver.cases.positions import mobility_of
from jointplay.solver.cases.preparation import Prepared
from jointplay.solver.cases.reach import reach_of
from jointplay.solver.cases.start import Start, start_with_frame
from jointplay.solver.cases.steps import SETTLED_PART, Accuracy, suspension_of
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.equations.links import link_motion
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.turns import alone
from jointplay.solver.errors import AssemblyError, SettingsError
from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.machine import Machine, has_known_effort
from jointplay.solver.machines.parts import RotationDrive
from jointplay.solver.simulation.limit_cycle import Driver, reach_limit_cycle, turning_in
from jointplay.solver.simulation.methods import RUNS
from jointplay.solver.simulation.repeating import periodic_acceleration, watch
from jointplay.solver.simulation.runs import OVERSAMPLING, Run
from jointplay.solver.simulation.turning_starts import start_turning
from jointplay.solver.spectra import sampling


def settle(
    machine: Machine, model: Model, cases: Sequence[Case], ready: Sequence[Prepared], settings: Settings,
    runs: Callable[..., Iterator[Run]],
) -> list[Prepared]:  # fmt: skip
    """Give worn cases for which it saves time another start and a shorter transient.

    Left as they are: the healthy machine, runs of a given duration, machines that do not come round, frames that
    supports do not hold and damp in all their motions, and machines in which more than the frame moves freely while
    nothing is worn. Where the run of the healthy machine gives no start, the remark says so.

    Parameters
    ----------
    machine : Machine
    model : Model
        Of the cases.
    cases : sequence of Case
        The table that they are of.
    ready : sequence of Prepared
        Of one model.
    settings : Settings
    runs : callable
        What integrates cases of one model, :func:`jointplay.solver.simulation.runs.adaptive_runs` or another.
    """
    given = {case.index: case for case in ready}
    worn = [case for case in ready if _gains(machine, model, cases[case.index], case, settings)]
    if not worn:
        return list(ready)
    healthy = [_healthy(cases[case.index]) for case in worn]
    shortest = replace(settings, revolutions=1e-6, motion=True, links=False, settled=False, repeating=False)
    for group in groups(machine, healthy, shortest, [case.accuracy for case in worn]):
        frame = group.model.frame_coordinates
        for index, error in group.failed:
            given[worn[index].index] = _as_drawn(worn[index], str(error))
        if not group.ready or group.model.degrees_of_freedom != len(frame):
            continue
        for run in runs(machine, group.model, group.varying, group.ready, frame, shortest):
            case = worn[run.case.index]
            given[case.index] = _started(model, case, run, settings.sample_rate)
    return list(given.values())


def _gains(machine: Machine, model: Model, case: Case, prepared: Prepared, settings: Settings) -> bool:
    """Whether the frame of the healthy machine has a steady state, and more of a transient than is dropped anyhow."""
    if not model.clearance_joints or settings.duration is not None:
        return False
    return _has_period(machine, case, prepared) and prepared.transient > 1.5 * _drop_time(prepared)


def _has_period(machine: Machine, case: Case, prepared: Prepared) -> bool:
    """Whether drive and loads come round with the numbers of the case, on a frame whose own swings die away."""
    try:
        repeating_frequency(machine, prepared.speed)
    except SettingsError:
        return False
    if not prepared.sprung:
        return False
    if not isinstance(machine.drive, RotationDrive):
        return "drive.speed" not in case.parameters
    rippled = any(path.startswith("drive.ripple.") for path in case.parameters)
    return not rippled or all(ripple.order == round(ripple.order) for ripple in machine.drive.ripple)


def _drop_time(case: Prepared) -> float:
    """Time that is dropped after a settled start, s."""
    revolution = 2 * math.pi / abs(case.speed)
    return revolution * max(1, math.ceil(SETTLED_PART * case.transient / revolution - 1e-9))


def _healthy(case: Case) -> Case:
    """The case without wear, and without the numbers of the worn joints, of which it may have no use."""
    worn = tuple(f"joints.{joint}." for joint in case.fault.joints)
    return Case(HEALTHY, {path: value for path, value in case.parameters.items() if not path.startswith(worn)})


def _as_drawn(case: Prepared, reason: str) -> Prepared:
    return _told(case, f"started as drawn: the healthy machine gave no settled start ({reason})")


def _told(case: Prepared, remark: str) -> Prepared:
    return replace(case, remark="; ".join(filter(None, (case.remark, remark)))) if remark else case


def _started(model: Model, case: Prepared, run: Run, sample_rate: float) -> Prepared:
    """A worn machine after the run of the healthy one."""
    case = replace(case, spent=run.seconds)
    if run.status is not Status.OK:
        return _as_drawn(case, f"{run.status}: {run.message}")
    try:
        start = start_with_frame(model, case.vector, 0.0, case.z, *_end_of_transient(run, sample_rate))
    except AssemblyError as error:
        return _as_drawn(case, str(error))
    dropped = _drop_time(case)
    return replace(case, z=start.z, v=start.v, transient=dropped, duration=case.duration - case.transient + dropped)


def _end_of_transient(run: Run, sample_rate: float) -> tuple[FloatArray, FloatArray]:
    """Displacement and velocity of the frame at the end of the healthy machine's transient, whole revolutions."""
    assert run.z is not None and run.a is not None
    last = run.case.transient * sample_rate
    first = min(math.floor(last), run.z.shape[1] - 2)
    pair, at = slice(first, first + 2), last - first
    z, v, a = run.z[:, pair], run.v[:, 0, sampling.head(OVERSAMPLING) :][:, pair], run.a[:, pair]
    return _cubic(z, v / sample_rate, at), _cubic(v, a / sample_rate, at)


def _cubic(values: FloatArray, slopes: FloatArray, at: float) -> FloatArray:
    """Between two samples with slopes, (r, 2) each, 0 <= `at` <= 1 of the way from the first to the second."""
    left, right = values.T
    down, up = slopes.T
    back = 1 - at
    return np.asarray(back**2 * ((1 + 2 * at) * left + at * down) + at**2 * ((3 - 2 * at) * right - back * up))


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
    """Simulate one case, or a fault alone: radial clearance [m] by joint; see :func:`simulate_batch`.

    Without a case, joints have the clearance that the machine's file gives them; a case or a fault says it in full.
    """
    if not isinstance(case, Case):
        case = Case(Fault(machine.clearances if case is None else case))
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
    settings = settings or Settings()
    reach = reach_of(machine, settings.whole or settings.links)
    group = next(groups(decouple(reach.machine, settings, [case])[0], [reach.case(case)], settings))
    for _, error in group.failed:
        raise error
    return Start(group.ready[0].z, group.ready[0].v)


@alone()
def simulate_batch(
    machine: Machine, cases: Sequence[Case], settings: Settings | None = None,
    progress: Callable[[int], None] | None = None, *, starts: Sequence[Start | None] | None = None,
    accuracies: Sequence[Accuracy] | None = None,
) -> list[History]:  # fmt: skip
    """Simulate a table of cases; of threads that do so at the same time one at a time works at equations.

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
    runs = RUNS[settings.integrator]
    reach, asked = reach_of(machine, settings.whole or settings.links), cases
    cases = [reach.case(case) for case in asked]
    machine, told = decouple(reach.machine, settings, cases)
    results: dict[int, History] = {}
    for group in groups(machine, cases, settings, accuracies):
        model = group.model
        for index, error in group.failed:
            results[index] = _fail(asked[index], Status.CANNOT_ASSEMBLE, str(error), settings)
        ready, free = [], []
        for case in group.ready:
            case = _told(_told(case, told), reach.remark(asked[case.index]))
            start = None if starts is None else starts[case.index]
            if start is None:
                free.append(case)
            else:
                ready.append(_start(case, start))
        recorded = model.frame_coordinates
        driver = Driver(model) if has_known_effort(machine) else None
        if driver is not None and settings.integrator == "full":  # its coordinates are others
            driver = None
            free = [_told(case, "method full does not say whether this is a limit cycle") for case in free]
        if settings.links:
            recorded = list(range(model.size))
        elif driver is not None:
            recorded += [i for i in driver.coordinates if i not in recorded]
        watched = partial(_watched, machine, cases, settings, driver, recorded)
        keep = partial(_keep, results, progress, asked, model, recorded, settings, driver)
        kernel = (machine, model, group.varying)
        if driver is not None and settings.duration is None:
            if settings.settled:
                healthy = [_healthy(cases[case.index]) for case in free]
                free = start_turning(machine, model, driver, free, healthy, settings, runs)
            for reached in reach_limit_cycle(*kernel, driver, recorded, free, settings, runs, watched):
                if isinstance(reached, Run):
                    keep(reached)
                else:
                    ready.append(reached)
        elif settings.settled and driver is None:
            ready += settle(machine, model, cases, free, settings, runs)
        else:
            ready += free
        if not ready:
            continue
        # The driver's angle is part of the motion.
        full = settings if driver is None else replace(settings, motion=True, repeating=False)
        for run in runs(*kernel, [watched(case) for case in ready], recorded, full):
            keep(run)
    return [results[index] for index in range(len(cases))]


def _watched(
    machine: Machine, cases: Sequence[Case], settings: Settings, driver: Driver | None, recorded: Sequence[int],
    case: Prepared,
) -> Prepared:  # fmt: skip
    """Have it looked whether a case repeats, if that is asked for and it can."""
    if not settings.repeating or case.unsteady or not _has_period(machine, cases[case.index], case):
        return case
    return watch(case if driver is None else replace(case, ends=partial(driver.ends, recorded, case.vector)))


def _keep(
    results: dict[int, History], progress: Callable[[int], None] | None, asked: Sequence[Case], model: Model,
    recorded: list[int], settings: Settings, driver: Driver | None, run: Run,
) -> None:  # fmt: skip
    """Add the history of a run to the results."""
    results[run.case.index] = _history(asked[run.case.index], model, run, recorded, settings, driver)
    if progress is not None:
        progress(len(results))


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


def _history(
    case: Case, model: Model, run: Run, recorded: list[int], settings: Settings, driver: Driver | None
) -> History:
    """Frame motion at the sample rate from what was recorded above it."""
    rate = run.case.sample_rate
    wanted = round(run.case.duration * rate) + 1
    head, count = sampling.head(OVERSAMPLING), min(wanted, -(-run.samples // OVERSAMPLING))
    first = 0 if settings.transient else min(count, _first_after(run.case.transient, rate))
    indices = (*model.frame_indices, *model.kinematics.modes)
    rows = {column: recorded.index(i) for column, i in enumerate(indices) if i is not None}

    def frame(motion: FloatArray | None) -> FloatArray:
        if motion is None:
            return np.zeros((0, len(indices)))
        columns = np.zeros((len(indices), count - first))
        for column, row in rows.items():
            columns[column] = motion[row, first:count]
        return columns.T

    if run.period:
        first, count = 0, run.v.shape[1] // OVERSAMPLING
    smooth = np.zeros((len(indices), count - first))
    if run.period:
        smooth[list(rows)] = periodic_acceleration(run.v[list(rows.values())], rate)
    elif count > first and rows:
        velocity = run.v
        if run.samples < (count - 1) * OVERSAMPLING + sampling.reach(OVERSAMPLING) + 1:
            velocity = _hold(run, count)
        if list(rows.items()) == [(0, 0), (1, 1), (2, 2)] and len(velocity) == 3:
            sampling.band_limited_acceleration(velocity, rate * OVERSAMPLING, count, smooth, first=first)
        else:
            some = velocity[list(rows.values())]
            smooth[list(rows)] = sampling.band_limited_acceleration(some, rate * OVERSAMPLING, count, first=first)
    t = run.begin + np.arange(first, count) / rate
    rates = None if run.z is None else run.v[:, 0, head:]
    moved = (frame(run.z), frame(rates), frame(run.a))
    transient = run.begin if run.period else run.case.before + run.case.transient
    turning, remarks = None, [run.message]
    if driver is not None:
        turning = turning_in(run, driver, recorded, slice(first, count), t, *(part[:, :3] for part in moved[:2]))
        remarks.append(turning.say(run.case.before or transient))
        if model.machine.response is not None and turning.is_steady:  # what it turns at is known from here on
            check_band(model.machine, rate, turning.speed)
    remarks.append(run.case.remark if run.status is Status.OK else "")
    message = "; ".join(remark for remark in remarks if remark)
    links = None
    if settings.links and run.z is not None and rates is not None and run.memory is not None:
        state = run.z[:, first:count].T, rates[:, first:count].T
        links = link_motion(model, run.case.vector, t, *state, run.memory[:, first:count].T)
    if not (settings.motion or settings.links):
        moved = (frame(None),) * 3
    z, v, a, band_limited = (motion[:, :3] for motion in (*moved, smooth.T))
    modes = Bending(*(motion[:, 3:] for motion in (*moved, smooth.T))) if len(indices) > 3 else None
    speed = run.case.speed if turning is None else turning.speed * turning.is_steady
    return History(
        case, run.status, message, t, z, v, a, band_limited, rate, transient, speed, run.step,
        run.case.spent + run.seconds, links, _end(run), turning, run.period, modes,
        None if model.machine.response is None else suspension_of(model, run.case.vector),
    )  # fmt: skip
