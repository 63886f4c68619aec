"""The guard: how far spectra of a catalogue are from those of finer steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAST_POWER", "mean_difference_db"]

LEAST_POWER = 1e-9
"""Bands below this part of the largest band of the same motion are rounding and do not count."""


def mean_difference_db(power: NDArray[np.complexfloating], finer: NDArray[np.complexfloating]) -> float:
    """Mean magnitude of the difference of two spectra's levels.

    Parameters
    ----------
    power, finer : ndarray of complex, shape (B, 3, 3)
        Cross-power in bands.

    Returns
    -------
    float
        dB, over all bands and motions that count in either; 0 without any.
    """
    a, b = (np.einsum("bii->bi", each).real.astype(np.float64) for each in (power, finer))
    floor = LEAST_POWER * np.maximum(a.max(axis=0, initial=0.0), b.max(axis=0, initial=0.0))
    counts = np.maximum(a, b) > floor
    levels = [10.0 * np.log10(np.maximum(each, np.maximum(floor, np.finfo(float).tiny))) for each in (a, b)]
    return float(np.abs(levels[0] - levels[1])[counts].mean()) if counts.any() else 0.0
