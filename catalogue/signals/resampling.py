"""A recording of a drive that wanders, sampled anew as if it had turned at its mean speed (angular resampling)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.ndimage

from jointplay.catalogue.measurements.drivespeed import SpeedTrack
from jointplay.solver.compiler.compiled import compiled

FloatArray = npt.NDArray[np.float64]

#: Wander, relative, from which bands are taken at the drive's own angle. At a tenth of a percent order 20 moves by a
#: fiftieth of an order, which its band does not notice.
WANDER = 1e-3
#: Samples are made this many times denser before cubic splines go through them: then the splines, too, are flat (to
#: 0.02 dB) up to 0.4 of the sample rate.
DENSER = 2
#: Samples that are repeated at both ends, so that the ends do not show in the splines.
PADDING = 12


def at_mean_speed(signal: npt.ArrayLike, sample_rate: float, track: SpeedTrack) -> FloatArray:
    """Sample a signal at equal steps of the drive's angle.

    Parameters
    ----------
    signal : (n, c) array
    sample_rate : float
        Hz.
    track : SpeedTrack
        Course of the speed; what is added to it as a factor changes nothing.

    Returns
    -------
    (n, c) array
        As many samples over the same angle: the drive turns at its mean speed in it, and orders are sharp. Frequencies
        that do not turn with the drive are smeared by the wander, far less than a band is wide.

    Notes
    -----
    Fyfe and Munck, Mech. Syst. Signal Process. 11 (1997) 187 (computed order tracking).
    """
    values = np.ascontiguousarray(np.asarray(signal, dtype=np.float64).T)
    count = values.shape[1]
    place = _places(count, sample_rate, track)
    mean = values.mean(axis=1, keepdims=True)
    length = scipy.fft.next_fast_len(count, real=True)
    spectrum = scipy.fft.rfft(values - mean, length)
    dense = DENSER * scipy.fft.irfft(spectrum, DENSER * length)[:, : DENSER * count]
    taken = np.stack([splined(row, DENSER * place) for row in dense])
    return np.asarray((taken + mean).T, dtype=np.float64)


def samples_at_mean_speed(mask: npt.NDArray[np.bool_], sample_rate: float, track: SpeedTrack) -> npt.NDArray[np.bool_]:
    """Samples (n,) of a signal at equal steps of the drive's angle that lie where those of a mask do, or next to it."""
    place = _places(len(mask), sample_rate, track)
    found: npt.NDArray[np.bool_] = mask[np.floor(place).astype(np.intp)] | mask[np.ceil(place).astype(np.intp)]
    return found


def _places(count: int, sample_rate: float, track: SpeedTrack) -> FloatArray:
    """Where samples at equal steps of the drive's angle lie, in samples."""
    speed = np.interp(np.arange(count) / sample_rate, track.time, track.speed)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    place = np.interp(np.linspace(0.0, angle[-1], count), angle, np.arange(count, dtype=np.float64))
    return np.asarray(np.clip(place, 0.0, count - 1.0), dtype=np.float64)


def splined(row: FloatArray, places: FloatArray) -> FloatArray:
    """Return the cubic spline through a row (m,) at places (n,) from 0 to m - 1, in samples."""
    coefficients = scipy.ndimage.spline_filter1d(np.pad(row, PADDING, mode="edge"), order=3, mode="nearest")
    out = np.empty(len(places))
    _evaluated(coefficients, places + PADDING, out)
    return out


def _evaluate(coefficients: Any, places: Any, out: Any) -> None:
    """Evaluate a cubic spline: what ``scipy.ndimage.map_coordinates`` does in any number of dimensions, in one.

    Parameters
    ----------
    coefficients : (m,) array
    places : (n,) array
        Where, in samples; at least 1 and less than m - 2.
    out : (n,) array
        To be filled.
    """
    for index in range(len(places)):
        whole = math.floor(places[index])
        after = places[index] - whole
        before = 1.0 - after
        first = before * before * before / 6.0
        second = (after * after * (after - 2.0) * 3.0 + 4.0) / 6.0
        third = (before * before * (before - 2.0) * 3.0 + 4.0) / 6.0
        start = int(whole) - 1
        total = coefficients[start] * first
        total += coefficients[start + 1] * second
        total += coefficients[start + 2] * third
        total += coefficients[start + 3] * (1.0 - first - second - third)
        out[index] = total


_evaluated = compiled(_evaluate)
