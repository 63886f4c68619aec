"""Worn machines that start with their suspension settled, by way of the healthy machine, which is cheap to simulate.

The start-up transient is mostly that of the suspension, and the frame of a worn machine swings nearly as that of the
healthy one. So the healthy machine runs through the transient, and the worn one starts with its frame moving as that
one's does then. What is left is the transient of the contacts, and of what the wear adds to the frame's motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import Case, Settings, Status
from jointplay.solver.cases.preparation import Prepared
from jointplay.solver.cases.start import start_with_frame
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.equations.model import Model
from jointplay.solver.errors import AssemblyError, SettingsError
from jointplay.solver.machines.fault import HEALTHY
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import RotationDrive
from jointplay.solver.simulation.recorded import OVERSAMPLING, Run
from jointplay.solver.spectra import sampling

#: Part of the transient as drawn that is still dropped, in whole revolutions: what the wear itself adds to the motion
#: of the frame decays as slowly as the suspension. Chosen from measured spectra, ``docs/measured/solver.md``.
SETTLED_PART = 0.25


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
        What integrates cases of one model, :func:`jointplay.solver.simulation.adaptive_runs.adaptive_runs` or another.
    """
    given = {case.index: case for case in ready}
    worn = [case for case in ready if _gains(machine, model, cases[case.index], case, settings)]
    if not worn:
        return list(ready)
    healthy = [_healthy(cases[case.index]) for case in worn]
    shortest = replace(settings, revolutions=1e-6, motion=True, links=False, settled=False)
    for group in groups(machine, healthy, shortest, [case.accuracy for case in worn]):
        frame = [index for index in group.model.frame_indices if index is not None]
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
    if not model.clearance_joints or not prepared.sprung or settings.duration is not None:
        return False
    try:
        repeating_frequency(machine, prepared.speed)
    except SettingsError:
        return False
    return _comes_round(machine, case) and prepared.transient > 1.5 * _drop_time(prepared)


def _comes_round(machine: Machine, case: Case) -> bool:
    """Whether the drive does with the numbers of the case, where the machine file has none of them."""
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
    remark = f"started as drawn: the healthy machine gave no settled start ({reason})"
    return replace(case, remark="; ".join(filter(None, (case.remark, remark))))


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
