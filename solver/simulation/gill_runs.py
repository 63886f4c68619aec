"""Groups of prepared cases through a kernel with fixed steps: recorded motion of some coordinates."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np

from jointplay.solver.cases.history import Settings, Status
from jointplay.solver.cases.preparation import Prepared, model_of
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.equations.model import Model
from jointplay.solver.integrators import gill
from jointplay.solver.integrators.kernel import Kernel, compile_model
from jointplay.solver.machines.kept import keep_by_machine
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.jamming import failure_remark, hold_remark, jam_message
from jointplay.solver.simulation.recorded import OVERSAMPLING, Run, describe_failure, samples_of
from jointplay.solver.spectra import sampling


def _round_number(count: int) -> int:
    """Next of 1, 2, 3, 4, 6, 8, 12, 16, 24 ...: few different steps fill the lanes."""
    power = 1 << max(0, count - 1).bit_length()
    return 3 * power // 4 if power >= 4 and 3 * power // 4 >= count else power


@keep_by_machine(64)
def _gill_kernel(machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...]) -> Kernel:
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
    kernel = _gill_kernel(machine, model.clearance_joints, varying)
    equal: dict[int, list[Prepared]] = defaultdict(list)
    for case in sorted(prepared, key=lambda case: case.duration):
        steps = math.ceil(1 / (OVERSAMPLING * settings.sample_rate * case.longest_step) - 1e-9)
        equal[_round_number(steps)].append(case)
    for substeps, same in equal.items():
        for first in range(0, len(same), LANES):
            yield from _gill_group(model, kernel, same[first : first + LANES], recorded, substeps, settings)


def _gill_group(
    model: Model, kernel: Kernel, lanes: Sequence[Prepared], recorded: Sequence[int], substeps: int, settings: Settings
) -> Iterator[Run]:
    """Up to eight cases side by side; lanes left over repeat the last one."""
    began = time.process_time()
    rows, work = kernel.rows, kernel.work_array()
    for lane in range(LANES):
        case = lanes[min(lane, len(lanes) - 1)]
        given = ((rows.z, case.z), (rows.v, case.v), (rows.parameters, case.vector), (rows.memory, case.memory))
        for place, column in given:
            work[place, lane] = column
    rate = settings.sample_rate * OVERSAMPLING
    h = 1 / (rate * substeps)
    counts = [samples_of(case, settings) for case in lanes]
    places = [*(place[i] for place in (rows.z, rows.v, rows.a) for i in recorded), *rows.memory]
    record = np.array(places, dtype=np.int64)
    out = np.zeros((LANES, len(record), max(counts)))
    broken = np.zeros(LANES, dtype=np.int64)
    finals = np.zeros((LANES, 2 + 2 * model.size))
    wanted = np.array([counts[min(lane, len(lanes) - 1)] for lane in range(LANES)], dtype=np.int64)
    begins = np.array([lanes[min(lane, len(lanes) - 1)].begin for lane in range(LANES)])
    gill.integrate(
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
        )
