"""What is in a recording but not of the machine: shocks from outside, drop-outs, clipping. It costs its time, no more.

The machine is periodic: what it does at an angle it does about so in other revolutions, too, worn or not. What is far
louder than anything at that angle in most other revolutions, and than what is loud at all, came from outside. Moments
that cannot be trusted are replaced by the same angles of the nearest revolution that can be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from jointplay.catalogue.measurements.drivespeed import SpeedTrack
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray

DisturbanceKind = Literal["shock", "drop-out", "clipping", "line"]

#: Moments of a revolution whose loudness is compared, and to how many on either side.
MOMENTS = 32
NEAR = 4
#: Least samples in a moment, and least revolutions that are compared.
LEAST_SAMPLES = 4
LEAST_REVOLUTIONS = 4
#: Of the other revolutions this share may be disturbed, too.
OTHERS_DISTURBED = 1.0 / 4.0
#: A shock is louder than the same angles of other revolutions by the first factor (power), and than the loudest moments
#: of other revolutions by the second: in what changes from sample to sample, from one quarter of a moment to the next,
#: and from the usual revolution (where errors of the speed's course show). Recordings of machines, worn ones too, reach
#: 7.3 and 1.6, or 3.6 and 2.4; 4.2 and 1.1, or 2.5 and 2.5; 44 and 18, or 91 and 91 once. Shocks reach hundreds.
FAST = (8.0, 2.5)
MIDDLE = (6.0, 2.5)
SLOW = (50.0, 15.0)
QUARTERS = 4
#: What differs from the usual revolution by less than this share of the signal's power is not looked at.
UNNOTICED = 1e-5
#: It lasts as long as any of these, smoothed, is louder than usual at that angle by this factor.
LASTING = 2.0
#: What rings after it is not loud, but there where the machine is silent: left out for this part of its time longer.
RINGS_ON = 0.25
#: What is left out goes on for this long [s] after it, and is faded in and out over as long.
MARGIN = 0.002


@dataclass(frozen=True)
class Disturbance:
    """Something in a recording that is not of the machine, and was left out of it.

    Parameters
    ----------
    kind : {"shock", "drop-out", "clipping", "line"}
    text : str
        What it is and when, one line.
    begin, end : float
        Of the recording [s].
    sensors : tuple of str
        Where it is in some sensors only; empty: in all.
    frequency : float, optional
        Of a line [Hz].
    """

    kind: DisturbanceKind
    text: str
    begin: float
    end: float
    sensors: tuple[str, ...] = ()
    frequency: float | None = None


def find_shocks(
    signal: FloatArray, sample_rate: float, track: SpeedTrack, missing: BoolArray, weaker: float = 1.0
) -> BoolArray:
    """Samples that hold shocks from outside.

    Parameters
    ----------
    signal : (n, c) array
        Finite everywhere.
    sample_rate : float
        Hz.
    track : SpeedTrack
        Course of the speed.
    missing : (n,) array of bool
        Samples that are not looked at.
    weaker : float
        By how much less than usual a shock may stand out.

    Returns
    -------
    (n,) array of bool
        All false in recordings of less than four revolutions.
    """
    found = np.zeros(len(signal), dtype=bool)
    angle = _revolutions(len(signal), sample_rate, track)
    count = int(angle[-1])
    if count < LEAST_REVOLUTIONS or len(signal) < LEAST_SAMPLES * MOMENTS * count:
        return found
    edges = _places(angle, count * MOMENTS, MOMENTS)
    unknown = np.maximum.reduceat(missing[: edges[-1]], edges[:-1]).reshape(count, MOMENTS)
    unknown = _near(unknown, 1).astype(bool)
    others = 1 + int(OTHERS_DISTURBED * count)
    hit = np.zeros((count, MOMENTS), dtype=bool)
    lasting = np.zeros((count, MOMENTS), dtype=bool)
    for loudness, (here, anywhere) in (
        (_fast(signal, edges, count), FAST),
        (_middle(signal, angle, count), MIDDLE),
        (_slow(signal, edges, count), SLOW),
    ):
        loudness[unknown] = 0.0
        usual = _of_others(_near(loudness, NEAR), others)
        loud = _of_others(loudness.max(axis=1, keepdims=True), others)
        hit |= (loudness > weaker * here * usual) & (loudness > weaker * anywhere * loud)
        smooth = _around(loudness, NEAR)
        lasting |= smooth > LASTING * np.median(smooth, axis=0)
    if not hit.any():
        return found
    # A shock begins at once, and goes on as long as it lasts.
    hits = hit.ravel()
    for first, last in stretches_of((lasting | hit).ravel()):
        if hits[first:last].any():
            begin = max(first, first + int(np.argmax(hits[first:last])) - 1)
            found[edges[begin] : edges[last] + round(RINGS_ON * (edges[last] - edges[begin]))] = True
    return found


def stretches_of(mask: BoolArray) -> list[tuple[int, int]]:
    """First and last + 1 of every stretch that is true."""
    steps = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in steps.reshape(-1, 2)]


def patch(signal: FloatArray, sample_rate: float, track: SpeedTrack, bad: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Replace samples by those of the same angle in the nearest revolution that is whole there.

    Parameters
    ----------
    signal : (n, c) array
    sample_rate : float
    track : SpeedTrack
    bad : (n,) array of bool
        Samples to be replaced.

    Returns
    -------
    signal : (n, c) array
        A copy.
    left : (n,) array of bool
        Samples that no revolution could replace: they are as they were.
    """
    values = signal.copy()
    left = np.zeros(len(signal), dtype=bool)
    angle = _revolutions(len(signal), sample_rate, track)
    count = math.ceil(angle[-1])
    fade = max(2, round(MARGIN * sample_rate))
    longest = max(4 * fade, int(0.5 * len(signal) / max(angle[-1], 1.0)))
    index = np.arange(len(signal), dtype=np.float64)
    bads = np.concatenate([[0], np.cumsum(bad)])
    for begin, end in stretches_of(bad):
        for first in range(begin, end, longest):
            last = min(first + longest, end)
            low, high = max(0, first - fade), min(len(signal), last + fade)
            middle = 0.5 * (first + last)
            for turns in (side * step for step in range(1, count + 1) for side in (-1, 1)):
                there = np.interp(middle, index, angle) + turns
                if not 0.0 < there < angle[-1]:
                    continue
                shift = round(float(np.interp(there, angle, index)) - middle)
                if low + shift < 0 or high + shift > len(signal) or bads[high + shift] > bads[low + shift]:
                    continue
                weight = np.ones(high - low)
                rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
                weight[: first - low] = rise[: first - low]
                weight[last - low :] = rise[::-1][fade - (high - last) :] if high > last else 1.0
                source = signal[low + shift : high + shift]
                values[low:high] += weight[:, None] * (source - values[low:high])
                break
            else:
                left[first:last] = True
    return values, left


def _revolutions(count: int, sample_rate: float, track: SpeedTrack) -> FloatArray:
    """Return the drive's angle at every sample, in revolutions from the first."""
    speed = np.interp(np.arange(count) / sample_rate, track.time, track.speed)
    angle = np.empty(count)
    angle[0] = 0.0
    np.cumsum(speed[:-1], out=angle[1:])
    angle *= 1.0 / (2.0 * math.pi * sample_rate)
    return angle


def _places(angle: FloatArray, count: int, parts: int) -> IntArray:
    """First sample of each part of a revolution, and the one after the last, (count + 1,)."""
    return np.asarray(np.searchsorted(angle, np.arange(count + 1) / parts), dtype=np.int64)


def _fast(signal: FloatArray, edges: IntArray, count: int) -> FloatArray:
    """Power of the changes from sample to sample in each moment, channels alike, (r, m)."""
    power = np.zeros(edges[-1])
    for column in signal.T:
        change = np.diff(column[: edges[-1]], prepend=column[0])
        change *= change
        typical = float(np.median(change[:: max(1, len(change) // 20_000)]))
        power += change / typical if typical > 0 else 0.0
    return np.asarray((np.add.reduceat(power, edges[:-1]) / np.diff(edges)).reshape(count, MOMENTS))


def _middle(signal: FloatArray, angle: FloatArray, count: int) -> FloatArray:
    """Power of the changes from each quarter of a moment to the next, channels alike, (r, m)."""
    power = np.zeros((count, MOMENTS))
    if len(signal) < LEAST_SAMPLES * QUARTERS * MOMENTS * count:
        return power
    edges = _places(angle, count * MOMENTS * QUARTERS, MOMENTS * QUARTERS)
    for column in signal.T:
        means = np.add.reduceat(column[: edges[-1]], edges[:-1]) / np.diff(edges)
        change = np.diff(means, prepend=means[0]) ** 2
        typical = float(np.median(change))
        power += change.reshape(count, MOMENTS, QUARTERS).mean(axis=-1) / typical if typical > 0 else 0.0
    return power


def _slow(signal: FloatArray, edges: IntArray, count: int) -> FloatArray:
    """Power of the mean in each moment, less that of the usual revolution, channels alike, (r, m)."""
    power = np.zeros((count, MOMENTS))
    for column in signal.T:
        means = (np.add.reduceat(column[: edges[-1]], edges[:-1]) / np.diff(edges)).reshape(count, MOMENTS)
        odd = (means - np.median(means, axis=0)) ** 2 + UNNOTICED * float(means.var())
        power += odd / max(float(odd.mean()), 1e-300)
    return power


def _near(loudness: npt.NDArray[np.generic], reach: int) -> FloatArray:
    """Loudest of the moments next to each, across revolutions, (r, m)."""
    padded = np.pad(loudness.astype(np.float64).ravel(), reach, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    return np.asarray(around.max(axis=1).reshape(loudness.shape))


def _around(loudness: FloatArray, reach: int) -> FloatArray:
    """Mean over the moments next to each, across revolutions, (r, m)."""
    total = np.cumsum(np.pad(loudness.ravel(), (reach + 1, reach), mode="edge"))
    width = 2 * reach + 1
    return np.asarray(((total[width:] - total[:-width]) / width).reshape(loudness.shape))


def _of_others(loudness: FloatArray, rank: int) -> FloatArray:
    """Return for each revolution the so-and-so-loudest of all others, column by column."""
    ordered = np.sort(loudness, axis=0)[::-1]
    after = ordered[min(rank, len(ordered) - 1)]
    return np.asarray(np.where(loudness >= ordered[rank - 1], after, ordered[rank - 1]), dtype=np.float64)
