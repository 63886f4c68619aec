"""Sums of what is only known by its logarithm."""

from __future__ import annotations

import numpy as np

from jointplay.solver.arrays import FloatArray


def log_sum_exp(values: FloatArray) -> FloatArray:
    """Return the logarithm of the sum of exponentials along the last axis.

    Parameters
    ----------
    values : ndarray, shape (..., n)
        Finite; n > 0.

    Notes
    -----
    What :func:`scipy.special.logsumexp` computes for finite real numbers, to the last bit, without its provisions for
    all other kinds: those take most of the time of a short sum.
    """
    largest = values.max(axis=-1, keepdims=True)
    at_top = values == largest
    count = at_top.sum(axis=-1, keepdims=True, dtype=np.float64)
    others = np.exp(np.where(at_top, -np.inf, values) - largest).sum(axis=-1, keepdims=True)
    total: FloatArray = (np.log1p(others / count) + np.log(count) + largest)[..., 0]
    return total
