"""What one recording says of the clearances of all joints, and what an inspection does, on the grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer, JointClearance
from jointplay.catalogue.following.play import AXIS, STEP, JointBounds
from jointplay.catalogue.matching.modes import UNKNOWN_BELOW
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.together import LEAST_DENSITY
from jointplay.solver.arrays import BoolArray, FloatArray

SLIP, DOUBTED = 0.03, 0.1
"""Share of recordings that say nothing of wear, whatever they look like; and of those that the machine as filed, worn
or not, does not explain."""

ACQUITTED = 0.5
"""Odds of wear by a recording, against those of before, below which it speaks against wear. Chosen, not measured."""

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
    acquits : ndarray of bool, shape (J,)
        Joints that it speaks against, as far as to call them mended where wear was sure.
    slip : float
        Probability that all of it says nothing.
    """

    weights: FloatArray
    densities: FloatArray
    tells: FloatArray
    acquits: BoolArray
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
    before = np.array([prior.weight(match.joints, len(answer.joints), most) for match in answer.hypotheses])
    before = before / before.sum()
    found = np.maximum([match.probability for match in answer.hypotheses], 1e-12)
    worn = np.array([[joint in match.joints for joint in bounds] for match in answer.hypotheses])
    spoken = worn.any(axis=0) & ~worn.all(axis=0)
    unsettled = worn[:, spoken]
    odds = (found @ unsettled) / (found @ ~unsettled) * (before @ ~unsettled) / (before @ unsettled)
    heard = answer.baseline is not None and answer.baseline.heard
    densities = np.array(
        [[_density(match.joints.get(joint), own) for joint, own in bounds.items()] for match in answer.hypotheses]
    )
    densities[:, ~spoken] = 1.0  # that a catalogue never wears a joint, or always, says nothing of it
    # That a machine is not as its file says is no doubt where it is compared with itself.
    odd = answer.verdict == "unknown" or (answer.verdict == "changed" and not heard)
    doubted = odd or answer.goodness_of_fit.p_value < UNKNOWN_BELOW
    tells = spoken * (1.0 - np.minimum(odds, 1.0 / odds).min(initial=1.0))
    slip = 1.0 if answer.sensors else DOUBTED if doubted else SLIP
    acquits = np.zeros(len(bounds), bool)
    acquits[spoken] = (odds < ACQUITTED) & (slip < 1.0)
    return Evidence(found / before, densities, tells, acquits, slip)


def _density(found: JointClearance | None, bounds: JointBounds) -> FloatArray:
    """Likelihood (X,) of the clearance of a joint, worn or not, against those that are log-uniform beforehand.

    What is told of wear below the least that counts as such, or beyond the grid, is that of its end.
    """
    if found is None:
        return np.asarray(~bounds.worn, np.float64)
    low, middle, high = np.log(1e-6 * np.array([found.interval_um[0], found.clearance_um, found.interval_um[1]]))
    beyond = np.clip(middle, AXIS[bounds.worn][0], AXIS[-1]) - middle
    low, middle, high = low + beyond, middle + beyond, high + beyond
    width = np.where(middle > AXIS, middle - low, high - middle) / HALF_90
    law = bounds.worn * np.exp(-0.5 * ((AXIS - middle) / np.maximum(width, STEP)) ** 2)
    ratio = bounds.worn * np.maximum(law / max(float(law[bounds.worn].mean()), 1e-12), LEAST_DENSITY)
    return np.asarray(ratio / ratio[bounds.worn].mean())


def read_measured(clearance: float) -> FloatArray:
    """Return the likelihood (X,) of a joint's clearance where somebody has measured so much, m.

    What is beyond the grid is that of its end.
    """
    part, size = MEASURED
    clearance = min(clearance, math.exp(AXIS[-1]))
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
