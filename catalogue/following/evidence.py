"""What one recording says of the clearances of all joints, and what an inspection does, on the grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer, JointClearance, JointState
from jointplay.catalogue.diagnosing.verdict import UNKNOWN_BELOW
from jointplay.catalogue.following.play import AXIS, SEEN_AT, STEP, JointBounds
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.together import LEAST_DENSITY
from jointplay.solver.arrays import FloatArray

SLIP, DOUBTED = 0.03, 0.15
"""Share of recordings that say nothing of wear, whatever they look like; and of those that the machine as filed, worn
or not, does not explain."""

SHOWN = 0.003
"""Share of recordings of a joint, of the clearance from which its wear shows, that call it in order for no reason."""

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
    edges = [_edge(answer.joints[joint], bounds[joint]) for joint in bounds]
    densities = np.array(
        [
            [
                edge[0] if found is None else _density(found, bounds[joint]) * edge[1]
                for joint, edge in zip(bounds, edges, strict=True)
                for found in [match.joints.get(joint)]
            ]
            for match in answer.hypotheses
        ]
    )
    doubted = answer.verdict in ("changed", "unknown") or answer.goodness_of_fit.p_value < UNKNOWN_BELOW
    return Evidence(weights, densities, 1.0 if answer.sensors else DOUBTED if doubted else SLIP)


def _edge(seen: JointState, bounds: JointBounds) -> tuple[FloatArray, FloatArray]:
    """How likely (X,) a joint is called in order, and worn, by its clearance.

    Of the clearance from which wear shows with 95 %, one in twenty is called in order; where none shows, being called
    in order says nothing.
    """
    begins = math.log(bounds.worn_from)
    if seen.detectable_from_um is None:
        return np.ones(len(AXIS)), np.asarray(AXIS >= begins, np.float64)
    wide = max(math.log(1e-6 * seen.detectable_from_um) - begins, STEP)
    falls = math.log(SHOWN) / wide
    return np.exp(falls * np.maximum(AXIS - begins, 0.0)), np.exp(falls * np.maximum(begins - AXIS, 0.0))


def _density(found: JointClearance, bounds: JointBounds) -> FloatArray:
    """Likelihood (X,) of the clearance of a worn joint, against clearances that are log-uniform beforehand."""
    middle = math.log(found.clearance_um * 1e-6)
    low, high = (math.log(end * 1e-6) for end in found.interval_um)
    width = np.where(middle > AXIS, middle - low, high - middle) / HALF_90
    law = np.exp(-0.5 * ((AXIS - middle) / np.maximum(width, STEP)) ** 2)
    ratio = law / law[bounds.worn].sum() * bounds.worn.sum()
    return np.asarray(np.maximum(ratio, LEAST_DENSITY))


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
