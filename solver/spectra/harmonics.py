"""Harmonic error: how far two signals of the same machine differ at multiples of the drive's frequency.

The measure of accuracy used everywhere. Differences line by line of a Welch spectrum mostly grade the floor between
the lines of a periodic response; what a diagnosis reads are the lines themselves.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from jointplay.solver.arrays import BoolArray, FloatArray
from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.band_power import band_matrix
from jointplay.solver.spectra.bands import BandScheme

#: Multiples of the drive's frequency that are compared, and the highest frequency among them, Hz.
HARMONICS = 200
HIGHEST_HZ = 2000.0
#: A line this far below the strongest of the reference is beyond any measurement and is not compared, dB.
FLOOR_DB = 80.0
#: A sample rate is a multiple of the drive's frequency if it misses by less than this part of a sample a revolution.
_WHOLE = 1e-6


def count_of(frequency: float) -> int:
    """How many multiples of the drive's frequency (Hz) are compared: 200, or those up to 2 kHz if that is fewer."""
    return max(1, min(HARMONICS, math.floor(HIGHEST_HZ / frequency * (1 + 1e-9))))


def whole_rate(frequency: float, at_least: float) -> float:
    """Lowest sample rate not below `at_least` (Hz) with a whole number of samples in a period of `frequency` (Hz)."""
    return frequency * math.ceil(at_least / frequency * (1 - 1e-9))


def harmonic_levels(signal: npt.ArrayLike, sample_rate: float, frequency: float) -> FloatArray:
    """Levels of the first multiples of the drive's frequency over the whole revolutions that a signal begins with.

    Parameters
    ----------
    signal : (n,) array
        Without the start-up transient.
    sample_rate : float
        Hz; a multiple of the drive's frequency.
    frequency : float
        Of the drive, Hz.

    Returns
    -------
    (k,) array
        dB re one unit of amplitude; `k` as :func:`count_of`.

    Raises
    ------
    SettingsError
        Not one whole revolution, or a sample rate that is no multiple of the drive's frequency.
    """
    values = np.asarray(signal, dtype=np.float64)
    revolution = round(sample_rate / frequency)
    if abs(sample_rate / frequency - revolution) > _WHOLE:
        raise SettingsError(
            f"sample rate: {sample_rate:.10g} Hz: must be a multiple of the drive's {frequency:.10g} Hz"
        )
    revolutions = len(values) // revolution
    lines = revolutions * np.arange(1, count_of(frequency) + 1)
    if not revolutions or 2 * lines[-1] >= revolutions * revolution:
        raise SettingsError(f"signal: {len(values)} samples at {sample_rate:g} Hz: too short or too slow for harmonics")
    amplitude = np.abs(np.fft.rfft(values[: revolutions * revolution])[lines]) * 2 / (revolutions * revolution)
    return np.asarray(20 * np.log10(np.maximum(amplitude, np.finfo(np.float64).tiny)))


def order_band_levels(signal: npt.ArrayLike, sample_rate: float, frequency: float) -> FloatArray:
    """Levels in bands one order wide around the same multiples, for responses that never repeat.

    Parameters
    ----------
    signal, sample_rate, frequency
        As for :func:`harmonic_levels`; any sample rate.

    Returns
    -------
    (k,) array
        dB re one unit squared.
    """
    count = count_of(frequency)
    scheme = BandScheme(tuple(k + 0.5 for k in range(count + 1)), count)
    found = band_matrix(np.asarray(signal)[:, None], sample_rate, 2 * math.pi * frequency, scheme)
    return np.asarray(10 * np.log10(np.maximum(found.auto_power[:, 0], np.finfo(np.float64).tiny)))


def find_comparable(reference: npt.ArrayLike) -> BoolArray:
    """Which of the reference's levels (dB) stand far enough out to be compared."""
    levels = np.asarray(reference)
    return np.asarray(levels > levels.max() - FLOOR_DB)


def mean_difference_db(levels: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Mean of absolute differences of levels (..., k), dB, over those that are :func:`find_comparable`."""
    kept = find_comparable(reference)
    return float(np.mean(np.abs(np.asarray(levels)[..., kept] - np.asarray(reference)[kept])))


def harmonic_error(signal: npt.ArrayLike, reference: npt.ArrayLike, sample_rate: float, frequency: float) -> float:
    """Mean absolute difference of two signals at the first multiples of the drive's frequency, dB.

    Parameters
    ----------
    signal, reference : (n,) arrays
        From the same instant on, without the start-up transient; the shorter one says how long.
    sample_rate, frequency : float
        Hz.
    """
    count = min(np.size(signal), np.size(reference))
    ours, theirs = (harmonic_levels(np.asarray(x)[:count], sample_rate, frequency) for x in (signal, reference))
    return mean_difference_db(ours, theirs)
