"""Space-filling sequences and quantiles that draws of a plan come from."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jointplay.catalogue.plans.plan_parts import Distribution, unit_draws


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**64 - 1), st.integers(1, 8), st.integers(1, 40), st.integers(0, 100))
def test_draws_continue(seed: int, dimensions: int, count: int, more: int) -> None:
    points = unit_draws(seed, dimensions, count)
    assert points.shape == (count, dimensions)
    assert np.array_equal(unit_draws(seed, dimensions, count + more)[:count], points)


def test_draws_fill_the_range_evenly() -> None:
    points = unit_draws(5, 4, 32)
    for column in points.T:
        assert len({int(32 * u) for u in column}) == 32


def test_quantiles() -> None:
    assert Distribution(uniform=(2.0, 4.0)).quantile(0.25) == 2.5
    assert Distribution(factor_uniform=(0.9, 1.1)).quantile(1.0) == pytest.approx(1.1)
    assert Distribution(loguniform=(1.0, 100.0)).quantile(0.5) == pytest.approx(10.0)
    assert Distribution(factor_loguniform=(0.5, 2.0)).quantile(0.5) == pytest.approx(1.0)
    either = Distribution(either_loguniform=(0.1, 10.0))
    assert [either.quantile(u) for u in (0.0, 0.25, 0.75, 1.0)] == pytest.approx([-10.0, -1.0, 1.0, 10.0])
    assert not either.is_factor
    assert str(either) == "+-0.1 to 10 (log)"
    assert [Distribution(loguniform=(1, 9)).is_factor, Distribution(factor_loguniform=(1, 9)).is_factor] == [
        False,
        True,
    ]
    assert Distribution(lognormal=0.4).quantile(0.5) == pytest.approx(1.0)
    assert Distribution(lognormal=0.4).quantile(0.8413447460685429) == pytest.approx(math.exp(0.4))
    assert 0 < Distribution(lognormal=0.4).quantile(0.0) < 1 < Distribution(lognormal=0.4).quantile(1.0) < math.inf
