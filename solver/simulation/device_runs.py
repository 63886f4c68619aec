"""Groups of prepared cases through a kernel for a CUDA device: what ``runs.py`` does in lanes.

Imported only where a device is asked for.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from jointplay.solver.cases.history import Settings
from jointplay.solver.cases.preparation import Prepared, model_of
from jointplay.solver.cases.rates import error_scales
from jointplay.solver.equations.model import Model
from jointplay.solver.integrators.device import DeviceKernel, Records, compile_device, memory
from jointplay.solver.machines.kept import kept
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.adaptive_runs import how_it_ended, queue_of
from jointplay.solver.simulation.recorded import OVERSAMPLING, Run, samples_of
from jointplay.solver.spectra import sampling

#: Cases that run side by side are bounded by the memory of their records, bytes: here and on the device.
_RECORD_BYTES = 4e9


@kept(64)
def _kernel(
    machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...], recorded: tuple[int, ...]
) -> DeviceKernel:
    model = model_of(machine, joints, varying)
    return compile_device(model, error_scales(machine, model), recorded)


def device_runs(
    machine: Machine, model: Model, varying: tuple[str, ...], prepared: Sequence[Prepared], recorded: Sequence[int],
    settings: Settings,
) -> Iterator[Run]:  # fmt: skip
    """Dormand-Prince steps under error control, one case a thread; parameters as
    :func:`jointplay.solver.simulation.gill_runs.gill_runs`.
    """
    kernel = _kernel(machine, model.clearance_joints, varying, tuple(recorded))
    room = min(_RECORD_BYTES, 0.5 * memory())
    queue = sorted(prepared, key=lambda case: case.duration)  # threads of a warp end together
    while queue:
        together = max(1, int(room / max(1, 16 * len(recorded) * samples_of(queue[-1], settings))))
        yield from _group(machine, model, kernel, queue[-together:], settings)
        del queue[-together:]


def _group(
    machine: Machine, model: Model, kernel: DeviceKernel, cases: Sequence[Prepared], settings: Settings
) -> Iterator[Run]:
    began = time.process_time()
    rate = settings.sample_rate * OVERSAMPLING
    queue = queue_of(machine, model, cases, settings)
    motion = settings.motion or settings.links
    records = Records.empty(
        len(cases),
        len(kernel.rows.recorded),
        len(model.remembering),
        int(queue.cases["samples"].max()),
        OVERSAMPLING,
        motion,
    )
    ends = kernel.integrate(queue, 1 / rate, records)
    spent = (time.process_time() - began) / len(cases)
    for i, case in enumerate(cases):
        reached = int(ends.reached[i])
        whole = -(-reached // OVERSAMPLING)
        z, a, remembered = (
            part[i, :, :whole] if motion else None
            for part in (records.coordinates, records.accelerations, records.memories)
        )
        v = sampling.phases(records.velocities[i, :, :reached], OVERSAMPLING)
        seconds = reached / rate
        status, message = how_it_ended(model, case, int(ends.outcome[i]), ends.finals[i], case.begin + seconds)
        step = seconds / max(int(ends.accepted[i]), 1)
        yield Run(case, status, message, z, v, reached, a, remembered, ends.finals[i], step, spent)
