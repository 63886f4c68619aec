"""Every joint by itself, as the answer shows it: worn or in order, how far, and what could not have been seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.answer import Bound, Condition, JointState
from jointplay.catalogue.matching.matcher import HEALTHY, HypothesisMatch, MatchResult
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray

EDGE = 0.02
"""Share of the catalogue's clearance range, at either end, which an interval has to reach to be a bound."""


def joint_states(
    result: MatchResult, catalogue: Catalogue, coverage: float, limits_um: Mapping[str, float]
) -> dict[str, JointState]:
    """Return what a recording says of every joint of the catalogue's hypotheses.

    Parameters
    ----------
    result : MatchResult
    catalogue : Catalogue
    coverage : float
        Of the set, of worn and in order, that a condition is the only member of.
    limits_um : mapping of str to float
        From which on joints are worn out [um]; of others, as the machine's file says.
    """
    joints = sorted({joint for match in result.hypotheses for joint in match.joints})
    worn = {found.joint: found.median for found in result.best.clearances}
    posteriors = joint_posteriors(result, {joint: plays_of_fits(catalogue, joint) for joint in joints})
    states = {}
    for joint, posterior in posteriors.items():
        sightings = result.sightings
        is_worn = sightings.condition(posterior.p_worn, coverage) if sightings else None
        condition: Condition = "open" if is_worn is None else "worn" if is_worn else "in_order"
        least = sightings.detectable_from(joint, worn) if sightings and joint in sightings.joints else None
        limit_um = limits_um.get(joint, 1e6 * catalogue.machine.joints[joint].worn_out_from)
        low, median, high = (1e6 * posterior.quantile(share) for share in (0.05, 0.5, 0.95))
        states[joint] = JointState(
            condition=condition,
            p_worn=posterior.p_worn,
            p_over_limit=posterior.above(1e-6 * limit_um),
            limit_um=limit_um,
            clearance_um=median,
            interval_um=(low, high),
            bound=_find_bound(posterior, catalogue),
            detectable_from_um=None if least is None else 1e6 * least,
        )
    return states


def plays_of_fits(catalogue: Catalogue, joint: str) -> FloatArray:
    """Return the plays [m] of a joint in the catalogue's machines in order; those of its fit where there are none."""
    matrix = catalogue.matrix
    rows = matrix.rows(HEALTHY)
    if len(rows) and joint in matrix.joints:
        found = matrix.clearance(rows)[:, matrix.joints.index(joint)]
        if (found > 0.0).any():
            return np.asarray(found[found > 0.0], np.float64)
    return np.array(catalogue.machine.joints[joint].play_as_new)


def _span(catalogue: Catalogue, joint: str) -> tuple[float, float] | None:
    """Least and greatest clearance [m] of a worn joint that is told: where it alone is, or else with others.

    The catalogue's cases go beyond the greatest. None where the clearances of its entries are not known.
    """
    spans = catalogue.matrix.ranges.clearance
    labels = [known.label for known in catalogue.matrix.hypotheses if joint in known.joints and known.label in spans]
    found = [spans[joint]] if joint in labels else [spans[label] for label in labels]
    if not found:
        return None
    return min(low for low, _ in found), min(max(high for _, high in found), catalogue.plan.clearance.high)


def _find_bound(posterior: JointPosterior, catalogue: Catalogue) -> Bound:
    span = _span(catalogue, posterior.joint)
    if span is None or posterior.p_worn < 0.5:
        return "none"
    margin = EDGE * math.log(span[1] / span[0])
    if math.log(span[1] / posterior.quantile(0.95)) <= margin:
        return "at_least"
    return "at_most" if math.log(posterior.quantile(0.05) / span[0]) <= margin else "none"


def edge_warnings(best: HypothesisMatch, catalogue: Catalogue) -> list[str]:
    """Warn of clearances at the ends of what the catalogue holds."""
    warnings = []
    for found in best.clearances:
        span = _span(catalogue, found.joint)
        if span is None:
            continue
        margin = EDGE * math.log(span[1] / span[0])
        # What was simulated anew may have an interval that goes beyond them.
        for bound, beyond, inside in (
            (span[0], "smallest", math.log(found.low / span[0])),
            (span[1], "largest", math.log(span[1] / found.high)),
        ):
            if inside <= margin:
                warnings.append(f"clearance of {found.joint} reaches the catalogue's {beyond}, {1e6 * bound:.3g} um")
    return warnings


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
