"""The steady part of a recording: run-up, coast-down and standstill cut off its ends, and a wandering drive made even.

A catalogue holds steady machines. What a machine does while it starts or stops is as loud, at other frequencies, and
spoils speed, noise and levels alike. A drive that wanders is sampled anew as if it had turned at its mean speed
(angular resampling).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.ndimage

from jointplay.catalogue.measurements.drivespeed import SpeedTrack, comb_speed, thin
from jointplay.solver.arrays import BoolArray, FloatArray
from jointplay.solver.compiler.native import compiled

#: Windows [revolutions], and windows a revolution.
WINDOW_REVOLUTIONS = 1.0
WINDOWS_PER_REVOLUTION = 4
#: Orders whose phases say how fast the machine turns in a window.
WATCHED_ORDERS = 8
#: Deviation from the usual that is not steady: of the speed, relative, and of the level [dB]. Recordings of steady
#: machines, worn or not, stay below a third of the one and half of the other; drives that wander do so by 1 %.
SPEED_DEVIATION = 0.03
LEVEL_DEVIATION_DB = 6.0
#: Once an end is not steady, it is cut as far as windows deviate from the usual by more than this many median
#: deviations, and more than this: the beginning of a coast-down is no louder news than a rattling joint.
CLEAR_DEVIATIONS = 5.0
CLEAR_SPEED = 0.005
CLEAR_LEVEL_DB = 1.5
#: Fewest revolutions that are looked at, and that must be left.
LEAST_REVOLUTIONS = 3.0
#: Revolutions that must be steady in a row, where there are so many.
IN_A_ROW = 2
#: How a finding ends that is of no consequence.
KEPT = "between steady parts: kept"
#: The usual speed is looked for in this many parts of so many revolutions.
PARTS = 9
PART_REVOLUTIONS = 4.0
#: Contrast [dB] of a comb, below the best one, from which a part has no say.
WORSE_BY_DB = 8.0


@dataclass(frozen=True)
class Stretch:
    """Samples ``first`` to ``last - 1`` are steady.

    Parameters
    ----------
    first, last : int
    findings : tuple of str
        What was cut off and why, and what is unsteady in between; one line each.
    """

    first: int
    last: int
    findings: tuple[str, ...] = ()


def steady_stretch(signal: npt.ArrayLike, sample_rate: float, nominal: float) -> Stretch:
    """Find the steady part of a recording.

    Parameters
    ----------
    signal : (n, c) array
        In any units.
    sample_rate : float
        Hz.
    nominal : float
        The machine's drive speed [rad/s]; its sign does not matter.

    Returns
    -------
    Stretch
        All of it, without findings, where it is too short to be judged or no speed stands out.

    Notes
    -----
    Windows of one revolution, four a revolution. A window is unsteady where its level is more than 6 dB off the median,
    or where the phases of orders 1 to 8 advance as at a speed more than 3 % off the usual one. At either end everything
    up to the first two whole revolutions of steady windows goes, and what is clearly off next to them. Levels
    find what is far from the speed (accelerations go with its square), phases what is near.
    """
    values = np.asarray(signal, dtype=np.float64)
    turn = abs(nominal) / (2.0 * math.pi)
    everything = Stretch(0, len(values))
    if len(values) / sample_rate * turn < LEAST_REVOLUTIONS + 1.0 or sample_rate < 8.0 * turn:
        return everything
    kept, rate = thin(values, sample_rate, turn)
    usual = _usual_turn(kept, rate, turn)
    if usual is None:
        return everything
    frames = _Frames.of(kept, rate, usual)
    slow = np.abs(frames.speed_deviation) > SPEED_DEVIATION
    odd = np.abs(frames.level_db) > LEVEL_DEVIATION_DB
    first, last = _ends(slow | odd, frames)
    if (last - first) / WINDOWS_PER_REVOLUTION < LEAST_REVOLUTIONS:
        return Stretch(0, len(values), ("no part of three revolutions is steady: nothing was cut off",))
    start = 0 if first == 0 else round(frames.starts[first] / rate * sample_rate)
    end = len(values) if last == len(slow) else round((frames.starts[last - 1] + frames.length) / rate * sample_rate)
    findings = []
    for side, cut, windows in (("beginning", start, slice(0, first)), ("end", len(values) - end, slice(last, None))):
        if cut:
            why = _why(slow[windows], odd[windows], frames.level_db[windows])
            findings.append(f"not steady at its {side} ({why}): {cut / sample_rate:.3g} s left out")
    inside = np.flatnonzero((slow | odd)[first:last])
    if inside.size:
        time = frames.starts[first + int(inside[0])] / rate
        findings.append(f"not steady at {time:.3g} s, {KEPT}")
    return Stretch(start, end, tuple(findings))


@dataclass(frozen=True, eq=False)
class _Frames:
    """Windows of one revolution.

    Parameters
    ----------
    starts : (w,) array of int
        First kept sample of each.
    length : int
    level_db : (w,) array
        Power, mean over channels in units of their median, dB.
    speed_deviation : (w,) array
        Of the speed, relative, from the phases' advance to the neighbours.
    """

    starts: npt.NDArray[np.intp]
    length: int
    level_db: FloatArray
    speed_deviation: FloatArray

    @classmethod
    def of(cls, kept: FloatArray, rate: float, turn: float) -> _Frames:
        period = rate / turn
        length = round(WINDOW_REVOLUTIONS * period)
        count = 1 + math.floor((len(kept) - length) * WINDOWS_PER_REVOLUTION / period)
        starts = np.rint(np.arange(count) * period / WINDOWS_PER_REVOLUTION).astype(np.intp)
        starts = starts[starts + length <= len(kept)]
        orders = np.arange(1, WATCHED_ORDERS + 1)
        orders = orders[orders * turn < 0.4 * rate]
        pieces = np.lib.stride_tricks.sliding_window_view(kept, length, axis=0)[starts]  # (w, c, length)
        power = pieces.var(axis=-1)
        typical = np.median(power, axis=0)
        level = 10.0 * np.log10(np.maximum((power / np.where(typical > 0, typical, 1.0)).mean(axis=1), 1e-12))
        place = np.arange(length) / period
        kernel = (np.hanning(length + 1)[:-1] * np.exp(-2j * math.pi * np.outer(orders, place))).T
        lines = (pieces @ kernel) * np.exp(-2j * math.pi * np.outer(starts / period, orders))[:, None, :]
        # Advance over one revolution, so that neighbouring orders' leakage is the same on both sides.
        hop = WINDOWS_PER_REVOLUTION
        product = lines[hop:] * lines[:-hop].conj()
        # An order votes by its power in this channel, so that lines of noise have none.
        weight = np.abs(product) * orders**2
        vote = np.angle(product) / (2.0 * math.pi * orders)
        deviation = (weight * vote).sum(axis=(1, 2)) / np.maximum(weight.sum(axis=(1, 2)), 1e-300)
        deviation = np.pad(deviation, (hop // 2, len(starts) - len(deviation) - hop // 2), mode="edge")
        return cls(starts, length, level - np.median(level), deviation)


def _usual_turn(kept: FloatArray, rate: float, turn: float) -> float | None:
    """Drive frequency [Hz] in the parts whose orders stand out most; None where none do."""
    length = round(PART_REVOLUTIONS * rate / turn)
    starts = np.unique(np.linspace(0, max(0, len(kept) - length), PARTS).astype(int))
    found = np.array([comb_speed(kept[start : start + length], rate, turn) for start in starts])
    clear = found[:, 1] > max(found[:, 1].max() - WORSE_BY_DB, 0.0)
    return float(np.median(found[clear, 0])) if clear.any() else None


def _ends(unsteady: BoolArray, frames: _Frames) -> tuple[int, int]:
    """First and last + 1 of the windows from the first whole steady revolutions to the last."""
    row = min(IN_A_ROW * WINDOWS_PER_REVOLUTION + 1, len(unsteady))
    calm = np.flatnonzero(~np.lib.stride_tricks.sliding_window_view(unsteady, row).any(axis=1))
    if not calm.size:
        return 0, 0
    first, last = int(calm[0]), int(calm[-1]) + row
    off = np.zeros(len(unsteady), dtype=bool)
    for values, least in ((frames.speed_deviation, CLEAR_SPEED), (frames.level_db, CLEAR_LEVEL_DB)):
        away = np.abs(values - np.median(values[first:last]))
        off |= away > max(CLEAR_DEVIATIONS * float(np.median(away[first:last])), least)
    if first > 0:
        while first < last and off[first : first + WINDOWS_PER_REVOLUTION].any():
            first += 1
    if last < len(unsteady):
        while last > first and off[max(0, last - WINDOWS_PER_REVOLUTION) : last].any():
            last -= 1
    return first, last


def _why(slow: BoolArray, odd: BoolArray, level_db: FloatArray) -> str:
    reasons = ["its speed changes"] if slow.any() else []
    if odd.any():
        extreme = float(level_db[np.argmax(np.abs(level_db))])
        reasons.append(f"its level is {extreme:+.0f} dB off")
    return ", ".join(reasons)


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
    place = places_at_mean_speed(count, sample_rate, track)
    mean = values.mean(axis=1, keepdims=True)
    length = scipy.fft.next_fast_len(count, real=True)
    spectrum = scipy.fft.rfft(values - mean, length)
    dense = DENSER * scipy.fft.irfft(spectrum, DENSER * length)[:, : DENSER * count]
    taken = np.stack([interpolate(row, DENSER * place) for row in dense])
    return np.asarray((taken + mean).T, dtype=np.float64)


def samples_at_mean_speed(mask: BoolArray, sample_rate: float, track: SpeedTrack) -> BoolArray:
    """Samples (n,) of a signal at equal steps of the drive's angle that lie where those of a mask do, or next to it."""
    place = places_at_mean_speed(len(mask), sample_rate, track)
    found: BoolArray = mask[np.floor(place).astype(np.intp)] | mask[np.ceil(place).astype(np.intp)]
    return found


def places_at_mean_speed(count: int, sample_rate: float, track: SpeedTrack) -> FloatArray:
    """Where (n,) samples at equal steps of the drive's angle lie, in samples; see :func:`at_mean_speed`."""
    speed = np.interp(np.arange(count) / sample_rate, track.time, track.speed)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    place = np.interp(np.linspace(0.0, angle[-1], count), angle, np.arange(count, dtype=np.float64))
    return np.asarray(np.clip(place, 0.0, count - 1.0), dtype=np.float64)


def interpolate(row: FloatArray, places: FloatArray) -> FloatArray:
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
