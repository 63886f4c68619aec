"""When samples were taken: a sample rate from a column of times, and even samples where rows are uneven or missing.

Times may be noise about an even clock, or true and uneven. Which is so the recording tells: each sample is better
predicted from its neighbours at the times that are right. Where the times are true, or rows are missing, a spline
through the samples gives even ones. What that may spoil is tried on the recording itself: the same times, laid over
another part of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from jointplay.catalogue.errors import MeasurementError
from jointplay.solver.arrays import BoolArray, FloatArray

#: Deviation of a sample interval from the mean up to which a recording counts as evenly sampled.
JITTER = 0.01
#: Missing rows in a row up to which they are filled; longer gaps are dropouts.
FILLED = 3
#: Share of a channel's rms that even samples may have wrong.
SPOILED = 0.1
#: Uncertainty up to which coarsely printed times say the sample rate.
RATE_KNOWN = 1e-3

_LOOKED_AT = 1000  # neighbouring times looked at for how many decimals are printed
_DEGREE = 5
_BLOCK, _MARGIN = 100_000, 64  # samples that a spline is made for at once, and rows beyond them that it goes through
_NEIGHBOURS = (-2, -1, 1, 2)


@dataclass(frozen=True, eq=False)
class TimeBase:
    """Sample rate [Hz], and what there is to say about it.

    Parameters
    ----------
    sample_rate : float
    facts, warnings : tuple of str
    places : (n,) array or None
        Of the rows among the even samples, counted from 0; None where each row is a sample.
    """

    sample_rate: float
    facts: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    places: FloatArray | None = None

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """First sample that is missing, and the one after the last, of each dropout."""
        return [] if self.places is None else gaps_of(self.places)

    def even(self, signal: FloatArray) -> FloatArray:
        """Return even samples (m, c) of rows (n, c)."""
        return signal if self.places is None else even_samples(self.places, signal)

    def place(self, rows: FloatArray) -> FloatArray:
        """Return where rows, or parts of them, are among the even samples."""
        return rows if self.places is None else np.interp(rows, np.arange(len(self.places)), self.places)

    def sample(self, row: int) -> int:
        """Return the even sample that is nearest to a row."""
        return round(float(self.place(np.array([row]))[0]))


@dataclass(frozen=True, eq=False)
class TimeColumn:
    """Times of a recording.

    Parameters
    ----------
    seconds : (n,) array
        From the first.
    quantum : float
        Last digit they have [s].
    """

    seconds: FloatArray
    quantum: float

    @classmethod
    def of(cls, time: FloatArray, factor: float) -> TimeColumn:
        """Return the times of a column as the file has it, of which a unit is `factor` seconds."""
        # Of times since 1970, a double does not hold all digits.
        since = time - time[0]
        if abs(time[0]) > 1e3 * abs(since[-1]):
            return cls(since * factor, max(_find_quantum(since), 2.0 * float(np.spacing(np.abs(time).max()))) * factor)
        return cls(since * factor, _find_quantum(time) * factor)


def even_time_base(
    column: TimeColumn,
    signal: FloatArray,
    names: tuple[str, ...],
    refusal: Callable[[str | None, int | None, str], MeasurementError],
    given: float | None = None,
) -> TimeBase:
    """Sample rate from a time column.

    Parameters
    ----------
    column : TimeColumn
    signal : (n, c) array
        Channels; they tell whether uneven times are true.
    names : tuple of str, (c,)
    refusal : callable
        Makes an error of a channel (or None for the time column), a row and the rule that is broken.
    given : float, optional
        Sample rate that the sender gives [Hz]: where times are not even, the rows are then taken to be.

    Raises
    ------
    MeasurementError
        Times that go back, that are printed too coarsely to tell the rate, or so uneven, or with so many missing rows,
        that a channel would be spoiled.
    """
    time, quantum = column.seconds, column.quantum
    steps = np.diff(time)
    step = float(np.median(steps))
    coarse = not step > 0 or quantum > step * (1.0 + 1e-9)
    if coarse:
        step = float(time[-1]) / len(steps)
    if not step > 0:
        raise refusal(None, 1, "time does not rise")
    slack = quantum * (1.0 + 1e-6)
    if not coarse and steps.min() > 0 and np.abs(steps - step).max() <= JITTER * step + slack:
        # Rounding of the first and last time alone makes the rate uncertain by this much; say 10000, not 9999.99998.
        rate = _whole(len(steps) / time[-1], 2.0 * quantum / time[-1])
        return TimeBase(rate, (f"{len(time)} samples at {rate:.8g} Hz (time column), {len(time) / rate:.4g} s",))
    spread = 1.4826 * float(np.median(np.abs(steps / step - 1.0)))
    longest = 1.5 + slack / step + max(0.0, 4.0 * spread - 0.4)
    clock = _even_clock(time, steps, step, longest if coarse else 1.5)
    if not coarse and np.abs(clock[2]).max() > JITTER:
        clock = _even_clock(time, steps, step, longest)
    rows, step, off = clock
    most = float(np.abs(off).max())
    back = np.flatnonzero(steps <= 0)
    rate = _whole(1.0 / step, (14.0 * float(off.std()) / math.sqrt(len(time)) + 2.0 * quantum / step) / rows[-1])
    missing = int(rows[-1]) + 1 - len(rows)
    if given is not None:
        agree = [abs(given / each - 1.0) <= JITTER for each in (rate, (len(time) - 1) / time[-1])]
        rate = given if any(agree) else rate
        told = f"times are not used, as the sample rate is given: they are up to {most:.2g} of an interval off"
        told += f", and {missing} rows seem to be missing" if missing else ""
        return TimeBase(rate, (f"{len(time)} samples at {rate:.8g} Hz (given)",), (told,))
    if missing > len(time):
        raise refusal(None, int(np.argmax(steps)) + 1, f"{missing} rows are missing, more than are there")
    if most > max(1.0, slack / step):
        if back.size:
            raise refusal(None, int(back[0]) + 1, "time does not rise: give the sample rate, if the samples are even")
        about_even = False
    elif coarse and 2.0 * quantum > RATE_KNOWN * time[-1]:
        rule = f"times are printed to {quantum:g} s only, more than a sample interval: give the sample rate"
        raise refusal(None, 0, rule)
    else:
        rounding = most * step <= JITTER * step + slack
        about_even = rounding or bool(back.size) or not _are_true(time / step, rows, signal)
    warnings = []
    if about_even:
        places = rows
        if not rounding:
            warnings.append(f"times are up to {most:.2g} of an interval off an even clock: samples are taken as even")
    else:
        rate = float(f"{rate:.4g}")
        places = time * rate
        shown = f"{steps.min():.4g} to {np.percentile(steps, 99.9):.4g} s"
        warnings.append(f"times are uneven (intervals of {shown}): resampled to {rate:g} Hz")
    dropouts = gaps_of(places)
    if missing:
        wide = f"; {len(dropouts)} of more than {FILLED} are dropouts" if dropouts else ""
        warnings.append(f"{missing} rows are missing: gaps are filled from the rows beside them{wide}")
    facts = [f"{len(time)} rows at {rate:.8g} Hz (time column), {(places[-1] + 1) / rate:.4g} s"]
    if about_even and not missing:
        return TimeBase(rate, tuple(facts + warnings), tuple(warnings))
    spoiled = spoiled_by(places, signal)
    worst = int(np.argmax(spoiled))
    facts.append(
        f"even samples by a spline of degree {_DEGREE}: at most {spoiled[worst]:.1%} of a channel's rms is wrong"
    )
    if not spoiled[worst] <= SPOILED:
        why = f"{missing} rows are missing" if about_even else "times are uneven"
        rule = f"{why}: even samples would have {spoiled[worst]:.0%} of its rms wrong, more than {SPOILED:.0%}"
        cure = "" if about_even else "; give the sample rate if only the times are uneven"
        raise refusal(names[worst], None, f"{rule}{cure}")
    return TimeBase(rate, tuple(facts + warnings), tuple(warnings), places)


def gaps_of(places: FloatArray) -> list[tuple[int, int]]:
    """First sample that is missing, and the one after the last, of each gap that is not filled."""
    before = np.flatnonzero(np.diff(places) > FILLED + 1.5)
    return [(math.floor(places[row]) + 1, math.ceil(places[row + 1])) for row in before]


def even_samples(places: FloatArray, signal: FloatArray) -> FloatArray:
    """Samples at whole places of rows that stand at others: a spline through the rows, straight lines over dropouts.

    Parameters
    ----------
    places : (n,) array
        Rising from 0.
    signal : (n, c) array

    Returns
    -------
    (m, c) array
    """
    at = np.arange(math.floor(places[-1] + 1e-6) + 1, dtype=np.float64)
    even = np.column_stack([np.interp(at, places, channel) for channel in signal.T])
    breaks = np.flatnonzero(np.diff(places) > FILLED + 1.5) + 1
    for first, last in zip([0, *breaks], [*breaks, len(places)], strict=True):
        if last - first <= _DEGREE:
            continue
        begin, end = math.ceil(places[first] - 1e-6), math.floor(places[last - 1] + 1e-6) + 1
        for start in range(begin, end, _BLOCK):
            stop = min(start + _BLOCK, end)
            low = max(first, int(np.searchsorted(places, start)) - _MARGIN)
            high = min(last, max(int(np.searchsorted(places, stop)), low + _DEGREE + 1) + _MARGIN)
            even[start:stop] = make_interp_spline(places[low:high], signal[low:high], k=_DEGREE)(at[start:stop])
    return even


def spoiled_by(places: FloatArray, signal: FloatArray, by: int | None = None) -> FloatArray:
    """Share of the rms (c,) of each channel that even samples have wrong.

    As of another recording by the same sensors: this one, moved by half its length, or by so many samples, is sampled
    at the same places.
    """
    even = even_samples(places, signal)
    whole = np.arange(len(even), dtype=np.float64)
    by = len(even) // 2 if by is None else by
    moved = np.roll(even, by, axis=0)
    again = even_samples(places, make_interp_spline(whole, moved, k=_DEGREE)(np.minimum(places, whole[-1])))
    kept: BoolArray = np.abs(whole - by) > _MARGIN / 2
    for first, last in [(0, _MARGIN // 2), *gaps_of(places), (len(even) - _MARGIN // 2, len(even))]:
        kept[max(0, first - 2) : last + 2] = False
    if not kept.any():
        return np.ones(signal.shape[1])
    wrong = np.sqrt(np.mean((again - moved)[kept] ** 2, axis=0))
    return np.asarray(wrong / np.maximum(even.std(axis=0), 1e-300), dtype=np.float64)


def _even_clock(
    time: FloatArray, steps: FloatArray, step: float, longest: float
) -> tuple[FloatArray, float, FloatArray]:
    """Places of the rows by an even clock, its step [s], and how far off times are [steps].

    Rows are missing where an interval is longer than so many steps.
    """
    missed = steps > longest * step
    if not missed.all():
        step = float(steps[~missed].mean())
    missing = np.where(missed, np.maximum(np.round(steps / step) - 1.0, 0.0), 0.0)
    rows = np.arange(len(time)) + np.concatenate([[0.0], np.cumsum(missing)])
    middle = rows - rows.mean()
    step = float(middle @ time / (middle @ middle))
    off = time - time.mean() - step * middle
    return rows, step, off / step


def _are_true(places: FloatArray, rows: FloatArray, signal: FloatArray) -> bool:
    """Whether samples are better predicted from their neighbours at the times they have than at those of a clock."""
    at = np.arange(2, len(rows) - 2)
    at = at[rows[at + 2] - rows[at - 2] < 4.5 + FILLED]
    if not len(at):
        return False
    misfits = []
    for places_ in (places, rows):
        predicted = np.zeros((len(at), signal.shape[1]))
        for one in _NEIGHBOURS:
            weight = np.ones(len(at))
            for other in _NEIGHBOURS:
                if other != one:
                    weight *= (places_[at] - places_[at + other]) / (places_[at + one] - places_[at + other])
            predicted += weight[:, None] * signal[at + one]
        misfits.append(np.mean((predicted - signal[at]) ** 2, axis=0) + 1e-300)
    return bool(np.mean(np.log(misfits[0] / misfits[1])) < 0.0)


def _whole(rate: float, uncertainty: float) -> float:
    """Return a rate as a whole number where it may be one."""
    rounded = float(round(rate))
    return rounded if rounded and abs(rate / rounded - 1.0) <= max(uncertainty, 1e-9) else rate


def _find_quantum(time: FloatArray) -> float:
    """Last printed digit of the times, 0 when they have more than nine decimals.

    Looked at in neighbouring times of both ends: every tenth time of a recording has one decimal less than all of them,
    and a file of so many significant digits has fewer decimals at its end.
    """
    return max(_quantum_of(time[:_LOOKED_AT]), _quantum_of(time[-_LOOKED_AT:]))


def _quantum_of(time: FloatArray) -> float:
    for digits in range(10):
        scaled = time * 10.0**digits
        if np.all(np.abs(scaled - np.round(scaled)) <= 1e-4 + 1e-12 * np.abs(scaled)):
            return float(10.0**-digits)
    return 0.0
