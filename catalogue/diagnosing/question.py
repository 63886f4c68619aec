"""How a recording is to be diagnosed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import get_args

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.prior import Prior

MOST_CASES = 100_000
"""Cases that an effort of thorough may ask for, at most: some hours."""

MOST_TOGETHER = 20
"""Recordings of one machine that have one answer, at most."""


@dataclass(frozen=True)
class Question:
    """How a recording is to be diagnosed.

    Parameters
    ----------
    effort : {"fast", "standard", "thorough"}
        ``fast`` looks the answer up in a model for about this noise, ``standard`` refits what that leaves open to the
        noise of the recording where no network knows it, and looks for causes other than play where none is needed,
        too; ``thorough`` also simulates the machine as found where that can change the answer.
    mode : {"auto", "trusted", "robust"}
        Whether the machine is taken to be as simulated, or to differ from it in whatever the catalogue varies;
        ``auto`` trusts the model unless it does not explain the recording.
    coverage : float
        Probability the candidate set is to hold, in (0, 1).
    cases : int
        Cases that ``thorough`` may simulate, > 0.
    prior : Prior
        Which joints are likely to wear, and how many at once.
    limits_um : mapping of str to float
        Radial clearance [um] from which a joint of this very machine is worn out, where it is not as its file says.
    progress : callable, optional
        Called with the number of cases done and their total, while ``thorough`` simulates for a recording.

    Raises
    ------
    DiagnosisError
        A setting breaks a rule.
    """

    effort: Effort = "standard"
    mode: ModeAsked = "auto"
    coverage: float = 0.95
    cases: int = 2304
    prior: Prior = field(default_factory=Prior)
    limits_um: Mapping[str, float] = field(default_factory=dict)
    progress: Callable[[int, int], None] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if not 0.0 < self.coverage < 1.0:
            raise DiagnosisError(f"coverage: {self.coverage}: must be between 0 and 1")
        if not 0 < self.cases <= MOST_CASES:
            raise DiagnosisError(f"cases: {self.cases}: must be a whole number from 1 to {MOST_CASES}")
        for joint, limit in self.limits_um.items():
            if not 0.0 < limit < math.inf:
                raise DiagnosisError(f"limits_um.{joint}: {limit}: must be greater than 0")
        for name, known in (("effort", get_args(Effort)), ("mode", get_args(ModeAsked))):
            if getattr(self, name) not in known:
                *first, last = known
                raise DiagnosisError(f"{name}: {getattr(self, name)}: must be {', '.join(first)} or {last}")
