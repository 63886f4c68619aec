"""Signals over the angle of the driver in place of time: orders of a machine that does not turn evenly.

Samples lie at equal steps of the angle. Divided by a mean speed that is a sample rate again, and everything that
estimates spectra in orders takes them as they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.band_power import band_matrix
from jointplay.solver.spectra.bands import BandScheme
from jointplay.solver.spectra.sampling import PASS

#: Signals are sampled so many times as finely before a cubic spline goes through them: 0.04 dB are lost at 0.4 of their
#: sample rate then, where it would be 1.7 dB without.
_FINER = 2
#: Samples of a revolution are as dense as those in time where it turns slowest, and no more than so many times as dense
#: as in the mean: where it all but stands, time has no end.
_DENSEST = 4.0
#: Revolutions in a window of a cascade, from one to the next, and the most windows.
WINDOW, HOP, MOST_WINDOWS = 4.0, 2.0, 400
#: Highest order of a cascade.
HIGHEST_ORDER = 100


def resample_by_angle(signal: FloatArray, angle: FloatArray, samples: int | None = None) -> tuple[FloatArray, int]:
    """A signal at equal steps of an angle.

    Parameters
    ----------
    signal : (n, c) array
        At equal steps of time.
    angle : (n,) array
        rad, growing or falling throughout.
    samples : int, optional
        In a revolution; by default as dense as the signal where the angle changes slowest.

    Returns
    -------
    resampled : (m, c) array
        From the first sample on.
    samples : int
        In a revolution.

    Raises
    ------
    SettingsError
        The angle does not turn in one direction, or not by a revolution.
    """
    from scipy import interpolate  # half a second to load, which a server can begin without
    from scipy import signal as processing

    turned = np.abs(angle - angle[0]) if len(angle) else angle
    steps = np.diff(turned)
    if len(turned) < 2 or turned[-1] < 2 * math.pi or steps.min() <= 0:
        turns = turned[-1] / (2 * math.pi) if len(turned) else 0.0
        raise SettingsError(f"drive: {turns:.3g} revolutions, or not all in one direction: no spectra by angle")
    mean = turned[-1] / (len(turned) - 1)
    samples = samples or math.ceil(2 * math.pi / max(float(steps.min()), mean / _DENSEST))
    where = interpolate.CubicSpline(turned, np.arange(len(turned), dtype=np.float64))
    wanted = np.arange(math.floor(turned[-1] / (2 * math.pi) * samples) + 1) * (2 * math.pi / samples)
    at = np.clip(where(wanted), 0.0, len(turned) - 1)
    finer = processing.resample_poly(signal, _FINER, 1, axis=0, padtype="line")
    spline = interpolate.CubicSpline(np.arange(len(finer)) / _FINER, finer, axis=0)
    return np.asarray(spline(at)), samples


@dataclass(frozen=True, eq=False)
class Cascade:
    """Levels in orders over speed, of a machine that changes its speed.

    Attributes
    ----------
    t, speed : (w,) arrays
        Middle of each window, s, and its mean speed, rad/s.
    orders : (k,) array
    level : (w, k, c) array
        Rms in the one-order band; not a number where the sample rate has no such order at that speed.
    """

    t: FloatArray
    speed: FloatArray
    orders: FloatArray
    level: FloatArray


def cascade(t: FloatArray, signal: FloatArray, angle: FloatArray, sample_rate: float) -> Cascade:
    """Orders over speed, in windows of four revolutions.

    Parameters
    ----------
    t : (n,) array
        s.
    signal : (n, c) array
        Alias-free accelerations.
    angle : (n,) array
        Of the driver, rad.
    sample_rate : float
        Hz.

    Raises
    ------
    SettingsError
        Not one window in which the driver turns in one direction.
    """
    turned = np.maximum.accumulate(np.abs(angle - angle[0]) if len(angle) else angle) / (2 * math.pi)
    turns = float(turned[-1]) if len(turned) else 0.0
    hop = max(HOP, (turns - WINDOW) / MOST_WINDOWS)
    found: list[tuple[float, float, FloatArray]] = []
    for begin in np.arange(0.0, turns - WINDOW, hop):
        # A window is a little longer than its revolutions: their transform may be, for the sake of its speed.
        first, last = np.searchsorted(turned, [begin, begin + WINDOW * 1.002])
        part = slice(max(0, int(first) - 1), int(last) + 1)
        try:
            even, samples = resample_by_angle(signal[part], angle[part])
        except SettingsError:
            continue
        here = t[part]
        speed = 2 * math.pi * (turned[part][-1] - turned[part][0]) / (here[-1] - here[0])
        count = max(1, min(HIGHEST_ORDER, math.floor(PASS * sample_rate * 2 * math.pi / speed - 0.5)))
        scheme = BandScheme(tuple(order + 0.5 for order in range(count + 1)), count)
        if len(even) < WINDOW * samples:
            continue
        bands = band_matrix(even, float(samples), 2 * math.pi, scheme, window_revolutions=WINDOW)
        found.append((float(here.mean()), speed, np.sqrt(bands.auto_power)))
    if not found:
        raise SettingsError(f"drive: {turns:.3g} revolutions: no four of them in one direction for orders over speed")
    highest = max(len(level) for _, _, level in found)
    table = np.full((len(found), highest, signal.shape[1]), np.nan)
    for row, (_, _, level) in zip(table, found, strict=True):
        row[: len(level)] = level
    times, speeds, _ = zip(*found, strict=True)
    return Cascade(np.array(times), np.array(speeds), np.arange(1.0, highest + 1), table)
