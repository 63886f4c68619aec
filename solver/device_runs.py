"""Groups of prepared cases through a kernel for a CUDA device; what :func:`solver.runs.adaptive_runs` does in lanes.

Imported only where a device is asked for.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np

from solver.device import CaseLimits, DeviceKernel, Records, compile_device, memory
from solver.errors import SettingsError
from solver.history import Settings
from solver.machine import Machine
from solver.model import Model
from solver.preparation import Prepared, model_of
from solver.runs import OVERSAMPLING, TOLERANCES, Run, _samples, _scales, how_it_ended, step_bounds, with_head

#: Cases that run side by side are bounded by the memory of their records, bytes: here and on the device.
_RECORD_BYTES = 4e9


@lru_cache(maxsize=64)
def _kernel(
    machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...], recorded: tuple[int, ...]
) -> DeviceKernel:
    model = model_of(machine, joints, varying)
    return compile_device(model, _scales(machine, model), recorded)


def device_runs(
    machine: Machine, model: Model, varying: tuple[str, ...], prepared: Sequence[Prepared], recorded: Sequence[int],
    settings: Settings,
) -> Iterator[Run]:  # fmt: skip
    """Dormand-Prince steps under error control, one case a thread; parameters as :func:`solver.runs.gill_runs`.

    Raises
    ------
    SettingsError
        A contact law that remembers, or a case that starts at another time than 0.
    """
    if any(case.begin for case in prepared):
        raise SettingsError(f"device: {settings.device}: runs start at t = 0 there; go on with one on the cpu")
    if model.remembering:
        joint = model.clearance_joints[model.remembering[0]]
        rule = f"the contact law of joint {joint} remembers its impacts, which only runs on the processor do"
        raise SettingsError(f"device: {settings.device}: {rule}")
    kernel = _kernel(machine, model.clearance_joints, varying, tuple(recorded))
    room = min(_RECORD_BYTES, 0.5 * memory())
    queue = sorted(prepared, key=lambda case: case.duration)  # threads of a warp end together
    while queue:
        together = max(1, int(room / max(1, 16 * len(recorded) * _samples(queue[-1], settings))))
        yield from _group(machine, model, kernel, queue[-together:], settings)
        del queue[-together:]


def _group(
    machine: Machine, model: Model, kernel: DeviceKernel, cases: Sequence[Prepared], settings: Settings
) -> Iterator[Run]:
    began = time.process_time()
    rate = settings.sample_rate * OVERSAMPLING
    tolerance = settings.rtol or TOLERANCES[settings.accuracy]
    extent = min(scale for scale in _scales(machine, model)[: model.size] or [1.0])
    first, longest, most = step_bounds(cases)
    samples = np.array([_samples(case, settings) for case in cases], dtype=np.int64)
    limits = CaseLimits(first, longest, samples, most)
    records = Records.empty(len(cases), len(kernel.rows.recorded), int(samples.max()), OVERSAMPLING)
    ends = kernel.integrate(
        np.array([np.concatenate([case.z, case.v]) for case in cases]),
        np.array([case.vector for case in cases]).reshape(len(cases), -1),
        limits, 1 / rate, tolerance, min(1e-8, 0.01 * tolerance * extent), records,
    )  # fmt: skip
    spent = (time.process_time() - began) / len(cases)
    for i, case in enumerate(cases):
        reached = int(ends.reached[i])
        whole = -(-reached // OVERSAMPLING)
        z, a = (motion[i, :, :whole] for motion in (records.coordinates, records.accelerations))
        v = records.velocities[i, :, :reached]
        status, message = how_it_ended(model, case, int(ends.outcome[i]), ends.finals[i], reached / rate)
        yield Run(
            case,
            status,
            message,
            z,
            with_head(v),
            a,
            np.zeros((0, whole)),
            ends.finals[i],
            reached / rate / max(int(ends.accepted[i]), 1),
            spent,
        )
