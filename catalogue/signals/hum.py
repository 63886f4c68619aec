"""Mains hum and other steady lines between the orders: found, weighed against the orders next to them, taken out.

A steady line keeps its phase against the clock, an order keeps its phase against the drive's angle, which wanders.
Around each suspected frequency both are fitted together; the line goes only when it explains far more than chance
would. So hum is told from an order even where the two are closer than the recording resolves.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.fft

from jointplay.catalogue.measurements.drivespeed import SpeedTrack
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.spectra.segments import hann

#: Mains frequencies of the world [Hz], how far they stray, which multiples betray them, how many are then looked at.
MAINS = (50.0, 60.0)
MAINS_STRAY = 0.2
STRAY_USUAL = 0.15  # of that, the usual deviation
FIRST_MULTIPLES = (1, 2)
MULTIPLES = 6
#: Least distance of a line from an order, in cycles over the recording, for the two to be told apart; more at high
#: orders, whose phase is known less well.
LEAST_SEPARATION = 0.2
SEPARATION_PER_ORDER = 0.002
#: A line less than a cycle from an order must have at least this share of its amplitude: orders are not that steady.
LEAST_SHARE = 0.1
#: Amplitude [m/s2] of hum that cables pick up without being called faulty: half a millivolt at 100 mV/g.
PICKED_UP = 0.05
#: A line goes when the sum over channels of (its power / what chance would give) exceeds this much a channel, plus
#: this much.
GAIN_A_CHANNEL = 6.0
GAIN_ON_TOP = 6.0
#: More for higher multiples, where orders are dense, and for lines at no particular frequency.
MULTIPLES_FACTOR = 2.0
SEARCH_FACTOR = 5.0
SEARCH_UP_TO = 1000.0
SEARCH_LINES = 8
#: Fewest revolutions that tell a line from an order.
LEAST_REVOLUTIONS = 3.0
#: Long recordings are taken in stretches [s], as the mains frequency drifts.
STRETCH = 30.0
#: Windows: one revolution of Hann, so that all orders but the neighbours fall on zeros; four a revolution.
WINDOWS_PER_REVOLUTION = 4
#: Independent windows among them: the noise bandwidth of a Hann window is 1.5 lines.
INDEPENDENT = 1.5 / WINDOWS_PER_REVOLUTION
#: Samples in a row whose phases follow from one another by products: exponentials cost ten times as much.
PHASES_TOGETHER = 256


@dataclass(frozen=True, eq=False)
class SteadyLine:
    """A line that was taken out.

    Parameters
    ----------
    frequency : float
        Hz.
    amplitude : (c,) array
        Peak amplitude in each channel [unit]; the mean over stretches.
    mains : float or None
        The mains frequency it is a multiple of.
    """

    frequency: float
    amplitude: FloatArray
    mains: float | None


@dataclass(frozen=True, eq=False)
class Cleaned:
    """A signal without the lines.

    Parameters
    ----------
    signal : (n, c) array
    lines : tuple of SteadyLine
    """

    signal: FloatArray
    lines: tuple[SteadyLine, ...]


def hum_in_orders(turn: float, duration: float, lines: Sequence[SteadyLine]) -> dict[int, float]:
    """Find the orders that hum may hide in: those that a multiple of the mains frequency cannot be told from.

    Parameters
    ----------
    turn : float
        Mean drive speed [Hz].
    duration : float
        Of the recording [s].
    lines : sequence of SteadyLine
        What was taken out of it, as accelerations.

    Returns
    -------
    dict of int to float
        By order, the peak amplitude [m/s2] that hum may have in it: what is picked up commonly, or as much as the
        loudest mains line that was found.
    """
    known = [line for line in lines if line.mains is not None]
    # A line that was found says which frequency it is, and exactly; without any it may be either, and stray.
    families = {line.mains: line.frequency / round(line.frequency / line.mains) for line in known if line.mains}
    stray = 0.0 if families else 2.0 * STRAY_USUAL * MAINS_STRAY
    amplitude = max([PICKED_UP, *(float(line.amplitude.max()) for line in known)])
    stretch = duration / max(1, math.ceil(duration / STRETCH))
    taken_out = {(line.mains, round(line.frequency / line.mains)) for line in known if line.mains}
    found = {}
    for mains, frequency in (families or {each: each for each in MAINS}).items():
        for multiple in range(1, MULTIPLES + 1):
            order = round(multiple * frequency / turn)
            unlike = abs(order * turn - multiple * frequency)
            separation = (LEAST_SEPARATION + SEPARATION_PER_ORDER * order) / stretch
            if order and (mains, multiple) not in taken_out and unlike < separation + stray * multiple:
                found[order] = amplitude
    return dict(sorted(found.items()))


def remove_hum(signal: npt.ArrayLike, sample_rate: float, track: SpeedTrack) -> Cleaned:
    """Take steady lines out of a signal.

    Parameters
    ----------
    signal : (n, c) array
    sample_rate : float
        Hz.
    track : SpeedTrack
        Course of the drive speed in this recording.

    Returns
    -------
    Cleaned
        The signal is a copy; orders are untouched.
    """
    # Channel by channel, each in one piece of memory: every step below works along time.
    values = np.array(np.asarray(signal, dtype=np.float64).T, order="C")
    samples = values.shape[1]
    count = max(1, math.ceil(samples / sample_rate / STRETCH))
    borders = np.linspace(0, samples, count + 1).round().astype(int)
    found: dict[tuple[float, float | None], list[FloatArray]] = {}
    for first, last in itertools.pairwise(borders):
        stretch = _CleanedStretch(values[:, first:last], sample_rate, first / sample_rate, track)
        for line in stretch.clean():
            # Stretches find slightly different frequencies of one line.
            known = [key for key in found if abs(key[0] - line.frequency) < 2 * MAINS_STRAY and key[1] == line.mains]
            found.setdefault(known[0] if known else (line.frequency, line.mains), []).append(line.amplitude)
    lines = tuple(
        SteadyLine(frequency, np.sum(amplitudes, axis=0) / count, mains)
        for (frequency, mains), amplitudes in sorted(found.items())
    )
    return Cleaned(values.T, lines)


@dataclass(frozen=True, eq=False)
class _LineFit:
    line: SteadyLine
    half_amplitude: ComplexArray
    gain: float


class _CleanedStretch:
    """A stretch of the signal (c, n), cleaned in place."""

    def __init__(self, values: FloatArray, sample_rate: float, start: float, track: SpeedTrack) -> None:
        self.values = values
        self.rate = sample_rate
        self.samples = values.shape[1]
        self.time = np.arange(self.samples) / sample_rate
        speed = np.interp(start + self.time, track.time, track.speed)
        self.angle = np.concatenate([[0.0], np.cumsum(speed[:-1])]) / sample_rate
        self.turn = float(speed.mean()) / (2.0 * math.pi)
        self.duration = self.samples / sample_rate
        self.hop = round(sample_rate / self.turn / WINDOWS_PER_REVOLUTION)
        self._frames: FloatArray | None = None

    def clean(self) -> list[SteadyLine]:
        """Take out mains lines of the stronger family, then others."""
        if self.duration * self.turn < LEAST_REVOLUTIONS:
            return []
        removed = []
        families = [self._fit(mains * m, MAINS_STRAY * m, mains, 1.0) for mains in MAINS for m in FIRST_MULTIPLES]
        best = max((fit for fit in families if fit is not None), key=lambda fit: fit.gain, default=None)
        if best is not None:
            mains = best.line.mains
            assert mains is not None
            # The multiples of a line that was found lie where they must.
            actual = best.line.frequency / round(best.line.frequency / mains)
            for multiple in range(1, MULTIPLES + 1):
                factor = 1.0 if multiple in FIRST_MULTIPLES else MULTIPLES_FACTOR
                removed.append(self._fit(multiple * actual, 0.0, mains, factor))
                self._take_out(removed[-1])
        for frequency in self._suspects():
            removed.append(self._fit(frequency, 0.5 / self.duration, None, SEARCH_FACTOR))
            self._take_out(removed[-1])
        return [fit.line for fit in removed if fit is not None]

    def _take_out(self, fit: _LineFit | None) -> None:
        if fit is not None:
            self._frames = None
            wave = self._phases(fit.line.frequency)
            for channel, amplitude in zip(self.values, 2.0 * fit.half_amplitude, strict=True):
                channel -= amplitude.real * wave.real - amplitude.imag * wave.imag

    def _phases(self, frequency: float) -> ComplexArray:
        """Return exp(2 pi i f t) at every sample, (n,)."""
        turning = 2j * math.pi * frequency / self.rate
        within = np.exp(turning * np.arange(PHASES_TOGETHER))
        between = np.exp(turning * PHASES_TOGETHER * np.arange(math.ceil(self.samples / PHASES_TOGETHER)))
        return np.outer(between, within).ravel()[: self.samples]

    def _fit(self, frequency: float, stray: float, mains: float | None, factor: float) -> _LineFit | None:
        """Fit a line and the orders around it; None when the line is not there or cannot be told from an order."""
        if frequency + 2.0 * self.turn > 0.5 * self.rate:
            return None
        baseband, middle = self._baseband(frequency)
        centre = frequency / self.turn
        orders = np.arange(max(1, math.ceil(centre - 1.99)), math.floor(centre + 1.99) + 1)
        angle = np.interp(middle, self.time, self.angle)
        turning = np.exp(1j * (np.outer(angle, orders) - 2.0 * math.pi * frequency * middle[:, None]))
        offset = self._offset(baseband, turning, middle, frequency, stray, orders)
        if offset is None:
            return None
        model = np.column_stack([np.exp(2j * math.pi * offset * middle), turning])
        basis, triangle = np.linalg.qr(model)
        unmixed = np.linalg.inv(triangle)
        weights = unmixed @ (basis.conj().T @ baseband)
        residual = baseband - model @ weights
        freedom = max(1.0, INDEPENDENT * len(middle) - model.shape[1])
        variance = (np.abs(residual) ** 2).sum(axis=0) * INDEPENDENT / freedom
        chance = variance * float(np.sum(np.abs(unmixed[0]) ** 2)) / INDEPENDENT
        power = np.abs(weights[0]) ** 2
        gain = float((power / np.maximum(chance, np.finfo(np.float64).tiny)).sum())
        if gain < factor * (GAIN_A_CHANNEL * len(power) + GAIN_ON_TOP):
            return None
        if orders.size:
            nearest = int(np.argmin(np.abs(orders * self.turn - frequency - offset)))
            unresolved = abs(orders[nearest] * self.turn - frequency - offset) * self.duration < 1.0
            if unresolved and power.sum() < LEAST_SHARE**2 * float((np.abs(weights[1 + nearest]) ** 2).sum()):
                return None
        return _LineFit(SteadyLine(frequency + offset, 2.0 * np.abs(weights[0]), mains), weights[0], gain)

    @cached_property
    def _window(self) -> tuple[FloatArray, FloatArray]:
        """Samples of a window, counted from its middle, and their weights, of sum 1."""
        revolution = self.rate / self.turn
        count = WINDOWS_PER_REVOLUTION * self.hop
        sample: FloatArray = np.arange(count, dtype=np.float64) + 0.5 - 0.5 * count
        place = sample / revolution
        window = np.where(np.abs(place) < 0.5, np.cos(math.pi * place) ** 2, 0.0)
        weight: FloatArray = window / window.sum()
        return sample, weight

    def _baseband(self, frequency: float) -> tuple[ComplexArray, FloatArray]:
        """Complex amplitude at a frequency in every window, (windows, c), and the windows' middles [s]."""
        # Windows overlap by three quarters: weigh every quarter once for each place in a window, then add up.
        # The window is exactly one revolution wide, or loud low orders would not fall on its zeros. What leaks of them
        # folds onto the order next to the line, as windows follow each other by a quarter of a revolution.
        hop = self.hop
        sample, window = self._window
        kernel = (window * np.exp(-2j * math.pi * frequency / self.rate * sample)).reshape(-1, hop)
        count = self.samples // hop
        windows = count - WINDOWS_PER_REVOLUTION + 1
        if self._frames is None:
            mean = self.values.mean(axis=1, keepdims=True)
            self._frames = (self.values[:, : count * hop] - mean).reshape(-1, hop)
        weighed = self._frames @ np.concatenate([kernel.real, kernel.imag]).T
        parts = weighed.reshape(-1, count, 2, WINDOWS_PER_REVOLUTION)
        total = (
            sum(parts[:, q : q + windows, :, q] for q in range(1, WINDOWS_PER_REVOLUTION)) + parts[:, :windows, :, 0]
        )
        middle = ((np.arange(windows) + 0.5 * WINDOWS_PER_REVOLUTION) * hop - 0.5) / self.rate
        # The kernel's phase counts from the middle of its window: turned back to the beginning of the stretch.
        baseband = (total[..., 0] + 1j * total[..., 1]).T * np.exp(-2j * math.pi * frequency * middle)[:, None]
        return np.asarray(baseband, dtype=np.complex128), np.asarray(middle, dtype=np.float64)

    def _offset(
        self,
        baseband: ComplexArray,
        turning: ComplexArray,
        middle: FloatArray,
        frequency: float,
        stray: float,
        orders: npt.NDArray[np.int_],
    ) -> float | None:
        """Distance of the line from where it was suspected [Hz], None when it cannot be told from an order."""
        step = 0.05 / self.duration
        offsets = np.arange(-math.floor(stray / step), math.floor(stray / step) + 1) * step
        distance = np.abs(frequency + offsets[:, None] - orders * self.turn).min(axis=1, initial=math.inf)
        offsets = offsets[distance * self.duration >= LEAST_SEPARATION + SEPARATION_PER_ORDER * frequency / self.turn]
        if not offsets.size:
            return None
        # Project the orders out of both the signal and the line, or offsets next to an order would look best.
        basis, _ = np.linalg.qr(turning)
        rest = baseband - basis @ (basis.conj().T @ baseband)
        waves = np.exp(-2j * math.pi * np.outer(offsets, middle))
        left = len(middle) - (np.abs(waves @ basis) ** 2).sum(axis=1)
        total = np.maximum((np.abs(rest) ** 2).sum(axis=0), 1e-300)
        explained = np.abs(waves @ rest) ** 2 / np.maximum(left, 1e-9)[:, None] / total
        likelihood = -INDEPENDENT * len(middle) * np.log(np.maximum(1.0 - explained, 1e-12)).sum(axis=1)
        usual = max(STRAY_USUAL * stray, step)
        return float(offsets[np.argmax(likelihood - 0.5 * (offsets / usual) ** 2)])

    def _suspects(self) -> Iterable[float]:
        """Frequencies [Hz] of sharp peaks that are no order, nor a half, third or quarter of one."""
        length = scipy.fft.next_fast_len(self.samples, real=True)
        window = hann(self.samples)
        spectrum = scipy.fft.rfft((self.values - self.values.mean(axis=1, keepdims=True)) * window, length)
        lines = min(spectrum.shape[1], int(min(SEARCH_UP_TO, 0.4 * self.rate) * length / self.rate))
        power = spectrum[:, :lines].real ** 2 + spectrum[:, :lines].imag ** 2
        scale = np.median(power, axis=1, keepdims=True)
        level = (power / np.where(scale > 0, scale, 1.0)).sum(axis=0)
        frequency = np.arange(lines) * self.rate / length
        order = frequency / self.turn
        away = np.min([np.abs(order * n - np.round(order * n)) / n for n in (2, 3, 4)], axis=0) * self.turn
        peaks = np.zeros(lines, dtype=bool)
        peaks[1:-1] = (level[1:-1] >= level[:-2]) & (level[1:-1] > level[2:])
        peaks &= (away * self.duration > 1.5) & (order > 0.5)
        # The floor, a running median over two orders to either side, is only worked out under peaks.
        half = max(1, min(int(2.0 * self.turn * self.duration), (lines - 1) // 2))
        chosen = np.flatnonzero(peaks)
        around = np.lib.stride_tricks.sliding_window_view(np.pad(level, half, mode="symmetric"), 2 * half + 1)
        chosen = chosen[level[chosen] > 100.0 * np.median(around[chosen], axis=1)]
        return [float(f) for f in frequency[chosen[np.argsort(-level[chosen])][:SEARCH_LINES]]]
