"""From hypotheses, each a set of worn joints, to every joint by itself: how likely worn, and its clearance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.solver.arrays import FloatArray

POINTS = 400
"""Points of ln(clearance) at which a posterior is kept."""


@dataclass(frozen=True, eq=False)
class JointPosterior:
    """Clearance of one joint, whatever the others are like.

    Parameters
    ----------
    joint : str
    p_worn : float
        Probability of play beyond that of a fit.
    log_clearance : ndarray, shape (n,)
        Points, in rising order.
    below : ndarray, shape (n,)
        Probability of a smaller clearance.
    """

    joint: str
    p_worn: float
    log_clearance: FloatArray
    below: FloatArray

    def quantile(self, share: float) -> float:
        """Return the clearance [m] below which lies a share of the probability."""
        return float(np.exp(np.interp(share, self.below, self.log_clearance)))

    def above(self, clearance: float) -> float:
        """Return the probability of more than a clearance [m]."""
        return float(np.clip(1.0 - np.interp(np.log(clearance), self.log_clearance, self.below), 0.0, 1.0))


def joint_posteriors(result: MatchResult, fits: Mapping[str, FloatArray]) -> dict[str, JointPosterior]:
    """Return the posterior of every joint: that of each hypothesis it is worn in, and of its fit in the others.

    Parameters
    ----------
    result : MatchResult
        Its clearances are those of worn joints.
    fits : mapping of str to ndarray
        Plays [m] that each joint has where it is not worn.
    """
    found = {}
    for joint, plays in fits.items():
        weighed = [
            (match.probability, estimate)
            for match in result.hypotheses
            for estimate in match.clearances
            if estimate.joint == joint and match.probability > 0.0
        ]
        p_worn = min(1.0, sum(match.probability for match in result.hypotheses if joint in match.joints))
        known = np.sort(np.log(plays))
        # A hypothesis without clearances says nothing of how large they are; those that do, share out its probability.
        total = sum(probability for probability, _ in weighed)
        ends = [known[0], known[-1]]
        for _, estimate in weighed:
            reach = [np.log(estimate.low) - 1.0, np.log(estimate.high) + 1.0]
            ends += list(estimate.course[0][[0, -1]]) if estimate.course else reach
        axis = np.linspace(min(ends) - 1e-6, max(ends) + 1e-6, POINTS)
        cumulated = np.searchsorted(known, axis, side="right") / len(known) * (1.0 - p_worn if weighed else 1.0)
        for probability, estimate in weighed:
            cumulated = cumulated + p_worn * probability / total * estimate.below(axis)
        cumulated = np.maximum.accumulate(np.clip(cumulated, 0.0, 1.0))
        found[joint] = JointPosterior(joint, p_worn, axis, cumulated)
    return found
