"""Importance weights: effective size, the law of the largest, and the temperature they bear."""

from __future__ import annotations

import numpy as np
import pytest

from jointplay.catalogue.matching.population import LEAST_EFFECTIVE, effective_size, pareto_k, weigh


def test_effective_size_by_hand() -> None:
    assert effective_size(np.ones(7)) == pytest.approx(7.0)
    assert effective_size(np.array([1.0, 0.0, 0.0])) == pytest.approx(1.0)
    assert effective_size(np.array([2.0, 1.0, 1.0])) == pytest.approx(16.0 / 6.0)


@pytest.mark.parametrize("shape", [0.2, 0.5, 0.9])
def test_shape_of_the_largest_weights(shape: float) -> None:
    """Of 4000 weights with a Pareto tail of known shape; the largest 189 tell it to 0.07, one standard error."""
    found = []
    for seed in range(8):
        weights = 1.0 + (np.random.default_rng(seed).uniform(size=4000) ** -shape - 1.0) / shape
        found.append(pareto_k(weights))
    assert np.mean(found) == pytest.approx(shape, abs=0.1)
    assert pareto_k(np.ones(64)) == -1.0


def test_even_weights_need_no_temperature() -> None:
    samples = [np.random.default_rng(seed).normal(size=64) * 0.3 for seed in (0, 1)]
    weighed, temperature = weigh(samples)
    assert temperature == 1.0
    for each, logs in zip(weighed, samples, strict=True):
        assert each.weights.sum() == pytest.approx(1.0)
        assert each.log_mean == pytest.approx(float(np.log(np.mean(np.exp(logs)))))


def test_a_sample_with_one_heavy_case_is_tempered_until_it_can_be_believed() -> None:
    heavy = np.random.default_rng(2).normal(size=64) * 30.0
    weighed, temperature = weigh([heavy, np.zeros(64)])
    assert temperature > 5.0
    for each in weighed:
        assert each.effective >= LEAST_EFFECTIVE
    # All have one temperature, and the surer the sample, the smaller its error.
    assert weighed[0].error > 0.1 > 1e-6 > weighed[1].error
    assert np.argmax(weighed[0].weights) == np.argmax(heavy)
