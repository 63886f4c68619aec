"""What draws held out of learning showed of each joint: from which clearance on its wear is seen, and how surely."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import expit

from jointplay.catalogue.matching.conformal import Conformal
from jointplay.solver.arrays import FloatArray

SEEN_ABOVE = 0.5
"""Probability of wear from which on a joint's wear counts as seen."""

SEEN_SHARE = 0.95
"""Share of recordings that show the wear of a joint from its limit of detection on."""

ALIKE = 0.5
"""Standard deviation in ln(clearance) of the other worn joints, within which a draw is like the recording's machine."""

BELOW = 0.3
"""By how much, in ln(clearance), below the least worn clearance one unseen draw is supposed: play of that size is a
fit's."""

STEEPNESS = (12.0, 4.0)
"""Slope of the logistic curve over ln(clearance), mean and standard deviation before any draw is looked at: from 5 to
95 % within a factor of 1.6. Held-out draws of three catalogues show 95 % of wear from 0.88 to 1.02 of the limits on so;
from 0.66 to 0.94 with a slope of 4 +- 2, from 0.74 to 0.92 with 8 +- 4."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """Held-out draws, joint by joint.

    Parameters
    ----------
    joints : tuple of str
    log_clearance : ndarray, shape (m, joints)
        Of the worn joints of each draw, ln m; NaN where a joint is not worn.
    p_worn : ndarray, shape (m, joints)
        Probability of wear that each joint was given.
    conformal : Conformal
        Probabilities of what is true of a joint, worn or in order.
    """

    joints: tuple[str, ...]
    log_clearance: FloatArray
    p_worn: FloatArray
    conformal: Conformal

    @classmethod
    def of(
        cls,
        joints: Sequence[str],
        hypotheses: Sequence[tuple[str, ...]],
        log_clearance: FloatArray,
        posterior: FloatArray,
        weights: FloatArray,
    ) -> Self | None:
        """Learn from the posterior (m, h) of draws over hypotheses, which are given by their worn joints.

        None where the clearances (m, joints) of no draw are known, or no joint is ever worn.
        """
        if not joints or np.isnan(log_clearance).all():
            return None
        member = np.array([[joint in worn for joint in joints] for worn in hypotheses], dtype=np.float64)
        p_worn = np.clip(posterior @ member, 0.0, 1.0)
        is_worn = np.isfinite(log_clearance)
        both = np.stack([1.0 - p_worn.ravel(), p_worn.ravel()], axis=1)
        conformal = Conformal.fit(both, is_worn.ravel().astype(np.int64), np.repeat(weights, len(joints)))
        return cls(tuple(joints), log_clearance, p_worn, conformal)

    def condition(self, p_worn: float, coverage: float) -> bool | None:
        """Return whether a joint of this probability is worn; None where `coverage` does not allow to say."""
        # A probability as high as the coverage is always enough, which only makes sets hold more often.
        least = min(self.conformal.threshold(coverage), coverage)
        worn, in_order = p_worn >= least, 1.0 - p_worn >= least
        return worn if worn != in_order else None

    def detectable_from(self, joint: str, others: Mapping[str, float]) -> float | None:
        """Return the smallest clearance [m] of a joint that 95 % of recordings show.

        Parameters
        ----------
        joint : str
        others : mapping of str to float
            Clearances [m] of the other worn joints. Where no draws have wear in all of these and in the joint, the
            smallest of them are left aside.

        Returns
        -------
        float or None
            None where not even the largest clearance is seen as often.

        Notes
        -----
        Logistic regression of "seen" on ln(clearance), draws weighted by how near the other worn joints' clearances
        are; maximum of the posterior with a normal law of the slope, by Newton's method.
        """
        place = self.joints.index(joint)
        is_worn = np.isfinite(self.log_clearance)
        left = sorted((each for each in others if each != joint), key=lambda each: -others[each])
        while True:
            wanted = np.array([each == joint or each in left for each in self.joints])
            rows = np.flatnonzero((is_worn == wanted).all(axis=1))
            if len(rows) or not left:
                break
            left.pop()
        if not len(rows):
            return None
        weight = np.ones(len(rows))
        for other in left:
            away = self.log_clearance[rows, self.joints.index(other)] - np.log(others[other])
            weight *= np.exp(-0.5 * (away / ALIKE) ** 2) + 1e-3
        x = self.log_clearance[rows, place]
        low, high = float(x.min()), float(x.max())
        seen = self.p_worn[rows, place] >= SEEN_ABOVE
        return _crossing(np.r_[x, low - BELOW], np.r_[seen, False], np.r_[weight, weight.max()], low, high)


def _crossing(x: FloatArray, seen: FloatArray, weight: FloatArray, low: float, high: float) -> float | None:
    """Return where the logistic curve through what was seen over x reaches :data:`SEEN_SHARE`, as exp(x).

    Parameters
    ----------
    x : ndarray, shape (m,)
        ln(clearance).
    seen : ndarray, shape (m,)
        1 where the wear was seen, else 0.
    weight : ndarray, shape (m,)
    low, high : float
        Ends of x: nothing smaller is returned, and None in place of what is larger.
    """
    slope, scatter = STEEPNESS
    middle = float(np.average(x, weights=weight))
    design = np.column_stack([np.ones(len(x)), x - middle])
    found = np.array([0.0, slope])
    prior = np.diag([1e-3, scatter**-2])
    for _ in range(50):
        p = expit(design @ found)
        gradient = design.T @ (weight * (seen - p)) - prior @ (found - [0.0, slope])
        curvature = (design * (weight * p * (1.0 - p))[:, None]).T @ design + prior
        step = np.linalg.solve(curvature, gradient)
        # A concave function: shorter steps than Newton's first ones always lead up.
        found = found + step / max(1.0, float(np.abs(step).max()) / 2.0)
        if np.abs(step).max() < 1e-6:
            break
    if found[1] <= 0.0:
        return None
    at = middle + (float(np.log(SEEN_SHARE / (1.0 - SEEN_SHARE))) - found[0]) / found[1]
    return None if at > high else float(np.exp(max(at, low)))
