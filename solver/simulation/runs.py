"""Prepared cases through a kernel, under error control or with fixed steps: recorded motion of some coordinates."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Settings, Status
from jointplay.solver.cases.preparation import NEVER, Prepared, model_of
from jointplay.solver.cases.rates import error_scales, velocity_scales
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.equations.anchors import row_times
from jointplay.solver.equations.model import MODELS_KEPT, Model
from jointplay.solver.equations.turns import aside
from jointplay.solver.integrators import adaptive, control, gill
from jointplay.solver.integrators.kernel import Kernel, compile_adaptive, compile_model
from jointplay.solver.integrators.lanes import (
    BUSY,
    CASE,
    ENDED,
    FREE,
    NEXT,
    PHASES,
    SLOTS,
    Lanes,
    Queue,
    Records,
    empty_records,
    idle_lanes,
)
from jointplay.solver.machines.machine import Machine, keep_by_machine
from jointplay.solver.simulation.jamming import failure_remark, hold_remark, jam_message
from jointplay.solver.simulation.repeating import Period, Repetition
from jointplay.solver.spectra import sampling

#: Recorded samples per sample asked for; at least 2 so that nothing folds below 0.4 of the sample rate.
OVERSAMPLING = PHASES


@dataclass(frozen=True, eq=False)
class Run:
    """What was recorded of one case.

    Attributes
    ----------
    case : Prepared
    status : Status
    message : str
        For a status other than ok; else a remark on a joint that its friction holds, mostly empty.
    z, a : (r, samples) arrays or None
        Recorded coordinates and accelerations at the sample rate, where motion is wanted. Of a case that failed, the
        samples before.
    v : (r, OVERSAMPLING, head + k) array
        Velocities at :data:`OVERSAMPLING` times the sample rate, by phase
        (:func:`jointplay.solver.spectra.sampling.phases`).
    samples : int
        Velocities that there are.
    memory : (m, samples) array or None
        What contacts remember, at the sample rate, where motion is wanted.
    final : (1 + 2 n + m,) array
        Time, coordinates, velocities and memories at the end; of a case that is ok, those at the last sample of `v`.
    step : float
        s; the mean of an error-controlled run.
    seconds : float
        Processor time.
    begin : float
        Time of the first velocity, s.
    period : int
        Revolutions after which the motion repeats, where it was ended for that; else 0. Of such a run `v` is one
        period, (r, samples), plain, at :data:`OVERSAMPLING` times the sample rate of `case`.
    ends : (k,) array or None
        Of the revolutions of which that is, s; None where their time is prescribed.
    angle : float
        Of the drive at these, rad.
    """

    case: Prepared
    status: Status
    message: str
    z: FloatArray | None
    v: FloatArray
    samples: int
    a: FloatArray | None
    memory: FloatArray | None
    final: FloatArray
    step: float
    seconds: float
    begin: float
    period: int = 0
    ends: FloatArray | None = None
    angle: float = 0.0


def samples_of(case: Prepared) -> int:
    """Recorded samples: to the end, and what the filter needs beyond."""
    return round(case.duration * case.sample_rate) * OVERSAMPLING + sampling.reach(OVERSAMPLING) + 1


def describe_failure(where: str, friction: str, advice: str) -> str:
    """Message of a run that failed, beside its status: where, and joints that friction holds or else general advice."""
    return f"{where}; {friction or f'try {advice}'}"


#: Scaled error of a step that each level of accuracy allows, from measured harmonic errors: docs/measured/solver.md.
TOLERANCES = {"draft": 1e-5, "standard": 1e-6, "reference": 1e-9}
#: Part of it, and least error, of explicit steps with oil: films keep them at the limit of stability, where errors of
#: this size become noise in accelerations, and cost next to nothing less (docs/measured/solver.md).
_WITH_OIL, _LEAST_TOLERANCE = 1e-2, 1e-10
#: Longest step where nothing else bounds it, s.
_LONGEST_STEP = 0.1
#: Trial steps of a case, in multiples of the fixed steps it would take, after which it counts as stalled. The least and
#: the most of them: nothing says beforehand how fast a machine will turn that no motion is prescribed to (half a minute
#: of steps), and no case may hold up the others for days, however stiff it is (some ten minutes to two hours).
_PATIENCE = 10
_LEAST_PATIENCE, _MOST_PATIENCE = 2e7, 2e8
#: The same for implicit steps: fixed ones are counted by what is slow then, and these are not so many, but dearer.
_EASE = 0.05
#: What an error-controlled run can end with.
_STATUSES = {
    control.OK: Status.OK,
    control.DIVERGING: Status.DIVERGED,
    control.STALLED: Status.STEP_TOO_SMALL,
    control.JAMMED: Status.JAMMED,
}


@keep_by_machine(MODELS_KEPT)
def _adaptive_kernel(
    machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...], recorded: tuple[int, ...], implicit: bool
) -> Kernel:
    model = model_of(machine, joints, varying)
    scales = error_scales(machine, model)
    return compile_adaptive(model, scales, recorded, velocity_scales(model, scales) if implicit else None)


def adaptive_runs(
    machine: Machine, model: Model, varying: tuple[str, ...], prepared: Sequence[Prepared], recorded: Sequence[int],
    settings: Settings,
) -> Iterator[Run]:  # fmt: skip
    """Steps under error control, contacts located; parameters as :func:`gill_runs`.

    Of Dormand and Prince, and of Rosenbrock's kind for the cases that are to be implicit. What a run holds is a view of
    records that the next run may overwrite: take what is needed of one run before asking for another.
    """
    for implicit in (False, True):
        same = [case for case in prepared if (case.implicit is not None) == implicit]
        if same:
            kernel = _adaptive_kernel(machine, model.clearance_joints, varying, tuple(recorded), implicit)
            yield from _controlled_runs(machine, model, kernel, same, recorded, settings)


def _controlled_runs(
    machine: Machine, model: Model, kernel: Kernel, prepared: Sequence[Prepared], recorded: Sequence[int],
    settings: Settings,
) -> Iterator[Run]:  # fmt: skip
    # The longest first, so that they end together; a step is about as long as the fifth root of its error.
    waiting = sorted(prepared, key=lambda case: -case.duration / tolerance_of(case, settings) ** 0.2)
    queue = queue_of(machine, model, waiting, settings)
    slots = min(SLOTS, len(waiting))
    remembering, rubbing = (np.array(joints, dtype=np.int64) for joints in (model.remembering, model.bristles.contacts))
    lanes = idle_lanes(model.size, remembering, rubbing, slots)
    channels = np.array(recorded, dtype=np.int64)
    head, most = sampling.head(OVERSAMPLING), int(queue.cases["samples"].max())
    motion = settings.motion or settings.links
    records = empty_records(channels, head, slots, most, model.memory.shape[0], motion)
    work, rows = kernel.work_array(), kernel.first
    repeating = [Repetition(case) if case.look < NEVER else None for case in waiting]
    spent = 0.0
    while lanes.cursor[BUSY] > 0 or lanes.cursor[NEXT] < len(waiting):
        began = time.process_time()
        with aside():
            adaptive.integrate(kernel.functions, work, rows, queue, records, lanes)
        _look(lanes, queue, records, len(model.frame_coordinates), repeating)
        ended = lanes.ended[: lanes.cursor[ENDED]].copy()
        lanes.cursor[ENDED] = 0
        spent += time.process_time() - began
        took = spent / max(1, len(ended))
        for index, slot in ended:
            run = _run(model, waiting[index], queue, int(index), records, int(slot), took)
            repeated = repeating[index]
            yield run if repeated is None or repeated.found is None else _one_period(run, repeated.found)
            lanes.free[lanes.cursor[FREE]] = slot
            lanes.cursor[FREE] += 1
        if len(ended):
            spent = 0.0


def _one_period(run: Run, found: Period) -> Run:
    """The last period of a run that repeats."""
    return replace(
        run, case=replace(run.case, sample_rate=found.rate), z=None, v=found.velocity, a=None, memory=None,
        samples=found.velocity.shape[1], begin=run.begin + found.begin, period=found.revolutions,
        ends=None if found.ends is None else run.begin + found.ends, angle=found.angle,
    )  # fmt: skip


def _look(lanes: Lanes, queue: Queue, records: Records, frame: int, repeating: list[Repetition | None]) -> None:
    """End the cases whose frame, the first coordinates, repeats; look at the others again after another revolution."""
    for lane in lanes.lanes:
        index, done = int(lane["case"]), int(lane["sample"])
        repeated = repeating[index] if index >= 0 else None
        if repeated is None or done < queue.cases["look"][index]:
            continue
        first, slot, count = records.head, int(lane["slot"]), -(-done // OVERSAMPLING)
        motion = records.coordinates[slot][:, :count] if slot < len(records.coordinates) else None
        if repeated.look(records.velocities[slot][:frame, :, first : first + count], done, motion):
            queue.cases["samples"][index] = done
        queue.cases["look"][index] = repeated.next_look(done)


def tolerance_of(case: Prepared, settings: Settings) -> float:
    """Scaled error of a step, for a drive at least as fast as the suspension."""
    return settings.rtol or TOLERANCES[case.accuracy]


def queue_of(machine: Machine, model: Model, waiting: Sequence[Prepared], settings: Settings) -> Queue:
    """The cases as an error-controlled driver takes them."""
    cases = np.zeros(len(waiting), CASE)
    cases["begin"] = [case.begin for case in waiting]
    cases["interval"] = [1 / (case.sample_rate * OVERSAMPLING) for case in waiting]
    tolerances = np.array([tolerance_of(case, settings) for case in waiting])
    if settings.rtol is None and waiting[0].implicit is None:
        finer = np.maximum(_WITH_OIL * tolerances, _LEAST_TOLERANCE)
        tolerances = np.where([case.oiled for case in waiting], finer, tolerances)
    cases["tolerance"] = tolerances * [case.response for case in waiting]
    cases["precision"] = np.minimum(1e-8, 0.01 * tolerances * min(error_scales(machine, model) or [1.0]))
    cases["pace"] = [case.pace for case in waiting]
    cases["samples"] = [samples_of(case) for case in waiting]
    cases["look"] = [case.look for case in waiting]
    cases["longest_step"] = [min(case.smooth_step, _LONGEST_STEP) for case in waiting]
    cases["first_step"] = np.minimum(cases["longest_step"], [case.longest_step for case in waiting])
    ease = np.array([1.0 if case.implicit is None else _EASE for case in waiting])
    needed = [_PATIENCE * case.duration / case.longest_step for case in waiting] / ease
    patience = np.clip(needed, _LEAST_PATIENCE * ease, _MOST_PATIENCE).astype(np.int64)
    cases["most_trials"] = patience if settings.most_trials is None else settings.most_trials
    starts = np.array([np.concatenate([case.z, case.v, case.memory]) for case in waiting])
    vectors = np.array([case.vector for case in waiting]).reshape(len(waiting), -1)
    return Queue(cases, starts, vectors, np.array(row_times(machine)))


def _run(model: Model, case: Prepared, queue: Queue, index: int, records: Records, slot: int, seconds: float) -> Run:
    ended = queue.cases[index]
    samples = int(ended["reached"])
    whole = -(-samples // OVERSAMPLING)
    reached = samples * float(ended["interval"])
    final = np.concatenate([[ended["begin"]], queue.starts[index]])
    status, message = how_it_ended(model, case, int(ended["outcome"]), final, case.begin + reached)
    motion = slot < len(records.coordinates)
    parts = (records.coordinates, records.accelerations, records.memories)
    z, a, memory = ((part[slot, :, :whole] if motion else None) for part in parts)
    velocities = records.velocities[slot]
    step = reached / max(int(ended["accepted"]), 1)
    return Run(case, status, message, z, velocities, samples, a, memory, final, step, seconds, case.begin)


def how_it_ended(model: Model, case: Prepared, outcome: int, final: FloatArray, reached: float) -> tuple[Status, str]:
    """Status and message of an error-controlled run.

    Parameters
    ----------
    model : Model
    case : Prepared
    outcome : int
        See :mod:`jointplay.solver.integrators.control`.
    final : (1 + 2 n + m,) array
        Time, coordinates, velocities and memories with which it ended.
    reached : float
        Time that it has samples of, s.
    """
    status, how = _STATUSES[outcome], f" with {case.implicit}" if case.implicit else ""
    end = (model, final[0], *np.split(final[1 : 1 + 2 * model.size], 2), case.vector)
    if status is Status.OK:
        return status, hold_remark(*end)
    if status is Status.JAMMED:
        return status, jam_message(*end)
    what = "left all bounds" if status is Status.DIVERGED else "no step was small enough, or too many were needed,"
    return status, describe_failure(
        f"{what} at {reached:.6g} s{how}",
        failure_remark(*end),
        f"{'a larger presliding, ' if model.bristles.contacts else ''}another tolerance, or `gill` with a small step",
    )


def _round_number(count: int) -> int:
    """Next of 1, 2, 3, 4, 6, 8, 12, 16, 24 ...: few different steps fill the lanes."""
    power = 1 << max(0, count - 1).bit_length()
    return 3 * power // 4 if power >= 4 and 3 * power // 4 >= count else power


@keep_by_machine(64)
def gill_kernel(machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...]) -> Kernel:
    """The compiled step of :func:`gill_runs`."""
    return compile_model(model_of(machine, joints, varying))


def gill_runs(
    machine: Machine, model: Model, varying: tuple[str, ...], prepared: Sequence[Prepared], recorded: Sequence[int],
    settings: Settings,
) -> Iterator[Run]:  # fmt: skip
    """Runge-Kutta-Gill with fixed steps.

    Cases with equal steps run side by side: no result depends on which other cases are in the table.

    Parameters
    ----------
    machine, model, varying
        As :func:`jointplay.solver.cases.preparation.model_of`.
    prepared : sequence of Prepared
    recorded : sequence of int
        Coordinates to record.
    settings : Settings
    """
    yield from even_runs(model, gill_kernel(machine, model.clearance_joints, varying), prepared, recorded, settings)


def even_runs(
    model: Model, kernel: Kernel, prepared: Sequence[Prepared], recorded: Sequence[int], settings: Settings
) -> Iterator[Run]:
    """Fixed steps of a model's kernel; parameters as :func:`gill_runs`."""
    equal: dict[int, list[Prepared]] = defaultdict(list)
    for case in sorted(prepared, key=lambda case: case.duration):
        steps = math.ceil(1 / (OVERSAMPLING * settings.sample_rate * case.longest_step) - 1e-9)
        equal[_round_number(steps)].append(case)
    for substeps, same in equal.items():
        for first in range(0, len(same), LANES):
            yield from gill_group(model, kernel, same[first : first + LANES], recorded, substeps, settings)


def gill_group(
    model: Model, kernel: Kernel, lanes: Sequence[Prepared], recorded: Sequence[int], substeps: int, settings: Settings,
    integrate: Callable[..., None] = gill.integrate,
) -> Iterator[Run]:  # fmt: skip
    """Up to eight cases side by side; lanes left over repeat the last one.

    Parameters
    ----------
    model, kernel, lanes, recorded, settings
        As :func:`gill_runs`.
    substeps : int
        Steps from one recorded sample to the next.
    integrate : callable
        :func:`jointplay.solver.integrators.gill.integrate`, or what takes and gives the same.
    """
    began = time.process_time()
    rows, work = kernel.rows, kernel.work_array()
    remembered = range(rows.memory.start, rows.slips.stop)
    for lane in range(LANES):
        case = lanes[min(lane, len(lanes) - 1)]
        given = ((rows.z, case.z), (rows.v, case.v), (rows.parameters, case.vector), (remembered, case.memory))
        for place, column in given:
            work[place, lane] = column
    rate = settings.sample_rate * OVERSAMPLING
    h = 1 / (rate * substeps)
    counts = [samples_of(case) for case in lanes]
    places = [*(place[i] for place in (rows.z, rows.v, rows.a) for i in recorded), *remembered]
    record = np.array(places, dtype=np.int64)
    out = np.zeros((LANES, len(record), max(counts)))
    broken = np.zeros(LANES, dtype=np.int64)
    finals = np.zeros((LANES, 2 + 2 * model.size))
    wanted = np.array([counts[min(lane, len(lanes) - 1)] for lane in range(LANES)], dtype=np.int64)
    begins = np.array([lanes[min(lane, len(lanes) - 1)].begin for lane in range(LANES)])
    integrate(
        kernel.functions, work, kernel.first, begins, h, substeps, record, out, broken, wanted, finals
    )  # fmt: skip
    spent = (time.process_time() - began) / len(lanes)
    for lane, case in enumerate(lanes):
        status, reached = Status.OK, counts[lane]
        end = (model, finals[lane, 1], *np.split(finals[lane, 2:], 2), case.vector)
        if 0 <= broken[lane] < reached:
            reached = int(broken[lane])
            status = Status.JAMMED if finals[lane, 0] == gill.JAMMED else Status.DIVERGED
        if status is Status.JAMMED:
            message = jam_message(*end)
        elif status is Status.DIVERGED:
            where = f"left all bounds at {reached / rate:.6g} s with steps of {h:.3g} s"
            message = describe_failure(where, failure_remark(*end), "a higher accuracy or a smaller step")
        else:
            message = hold_remark(*end)
        z, v, a, memory = np.split(out[lane, :, :reached], [len(recorded) * i for i in (1, 2, 3)])
        reduced = [motion[:, ::OVERSAMPLING] for motion in (z, a, memory)]
        final = np.concatenate([finals[lane, 1:], memory[:, -1] if reached else case.memory])
        yield Run(
            case,
            status,
            message,
            reduced[0],
            sampling.phases(v, OVERSAMPLING),
            v.shape[1],
            reduced[1],
            reduced[2],
            final,
            h,
            spent,
            case.begin,
        )
