"""Candidate sets by split-conformal prediction."""

from __future__ import annotations

import numpy as np
import pytest

from jointplay.catalogue.matching.conformal import Conformal


def simulated(generator: np.random.Generator, count: int, sharpness: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Posteriors (m, 4) that mean what they say, and truths drawn from them; `sharpness` makes them boast."""
    score = generator.normal(0.0, 1.5, (count, 4))
    posterior = np.exp(score) / np.exp(score).sum(axis=1, keepdims=True)
    truth = np.array([generator.choice(4, p=row) for row in posterior])
    told = np.exp(sharpness * score)
    return told / told.sum(axis=1, keepdims=True), truth


@pytest.mark.parametrize("sharpness", [0.5, 1.0, 3.0])
def test_sets_hold_the_truth_as_often_as_asked(sharpness: float) -> None:
    generator = np.random.default_rng(1)
    posterior, truth = simulated(generator, 2000, sharpness)
    fitted = Conformal.fit(posterior, truth, np.ones(2000))
    told, true = simulated(generator, 4000, sharpness)
    for coverage in (0.8, 0.95):
        least = fitted.threshold(coverage)
        held = np.mean(told[np.arange(4000), true] >= least)
        # Binomial scatter of both samples: 1.1 % at 0.8.
        assert held == pytest.approx(coverage, abs=0.03)


def test_threshold_is_that_of_the_definition() -> None:
    posterior = np.array([[p, 1.0 - p] for p in (0.9, 0.2, 0.5, 0.7, 0.6, 0.8, 0.95, 0.99, 0.3)])
    fitted = Conformal.fit(posterior, np.zeros(9, np.int64), np.ones(9))
    # Of ten draws, the recording included, two may be left out at 0.8: the smallest, and itself.
    assert fitted.threshold(0.8) == 0.3
    assert fitted.threshold(0.9) == 0.2
    assert fitted.threshold(0.95) == 0.0


def test_doubtful_answers_get_the_wider_set_and_strange_ones_none() -> None:
    posterior = np.column_stack([np.linspace(0.6, 1.0, 2000), np.linspace(0.4, 0.0, 2000)])
    fitted = Conformal.fit(posterior, np.zeros(2000, np.int64), np.ones(2000))
    assert 0.6 < fitted.threshold(0.95) < 0.95
    sure = fitted.members(("A", "B", "C"), np.array([0.97, 0.02, 0.01]), 0.95)
    assert sure.labels == ("A",)
    assert (sure.coverage, sure.widened) == (0.95, False)
    torn = fitted.members(("A", "B", "C"), np.array([0.4, 0.55, 0.05]), 0.95)
    assert torn.labels == ("B",)
    # Doubtful answers are wrong more often than others: nothing like 0.99 is promised of them.
    assert (torn.coverage, torn.widened) == (0.95, True)
    lost = fitted.members(("A", "B", "C"), np.array([0.34, 0.33, 0.33]), 0.95)
    assert lost.labels == ()
    assert (lost.coverage, lost.widened) == (0.95, True)
