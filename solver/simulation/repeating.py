"""Whether a motion repeats with the drive, told while it is simulated, and the period of it that then says everything.

A Hann window of two periods, folded onto one, makes of any motion one that repeats: what repeats is left as it is, and
nothing jumps where the period closes. Two such periods that begin a revolution apart differ by what has not settled
yet, and by what never will. The amplitudes of their lines are compared as complex numbers, because levels can agree
while phases drift.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from jointplay.solver.arrays import ComplexArray, FloatArray, IntArray
from jointplay.solver.cases.preparation import NEVER, Prepared
from jointplay.solver.integrators.lanes import PHASES
from jointplay.solver.spectra.bands import FEATURE_ORDERS
from jointplay.solver.spectra.sampling import PASS
from jointplay.solver.spectra.segments import hann

#: Multiples of a revolution that are tried as a period.
PERIODS = (1, 2)
#: Periods agree when their bands differ by this part of themselves, root mean square: levels then are 0.004 dB from
#: those of a long run in the median and 0.5 dB at the 99th percentile, ``docs/measured/solver.md``.
AGREEMENT = 0.1
#: Periods whose accelerations differ by this part of themselves do not agree band by band either.
HOPELESS = 0.15
#: Later than at this part of a run its end saves less than the looking costs.
WORTHWHILE = 0.9
#: Bands below this part of the largest band of the same motion are rounding and do not count.
_LEAST_POWER = 1e-9


def watch(case: Prepared) -> Prepared:
    """Have it looked whether a case repeats, as soon as two periods can be compared.

    Its samples are then a whole number a revolution, at the next higher rate for which their transform is cheap.
    """
    from scipy.fft import next_fast_len  # takes long to load, which a server can begin without

    revolution = 2 * math.pi / abs(case.speed)
    samples = next_fast_len(math.ceil(case.sample_rate * revolution - 1e-9))
    return replace(case, sample_rate=samples / revolution, look=(2 * min(PERIODS) + 1) * PHASES * samples)


class Repetition:
    """What is known of one case's repeating.

    Parameters
    ----------
    case : Prepared
        Of :func:`watch`.

    Attributes
    ----------
    samples : int
        Recorded samples of a revolution.
    period : int
        Revolutions after which the motion repeats; 0 as long as that is not seen.
    """

    def __init__(self, case: Prepared) -> None:
        self.samples = case.look // (2 * min(PERIODS) + 1)
        self._wanted = PHASES * case.sample_rate * case.duration
        self.period = 0
        self._time = 2 * math.pi / abs(case.speed)
        self._lines = math.floor(PASS * case.sample_rate * self._time)
        # A swing that leaves the part q of itself after a revolution will change q / (1 - q) of its last change yet.
        left = math.exp(max(mode.real for mode in case.suspension) * self._time)
        self._agreement = AGREEMENT * (1.0 - left) / max(left, 1.0 - left)
        #: Lines that the last look found, by period and end: the next one compares with them.
        self._seen: dict[tuple[int, int], ComplexArray] = {}

    def look(self, velocity: FloatArray, samples: int) -> bool:
        """Whether the last ones of a case's samples repeat; `period` then says how often.

        Parameters
        ----------
        velocity : (c, PHASES, k) array
            Recorded from the start on, by phase.
        samples : int
            That there are; looked at are the last whole revolutions.
        """
        revolutions = samples // self.samples
        end = revolutions * self.samples
        seen, self._seen = self._seen, {}
        for period in PERIODS:
            length, count = period * self.samples, period * self._lines
            if revolutions <= 2 * period or _shaken(velocity, end, length) > HOPELESS:
                continue
            lines, before = (
                seen[period, last] if (period, last) in seen else _amplitudes(fold(velocity, last, length), count)
                for last in (end, end - self.samples)
            )
            self._seen[period, end] = lines
            # Seen from a revolution later, the same motion has turned on.
            if _difference(lines, before * _turn(period, count), period) <= self._agreement:
                self.period = period
                return True
        return False

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
