"""What one recording says, as it is handed on from matching to telling."""

from __future__ import annotations

from dataclasses import dataclass

from jointplay.catalogue.diagnosing.answer import EffortSpent, Verdict
from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.past import PastComparison
from jointplay.catalogue.diagnosing.verdict import OTHERWISE_BELOW
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.solver.arrays import FloatArray

NOTHING_SPENT = EffortSpent(simulations=0, generations=0, note="")


@dataclass(frozen=True, eq=False)
class Heard:
    """What one recording says.

    Parameters
    ----------
    prepared : PreparedMeasurement
        As it was compared.
    sha256 : str
        Of the recording.
    sensing : Sensing
    feature : ndarray, shape (d,)
    result : MatchResult
        Posterior of what is worn.
    causes : tuple of NamedCause
        Other than play, the most probable first.
    p_value : float
    verdict : Verdict
    spent : EffortSpent
    known : KnownMachine, optional
        What a recording of the machine in order has shown.
    weighed : bool
        Whether entries counted by how near they are to that.
    past : PastComparison, optional
        The recording beside those of the machine in order.
    as_recorded : Heard, optional
        What it said before it was converted to the mounts and the frame of the machine file, where it was.
    """

    prepared: PreparedMeasurement
    sha256: str
    sensing: Sensing
    feature: FloatArray
    result: MatchResult
    causes: tuple[NamedCause, ...]
    p_value: float
    verdict: Verdict
    spent: EffortSpent = NOTHING_SPENT
    known: KnownMachine | None = None
    weighed: bool = False
    past: PastComparison | None = None
    as_recorded: Heard | None = None

    @property
    def p_since(self) -> float | None:
        """P-value of the recording beside the machine's own past; None where it has not been compared with that."""
        return self.past.p_value if self.past else None

    @property
    def is_as_it_was(self) -> bool:
        """Whether it has been compared, and the machine is as it was when it was in order."""
        return self.p_since is not None and self.p_since >= OTHERWISE_BELOW
