"""What one recording says of the clearances of all joints, and what an inspection does, on the grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer, JointClearance
from jointplay.catalogue.diagnosing.verdict import UNKNOWN_BELOW
from jointplay.catalogue.following.play import AXIS, STEP, JointBounds
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.together import LEAST_DENSITY
from jointplay.solver.arrays import FloatArray

SLIP, DOUBTED = 0.01, 0.5
"""Share of recordings that say nothing of wear, whatever they look like; and of those that the machine as filed, worn
or not, does not explain."""

COUNTS = 0.6
"""What a recording counts beside others of its machine: what the model does not know is the same in all of them."""

HALF_90 = 1.6449
"""Half width of a 90 % interval in standard deviations."""

MEASURED = (0.1, 3e-6)
"""Error of a clearance that somebody has measured: part of it, and m (standard deviations)."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Likelihood of the clearances of J joints: a sum over H explanations of products over joints.

    Parameters
    ----------
    weights : ndarray, shape (H,)
        Of the explanations, against what was likely before.
    densities : ndarray, shape (H, J, X)
        Likelihood of each clearance of the grid in each explanation; its size is relative to what is likely before.
    slip : float
        Probability that all of it says nothing.
    """

    weights: FloatArray
    densities: FloatArray
    slip: float


def read_answer(answer: Answer, bounds: Mapping[str, JointBounds], counts: float = COUNTS) -> Evidence:
    """Return what an answer says.

    Parameters
    ----------
    answer : Answer
    bounds : mapping of str to JointBounds
        Of all joints that may wear, in the order of the grid's.
    counts : float
        Power of the likelihood.
    """
    prior = Prior(answer.prior.worn, answer.prior.another, answer.prior.joints)
    most = max(len(match.joints) for match in answer.hypotheses)
    before = np.array([prior.weight(match.joints, len(bounds), most) for match in answer.hypotheses])
    found = np.array([match.probability for match in answer.hypotheses])
    weights = (np.maximum(found, 1e-12) / (before / before.sum())) ** counts
    densities = np.array(
        [[_density(match.joints.get(joint), bounds[joint], counts) for joint in bounds] for match in answer.hypotheses]
    )
    doubted = answer.verdict in ("changed", "unknown") or answer.goodness_of_fit.p_value < UNKNOWN_BELOW
    return Evidence(weights, densities, 1.0 if answer.sensors else DOUBTED if doubted else SLIP)


def _density(found: JointClearance | None, bounds: JointBounds, counts: float) -> FloatArray:
    """Likelihood (X,) of a joint's clearance where it is in order, or worn by so much."""
    if found is None:
        return np.asarray(~bounds.worn, np.float64)
    middle = math.log(found.clearance_um * 1e-6)
    low, high = (math.log(end * 1e-6) for end in found.interval_um)
    width = np.where(middle > AXIS, middle - low, high - middle) / HALF_90
    law = np.exp(-0.5 * ((AXIS - middle) / np.maximum(width, STEP)) ** 2) * bounds.worn
    # Against clearances that are log-uniform beforehand.
    ratio = law / max(law.sum(), 1e-300) * bounds.worn.sum()
    return np.asarray(np.maximum(ratio, LEAST_DENSITY) ** counts * bounds.worn)


def read_measured(clearance: float) -> FloatArray:
    """Return the likelihood (X,) of a joint's clearance where somebody has measured so much, m."""
    part, size = MEASURED
    scatter = math.hypot(part * clearance, size)
    return np.asarray(np.maximum(np.exp(-0.5 * ((np.exp(AXIS) - clearance) / scatter) ** 2), 1e-6))


def weigh(belief: FloatArray, said: Evidence) -> FloatArray:
    """Return what a recording makes the probability of every joint's clearances multiply by, (J, X).

    Every joint is judged in the light of what is believed (J, S, X) of all others.
    """
    marginals = belief.sum(axis=1)
    each = np.einsum("hjx,jx->hj", said.densities, marginals)
    joint = said.weights * np.prod(each, axis=1)
    total = (1.0 - said.slip) * float(joint.sum()) + said.slip
    shares = (1.0 - said.slip) * joint / total
    factor = np.einsum("h,hjx,hj->jx", shares, said.densities, 1.0 / np.maximum(each, 1e-300))
    return np.asarray(factor + said.slip / total)
