"""Drive speed from a channel with pulses of the shaft: once or several times a revolution, in any unit."""

from __future__ import annotations

import math

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.drivespeed import SpeedEstimate, SpeedTrack
from jointplay.solver.arrays import FloatArray

#: Part of the channel's range that it must come back by before another pulse counts.
PULSE_HYSTERESIS = 0.1
#: Longest and shortest revolution, relative to the usual one: beyond, a pulse is missing or one too many.
UNEVEN = 0.3
#: Revolutions before and after one that it is compared with.
BESIDE = 2
#: Revolutions a speed is taken from at least.
LEAST_REVOLUTIONS = 3


def pulses(signal: FloatArray, threshold: float | None, falling: bool) -> FloatArray:
    """Where a channel crosses its threshold, in samples from the first, between samples by straight lines.

    Parameters
    ----------
    signal : (n,) array
    threshold : float or None
        Half way between the channel's ends unless given.
    falling : bool
        Count falling edges, not rising ones.

    Returns
    -------
    (k,) array
        Rising.
    """
    level = 0.5 * (float(signal.min()) + float(signal.max())) if threshold is None else threshold
    above = (level - signal) if falling else (signal - level)
    ready = -PULSE_HYSTERESIS * float(np.ptp(signal))
    crossed = np.flatnonzero((above[1:] >= 0.0) & (above[:-1] < 0.0))
    found: list[float] = []
    since = 0
    for at in crossed:
        if float(above[since : at + 1].min()) <= ready:
            found.append(float(at + above[at] / (above[at] - above[at + 1])))
            since = int(at) + 1
    return np.array(found)


def turns_of(
    signal: FloatArray, pulses_per_revolution: int, threshold: float | None, falling: bool, source: str, column: str
) -> FloatArray:
    """Ends of revolutions in samples, (k,), from the pulses of a channel; in a run-up they may be of any length.

    Raises
    ------
    MeasurementError
        Too few pulses.
    """
    turns = pulses(signal, threshold, falling)[::pulses_per_revolution]
    if len(turns) < LEAST_REVOLUTIONS + 1:
        rule = f"{max(0, len(turns) - 1)} revolutions by its pulses; at least {LEAST_REVOLUTIONS} are needed"
        raise MeasurementError(source, None, column, rule=rule, field="tacho")
    return turns


def usual_speed(turns: FloatArray, sample_rate: float) -> float:
    """Drive speed of most of the revolutions between `turns` (k,) in samples, rad/s."""
    return 2.0 * math.pi * sample_rate / float(np.median(np.diff(turns)))


def misses_pulses(turns: FloatArray) -> bool:
    """Whether a revolution between `turns` (k,) is far longer or shorter than those beside it: no machine turns so.

    A run-up has longer and shorter revolutions as well, but each is much like the two before and the two after it.
    """
    lengths = np.diff(turns)
    if len(lengths) < 2 * BESIDE + 1:
        return False
    windows = np.lib.stride_tricks.sliding_window_view(lengths, 2 * BESIDE + 1)
    usual = np.median(windows, axis=1)
    return bool(np.any(np.abs(lengths[BESIDE:-BESIDE] / usual - 1.0) > UNEVEN))


def track_of(turns: FloatArray, sample_rate: float, first: int, last: int, source: str) -> SpeedTrack:
    """Course of the speed between two samples.

    Parameters
    ----------
    turns : (k,) array
        Of :func:`turns_of`.
    sample_rate : float
        Hz.
    first, last : int
        Part of the recording that is used; times of the track count from its first sample.
    source : str

    Raises
    ------
    MeasurementError
        Fewer than three revolutions lie in it, or a pulse is missing or too many there.
    """
    inside = (turns[(turns >= first) & (turns < last)] - first) / sample_rate
    if len(inside) < LEAST_REVOLUTIONS + 1:
        rule = f"fewer than {LEAST_REVOLUTIONS} revolutions by the pulses in its steady part"
        raise MeasurementError(source, rule=rule, field="tacho")
    lengths = np.diff(inside)
    wrong = np.abs(lengths / np.median(lengths) - 1.0) > UNEVEN
    if wrong.any():
        at = first + inside[int(np.argmax(wrong))] * sample_rate
        rule = f"tacho: a pulse is missing or too many at sample {at:.0f}: check threshold and pulses_per_revolution"
        raise MeasurementError(source, rule=rule, field="tacho")
    course = 2.0 * math.pi / lengths
    span = float(inside[-1] - inside[0])
    mean = 2.0 * math.pi * (len(inside) - 1) / span
    # Both ends of the stretch are known to a sample, evenly distributed.
    uncertainty = mean * math.sqrt(2.0 / 12.0) / (sample_rate * span)
    wander = float(np.max(np.abs(course / mean - 1.0)))
    return SpeedTrack(0.5 * (inside[1:] + inside[:-1]), course, SpeedEstimate(mean, uncertainty, False, wander))
