"""What was recorded of one case, by whatever method."""

from __future__ import annotations

from dataclasses import dataclass

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.history import Settings, Status
from jointplay.solver.cases.preparation import Prepared
from jointplay.solver.integrators.lanes import PHASES
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


def samples_of(case: Prepared, settings: Settings) -> int:
    """Recorded samples: to the end, and what the filter needs beyond."""
    return round(case.duration * settings.sample_rate) * OVERSAMPLING + sampling.reach(OVERSAMPLING) + 1


def describe_failure(where: str, friction: str, advice: str) -> str:
    """Message of a run that failed, beside its status: where, and joints that friction holds or else general advice."""
    return f"{where}; {friction or f'try {advice}'}"
