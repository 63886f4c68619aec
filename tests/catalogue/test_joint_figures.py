"""Figures of single joints: against posteriors that are true, and others that are too narrow or say too much."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import expit, ndtr

from jointplay.catalogue.diagnosing.answer import Condition
from jointplay.catalogue.evaluation.joint_figures import (
    JointAnswer,
    credibility_of,
    joint_figures,
    limit_ratio,
    rank_of,
)
from jointplay.catalogue.evaluation.truth import Truth
from jointplay.catalogue.matching.matcher import NORMAL_90, ClearanceEstimate, HypothesisMatch, MatchResult
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.solver.machines.machine import shipped_machine

FloatArray = NDArray[np.float64]

MACHINE = shipped_machine("slider-crank")
SCATTER = 0.3
"""Of ln(clearance) about what a recording says of it."""
WEAR = (math.log(50e-6), math.log(2e-3))
FITS = {joint: np.exp(np.linspace(math.log(3e-6), math.log(20e-6), 200)) for joint in ("A", "B")}
SETS: tuple[tuple[str, ...], ...] = ((), ("A",), ("B",), ("A", "B"))


def estimate(joint: str, middle: float, scatter: float, *, course: bool) -> ClearanceEstimate:
    """A log-normal posterior, with its course or only by its median and ends."""
    low, high = (math.exp(middle + sign * NORMAL_90 * scatter) for sign in (-1.0, 1.0))
    axis = np.linspace(middle - 5.0 * scatter, middle + 5.0 * scatter, 200)
    drawn = (axis, ndtr((axis - middle) / scatter)) if course else None
    return ClearanceEstimate(joint, math.exp(middle), low, high, drawn)


def answer_of(generator: np.random.Generator, *, narrow: float = 1.0, shift: float = 0.0) -> tuple[Truth, MatchResult]:
    """Draw a posterior, then a truth from it: such a posterior is exact unless it is made narrower or shifted."""
    share = generator.dirichlet(np.full(len(SETS), 0.2))  # mostly sure
    middles = {joint: float(generator.uniform(*WEAR)) for joint in ("A", "B")}
    joints = SETS[generator.choice(len(SETS), p=share)]
    clearances = {
        joint: math.exp(generator.normal(middles[joint], SCATTER)) if joint in joints else generator.choice(FITS[joint])
        for joint in ("A", "B")
    }
    course = bool(generator.uniform() < 0.5)
    matches = tuple(
        HypothesisMatch(
            Hypothesis.of(worn).label,
            worn,
            float(probability),
            tuple(estimate(joint, middles[joint] + shift, SCATTER * narrow, course=course) for joint in worn),
            *(1.0, 0.5, np.zeros(1), np.zeros(1)),
        )
        for worn, probability in zip(SETS, share, strict=True)
    )
    seed = int(generator.integers(2**32))
    return Truth(Hypothesis.of(joints), MACHINE, clearances, {}, 1.0, seed=seed), MatchResult(matches)


def said(
    worn: bool = True,
    clearance_um: float = 100.0,
    p_worn: float = 0.9,
    condition: Condition = "worn",
    limit: float | None = 80.0,
    rank: float | None = None,
) -> JointAnswer:
    return JointAnswer("A", worn, clearance_um, p_worn, condition, "none", limit, rank)


def ranked(count: int, seed: int, *, narrow: float = 1.0, shift: float = 0.0) -> tuple[list[float], list[float]]:
    """Ranks of worn joints, and credibilities, of machines drawn from a seed."""
    generator = np.random.default_rng(seed)
    ranks, credibilities = [], []
    for _ in range(count):
        truth, result = answer_of(generator, narrow=narrow, shift=shift)
        found = [rank_of(result, joint, truth.clearances[joint]) for joint in truth.hypothesis.joints]
        ranks += [rank for rank in found if rank is not None]
        credibility = credibility_of(truth, result, FITS)
        assert credibility is not None
        credibilities.append(credibility)
    return ranks, credibilities


def distances(ranks: list[float], credibilities: list[float]) -> tuple[float, float]:
    found = joint_figures([[said(rank=rank)] for rank in ranks], credibilities)
    assert found.ranks.count == len(ranks)
    assert found.credibilities.count == len(credibilities)
    assert found.ranks.distance is not None
    assert found.credibilities.distance is not None
    return found.ranks.distance, found.credibilities.distance


def test_ranks_and_coverage_are_uniform_where_posteriors_are_exact() -> None:
    count = 600
    off = [distances(*ranked(count, seed)) for seed in range(3)]
    # Kolmogorov and Smirnov's limit of 5 in 100, of the median of three.
    assert np.median([each[0] for each in off]) < 1.36 / math.sqrt(count)
    assert np.median([each[1] for each in off]) < 1.36 / math.sqrt(count)


@pytest.mark.parametrize("changed", [{"narrow": 0.3}, {"shift": 0.3}])
def test_ranks_and_coverage_are_not_uniform_where_posteriors_are_too_narrow_or_shifted(
    changed: dict[str, float],
) -> None:
    count = 600
    ranks, credibilities = ranked(count, 1, **changed)
    off, away = distances(ranks, credibilities)
    assert off > 3.0 * 1.36 / math.sqrt(len(ranks))
    assert away > 1.36 / math.sqrt(count)
    if "narrow" in changed:
        # Too many truths lie in the tails of what is too narrow.
        assert np.mean(np.abs(np.array(ranks) - 0.5) > 0.4) > 0.4


def test_a_rank_is_that_of_the_posterior_given_that_the_joint_is_worn() -> None:
    one, other = math.log(1e-4), math.log(4e-4)
    plain = (1.0, 0.5, np.zeros(1), np.zeros(1))
    matches = (
        HypothesisMatch("A", ("A",), 0.3, (estimate("A", one, 0.3, course=True),), *plain),
        HypothesisMatch("A+B", ("A", "B"), 0.1, (estimate("A", other, 0.3, course=False),), *plain),
        HypothesisMatch("healthy", (), 0.6, (), *plain),
    )
    found = rank_of(MatchResult(matches), "A", 2e-4)
    at = math.log(2e-4)
    expected = (0.3 * ndtr((at - one) / 0.3) + 0.1 * ndtr((at - other) / 0.3)) / 0.4
    assert found == pytest.approx(expected, abs=2e-3)
    assert rank_of(MatchResult(matches), "B", 2e-4) is None
    # A hypothesis that does not say how large its clearances are cannot be drawn from.
    truth = Truth(Hypothesis.of(["A"]), MACHINE, {"A": 2e-4, "B": 1e-5}, {}, 1.0)
    assert credibility_of(truth, MatchResult(matches), FITS) is None
    certain = (replace(matches[0], probability=1.0), replace(matches[1], probability=0.0))
    assert credibility_of(truth, MatchResult(certain), FITS) is not None


def test_log_losses_and_conditions_worked_out_by_hand() -> None:
    joints = [
        said(p_worn=0.9),
        said(worn=False, p_worn=0.2, condition="in_order"),
        said(p_worn=0.4, condition="open"),
        replace(said(worn=False, p_worn=0.6, condition="worn"), joint="B"),
        replace(said(p_worn=0.1, condition="in_order"), joint="B"),
    ]
    found = joint_figures([joints[:2], joints[2:]], [None, 0.5])
    losses = -np.log([0.9, 0.8, 0.4, 0.4, 0.1])
    assert found.log_loss == pytest.approx(losses.mean())
    assert found.log_losses == pytest.approx({"A": losses[:3].mean(), "B": losses[3:].mean()})
    assert found.condition_holds == pytest.approx(3 / 5)
    assert found.condition_open == pytest.approx(1 / 5)
    assert found.credibilities.count == 1
    assert found.credibilities.distance == pytest.approx(0.5)
    assert (found.ranks.distance, found.ranks.count) == (None, 0)
    assert found.limits == 3
    none = joint_figures([])
    assert none.log_loss is none.condition_holds is none.condition_open is none.limit_ratio is None
    assert none.log_losses == {}


@pytest.mark.parametrize("factor", [0.6, 1.0, 2.0])
def test_the_limit_of_detection_is_compared_with_the_clearance_from_which_wear_is_seen(factor: float) -> None:
    """Wear of which 95 % are seen from `factor` times the limit on that answers say."""
    off = []
    for seed in range(20):
        generator = np.random.default_rng(seed)
        limits = generator.uniform(40.0, 200.0, 400)
        ratios = np.exp(generator.uniform(math.log(0.1), math.log(10.0), 400))
        chance = expit(4.0 * np.log(ratios / factor) + math.log(19.0))
        seen = generator.uniform(size=400) < chance
        joints = [
            said(clearance_um=limit * ratio, p_worn=0.9 if one else 0.1, limit=limit)
            for limit, ratio, one in zip(limits, ratios, seen, strict=True)
        ]
        found = limit_ratio(joints)
        assert found is not None
        off.append(math.log(found / factor))
    assert abs(np.median(off)) < 0.1
    assert np.std(off) < 0.25


def test_limits_of_joints_in_order_or_without_a_limit_do_not_count() -> None:
    assert limit_ratio([said(worn=False), said(limit=None)]) is None
    seen = [said(clearance_um=value, p_worn=0.9) for value in (200.0, 400.0, 800.0)]
    assert limit_ratio(seen) is None  # all are seen: from somewhere below the smallest
    unseen = [said(clearance_um=value, p_worn=0.1) for value in (20.0, 40.0, 80.0)]
    assert limit_ratio(unseen) is None  # none is: from somewhere above the largest
