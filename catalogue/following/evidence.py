"""What one recording says of the clearances of all joints, and what an inspection does, on the grid."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer, JointClearance
from jointplay.catalogue.following.play import AXIS, STEP, JointBounds
from jointplay.catalogue.following.visits import Visit
from jointplay.catalogue.matching.modes import UNKNOWN_BELOW
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.together import LEAST_DENSITY
from jointplay.solver.arrays import BoolArray, FloatArray

SLIP, DOUBTED = 0.03, 0.1
"""Share of recordings that say nothing of wear, whatever they look like; and of those that the machine as filed, worn
or not, does not explain."""

IN_ORDER, MOST_BIAS = -2.0, 5.0
"""ln(odds) of wear, against what is likely before, that an answer beside the past may give a joint of a machine in
order without being wrong; and by how much it is wrong at most: what is said to be in order may have been worn."""

SCATTER = 0.25
"""Variance of that between answers to one machine, as a part of that between machines: 0.4 and 0.8 squared."""

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
        Likelihood of each clearance in each explanation, relative to what is likely before.
    tells : ndarray, shape (J,)
        How surely it tells of any joint whether it is worn, 0 where that is as likely as before and 1 where it is sure;
        and 0 of joints that it cannot speak of.
    slip : float
        Probability that all of it says nothing.
    """

    weights: FloatArray
    densities: FloatArray
    tells: FloatArray
    slip: float


def read_answer(answer: Answer, bounds: Mapping[str, JointBounds], bias: FloatArray | None = None) -> Evidence:
    """Return what an answer says.

    Parameters
    ----------
    answer : Answer
    bounds : mapping of str to JointBounds
        Of all joints that may wear, in the order of the grid's.
    bias : ndarray, shape (J,), optional
        By how much, in ln(odds), it is known to speak too much for wear in each joint, see :func:`measure_bias`.
    """
    before, found, worn = _weights(answer, bounds)
    if bias is not None:
        found = found * np.exp(-(worn @ bias))
        found = found / found.sum()
    spoken = worn.any(axis=0) & ~worn.all(axis=0)
    odds = _odds(before, found, worn[:, spoken])
    heard = _is_beside_past(answer)
    densities = np.array(
        [[_density(match.joints.get(joint), own) for joint, own in bounds.items()] for match in answer.hypotheses]
    )
    densities[:, ~spoken] = 1.0  # that a catalogue never wears a joint, or always, says nothing of it
    # That a machine is not as its file says is no doubt where it is compared with itself.
    odd = answer.verdict == "unknown" or (answer.verdict == "changed" and not heard)
    doubted = odd or answer.goodness_of_fit.p_value < UNKNOWN_BELOW
    tells = spoken * (1.0 - np.minimum(odds, 1.0 / odds).min(initial=1.0))
    return Evidence(found / before, densities, tells, 1.0 if answer.sensors else DOUBTED if doubted else SLIP)


def measure_bias(visits: Sequence[Visit], bounds: Mapping[str, JointBounds]) -> list[FloatArray | None]:
    """Return by how much, in ln(odds) (J,), the answer of each visit is known to speak too much for wear in each joint.

    Recordings that others are compared with are of the machine in order. What answers to them, beside one another, say
    for wear all the same they have wrong of this machine, and later ones have it wrong, too (docs/decisions/0223). None
    where nothing is known of that: answers of the same catalogue and effort tell it.
    """
    in_order = {sha256 for visit in visits for sha256 in _in_order(visit.answer)}
    said: dict[tuple[str, str], list[FloatArray]] = defaultdict(list)
    for visit in visits:
        if visit.sha256 in in_order and _is_beside_past(visit.answer):
            before, found, worn = _weights(visit.answer, bounds)
            spoken = worn.any(axis=0) & ~worn.all(axis=0)
            own = np.full(len(bounds), IN_ORDER)
            own[spoken] = np.log(_odds(before, found, worn[:, spoken]))
            said[visit.answer.catalogue, visit.answer.effort].append(own - IN_ORDER)
    bias = {kind: np.clip(np.sum(each, axis=0) / (len(each) + SCATTER), 0.0, MOST_BIAS) for kind, each in said.items()}
    answers = [visit.answer for visit in visits]
    return [bias.get((each.catalogue, each.effort)) if _is_beside_past(each) else None for each in answers]


def _is_beside_past(answer: Answer) -> bool:
    """Whether an answer has heard how its recording differs from those of the machine in order."""
    return answer.baseline is not None and answer.baseline.heard


def _in_order(answer: Answer) -> list[str]:
    """Checksums of the recordings of the machine in order that an answer's is compared with."""
    if answer.baseline is None:
        return []
    return [answer.baseline.measurement_sha256, *(each.measurement_sha256 for each in answer.baseline.further)]


def _weights(answer: Answer, bounds: Mapping[str, JointBounds]) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Probabilities (H,) of an answer's hypotheses before it and by it, and which joints each holds worn (H, J)."""
    prior = Prior(answer.prior.worn, answer.prior.another, answer.prior.joints)
    most = max(len(match.joints) for match in answer.hypotheses)
    before = np.array([prior.weight(match.joints, len(answer.joints), most) for match in answer.hypotheses])
    found = np.maximum([match.probability for match in answer.hypotheses], 1e-12)
    worn = np.array([[joint in match.joints for joint in bounds] for match in answer.hypotheses])
    return before / before.sum(), found, worn


def _odds(before: FloatArray, found: FloatArray, worn: BoolArray) -> FloatArray:
    """By how much the odds of wear in joints (J,) change, by hypotheses (H,) that hold them worn (H, J) or not."""
    return np.asarray((found @ worn) / (found @ ~worn) * (before @ ~worn) / (before @ worn))


def _density(found: JointClearance | None, bounds: JointBounds) -> FloatArray:
    """Likelihood (X,) of the clearance of a joint, worn or not, against those that are log-uniform beforehand."""
    if found is None:
        return np.asarray(~bounds.worn, np.float64)
    low, middle, high = np.log(1e-6 * np.array([found.interval_um[0], found.clearance_um, found.interval_um[1]]))
    beyond = np.clip(middle, AXIS[0], AXIS[-1]) - middle
    low, middle, high = low + beyond, middle + beyond, high + beyond
    width = np.where(middle > AXIS, middle - low, high - middle) / HALF_90
    law = bounds.worn * np.exp(-0.5 * ((AXIS - middle) / np.maximum(width, STEP)) ** 2)
    ratio = bounds.worn * np.maximum(law / max(float(law[bounds.worn].mean()), 1e-12), LEAST_DENSITY)
    return np.asarray(ratio / ratio[bounds.worn].mean())


def read_measured(clearance: float) -> FloatArray:
    """Return the likelihood (X,) of a joint's clearance where somebody has measured so much, m."""
    part, size = MEASURED
    scatter = math.hypot(part * clearance, size)
    return np.asarray(np.maximum(np.exp(-0.5 * ((np.exp(AXIS) - clearance) / scatter) ** 2), 1e-6))


def weigh(marginals: FloatArray, said: Evidence) -> tuple[FloatArray, float]:
    """Return what a recording makes the probabilities (J, X) of all clearances multiply by, and whether it is silent.

    The former (J, X) where it says something: every joint is judged in the light of what is believed of all others.
    The latter is the probability that it does not.
    """
    each = np.einsum("hjx,jx->hj", said.densities, marginals)
    joint = said.weights * np.prod(each, axis=1)
    total = float(joint.sum())
    factor = np.einsum("h,hjx,hj->jx", joint / max(total, 1e-300), said.densities, 1.0 / np.maximum(each, 1e-300))
    return np.asarray(factor), said.slip / (said.slip + (1.0 - said.slip) * total)
