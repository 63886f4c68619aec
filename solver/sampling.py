"""Alias-free accelerations from simulated velocities.

The mean acceleration over an interval is the difference of two velocities divided by it: exact, whatever impacts
happened in between. The mean's known sinc is undone and the rate reduced by one filter.

What is left of aliases: nothing from below oversampling - 0.4 sample rates (the filter stops 90 dB). From there up
the mean itself is all that stands in the way; with two velocities a sample it lets -12 dB through from 1.6 sample rates
(to 0.4 of the sample rate) and -32 dB from 1.95 (to 0.05). Impacts hold little up there: bands of a slider-crank with a
worn joint, at 10 kHz, are 0.06 dB off at most up to 3 kHz and 0.2 dB up to 4 kHz.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]

#: Pass band ends, and stop band begins, at these parts of the sample rate: what folds lands above PASS.
PASS, STOP = 0.4, 0.6
_ATTENUATION_DB = 90.0


@cache
def _filter(oversampling: int) -> Array:
    """Low-pass with the inverse sinc in its pass band; even length, so that it centres between two samples."""
    width = (STOP - PASS) * 2 / oversampling
    taps, beta = signal.kaiserord(_ATTENUATION_DB, width)
    taps += taps % 2
    # Ideal edge half way; the window spreads it over the band between PASS and STOP.
    edge = (PASS + STOP) / 2 / oversampling
    frequency = np.linspace(0.0, edge, 257)
    grid = np.concatenate([2 * frequency, [2 * edge, 1.0]])
    gain = np.concatenate([1 / np.sinc(frequency), [0.0, 0.0]])
    found = signal.firwin2(taps, grid, gain, nfreqs=8193, window=("kaiser", beta))
    return np.asarray(found / found.sum())


def reach(oversampling: int) -> int:
    """Velocities beyond the last instant wanted that the filter needs."""
    return len(_filter(oversampling)) // 2


def band_limited_acceleration(velocity: Array, rate: float, oversampling: int) -> Array:
    """Acceleration at the reduced rate, flat to 0.4 of it; for aliases see the module.

    Parameters
    ----------
    velocity : (c, m) array
        At `rate`, from the first instant wanted on.
    rate : float
        Rate of the velocities, Hz.
    oversampling : int
        Velocities per reduced sample, at least 2.

    Returns
    -------
    (c, k) array
        At instants 0, oversampling, 2 oversampling ... of the input for as long as the filter has what it needs; before
        the first velocity the machine is taken to have kept its first mean acceleration.
    """
    taps = _filter(oversampling)
    half = len(taps) // 2
    means = np.diff(velocity, axis=1) * rate
    count = (means.shape[1] - half) // oversampling + 1
    # Result j is centred on instant j * oversampling: half the taps are means before it, half after.
    padded = np.concatenate([np.repeat(means[:, :1], half, axis=1), means], axis=1)
    out = np.empty((len(means), count))
    _decimate(padded, taps, oversampling, out)
    return out


@njit(cache=True, fastmath=True, nogil=True)
def _decimate(signals: Array, taps: Array, step: int, out: Array) -> None:
    """Scalar products of the (symmetric) taps with every `step`-th window."""
    width = taps.size
    for row in range(out.shape[0]):
        for j in range(out.shape[1]):
            window = signals[row, j * step : j * step + width]
            total = 0.0
            for i in range(width):
                total += taps[i] * window[i]
            out[row, j] = total
