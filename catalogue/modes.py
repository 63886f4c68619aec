"""Which model a recording is compared with: as simulated (trusted), or with all that may differ in reality (robust)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from catalogue.answer import Mode, ModeAsked, Verdict
from catalogue.entry import AS_NEW, HEALTHY
from catalogue.matching import MatchResult

__all__ = ["DOUBTED_BELOW", "UNKNOWN_BELOW", "Choice", "Mode", "ModeAsked", "chosen", "judged"]

DOUBTED_BELOW = 0.05
"""P-value below which the trusted model is taken to be wrong, where the choice is free."""

UNKNOWN_BELOW = 0.02
"""P-value below which a hypothesis does not explain a recording."""


@dataclass(frozen=True)
class Choice:
    """An answer, and the mode it is from.

    Parameters
    ----------
    result : MatchResult
    used : {"trusted", "robust"}
    trusted_p_value : float or None
        Of the trusted model, where it was asked.
    """

    result: MatchResult
    used: Mode
    trusted_p_value: float | None


def chosen(match: Callable[[Mode], MatchResult], asked: ModeAsked, coverage: float) -> Choice:
    """Answer in the mode that was asked for; ``auto`` is trusted unless that model does not explain the recording.

    Parameters
    ----------
    match : callable
        Answers in a mode.
    asked : {"auto", "trusted", "robust"}
    coverage : float
        Of the candidate set, whose best p-value decides.
    """
    if asked == "robust":
        return Choice(match("robust"), "robust", None)
    trusted = match("trusted")
    p_value = judged(trusted, coverage)[0]
    if asked == "trusted" or p_value >= DOUBTED_BELOW:
        return Choice(trusted, "trusted", p_value)
    return Choice(match("robust"), "robust", p_value)


def judged(result: MatchResult, coverage: float) -> tuple[float, Verdict]:
    """Return the p-value of the explanation, and the verdict.

    The p-value is that of the best fitting hypothesis of the candidate set: a recording is explained if any likely
    cause explains it. Below :data:`UNKNOWN_BELOW` the verdict is unknown; else the likelier one of healthy (the
    healthy and the as-new machine together) and fault.
    """
    likely = result.candidate_set(coverage)
    p_value = max(match.p_value for match in result.hypotheses if match.label in likely)
    if p_value < UNKNOWN_BELOW:
        return p_value, "unknown"
    healthy = result.probability(HEALTHY) + result.probability(AS_NEW)
    return p_value, "healthy" if healthy >= 0.5 else "fault"
