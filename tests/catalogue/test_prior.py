"""What is held likely beforehand, worked out by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from feature_model import FeatureModel

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.gaussian import fit_gaussian
from jointplay.catalogue.matching.matcher import HypothesisMatch, MatchResult, TrainingSet, rank
from jointplay.catalogue.matching.prior import Prior

NOTHING = np.zeros(1)


def match(label: str, probability: float) -> HypothesisMatch:
    joints = () if label == "healthy" else tuple(label.split("+"))
    return HypothesisMatch(label, joints, probability, (), 1.0, 0.5, NOTHING, NOTHING)


def test_weights_by_hand() -> None:
    prior = Prior(0.8, 0.5, {"A": 3.0, "B": 0.1})
    sets = [(), ("A",), ("B",), ("O",), ("A", "B"), ("A", "B", "O")]
    # Of four joints there are six pairs and four triples; one, two and three are worn with 4/7, 2/7 and 1/7.
    by_hand = [0.2, 3.0 * 0.8 / 7, 0.1 * 0.8 / 7, 0.8 / 7, 0.3 * 1.6 / 7 / 6, 0.3 * 0.8 / 7 / 4]
    assert [prior.weight(worn, 4, 3) for worn in sets] == pytest.approx(by_hand)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8])
def test_sets_of_as_many_joints_share_what_their_number_has(count: int) -> None:
    joints = "ABCDEFGH"[:count]
    together = [
        sum(Prior(0.7).weight(worn, count, 3) for worn in itertools.combinations(joints, number))
        for number in range(1, min(3, count) + 1)
    ]
    assert together == pytest.approx([0.7 * share for share in Prior().numbers(count, 3)])
    assert sum(together) == pytest.approx(0.7)
    assert together[1:] == pytest.approx([0.6 * fewer for fewer in together[:-1]])


def test_an_answer_is_weighed_again_and_ranked_anew() -> None:
    found = rank([match("healthy", 0.2), match("A", 0.5), match("O", 0.1), match("A+O", 0.2)])
    again = Prior(another=1.2, joints={"A": 0.1}).apply(found, 3)
    # One joint is worn with 1 / 2.2 in place of 1 / 1.6, two with 1.2 / 2.2 in place of 0.6 / 1.6.
    one, two = 1.6 / 2.2, 3.2 / 2.2
    weights = {"healthy": 0.2, "A": 0.5 * 0.1 * one, "O": 0.1 * one, "A+O": 0.2 * 0.1 * two}
    assert {each.label: each.probability for each in again.hypotheses} == pytest.approx(
        {label: weight / sum(weights.values()) for label, weight in weights.items()}
    )
    assert [each.label for each in again.hypotheses] == ["healthy", "O", "A", "A+O"]
    assert Prior().apply(found, 3) is found


def test_weighing_an_answer_again_is_what_learning_with_that_prior_gives() -> None:
    drawn = FeatureModel(separation=0.1).training(60, np.random.default_rng(1))
    feature = drawn.hypotheses[1].features[0]
    asked = Prior(joints={"A": 0.05, "B": 20.0})

    def answer(prior: Prior) -> MatchResult:
        sets = (replace(draws, prior=prior.weight(draws.joints, 3, 1)) for draws in drawn.hypotheses)
        return fit_gaussian(TrainingSet(tuple(sets), drawn.watched)).match(feature)

    usual, direct = answer(Prior()), answer(asked)
    assert usual.probability("B") < 0.5 * direct.probability("B")
    weighed = asked.apply(usual, 3)
    for each in direct.hypotheses:
        assert weighed.probability(each.label) == pytest.approx(each.probability, abs=1e-12)


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"another": 0.0}, "prior.another: 0.0: must be from 0.001 to 1000"),
        ({"another": float("nan")}, "prior.another: nan: must be from 0.001 to 1000"),
        ({"joints": {"A": 1e4}}, "prior.joints.A: 10000.0: must be from 0.001 to 1000"),
        ({"worn": 1.0}, "prior.worn: 1.0: must be from 0.001 to 0.999"),
        ({"worn": float("nan")}, "prior.worn: nan: must be from 0.001 to 0.999"),
    ],
)
def test_refusals(said: dict[str, Any], message: str) -> None:
    with pytest.raises(DiagnosisError, match=message):
        Prior(**said)


def test_joints_that_the_machine_does_not_have_are_refused() -> None:
    Prior(joints={"A": 2.0}).check(["A", "O"])
    with pytest.raises(DiagnosisError, match=r"prior\.joints\.Q: must be one of the joints A, O"):
        Prior(joints={"Q": 2.0}).check(["O", "A"])
