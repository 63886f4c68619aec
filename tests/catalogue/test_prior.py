"""What is held likely beforehand, worked out by hand."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from feature_model import FeatureModel

from catalogue.errors import DiagnosisError
from catalogue.matching.gaussian import GaussianAlongClearance
from catalogue.matching.matcher import HypothesisMatch, MatchResult, TrainingSet, ranked
from catalogue.matching.prior import Prior

NOTHING = np.zeros(1)


def match(label: str, probability: float) -> HypothesisMatch:
    joints = () if label == "healthy" else tuple(label.split("+"))
    return HypothesisMatch(label, joints, probability, (), 1.0, 0.5, NOTHING, NOTHING)


def test_weights_by_hand() -> None:
    prior = Prior(0.5, {"A": 3.0, "B": 0.1})
    sets = [(), ("A",), ("B",), ("O",), ("A", "B"), ("A", "B", "O")]
    # Of four joints there are six pairs and four triples.
    by_hand = [1.0, 3.0, 0.1, 1.0, 0.15 * 4 / 6, 0.075]
    assert [prior.weight(worn, 4) for worn in sets] == pytest.approx(by_hand)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8])
def test_sets_of_as_many_joints_share_what_their_number_has(count: int) -> None:
    joints = "ABCDEFGH"[:count]
    together = [
        sum(Prior(0.6).weight(worn, count) for worn in itertools.combinations(joints, number)) for number in (1, 2, 3)
    ]
    there = together[: min(3, count)]
    assert there == pytest.approx([count * 0.6**more for more in range(len(there))])
    assert Prior(0.6).numbers(count, 3) == pytest.approx([each / sum(there) for each in there])


def test_an_answer_is_weighed_again_and_ranked_anew() -> None:
    found = ranked([match("healthy", 0.2), match("A", 0.5), match("O", 0.1), match("A+O", 0.2)])
    again = Prior(1.2, {"A": 0.1}).applied(found, 3)
    # 0.2, 0.5 x 0.1, 0.1, and 0.2 x 0.1 x 1.2 / 0.6; together 0.39.
    assert {each.label: each.probability for each in again.hypotheses} == pytest.approx(
        {"healthy": 0.2 / 0.39, "A": 0.05 / 0.39, "O": 0.1 / 0.39, "A+O": 0.04 / 0.39}
    )
    assert [each.label for each in again.hypotheses] == ["healthy", "O", "A", "A+O"]
    assert Prior().applied(found, 3) is found


def test_weighing_an_answer_again_is_what_learning_with_that_prior_gives() -> None:
    drawn = FeatureModel(separation=0.1).training(60, np.random.default_rng(1))
    feature = drawn.hypotheses[1].features[0]
    asked = Prior(joints={"A": 0.05, "B": 20.0})

    def answer(prior: Prior) -> MatchResult:
        sets = (replace(draws, prior=prior.weight(draws.joints, 3)) for draws in drawn.hypotheses)
        return GaussianAlongClearance().fit(TrainingSet(tuple(sets), drawn.watched)).match(feature)

    usual, direct = answer(Prior()), answer(asked)
    assert usual.probability("B") < 0.5 * direct.probability("B")
    weighed = asked.applied(usual, 3)
    for each in direct.hypotheses:
        assert weighed.probability(each.label) == pytest.approx(each.probability, abs=1e-12)


@pytest.mark.parametrize(
    ("another", "joints", "message"),
    [
        (0.0, {}, "prior.another: 0.0: must be from 0.001 to 1000"),
        (float("nan"), {}, "prior.another: nan: must be from 0.001 to 1000"),
        (0.4, {"A": 1e4}, "prior.joints.A: 10000.0: must be from 0.001 to 1000"),
    ],
)
def test_refusals(another: float, joints: dict[str, float], message: str) -> None:
    with pytest.raises(DiagnosisError, match=message):
        Prior(another, joints)


def test_joints_that_the_machine_does_not_have_are_refused() -> None:
    Prior(joints={"A": 2.0}).check(["A", "O"])
    with pytest.raises(DiagnosisError, match=r"prior\.joints\.Q: must be one of the joints A, O"):
        Prior(joints={"Q": 2.0}).check(["O", "A"])
