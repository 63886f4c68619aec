"""Sums of exponentials are scipy's, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.special import logsumexp

from jointplay.catalogue.matching.curves import log_sum_exp

FINITE = st.floats(-1e6, 1e6) | st.sampled_from([0.0, -1.0, 700.0])


@given(arrays(np.float64, array_shapes(max_dims=2, max_side=40), elements=FINITE))
def test_the_same_as_the_general_one(values: np.ndarray) -> None:
    assert np.array_equal(log_sum_exp(values), logsumexp(values, axis=-1))


@pytest.mark.parametrize("shape", [(1,), (117,), (1, 389), (5, 1600)])
def test_the_same_for_log_likelihoods(shape: tuple[int, ...]) -> None:
    values = -np.random.default_rng(3).gamma(2.0, 40.0, shape)
    assert np.array_equal(log_sum_exp(values), logsumexp(values, axis=-1))
