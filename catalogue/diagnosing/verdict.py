"""The verdict: whether any hypothesis explains a recording, and which kind does."""

from __future__ import annotations

from catalogue.diagnosing.answer import Verdict
from catalogue.matching.matcher import MatchResult
from catalogue.plans.entry import HEALTHY

__all__ = ["UNKNOWN_BELOW", "judged"]

UNKNOWN_BELOW = 0.02
"""P-value below which a hypothesis does not explain a recording."""


def judged(result: MatchResult, coverage: float) -> tuple[float, Verdict]:
    """Return the p-value of the explanation, and the verdict.

    The p-value is that of the best fitting hypothesis of the candidate set: a recording is explained if any likely
    cause explains it. Below :data:`UNKNOWN_BELOW`, or where the set is empty, the verdict is unknown; else the likelier
    one of healthy and fault.
    """
    p_value = result.explained(coverage)
    if p_value < UNKNOWN_BELOW or not result.set(coverage).labels:
        return p_value, "unknown"
    return p_value, "healthy" if result.probability(HEALTHY) >= 0.5 else "fault"
