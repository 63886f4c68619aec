"""Queues of prepared cases through a kernel under error control: recorded motion of some coordinates."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.history import Settings, Status
from jointplay.solver.cases.preparation import Prepared, model_of
from jointplay.solver.cases.rates import error_scales
from jointplay.solver.equations.model import MODELS_KEPT, Model
from jointplay.solver.integrators import adaptive, control
from jointplay.solver.integrators.kernel import Kernel, compile_adaptive
from jointplay.solver.integrators.lanes import (
    BUSY,
    CASE,
    ENDED,
    FREE,
    NEXT,
    SLOTS,
    Queue,
    Records,
    empty_records,
    idle_lanes,
)
from jointplay.solver.machines.kept import keep_by_machine
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.jamming import failure_remark, hold_remark, jam_message
from jointplay.solver.simulation.recorded import OVERSAMPLING, Run, describe_failure, samples_of
from jointplay.solver.spectra import sampling

#: Scaled error of a step that each level of accuracy allows, from measured harmonic errors: docs/measured/solver.md.
TOLERANCES = {"draft": 1e-5, "standard": 1e-6, "reference": 1e-9}
#: Longest step where nothing else bounds it, s.
_LONGEST_STEP = 0.1
#: Trial steps of a case, in multiples of the fixed steps it would take, after which it counts as stalled. The least and
#: the most of them: nothing says beforehand how fast a machine will turn that no motion is prescribed to (half a minute
#: of steps), and no case may hold up the others for days, however stiff it is (some ten minutes to two hours).
_PATIENCE = 10
_LEAST_PATIENCE, _MOST_PATIENCE = 2e7, 2e8
#: What an error-controlled run can end with.
_STATUSES = {
    control.OK: Status.OK,
    control.DIVERGING: Status.DIVERGED,
    control.STALLED: Status.STEP_TOO_SMALL,
    control.JAMMED: Status.JAMMED,
}


@keep_by_machine(MODELS_KEPT)
def _adaptive_kernel(
    machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...], recorded: tuple[int, ...]
) -> Kernel:
    model = model_of(machine, joints, varying)
    return compile_adaptive(model, error_scales(machine, model), recorded)


def adaptive_runs(
    machine: Machine, model: Model, varying: tuple[str, ...], prepared: Sequence[Prepared], recorded: Sequence[int],
    settings: Settings,
) -> Iterator[Run]:  # fmt: skip
    """Dormand-Prince steps under error control, contacts located; parameters as :func:`gill_runs`.

    What a run holds is a view of records that the next run may overwrite: take what is needed of one run before asking
    for another.
    """
    if not prepared:
        return
    kernel = _adaptive_kernel(machine, model.clearance_joints, varying, tuple(recorded))
    # The longest first, so that they end together; a step is about as long as the fifth root of its error.
    waiting = sorted(prepared, key=lambda case: -case.duration / tolerance_of(case, settings) ** 0.2)
    queue = queue_of(machine, model, waiting, settings)
    slots = min(SLOTS, len(waiting))
    lanes = idle_lanes(model.size, len(model.contacts), np.array(model.remembering, dtype=np.int64), slots)
    channels, interval = np.array(recorded, dtype=np.int64), 1 / (settings.sample_rate * OVERSAMPLING)
    head, most = sampling.head(OVERSAMPLING), int(queue.cases["samples"].max())
    motion = settings.motion or settings.links
    records = empty_records(channels, interval, head, slots, most, len(model.remembering), motion)
    work, rows = kernel.work_array(), kernel.first
    while lanes.cursor[BUSY] > 0 or lanes.cursor[NEXT] < len(waiting):
        began = time.process_time()
        adaptive.integrate(kernel.functions, work, rows, queue, records, lanes)
        ended = lanes.ended[: lanes.cursor[ENDED]].copy()
        lanes.cursor[ENDED] = 0
        took = (time.process_time() - began) / max(1, len(ended))
        for index, slot in ended:
            yield _run(model, waiting[index], queue, int(index), records, int(slot), took)
            lanes.free[lanes.cursor[FREE]] = slot
            lanes.cursor[FREE] += 1


def tolerance_of(case: Prepared, settings: Settings) -> float:
    """Scaled error of a step, for a drive at least as fast as the suspension."""
    return settings.rtol or TOLERANCES[case.accuracy]


def queue_of(machine: Machine, model: Model, waiting: Sequence[Prepared], settings: Settings) -> Queue:
    """The cases as an error-controlled driver takes them."""
    cases = np.zeros(len(waiting), CASE)
    cases["begin"] = [case.begin for case in waiting]
    tolerances = np.array([tolerance_of(case, settings) for case in waiting])
    cases["tolerance"] = tolerances * [case.response for case in waiting]
    cases["precision"] = np.minimum(1e-8, 0.01 * tolerances * min(error_scales(machine, model) or [1.0]))
    cases["pace"] = [case.pace for case in waiting]
    cases["samples"] = [samples_of(case, settings) for case in waiting]
    cases["longest_step"] = [min(case.smooth_step, _LONGEST_STEP) for case in waiting]
    cases["first_step"] = np.minimum(cases["longest_step"], [case.longest_step for case in waiting])
    needed = [_PATIENCE * case.duration / case.longest_step for case in waiting]
    patience = np.clip(needed, _LEAST_PATIENCE, _MOST_PATIENCE).astype(np.int64)
    cases["most_trials"] = patience if settings.most_trials is None else settings.most_trials
    starts = np.array([np.concatenate([case.z, case.v, case.memory]) for case in waiting])
    return Queue(cases, starts, np.array([case.vector for case in waiting]).reshape(len(waiting), -1))


def _run(model: Model, case: Prepared, queue: Queue, index: int, records: Records, slot: int, seconds: float) -> Run:
    ended = queue.cases[index]
    samples = int(ended["reached"])
    whole = -(-samples // OVERSAMPLING)
    reached = samples * records.interval
    final = np.concatenate([[ended["begin"]], queue.starts[index]])
    status, message = how_it_ended(model, case, int(ended["outcome"]), final, case.begin + reached)
    motion = slot < len(records.coordinates)
    parts = (records.coordinates, records.accelerations, records.memories)
    z, a, memory = ((part[slot, :, :whole] if motion else None) for part in parts)
    velocities = records.velocities[slot]
    step = reached / max(int(ended["accepted"]), 1)
    return Run(case, status, message, z, velocities, samples, a, memory, final, step, seconds)


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
    status = _STATUSES[outcome]
    end = (model, final[0], *np.split(final[1 : 1 + 2 * model.size], 2), case.vector)
    if status is Status.OK:
        return status, hold_remark(*end)
    if status is Status.JAMMED:
        return status, jam_message(*end)
    what = "left all bounds" if status is Status.DIVERGED else "no step was small enough, or too many were needed,"
    return status, describe_failure(
        f"{what} at {reached:.6g} s", failure_remark(*end), "another tolerance, or `gill` with a small step"
    )
