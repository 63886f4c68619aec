"""Figures of what answers say of single joints: whether probabilities, clearances and limits of detection are true."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression
from scipy.stats import kstest

from jointplay.catalogue.diagnosing.answer import Bound, Condition, Diagnosis
from jointplay.catalogue.evaluation.truth import Truth
from jointplay.catalogue.matching.calibration import log_loss
from jointplay.catalogue.matching.matcher import ClearanceEstimate, MatchResult
from jointplay.catalogue.matching.sightings import SEEN_ABOVE, SEEN_SHARE
from jointplay.catalogue.plans.entry import seed_from
from jointplay.solver.arrays import FloatArray

HYPOTHESES = 1000
"""Machines drawn from a posterior, of which a share is nearer to a point than the true one."""

LEAST_BEYOND = 20
"""Joints beyond a multiple of the limit of detection that are needed to say that 95 % of them are seen: a few are by
chance."""

POINTS = 400
"""Points of ln(clearance) through which clearances are drawn."""


@dataclass(frozen=True)
class JointAnswer:
    """What was true of one joint, and what was answered.

    Parameters
    ----------
    joint : str
    worn : bool
        The truth.
    clearance_um : float
        The true one.
    p_worn : float
    condition : {"worn", "in_order", "open"}
    bound : {"none", "at_least", "at_most"}
    detectable_from_um : float or None
        From which on the answer says that wear would have been seen.
    rank : float or None
        Posterior probability of a smaller clearance, given that the joint is worn; None for one that is not, and where
        no hypothesis tells a clearance.
    """

    joint: str
    worn: bool
    clearance_um: float
    p_worn: float
    condition: Condition
    bound: Bound
    detectable_from_um: float | None
    rank: float | None


@dataclass(frozen=True)
class Uniformity:
    """Numbers that are uniform from 0 to 1 where posteriors are true.

    Parameters
    ----------
    distance : float or None
        Largest distance of their empirical distribution from the uniform one (Kolmogorov and Smirnov); None without
        any. By chance it is above 1.36 / sqrt(count) in 5 of 100 cases.
    count : int
        How many there are.
    """

    distance: float | None
    count: int


@dataclass(frozen=True)
class JointFigures:
    """Figures of single joints over a set of recordings; None where there is nothing to count.

    Parameters
    ----------
    log_loss : float or None
        Mean of -ln p of what is true of a joint, worn or in order.
    log_losses : mapping of str to float
        The same joint by joint.
    condition_holds : float or None
        Share of joints that are not called worn where they are in order, or in order where they are worn.
    condition_open : float or None
        Share of joints of which neither is said.
    ranks : Uniformity
        Of the clearances of worn joints: posterior probability of a smaller one, see :func:`rank_of`.
    credibilities : Uniformity
        Of the clearances of all joints at once, see :func:`credibility_of`.
    limit_ratio : float or None
        Clearance from which on 95 % of worn joints were seen, as a multiple of the limit that the answers say; 1 is
        right. None where no clearance that there was is as large, or every one is larger.
    limits : int
        Worn joints whose limit the answers say.
    """

    log_loss: float | None
    log_losses: Mapping[str, float]
    condition_holds: float | None
    condition_open: float | None
    ranks: Uniformity
    credibilities: Uniformity
    limit_ratio: float | None
    limits: int


def joint_answers(truth: Truth, answer: Diagnosis, result: MatchResult) -> tuple[JointAnswer, ...]:
    """Keep of an answer, and of the posterior behind it, what figures of joints are made of."""
    worn = frozenset(truth.hypothesis.joints)
    return tuple(
        JointAnswer(
            joint=joint,
            worn=joint in worn,
            clearance_um=1e6 * truth.clearances[joint],
            p_worn=state.p_worn,
            condition=state.condition,
            bound=state.bound,
            detectable_from_um=state.detectable_from_um,
            rank=rank_of(result, joint, truth.clearances[joint]) if joint in worn else None,
        )
        for joint, state in answer.joints.items()
    )


def rank_of(result: MatchResult, joint: str, clearance: float) -> float | None:
    """Return the posterior probability of a smaller clearance [m] of a joint, given that it is worn.

    Over worn joints whose clearances are drawn as those of the catalogue it is uniform where the posterior is true:
    the rank statistic of simulation-based calibration with as many draws as one likes (Talts et al. 2018,
    arXiv:1804.06788). None where no hypothesis tells a clearance of the joint.
    """
    weighed = [
        (match.probability, estimate)
        for match in result.hypotheses
        for estimate in match.clearances
        if estimate.joint == joint and match.probability > 0.0
    ]
    total = sum(probability for probability, _ in weighed)
    if not total:
        return None
    at = np.log([clearance])
    below = sum(probability * float(estimate.below(at)[0]) for probability, estimate in weighed)
    return min(1.0, below / total)


def credibility_of(truth: Truth, result: MatchResult, fits: Mapping[str, FloatArray]) -> float | None:
    """Return the share of machines drawn from the posterior that are nearer to a random point than the true one.

    Parameters
    ----------
    truth : Truth
    result : MatchResult
    fits : mapping of str to ndarray
        Plays [m] that each joint has where it is not worn.

    Returns
    -------
    float or None
        None where a hypothesis that may be true does not tell the clearances of its joints.

    Notes
    -----
    Over many machines it is uniform where the posterior of all clearances together is true: coverage by tests of
    accuracy with random points (TARP; Lemos et al. 2023, arXiv:2302.03026). Machines are drawn hypothesis by
    hypothesis, clearances of worn joints each from its own posterior there, all others from the plays of fits;
    distances are of ln(clearance). A point lies anywhere where clearances of each joint were drawn, or a little beyond.
    """
    generator = np.random.default_rng(seed_from("credibility", truth.seed))
    joints = sorted(fits)
    matches = [match for match in result.hypotheses if match.probability > 0.0]
    if any(len(match.clearances) < len(match.joints) for match in matches):
        return None
    share = np.array([match.probability for match in matches])
    counts = generator.multinomial(HYPOTHESES, share / share.sum())
    drawn = []
    for match, count in zip(matches, counts, strict=True):
        worn = {estimate.joint: estimate for estimate in match.clearances}
        columns = [
            _draw(worn[joint], generator.uniform(size=count))
            if joint in worn
            else np.log(generator.choice(fits[joint], size=count))
            for joint in joints
        ]
        drawn.append(np.column_stack(columns))
    machines = np.concatenate(drawn)
    true = np.log([truth.clearances[joint] for joint in joints])
    # Where the point lies may follow from the posterior, but not from the truth.
    point = generator.uniform(machines.min(axis=0) - 1.0, machines.max(axis=0) + 1.0)
    away = np.sum((machines - point) ** 2, axis=1)
    return float(np.mean(away < np.sum((true - point) ** 2)))


def _draw(estimate: ClearanceEstimate, uniform: FloatArray) -> FloatArray:
    """Draws (n,) of ln(clearance), by the probability (n,) of a smaller one."""
    reach = (np.log(estimate.low) - 1.0, np.log(estimate.high) + 1.0)
    low, high = (estimate.course[0][0], estimate.course[0][-1]) if estimate.course else reach
    axis = np.linspace(low, high, POINTS)
    return np.asarray(np.interp(uniform, estimate.below(axis), axis), dtype=np.float64)


def joint_figures(answers: Sequence[Sequence[JointAnswer]], credibilities: Sequence[float | None] = ()) -> JointFigures:
    """Return the figures of single joints.

    Parameters
    ----------
    answers : sequence of sequence of JointAnswer
        Joints of every recording.
    credibilities : sequence of float or None
        Of every recording, see :func:`credibility_of`.
    """
    joints = [joint for answer in answers for joint in answer]
    said = [joint for joint in joints if joint.condition != "open"]
    wrong = sum((joint.condition == "worn") != joint.worn for joint in said)
    names = sorted({joint.joint for joint in joints})
    return JointFigures(
        log_loss=_log_loss(joints) if joints else None,
        log_losses={name: _log_loss([joint for joint in joints if joint.joint == name]) for name in names},
        condition_holds=1.0 - wrong / len(joints) if joints else None,
        condition_open=1.0 - len(said) / len(joints) if joints else None,
        ranks=_uniformity([joint.rank for joint in joints]),
        credibilities=_uniformity(credibilities),
        limit_ratio=limit_ratio(joints),
        limits=len(_select_limited(joints)),
    )


def limit_ratio(joints: Sequence[JointAnswer]) -> float | None:
    """Return from which multiple of the limit of detection that answers say on worn joints are seen, 95 % of them.

    A joint is seen where it is more likely worn than not, as for the limits themselves. The share that is seen rises
    with the multiple, in whatever way (isotonic regression): limits of many joints together follow no one curve. None
    where it does not pass 95 % among the multiples that there are, or only among the last few.
    """
    limited = sorted(
        (joint.clearance_um / limit, joint.p_worn >= SEEN_ABOVE) for joint, limit in _select_limited(joints)
    )
    if not limited:
        return None
    share = isotonic_regression([float(seen) for _, seen in limited]).x
    first = int(np.searchsorted(share, SEEN_SHARE))
    return limited[first][0] if 0 < first <= len(limited) - LEAST_BEYOND else None


def _select_limited(joints: Sequence[JointAnswer]) -> list[tuple[JointAnswer, float]]:
    return [
        (joint, joint.detectable_from_um) for joint in joints if joint.worn and joint.detectable_from_um is not None
    ]


def _log_loss(joints: Sequence[JointAnswer]) -> float:
    p_worn = np.array([joint.p_worn for joint in joints])
    return log_loss(np.stack([1.0 - p_worn, p_worn], axis=1), np.array([joint.worn for joint in joints], np.int64))


def _uniformity(values: Sequence[float | None]) -> Uniformity:
    known = [value for value in values if value is not None]
    return Uniformity(float(kstest(known, "uniform").statistic) if known else None, len(known))
