"""Drive speed out of a recording: a comb of harmonics finds it, the phases of the low orders refine it.

The mean over a few seconds must be known to 0.1 %: at order 20 that is a fiftieth of an order. A comb alone is not that
good, because real drives wander by some tenths of a percent during a recording and smear their own high orders. Phases
are: the drive's angle is taken as uniform rotation plus a slow polynomial, and the phase of order k follows it k-fold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from jointplay.catalogue.errors import MeasurementError
from jointplay.solver.arrays import ComplexArray, FloatArray

#: Speeds looked at, to either side of nominal.
SEARCH_RANGE = 0.10
#: Parts of a recording in which one of several speeds is looked for, and revolutions of one at the slowest of them.
LOUDEST, LOUD_REVOLUTIONS = 3, 15.0
#: Orders in the comb, and at the end of the phase tracking.
COMB_ORDERS = 8
TRACKED_ORDERS = 16
#: Revolutions in a tracking window, and windows a revolution.
WINDOW_REVOLUTIONS = 1.0
WINDOWS_PER_REVOLUTION = 2.0
#: Polynomial degree of the wander at most, and its usual size as a fraction of the speed.
WANDER_DEGREE = 6
WANDER_PRIOR = 6e-3
#: Phase error [rad] that no line is believed to stay below.
PHASE_FLOOR = 0.01
#: Samples a revolution that are kept for all this.
KEPT_PER_REVOLUTION = 128
#: Fewest revolutions a speed is estimated from.
MIN_REVOLUTIONS = 3.0
#: Longest stretch searched and tracked at a time: over more, an error of the comb could slip by a revolution.
BLOCK_REVOLUTIONS = 40.0
#: Windows of the search where blows hide the orders.
ROUGH_REVOLUTIONS = 8.0
#: Least mean ratio [dB] of the comb's lines to what lies between them. Machines show 30 to 50; the best comb of a
#: single channel of white noise reached 10.6 in 200 tries.
COMB_CONTRAST_DB = 12.0
#: Contrast [dB] below which, and deviation from the nominal speed above which, a speed that was found is warned of.
WEAK_CONTRAST_DB = 20.0
FAR_FROM_NOMINAL = 0.05
#: What to do where no speed is found.
OTHER_MACHINE = "give the speed, unless this is a recording of another machine or of one at rest"
#: A drive that turns so many times slower than was found, at most, is looked for.
MOST_SLOWER = 8


@dataclass(frozen=True)
class SpeedEstimate:
    """Drive speed of a recording.

    Parameters
    ----------
    speed : float
        Mean over the recording [rad/s].
    uncertainty : float
        Standard uncertainty of that mean [rad/s]; 0 when it was given.
    given : bool
        True when a user or a tachometer said it.
    wander : float
        Largest deviation from the mean during the recording, as a fraction of it; 0 when not tracked.
    contrast_db : float
        How far the orders stand out of what lies between them [dB]; 0 when the speed was given.
    """

    speed: float
    uncertainty: float
    given: bool
    wander: float = 0.0
    contrast_db: float = 0.0


@dataclass(frozen=True, eq=False)
class SpeedTrack:
    """Slow course of the speed.

    Parameters
    ----------
    time : (n,) array
        Middles of the windows [s].
    speed : (n,) array
        rad/s.
    estimate : SpeedEstimate
    """

    time: FloatArray
    speed: FloatArray
    estimate: SpeedEstimate


def estimate_speed(
    signal: npt.ArrayLike, sample_rate: float, nominal: float, given: float | None = None, source: str = "recording"
) -> SpeedEstimate:
    """Mean drive speed of a recording.

    Parameters
    ----------
    signal : (n, c) array
        Displacement, velocity or acceleration, in any units.
    sample_rate : float
        Hz.
    nominal : float
        The machine's drive speed [rad/s]; its sign does not matter.
    given : float, optional
        Known speed [rad/s]; it is taken as it is.
    source : str
        What messages call the recording.

    Returns
    -------
    SpeedEstimate

    Raises
    ------
    MeasurementError
        When the recording is too short or shows no orders within 10 % of the nominal speed.
    """
    if given is not None:
        if not (abs(given) > 0 and math.isfinite(given)):
            raise MeasurementError(source, value=given, rule="drive speed must be finite and not zero")
        return SpeedEstimate(abs(given), 0.0, True)
    return track_speed(signal, sample_rate, nominal, source).estimate


def track_speed(signal: npt.ArrayLike, sample_rate: float, nominal: float, source: str = "recording") -> SpeedTrack:
    """Course and mean of the drive speed; parameters and errors as for :func:`estimate_speed`.

    Returns
    -------
    SpeedTrack
    """
    values = np.asarray(signal, dtype=np.float64)
    turn = abs(nominal) / (2.0 * math.pi)
    if not (turn > 0 and math.isfinite(turn)):
        raise MeasurementError(source, value=nominal, rule="nominal drive speed must be finite and not zero")
    revolutions = len(values) / sample_rate * turn
    if revolutions < MIN_REVOLUTIONS:
        rule = f"{revolutions:.2g} revolutions; at least {MIN_REVOLUTIONS:g} are needed to find the drive speed"
        raise MeasurementError(source, rule=rule)
    if sample_rate < 8.0 * turn:
        rule = f"{sample_rate / turn:.2g} samples a revolution are too few to find the drive speed: give the speed"
        raise MeasurementError(source, rule=rule, field="speed")
    kept, rate = thin(values, sample_rate, turn)
    blocks = np.array_split(kept, math.ceil(revolutions / BLOCK_REVOLUTIONS))
    tracks = []
    for block in blocks:
        coarse, contrast = comb_speed(block, rate, turn)
        if contrast < COMB_CONTRAST_DB:
            low, high = (60.0 * turn * (1.0 + side * SEARCH_RANGE) for side in (-1, 1))
            rule = f"no orders of a drive speed between {low:.4g} and {high:.4g} rpm stand out: {OTHER_MACHINE}"
            raise MeasurementError(source, rule=rule, field="speed")
        tracks.append(_track(block, rate, coarse, contrast))
    return _join(tracks, [len(block) / rate for block in blocks])


def likeliest_speed(signal: npt.ArrayLike, sample_rate: float, speeds: Sequence[float]) -> float | None:
    """Return the one of some drive speeds [rad/s] about which orders stand out most; None where they do of none.

    Looked at where the recording is loudest: it may begin before the machine does.

    Parameters
    ----------
    signal, sample_rate
        As for :func:`estimate_speed`.
    speeds : sequence of float
        At least one; those that are too slow or too fast for the recording count for nothing.
    """
    values = np.asarray(signal, dtype=np.float64)
    values = np.where(np.isfinite(values), values, 0.0)
    turns = [abs(speed) / (2.0 * math.pi) for speed in speeds]
    revolutions = len(values) / sample_rate * min(turns)
    blocks = np.array_split(values, max(1, math.ceil(revolutions / LOUD_REVOLUTIONS)))
    loudest = sorted(blocks, key=lambda block: -float(np.sum(np.var(block, axis=0))))[:LOUDEST]
    contrasts = []
    for turn in turns:
        fits = [b for b in loudest if len(b) / sample_rate * turn >= MIN_REVOLUTIONS and sample_rate >= 8.0 * turn]
        found = [comb_speed(*thin(block, sample_rate, turn), turn)[1] for block in fits]
        contrasts.append(max(found, default=-math.inf))
    best = int(np.argmax(contrasts))
    return float(speeds[best]) if contrasts[best] >= COMB_CONTRAST_DB else None


def thin(values: FloatArray, sample_rate: float, turn: float) -> tuple[FloatArray, float]:
    """Means of blocks of samples: orders near zero stay, what would fold onto them falls on zeros of the mean."""
    block = max(1, int(sample_rate / (turn * KEPT_PER_REVOLUTION)))
    count = len(values) // block
    pieces = np.ascontiguousarray(values[: count * block].T).reshape(-1, count, block)
    kept = (pieces @ np.full(block, 1.0 / block)).T
    kept = kept - kept.mean(axis=0)
    scale = kept.std(axis=0)
    return kept / np.where(scale > 0, scale, 1.0), sample_rate / block


def comb_speed(kept: FloatArray, rate: float, turn: float) -> tuple[float, float]:
    """Frequency whose multiples stand out most, and by how much [dB]."""
    length = len(kept)
    padded = scipy.fft.next_fast_len(8 * length, real=True)
    window = np.hanning(length)
    power = np.abs(scipy.fft.rfft(kept * window[:, None], padded, axis=0)) ** 2
    duration = length / rate
    # A line at order 8 is 4 / duration wide; eight points across the narrowest peak of the comb are enough.
    step = 1.0 / (4.0 * COMB_ORDERS * duration)
    candidates = np.arange(turn * (1.0 - SEARCH_RANGE), turn * (1.0 + SEARCH_RANGE) + step, step)
    orders = np.arange(1, COMB_ORDERS + 1)
    orders = orders[orders * candidates[-1] < 0.45 * rate]
    lines = np.rint(np.outer(candidates, orders) * (padded / rate)).astype(np.intp)
    between = np.rint(np.outer(candidates, orders - 0.5) * (padded / rate)).astype(np.intp)
    on = np.log(power[lines] + 1e-30).mean(axis=(1, 2))
    off = np.log(power[between] + 1e-30).mean(axis=(1, 2))
    best = int(np.argmax(on - off))
    return float(candidates[best]), float((on - off)[best] * 10.0 / math.log(10.0))


def doubt_speed(estimate: SpeedEstimate, signal: npt.ArrayLike, sample_rate: float, nominal: float) -> list[str]:
    """Return what makes a drive speed doubtful, each in a line that begins with "drive speed".

    Parameters
    ----------
    estimate : SpeedEstimate
        What was found, or given.
    signal, sample_rate, nominal
        As for :func:`estimate_speed`.
    """
    found = f"drive speed {estimate.speed * 30.0 / math.pi:.4g} rpm"
    doubts = []
    if abs(estimate.speed / abs(nominal) - 1.0) > FAR_FROM_NOMINAL:
        doubts.append(f"{found} is far from the nominal {abs(nominal) * 30.0 / math.pi:.4g} rpm")
    if estimate.contrast_db == 0.0:  # nothing was looked for
        return doubts
    if estimate.contrast_db < WEAK_CONTRAST_DB:
        clear = f"{estimate.contrast_db:.0f} dB only, usually 30 to 50"
        doubts.append(f"{found} was found by orders that stand out by {clear}")
    slower = _times_slower(np.asarray(signal, dtype=np.float64), sample_rate, estimate.speed / (2.0 * math.pi))
    if slower > 1:
        rpm = estimate.speed * 30.0 / (math.pi * slower)
        doubts.append(f"{found} was found, but multiples of {rpm:.4g} rpm stand out, too: it may turn that slowly")
    return doubts


def _times_slower(values: FloatArray, sample_rate: float, turn: float) -> int:
    """How many times slower than found a drive turns, by lines between the orders that stand out, too; 1: none."""
    kept, rate = thin(values[: int(BLOCK_REVOLUTIONS * sample_rate / turn)], sample_rate, turn)
    padded = scipy.fft.next_fast_len(8 * len(kept), real=True)
    level = np.log(np.abs(scipy.fft.rfft(kept * np.hanning(len(kept))[:, None], padded, axis=0)) ** 2 + 1e-30)
    excess = {1: COMB_CONTRAST_DB}
    for times in range(2, MOST_SLOWER + 1):
        if len(kept) / rate * turn / times < MIN_REVOLUTIONS:
            break
        parts = np.arange(1, COMB_ORDERS * times)
        parts = parts[(parts % times > 0) & (parts * turn / times < 0.45 * rate)]
        lines, between = (np.rint((parts - off) * turn / times * padded / rate).astype(np.intp) for off in (0, 0.5))
        excess[times] = float((level[lines] - level[between]).mean()) * 10.0 / math.log(10.0)
    return max(excess, key=lambda times: excess[times])


def rough_track(signal: npt.ArrayLike, sample_rate: float, nominal: float) -> SpeedTrack | None:
    """Mean speed where blows from outside hide the orders in part of a recording.

    Parameters
    ----------
    signal, sample_rate, nominal
        As for :func:`estimate_speed`; long enough for it.

    Returns
    -------
    SpeedTrack or None
        Without a course, good to half a percent; None where no speed stands out even in the quieter half of windows of
        eight revolutions.
    """
    turn = abs(nominal) / (2.0 * math.pi)
    kept, rate = thin(np.asarray(signal, dtype=np.float64), sample_rate, turn)
    length = min(len(kept), round(ROUGH_REVOLUTIONS * rate / turn))
    padded = scipy.fft.next_fast_len(8 * length, real=True)
    step = rate / (16.0 * COMB_ORDERS * length)
    candidates = np.arange(turn * (1.0 - SEARCH_RANGE), turn * (1.0 + SEARCH_RANGE) + step, step)
    orders = np.arange(1, COMB_ORDERS + 1)
    orders = orders[orders * candidates[-1] < 0.45 * rate]
    lines, between = (np.rint(np.outer(candidates, orders - off) * (padded / rate)).astype(np.intp) for off in (0, 0.5))
    contrast = []
    for start in range(0, len(kept) - length + 1, max(1, length // 2)):
        spectrum = scipy.fft.rfft(kept[start : start + length] * np.hanning(length)[:, None], padded, axis=0)
        level = np.log(np.abs(spectrum) ** 2 + 1e-30)
        contrast.append((level[lines] - level[between]).mean(axis=(1, 2)))
    clear = np.sort(contrast, axis=0)[len(contrast) // 2 :].mean(axis=0)
    best = int(np.argmax(clear))
    decibels = float(clear[best]) * 10.0 / math.log(10.0)
    if decibels < COMB_CONTRAST_DB:
        return None
    speed = 2.0 * math.pi * float(candidates[best])
    return SpeedTrack(np.array([0.0]), np.array([speed]), SpeedEstimate(speed, 5e-3 * speed, False, 0.0, decibels))


def _track(kept: FloatArray, rate: float, turn: float, contrast: float) -> SpeedTrack:
    """Refine by the phases of order 1, then 1-2, 1-4 ... in windows of one revolution."""
    duration = len(kept) / rate
    length = min(len(kept), round(WINDOW_REVOLUTIONS * rate / turn))
    count = 1 + math.ceil((len(kept) - length) * WINDOWS_PER_REVOLUTION * turn / rate)
    starts = np.linspace(0, len(kept) - length, count).round().astype(np.intp)
    middle = (starts + 0.5 * (length - 1)) / rate
    orders = np.arange(1, TRACKED_ORDERS + 1)
    orders = orders[orders * turn < 0.4 * rate]
    time = np.arange(len(kept)) / rate
    turning = np.exp(-2j * math.pi * turn * time[:, None] * orders)
    lines = np.stack(
        [kept[start : start + length].T @ turning[start : start + length] for start in starts]
    )  # (windows, c, orders)
    # speed = 2 pi turn (1 + sum of g_j P_j(u)), u from -1 to 1: the mean is g_0, the angle the integral.
    abscissa = 2.0 * middle / duration - 1.0
    waves = min(WANDER_DEGREE, max(1, int(duration * turn / 1.5))) + 1
    legendre = np.polynomial.legendre.legvander(abscissa, waves)
    half = math.pi * turn * duration
    basis = half * np.column_stack(
        [legendre[:, 1]] + [(legendre[:, j + 1] - legendre[:, j - 1]) / (2 * j + 1) for j in range(1, waves)]
    )
    prior = np.array([1e-2, *(WANDER_PRIOR / j for j in range(1, waves))])
    deviation = np.zeros(waves)
    scatter = prior
    highest = 1
    for _ in range(10):
        used = orders <= highest
        deviation, scatter = _phase_step(lines[..., used], orders[used], basis, deviation, prior)
        highest = min(2 * highest, int(orders[-1]))
    speed = 2.0 * math.pi * turn * (1.0 + float(deviation[0]))
    course = 2.0 * math.pi * turn * (1.0 + legendre[:, :waves] @ deviation)
    uncertainty = 2.0 * math.pi * turn * float(scatter[0])
    wander = float(np.max(np.abs(course / speed - 1.0)))
    return SpeedTrack(
        np.asarray(middle, dtype=np.float64), course, SpeedEstimate(speed, uncertainty, False, wander, contrast)
    )


def _join(tracks: list[SpeedTrack], durations: list[float]) -> SpeedTrack:
    """One course out of those of blocks that follow each other."""
    starts = np.concatenate([[0.0], np.cumsum(durations)[:-1]])
    share = np.asarray(durations) / sum(durations)
    course = np.concatenate([track.speed for track in tracks])
    speed = float(share @ np.array([track.estimate.speed for track in tracks]))
    estimate = SpeedEstimate(
        speed=speed,
        uncertainty=float(np.sqrt(np.sum((share * np.array([track.estimate.uncertainty for track in tracks])) ** 2))),
        given=False,
        wander=float(np.max(np.abs(course / speed - 1.0))),
        contrast_db=min(track.estimate.contrast_db for track in tracks),
    )
    time = np.concatenate([start + track.time for start, track in zip(starts, tracks, strict=True)])
    return SpeedTrack(time, course, estimate)


def _phase_step(
    lines: ComplexArray,
    orders: npt.NDArray[np.int_],
    basis: FloatArray,
    deviation: FloatArray,
    prior: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """One weighted least-squares step for the course of the speed; each line has a phase of its own."""
    straight = lines * np.exp(-1j * (basis @ deviation)[:, None, None] * orders)
    residual = np.angle(straight * straight.sum(axis=0).conj())  # (windows, c, orders)
    size = np.abs(straight)
    share = size / np.maximum(size.mean(axis=0), 1e-300)
    # An order counts by how steady its phase is: impacts and other sources make it wander by themselves.
    variance = (share * residual**2).mean(axis=0) + PHASE_FLOOR**2
    # Windows overlap by half: neighbours share half of their data.
    weight = np.minimum(share, 4.0) / (WINDOWS_PER_REVOLUTION * variance)
    total = np.maximum(weight.sum(axis=0), 1e-300)  # a line of a dead channel weighs nothing
    windows = len(basis)
    squared = np.broadcast_to(orders**2, total.shape).ravel()
    flat = weight.reshape(windows, -1)
    centre = flat.T @ basis / total.reshape(-1, 1)
    normal = basis.T @ (basis * (flat @ squared)[:, None]) - (centre * (total.ravel() * squared)[:, None]).T @ centre
    pulled = flat * np.broadcast_to(orders, total.shape).ravel() * residual.reshape(windows, -1)
    right = basis.T @ pulled.sum(axis=1) - centre.T @ pulled.sum(axis=0)
    normal += np.diag(prior**-2)
    right -= deviation / prior**2
    covariance = np.linalg.inv(normal)
    return deviation + covariance @ right, np.sqrt(np.diag(covariance))
