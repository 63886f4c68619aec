"""Course of a drive speed that changes much: a run-up, a coast-down, a speed set by steps.

A comb of harmonics looks at short windows as they are and as if the drive sped up or slowed down evenly in them; of
what stands out in each, the course is the one that holds together best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from jointplay.catalogue.measurements.drivespeed import COMB_CONTRAST_DB, COMB_ORDERS, TRACKED_ORDERS, thin
from jointplay.solver.arrays import FloatArray

#: Revolutions in a window and from window to window, at the middle of the speeds that are looked at, and windows of a
#: recording at most. With windows of four revolutions some show nothing, with eight orders speeds are twice as far off.
WINDOW_REVOLUTIONS, HOP_REVOLUTIONS = 6.0, 2.0
MOST_WINDOWS = 300
#: Changes of the speed within a window that are tried, relative; none where all windows as they are show speeds that
#: differ by no more than the first of them: that is most recordings.
CHANGES = (0.0, 0.02, -0.02, 0.04, -0.04, 0.08, -0.08)
#: Distance of the speeds that are tried, relative: eight to a line of the highest order in the comb.
STEP = 1.0 / (8.0 * TRACKED_ORDERS * WINDOW_REVOLUTIONS)
#: What a change of the speed between windows costs, dB a step of speeds, and what any change costs at most.
TURN_DB, JUMP_DB = 0.2, 20.0
#: Windows that are transformed at a time, so that a long recording needs no more memory than a short one.
AT_A_TIME = 64


@dataclass(frozen=True, eq=False)
class SpeedCourse:
    """Speeds of a drive over time.

    Parameters
    ----------
    time : (w,) array
        s, rising.
    speed : (w,) array
        rad/s; not a number where none is to be seen.
    """

    time: FloatArray
    speed: FloatArray


def find_course(signal: npt.ArrayLike, sample_rate: float, low: float, high: float) -> SpeedCourse:
    """Find how fast a drive turns from moment to moment.

    Parameters
    ----------
    signal : (n, c) array
        In any units.
    sample_rate : float
        Hz.
    low, high : float
        Speeds that are looked at, rad/s, above 0.

    Returns
    -------
    SpeedCourse
        Empty where the recording is shorter than a window, or has less than eight samples in the fastest revolution.
    """
    turn = math.sqrt(low * high) / (2.0 * math.pi)
    nothing = SpeedCourse(np.zeros(0), np.zeros(0))
    if sample_rate < 8.0 * high / (2.0 * math.pi):
        return nothing
    kept, rate = thin(np.asarray(signal, dtype=np.float64), sample_rate, turn)
    length = round(WINDOW_REVOLUTIONS * rate / turn)
    if len(kept) < length:
        return nothing
    count = min(MOST_WINDOWS, 1 + math.ceil((len(kept) - length) * turn / (HOP_REVOLUTIONS * rate)))
    starts = np.unique(np.linspace(0, len(kept) - length, count).round().astype(np.intp))
    tried = low * np.exp(STEP * np.arange(math.ceil(math.log(high / low) / STEP) + 1))
    blocks = np.array_split(starts, math.ceil(len(starts) / AT_A_TIME))
    for changes in (CHANGES[:1], CHANGES):
        contrast, of_low = np.hstack([_contrasts(kept, rate, block, length, tried, changes) for block in blocks])
        path = _likeliest_path(contrast)
        # A quiet machine shows its low orders only; all of them say the speed twice as well.
        clear = np.maximum(contrast, of_low)[np.arange(len(starts)), path] >= COMB_CONTRAST_DB
        if clear.all() and STEP * float(np.ptp(path)) <= CHANGES[1]:
            break
    middle = (starts + 0.5 * (length - 1)) / rate
    return SpeedCourse(np.asarray(middle, dtype=np.float64), np.where(clear, tried[path], np.nan))


def _contrasts(
    kept: FloatArray,
    rate: float,
    starts: npt.NDArray[np.intp],
    length: int,
    tried: FloatArray,
    changes: Sequence[float],
) -> FloatArray:
    """How far all and the low orders of each speed stand out (2, w, s) in each window, dB, by the best change."""
    orders = np.arange(1, TRACKED_ORDERS + 1)
    orders = orders[orders * tried[-1] / (2.0 * math.pi) < 0.45 * rate]
    padded = scipy.fft.next_fast_len(8 * length, real=True)
    on, off = (np.rint(np.outer(tried, orders - by) * (padded / (2.0 * math.pi * rate))).astype(np.intp)
               for by in (0.0, 0.5))  # fmt: skip
    window = np.hanning(length)
    best = np.full((2, len(starts), len(tried)), -np.inf)
    # Of -1 to 1 in a window: the angle by a change a is u + a (u^2 - 1) / 4, evenly sampled in it.
    even = np.linspace(-1.0, 1.0, length)
    for change in changes:
        at = even if change == 0.0 else (np.sqrt(1.0 + change * (even + 0.25 * change)) - 1.0) * 2.0 / change
        place = np.clip(0.5 * (at + 1.0) * (length - 1), 0.0, length - 1.0)
        before = np.minimum(place.astype(np.intp), length - 2)
        share = (place - before)[:, None]
        rows = starts[:, None] + before
        even_angle = kept[rows] * (1.0 - share) + kept[rows + 1] * share
        even_angle -= even_angle.mean(axis=1, keepdims=True)
        spectrum = np.abs(scipy.fft.rfft(even_angle * window[:, None], padded, axis=1)) ** 2
        level = np.log(spectrum + 1e-30).mean(axis=2) * (10.0 / math.log(10.0))
        above = level[:, on] - level[:, off]
        best = np.maximum(best, [above.mean(axis=2), above[:, :, :COMB_ORDERS].mean(axis=2)])
    return best


def _likeliest_path(contrast: FloatArray) -> npt.NDArray[np.intp]:
    """Column (w,) in each row of contrasts (w, s) so that their sum less the cost of changes is largest."""
    windows, count = contrast.shape
    column = np.arange(count)
    cost = np.minimum(TURN_DB * np.abs(column[:, None] - column), JUMP_DB)
    total = contrast[0]
    came = np.zeros((windows, count), dtype=np.intp)
    for row in range(1, windows):
        reached = total[:, None] - cost
        came[row] = reached.argmax(axis=0)
        total = reached[came[row], column] + contrast[row]
    path = np.empty(windows, dtype=np.intp)
    path[-1] = int(total.argmax())
    for row in range(windows - 1, 0, -1):
        path[row - 1] = came[row, path[row]]
    return path
