"""What an ensemble is asked for, and what it gives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.history import Case, Status
from jointplay.solver.cases.steps import SETTLING_REVOLUTIONS
from jointplay.solver.errors import SettingsError
from jointplay.solver.simulation.averages import overall
from jointplay.solver.simulation.blocks import BLOCK, MOTIONS, SEEN

EnsembleKind = Literal["perturbation", "phase"]
#: Blocks that are the least to judge by.
FEWEST = 2


@dataclass(frozen=True)
class Ensemble:
    """What starts, and when to stop.

    Attributes
    ----------
    starts : int
        Members; eight fill the lanes.
    kind : str
        ``perturbation``: all at drive angle 0, their frames a millionth of the machine's extent apart. ``phase``:
        spread evenly over a revolution of the drive.
    converged_db : float or None
        Stop when the averaged levels are known this well: root mean square over the one-order bands of their standard
        error, worst motion of the frame. None for the duration that the settings ask for.
    most_revolutions : float
        Stop there in any case.
    seed : int
        Of the perturbations, or of where in the revolution the first start is.
    healthy_start : bool
        Start in the steady state of the healthy machine instead of as drawn.
    """

    starts: int = 8
    kind: EnsembleKind = "perturbation"
    converged_db: float | None = 0.2
    most_revolutions: float = 400.0
    seed: int = 0
    healthy_start: bool = True

    def __post_init__(self) -> None:
        if not 2 <= self.starts <= 1000:
            raise SettingsError(f"starts: {self.starts}: must be 2 to 1000; a spread needs two")
        if self.kind not in ("perturbation", "phase"):
            raise SettingsError(f"kind: {self.kind}: must be perturbation or phase")
        if self.converged_db is not None and not 0 < self.converged_db < math.inf:
            raise SettingsError(f"converged: {self.converged_db}: must be a finite number of dB greater than 0")
        least = SETTLING_REVOLUTIONS + (FEWEST - 1) * BLOCK + SEEN
        if not least <= self.most_revolutions < math.inf:
            raise SettingsError(f"most revolutions: {self.most_revolutions:g}: must be a number of at least {least}")
        if self.seed < 0:
            raise SettingsError(f"seed: {self.seed}: must be 0 or more")


@dataclass(frozen=True)
class Member:
    """One start: the drive angle (rad) it began at, and how its run ended."""

    angle: float
    status: Status
    message: str


@dataclass(frozen=True, eq=False)
class EnsembleResult:
    """Averaged spectra of a case with their spread.

    Attributes
    ----------
    case : Case
    ensemble : Ensemble
    members : tuple of Member
        Those whose status is not ok are in no average.
    status : Status
        ok if two members at least are.
    message : str
        Why it stopped where it was not converged; remarks.
    channels, units : tuple of str
        x, y, theta of the frame and the machine's sensors; m/s2 and rad/s2.
    frequency : (n,) array
        Hz.
    psd, psd_spread_db : (n, c) arrays
        Mean power spectral density, and the standard deviation of the members' levels, dB.
    orders : (k,) array
    level : (k, c) array
        Rms in the one-order band, of the mean power.
    spread_db, error_db : (k, c) arrays
        Standard deviation of the members' levels over the whole time; standard error of the mean level,
        infinite where there is one block only.
    error : float
        What `converged_db` bounds, dB; infinite where it is not known, because no block resembled the one before.
    converged : bool
        Whether it does; of no meaning where nothing was asked.
    revolutions : int
        That each member was averaged over.
    transient : float
        Revolutions dropped from each member's start.
    drive_speed, sample_rate : float
        rad/s, Hz.
    from_healthy : bool
        Whether members began in the healthy machine's steady state.
    seconds : float
        Processor time of the integration.
    """

    case: Case
    ensemble: Ensemble
    members: tuple[Member, ...]
    status: Status
    message: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    frequency: FloatArray
    psd: FloatArray
    psd_spread_db: FloatArray
    orders: FloatArray
    level: FloatArray
    spread_db: FloatArray
    error_db: FloatArray
    error: float
    converged: bool
    revolutions: int
    transient: float
    drive_speed: float
    sample_rate: float
    from_healthy: bool
    seconds: float

    @property
    def overall_spread(self) -> float:
        """Root mean square of `spread_db` over bands, worst motion of the frame, dB."""
        frame = slice(0, len(MOTIONS))
        return overall(self.spread_db[:, frame], self.level[:, frame] ** 2)
