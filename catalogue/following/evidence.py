"""What one recording says of the clearances of all joints, and what an inspection does, on the grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer, JointClearance, JointState
from jointplay.catalogue.following.play import AXIS, SEEN_AT, STEP, JointBounds
from jointplay.catalogue.matching.matcher import UNKNOWN_BELOW
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.together import LEAST_DENSITY
from jointplay.solver.arrays import FloatArray

SLIP, DOUBTED = 0.03, 0.1
"""Share of recordings that say nothing of wear, whatever they look like; and of those that the machine as filed, worn
or not, does not explain."""

SHOWN = 0.003
"""Share of recordings of a joint, of the clearance from which its wear shows, that call it in order for no reason."""

SHARPENS = 3.0
"""Power of the clearance, over that from which wear shows, at which the say on how much it is grows."""

HEARD, LEAST_HEARD = 0.3, 0.3
"""Part of the clearance from which wear shows that does for an answer that has heard the machine's own past; and the
least ln of that over the clearance that counts as wear: docs/decisions/0201."""

HALF_90 = 1.6449
"""Half width of a 90 % interval in standard deviations."""

MEASURED = (0.05, 3e-6)
"""Error of a clearance that somebody has measured: part of it, and m (standard deviations)."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Likelihood of the clearances of J joints: a sum over H explanations of products over joints.

    Parameters
    ----------
    weights : ndarray, shape (H,)
        Of the explanations, against what was likely before.
    densities : ndarray, shape (H, J, X)
        Likelihood of each clearance as it is seen in each explanation, relative to what is likely before.
    slip : float
        Probability that all of it says nothing.
    """

    weights: FloatArray
    densities: FloatArray
    slip: float


def read_answer(answer: Answer, bounds: Mapping[str, JointBounds]) -> Evidence:
    """Return what an answer says.

    Parameters
    ----------
    answer : Answer
    bounds : mapping of str to JointBounds
        Of all joints that may wear, in the order of the grid's.
    """
    prior = Prior(answer.prior.worn, answer.prior.another, answer.prior.joints)
    most = max(len(match.joints) for match in answer.hypotheses)
    before = np.array([prior.weight(match.joints, len(bounds), most) for match in answer.hypotheses])
    found = np.array([match.probability for match in answer.hypotheses])
    weights = np.maximum(found, 1e-12) / (before / before.sum())
    heard = answer.baseline is not None and answer.baseline.heard
    edges = [_edge(answer.joints.get(joint), bounds[joint], heard=heard) for joint in bounds]
    densities = np.array(
        [
            [
                edge.in_order if found is None else _density(found, bounds[joint], edge)
                for joint, edge in zip(bounds, edges, strict=True)
                for found in [match.joints.get(joint)]
            ]
            for match in answer.hypotheses
        ]
    )
    # That a machine is not as its file says is no doubt where it is compared with itself.
    odd = answer.verdict == "unknown" or (answer.verdict == "changed" and not heard)
    doubted = odd or answer.goodness_of_fit.p_value < UNKNOWN_BELOW
    return Evidence(weights, densities, 1.0 if answer.sensors else DOUBTED if doubted else SLIP)


def error_of(answer: Answer, joint: str) -> float:
    """Return the standard deviation of ln(clearance) that an answer gives a joint; explanations without it err by 0."""
    told = [
        (match.probability, match.joints[joint].interval_um) for match in answer.hypotheses if joint in match.joints
    ]
    return math.sqrt(sum(share * (math.log(high / low) / (2.0 * HALF_90)) ** 2 for share, (low, high) in told))


class _Edge(NamedTuple):
    """What an answer can say of clearances (X,) near those that count as wear.

    How likely a joint is called in order, and worn; how much likelier than any other a clearance is at most made by
    where the answer puts it; and whether that it is worn counts in full nevertheless: then relative to the mean of all
    that are wear.
    """

    in_order: FloatArray
    worn: FloatArray
    most: FloatArray
    whole: bool = False


def _edge(seen: JointState | None, bounds: JointBounds, *, heard: bool) -> _Edge:
    """Where an answer's say on small wear ends.

    Below the clearance from which wear shows with 95 % an answer knows whether it shows, not how much it is: what looks
    like 40 um in a sound joint of another machine looks so in every recording of it, unless what it looked like before
    is known.
    """
    begins = math.log(bounds.worn_from)
    if seen is None:
        return _Edge(np.ones(len(AXIS)), np.ones(len(AXIS)), np.ones(len(AXIS)))
    if seen.detectable_from_um is None:
        return _Edge(np.ones(len(AXIS)), np.asarray(AXIS >= begins, np.float64), np.ones(len(AXIS)), whole=heard)
    shows = max(math.log(1e-6 * seen.detectable_from_um), begins + STEP)
    surely = max(shows + math.log(HEARD), begins + LEAST_HEARD) if heard else shows
    falls = math.log(SHOWN) / (surely - begins)
    return _Edge(
        in_order=np.exp(falls * np.maximum(AXIS - begins, 0.0)),
        worn=np.exp(falls * np.maximum(begins - AXIS, 0.0)),
        most=np.exp(SHARPENS * np.maximum(AXIS - shows, 0.0)),
        whole=heard,
    )


def _density(found: JointClearance, bounds: JointBounds, edge: _Edge) -> FloatArray:
    """Likelihood (X,) of the clearance of a worn joint, against clearances that are log-uniform beforehand."""
    low, middle, high = np.log(1e-6 * np.array([found.interval_um[0], found.clearance_um, found.interval_um[1]]))
    beyond = np.clip(middle, AXIS[0], AXIS[-1]) - middle
    low, middle, high = low + beyond, middle + beyond, high + beyond
    width = np.where(middle > AXIS, middle - low, high - middle) / HALF_90
    law = np.exp(-0.5 * ((AXIS - middle) / np.maximum(width, STEP)) ** 2)
    ratio = law / max(float(law[bounds.worn].sum()), 1e-12) * bounds.worn.sum()
    ratio = np.minimum(np.maximum(ratio, LEAST_DENSITY), edge.most)
    return np.asarray(ratio * edge.worn / (float(ratio[bounds.worn].mean()) if edge.whole else 1.0))


def read_measured(clearance: float) -> FloatArray:
    """Return the likelihood (X,) of a joint's clearance where somebody has measured so much, m."""
    part, size = MEASURED
    scatter = math.hypot(part * clearance, size)
    return np.asarray(np.maximum(np.exp(-0.5 * ((np.exp(AXIS) - clearance) / scatter) ** 2), 1e-6))


def weigh(belief: FloatArray, said: Evidence) -> FloatArray:
    """Return what a recording makes the probability of every joint's states (J, D, S, X) multiply by, (J, D, 1, X).

    Every joint is judged in the light of what is believed of all others.
    """
    count = len(AXIS)
    marginals = np.array([np.bincount(SEEN_AT.ravel(), states.sum(axis=1).ravel(), count) for states in belief])
    each = np.einsum("hjx,jx->hj", said.densities, marginals)
    joint = said.weights * np.prod(each, axis=1)
    total = (1.0 - said.slip) * float(joint.sum()) + said.slip
    shares = (1.0 - said.slip) * joint / total
    factor = np.einsum("h,hjx,hj->jx", shares, said.densities, 1.0 / np.maximum(each, 1e-300)) + said.slip / total
    return np.asarray(factor[:, SEEN_AT][:, :, None, :])
