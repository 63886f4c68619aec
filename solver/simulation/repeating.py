"""Whether a motion repeats with the drive, told while it is simulated, and the period of it that then says everything.

A Hann window of two periods, folded onto one, makes of any motion one that repeats: what repeats is left as it is, and
nothing jumps where the period closes. Two such periods that begin a revolution apart differ by what has not settled
yet, and by what never will. The amplitudes of their lines are compared as complex numbers, because levels can agree
while phases drift.

Where a motor finds its own speed, revolutions end where its driver comes by again, and each of the last ones is sampled
anew, evenly in itself. The speed must have come to rest, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from jointplay.solver.arrays import ComplexArray, FloatArray, IntArray
from jointplay.solver.cases.preparation import NEVER, Prepared
from jointplay.solver.cases.turning import keeps_speed
from jointplay.solver.integrators.lanes import PHASES
from jointplay.solver.spectra.bands import FEATURE_ORDERS
from jointplay.solver.spectra.sampling import PASS, interpolate
from jointplay.solver.spectra.segments import hann

#: Multiples of a revolution that are tried as a period.
PERIODS = (1, 2)
#: Periods agree when their bands differ by this part of themselves, root mean square: levels then are 0.02 dB from
#: where they come to rest in the median and 2 dB at the 99th percentile, ``docs/measured/solver.md``.
AGREEMENT = 0.1
#: Periods whose accelerations differ by this part of themselves do not agree band by band either.
HOPELESS = 0.15
#: Later than at this part of a run its end saves less than the looking costs.
WORTHWHILE = 0.9
#: A motor that turns slower than its case says, by up to this part, has its revolutions all the same when it is looked.
_SLOWER = 0.05
#: Revolutions with which the shortest period is seen.
_LEAST = 2 * min(PERIODS) + 1
#: Bands below this part of the largest band of the same motion are rounding and do not count.
_LEAST_POWER = 1e-9


def watch(case: Prepared) -> Prepared:
    """Have it looked whether a case repeats, as soon as two periods can be compared.

    Its samples are then a whole number a revolution, at the next higher rate for which their transform is cheap; where
    it finds its own speed, that is done afterwards.
    """
    revolution = 2 * math.pi / abs(case.speed)
    if case.ends is None:
        samples = _cheap_length(case.sample_rate * revolution)
        case = replace(case, sample_rate=samples / revolution)
    else:
        samples = math.ceil((1.0 + _SLOWER) * case.sample_rate * revolution)
    return replace(case, look=_LEAST * PHASES * samples)


def _cheap_length(samples: float) -> int:
    """The next greater number of samples for which a transform is cheap."""
    from scipy.fft import next_fast_len  # takes long to load, which a server can begin without

    return int(next_fast_len(math.ceil(samples - 1e-9)))


@dataclass(frozen=True, eq=False)
class Turns:
    """Whole revolutions of a recorded motion, each with the same number of samples.

    Attributes
    ----------
    velocity : (c, PHASES, k) array
        By phase, see :func:`jointplay.solver.spectra.sampling.phases`, without its head.
    count : int
        Revolutions.
    samples : int
        Of a revolution.
    time : float
        Of a revolution, s.
    ends : (count + 1,) array or None
        Of revolutions, s since the first sample that was recorded; None where their time is prescribed.
    angle : float
        Of the drive at the ends, rad; 0 where their time is prescribed.
    """

    velocity: FloatArray
    count: int
    samples: int
    time: float
    ends: FloatArray | None = None
    angle: float = 0.0

    def lines(self, period: int) -> int:
        """Lines of a period up to where its acceleration is flat."""
        return period * math.floor(PASS * (self.samples / PHASES / self.time) * self.time)


@dataclass(frozen=True, eq=False)
class Period:
    """One period of a motion that repeats.

    Attributes
    ----------
    velocity : (c, n) array
    rate : float
        Of the results, of which there is one to :data:`PHASES` velocities, Hz.
    begin : float
        Of the first sample, s since the first one that was recorded.
    revolutions : int
    ends, angle
        As of :class:`Turns`, of the revolutions that it was folded from.
    """

    velocity: FloatArray
    rate: float
    begin: float
    revolutions: int
    ends: FloatArray | None
    angle: float


class Repetition:
    """What is known of one case's repeating.

    Parameters
    ----------
    case : Prepared
        Of :func:`watch`.

    Attributes
    ----------
    samples : int
        Recorded samples of a revolution, about as many where that finds its own speed.
    found : Period or None
        As soon as it is seen to repeat.
    """

    def __init__(self, case: Prepared) -> None:
        self.found: Period | None = None
        self._rate, self._ends = case.sample_rate, case.ends
        self._time = 2 * math.pi / abs(case.speed)
        self.samples = case.look // _LEAST
        self._wanted = PHASES * case.sample_rate * case.duration
        # A swing that leaves the part q of itself after a revolution will change q / (1 - q) of its last change yet.
        left = math.exp(max(mode.real for mode in case.suspension) * self._time)
        self._agreement = AGREEMENT * (1.0 - left) / max(left, 1.0 - left)
        #: Lines that the last look found, by period and end: the next one compares with them.
        self._seen: dict[tuple[int, int], ComplexArray] = {}

    @property
    def period(self) -> int:
        """Revolutions after which the motion repeats; 0 as long as that is not seen."""
        return 0 if self.found is None else self.found.revolutions

    def look(self, velocity: FloatArray, samples: int, motion: FloatArray | None = None) -> bool:
        """Whether the last ones of a case's samples repeat; `found` then is a period of them.

        Parameters
        ----------
        velocity : (c, PHASES, k) array
            Recorded from the start on, by phase.
        samples : int
            That there are; looked at are the last whole revolutions.
        motion : (r, k) array, optional
            Recorded coordinates, by which revolutions are known that have no prescribed time.
        """
        if self._ends is None:
            ends, angle, count = None, 0.0, samples // self.samples
        else:
            assert motion is not None
            ends, angle = self._ends(motion)
            count = len(ends) - 1
        enough = [period for period in PERIODS if count > 2 * period]
        periods = [period for period in enough if ends is None or keeps_speed(ends, period)]
        if not periods:
            return False
        if ends is None:
            turns = Turns(velocity, count, self.samples, self._time)
        else:
            turns = self._sample_anew(velocity, samples, ends, angle)
        last = turns.count * turns.samples
        seen, self._seen = self._seen, {}
        for period in periods:
            length, lines = period * turns.samples, turns.lines(period)
            if _shaken(turns.velocity, last, length) > HOPELESS:
                continue
            folded = fold(turns.velocity, last, length)
            now, before = _amplitudes(folded, lines), seen.get((period, last - turns.samples))
            if before is None:
                before = _amplitudes(fold(turns.velocity, last - turns.samples, length), lines)
            if ends is None:  # others are sampled anew at every look
                self._seen[period, last] = now
            # Seen from a revolution later, the same motion has turned on.
            if _difference(now, before * _turn(period, lines), period) <= self._agreement:
                self.found = self._period(turns, folded, period)
                return True
        return False

    def _sample_anew(self, velocity: FloatArray, samples: int, ends: FloatArray, angle: float) -> Turns:
        """The last whole revolutions, given their ends in samples of the results and the drive's angle at the last."""
        ends = ends[-2 * max(PERIODS) - 2 :]
        count = len(ends) - 1
        time = (ends[-1] - ends[-_LEAST]) / (_LEAST - 1) / self._rate
        length = PHASES * _cheap_length(self._rate * time)
        at = PHASES * np.interp(np.arange(count * length) / length, np.arange(count + 1), ends)
        first = max(0, int(at[0]) // PHASES - 2)
        plain = velocity[:, :, first:].swapaxes(1, 2).reshape(len(velocity), -1)[:, : samples - PHASES * first]
        even = interpolate(plain, at - PHASES * first)
        return Turns(even.reshape(len(even), -1, PHASES).swapaxes(1, 2), count, length, time, ends / self._rate, angle)

    def _period(self, turns: Turns, velocity: FloatArray, period: int) -> Period:
        if turns.ends is None:
            begin = (turns.count - 2 * period) * turns.samples / (self._rate * PHASES)
            return Period(velocity, self._rate, begin, period, None, 0.0)
        ends = turns.ends[-2 * period - 1 :]
        rate = turns.samples / PHASES * 2 * period / (ends[-1] - ends[0])
        return Period(velocity, rate, float(ends[0]), period, ends, turns.angle)

    def next_look(self, samples: int) -> int:
        """After how many recorded samples to look again: a revolution more, later on a quarter more, at last never."""
        revolutions = samples // self.samples
        after = (revolutions + max(1, revolutions // 4)) * self.samples
        return after if after < WORTHWHILE * self._wanted else NEVER


def _shaken(velocity: FloatArray, end: int, length: int) -> float:
    """How far a period's accelerations are from those of the one before, in parts of themselves; roughly, and fast."""
    last, size = end // PHASES, length // PHASES
    steps = np.diff(velocity[:, 0, last - 2 * size - 1 : last])
    now, apart = steps[:, size:], steps[:, size:] - steps[:, :size]
    sizes, differences = (np.einsum("ij,ij->i", x, x) for x in (now, apart))
    return math.sqrt(float(np.max(differences / np.maximum(sizes, 1e-300))))


def fold(velocity: FloatArray, end: int, length: int) -> FloatArray:
    """One period of a recorded motion.

    Parameters
    ----------
    velocity : (c, PHASES, k) array
        By phase, see :func:`jointplay.solver.spectra.sampling.phases`, without its head.
    end : int
        One past the last sample that counts, which needs `2 * length` samples before it.
    length : int
        Samples of the period.

    Returns
    -------
    (c, length) array
        From sample ``end - 2 * length`` on.
    """
    first = end - 2 * length
    low, high = first // PHASES, -(-end // PHASES)
    plain = velocity[:, :, low:high].swapaxes(1, 2).reshape(len(velocity), -1)
    windowed = plain[:, first - low * PHASES : end - low * PHASES] * hann(2 * length)
    return np.asarray(windowed[:, :length] + windowed[:, length:])


def periodic_acceleration(velocity: FloatArray, rate: float) -> FloatArray:
    """Acceleration of a period of velocities, at the rate of the results.

    Parameters
    ----------
    velocity : (c, PHASES * n) array
        One period.
    rate : float
        Of the results, Hz.

    Returns
    -------
    (c, n) array
        Flat and free of aliases below half the rate; nothing above that.
    """
    count = velocity.shape[1] // PHASES
    rates = 2j * math.pi * rate / count * np.arange(count // 2 + 1)
    rates[count // 2 :] = 0.0
    return np.asarray(np.fft.irfft(np.fft.rfft(velocity)[:, : count // 2 + 1] * rates, n=count) / PHASES)


def _amplitudes(period: FloatArray, count: int) -> ComplexArray:
    """Lines 0 ... `count` - 1 of the acceleration of a period of velocities, (c, count), to any scale."""
    return np.asarray(np.fft.rfft(period)[:, :count] * np.arange(count))


@lru_cache(maxsize=64)
def _turn(period: int, count: int) -> ComplexArray:
    """What a revolution later does to the lines of a period."""
    return np.asarray(np.exp(2j * np.pi / period * np.arange(count)))


def _difference(lines: ComplexArray, others: ComplexArray, period: int) -> float:
    """How far lines are apart, in parts of themselves: root mean square over bands, or single ones could be wrong."""
    starts = _first_lines(lines.shape[1], period)
    power, apart = (np.add.reduceat(x.real**2 + x.imag**2, starts, axis=1) for x in (lines, lines - others))
    counts = power > _LEAST_POWER * power.max(axis=1, keepdims=True)
    return math.sqrt(float((apart[counts] / power[counts]).mean())) if counts.any() else 0.0


@lru_cache(maxsize=1024)
def _first_lines(lines: int, period: int) -> IntArray:
    """First lines of the bands that are compared: each of the first orders, then thirds of an octave."""
    edges = [0.5 + order for order in range(FEATURE_ORDERS + 1)]
    while edges[-1] * period < lines:
        edges.append(edges[-1] * 2 ** (1 / 3))
    found = np.ceil(period * np.array(edges)).astype(np.int64)
    return np.asarray(found[found < lines])
