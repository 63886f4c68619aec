"""Two explanations of one recording, heard together: a machine as its file says, and one that may differ from it."""

from __future__ import annotations

import math
from dataclasses import replace

from jointplay.catalogue.matching.matcher import HypothesisMatch, MatchResult, ranked

AS_FILED_BEFORE = 0.9
"""Probability, before any recording, that a machine is what its file says."""


def weight_as_filed(p_value: float) -> float:
    """Return the probability that a machine is what its file says, from the p-value of that.

    Notes
    -----
    The Bayes factor of a p-value is at least -e p ln p, below 1 / e (T. Sellke, M. J. Bayarri, J. O. Berger, Am. Stat.
    55 (2001) 62).
    """
    factor = -math.e * p_value * math.log(p_value) if p_value < 1.0 / math.e else 1.0
    odds = AS_FILED_BEFORE / (1.0 - AS_FILED_BEFORE) * factor
    return odds / (1.0 + odds)


def blended(trusted: MatchResult, robust: MatchResult) -> MatchResult:
    """Return the answer of both modes, each with the probability that its machine is the recording's.

    Sets, clearances and levels of a hypothesis are those of the mode that says more for it; a recording is explained as
    well as the better one explains it.
    """
    weight = weight_as_filed(trusted.p_value)
    by_label = {match.label: match for match in trusted.hypotheses}
    matches: list[HypothesisMatch] = []
    for match in robust.hypotheses:
        own = by_label[match.label]
        first, second = weight * own.probability, (1.0 - weight) * match.probability
        said = own if first > second else match
        matches.append(replace(said, probability=first + second, p_value=max(own.p_value, match.p_value)))
    leading = trusted if weight >= 0.5 else robust
    return replace(
        ranked(matches, leading.conformal, leading.sightings),
        mode=leading.mode,
        trusted_p_value=trusted.p_value,
        notes=tuple(dict.fromkeys((*trusted.notes, *robust.notes))),
        network=leading.network,
    )
