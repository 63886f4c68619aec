"""Sensor noise of a recording: a white floor, and bands that stand out of it where the noise has a colour."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft

from jointplay.catalogue.errors import MeasurementError
from jointplay.solver.arrays import FloatArray
from jointplay.solver.spectra.segments import hann

#: Length of the short windows [s]: impacts ring off within milliseconds, so that windows between them hold noise.
WINDOW = 0.0128
#: Spectral lines averaged before anything is compared; quantile over time, then over frequency.
LINES_TOGETHER = 6
TIME_QUANTILE = 0.1
FREQUENCY_QUANTILE = 0.1
#: Where the floor is looked for: from here [Hz] ...
FLOOR_FROM = 30.0
#: ... to this fraction of the sample rate: above, the filters of converters begin to cut.
FLOOR_TO = 0.4
#: Colour: bands of a third octave whose quiet moments are this much above the white floor [dB] ...
COLOUR_DB = 4.5
#: ... and whose level hardly changes with time: the quantiles over time lie no further apart than those of white noise,
#: but for this much [dB]. Rattling joints, which are as broad in frequency, reach 6 to 20 dB.
STEADY_DB = 2.0
UPPER_QUANTILE = 0.6
#: Where orders stand apart, noise also lies between them: lines at least this far from an order, of recordings of at
#: least so many revolutions, and up to the order where wander has smeared them by so much.
AWAY_FROM_ORDERS = 0.3
COLOUR_REVOLUTIONS = 7.0
SMEARED = 0.1


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """Noise of each channel: white, times an excess in the bands where it has a colour.

    Parameters
    ----------
    density : (c,) array
        One-sided spectral density where the noise is white, [unit^2 / Hz].
    sample_rate : float
        Hz.
    edges : (k + 1,) array
        Borders of the bands of the excess [Hz]; the first is held down to zero. Empty where all channels are white.
    excess : (c, k) array
        Factor on the density, at least 1.
    """

    density: FloatArray
    sample_rate: float
    edges: FloatArray = field(default_factory=lambda: np.zeros(0))
    excess: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def coloured(self) -> bool:
        """Whether any band of any channel stands out."""
        return bool(self.excess.size and (self.excess > 1.0).any())

    @property
    def rms(self) -> FloatArray:
        """Root mean square from zero to half the sample rate, (c,) [unit]."""
        return np.asarray(np.sqrt(self.band_power([0.0, 0.5 * self.sample_rate], [0] * len(self.density))[0]))

    def band_power(self, edges_hz: npt.ArrayLike, derivatives: Sequence[int]) -> FloatArray:
        """Noise power in bands after differentiating each channel in time.

        Parameters
        ----------
        edges_hz : (B + 1,) array
        derivatives : sequence of int, (c,)
            0 for acceleration that stays acceleration, 2 for displacement that becomes acceleration.

        Returns
        -------
        (B, c) array
            The integral of density times (2 pi f)^(2 k).
        """
        edges = np.asarray(edges_hz, dtype=np.float64)
        power = np.empty((len(edges) - 1, len(self.density)))
        for index, (density, count) in enumerate(zip(self.density, derivatives, strict=True)):
            total = np.diff(_integral(edges, count))
            if self.excess.size:
                # Integral up to every edge of what lies in each band of the excess; the lowest reaches down to zero.
                low, high = np.concatenate([[0.0], self.edges[1:-1]]), self.edges[1:]
                inside = _integral(np.clip(edges[:, None], low, high), count)
                total = total + np.diff(inside, axis=0) @ (self.excess[index] - 1.0)
            power[:, index] = density * total
        return power


def _integral(frequency: FloatArray, derivatives: int) -> FloatArray:
    """Integral of (2 pi f)^(2 k) from zero."""
    exponent = 2 * derivatives + 1
    return (2.0 * np.pi) ** (2 * derivatives) * frequency**exponent / exponent


def noise_floor(
    signal: npt.ArrayLike,
    sample_rate: float,
    source: str = "recording",
    *,
    turn: float | None = None,
    wander: float = 0.0,
) -> NoiseFloor:
    """Noise floor of each channel.

    Parameters
    ----------
    signal : (n, c) array
        As recorded, not differentiated.
    sample_rate : float
        Hz.
    source : str
        What messages call the recording.
    turn : float, optional
        Drive revolutions a second; without it, and in recordings of few revolutions, noise is taken to be white.
    wander : float
        Of that speed, relative.

    Returns
    -------
    NoiseFloor

    Raises
    ------
    MeasurementError
        When the recording has less than 256 samples.

    Notes
    -----
    The floor is heard in quiet moments: a low quantile over time of the short-time spectrum, then over frequency. How
    far such quantiles lie below the mean is taken from white noise that goes through the same steps. A quantile of the
    averaged spectrum, as often used, is many times too high where impacts are loud at all frequencies.

    A band has a colour where even its quiet moments stand out of the white floor, where it is as steady in time as
    noise is (impacts are not), and where the spectrum between the orders says so too (a machine without play is steady
    in time, but silent between its orders). Below four lines of the short windows, some 300 Hz, nothing can be heard
    apart from the machine: there the lowest band's excess is taken.
    """
    values = np.ascontiguousarray(np.asarray(signal, dtype=np.float64).T)
    samples = values.shape[1]
    if samples < 256:
        raise MeasurementError(source, rule=f"{samples} samples are too few for a noise floor")
    length = 2 ** int(np.clip(round(math.log2(WINDOW * sample_rate)), 6, 10))
    length = min(length, 2 ** int(math.log2(samples / 4)))
    # The first lines hold what the window leaks from slow motion, which no quiet moment is free of.
    first = max(4, min(math.ceil(FLOOR_FROM * length / sample_rate), length // 5))
    cuts = _third_octaves(first, length)
    # Quantiles hardly depend on how many windows there are: one reference serves recordings of about one length.
    about = round(length * 2.0 ** (0.5 * round(2.0 * math.log2(samples / length))))
    reference = _reference(about, length, first, cuts)
    heard = [_quiet(column, length, first, cuts) for column in values]
    density = np.array([channel.white for channel in heard]) / (reference.white * 0.5 * sample_rate)
    floor = NoiseFloor(density, sample_rate)
    if turn is None or samples / sample_rate * turn < COLOUR_REVOLUTIONS:
        return floor
    excess = np.ones((len(values), len(cuts) - 1))
    edges = (np.asarray(cuts) - 0.5) * sample_rate / length
    for row, column, channel, white in zip(excess, values, heard, density, strict=True):
        level = channel.low / reference.low * (reference.white / channel.white)
        steadiness = (channel.high / channel.low) / (reference.high / reference.low)
        suspect = (level > 10.0 ** (0.1 * COLOUR_DB)) & (steadiness < 10.0 ** (0.1 * STEADY_DB))
        if suspect.any():
            between = _between_orders(column, sample_rate, turn, wander, edges) / white
            found = np.minimum(level, between)
            row[suspect] = np.where(found > 10.0 ** (0.1 * COLOUR_DB), found, 1.0)[suspect]
    return NoiseFloor(density, sample_rate, edges, excess) if (excess > 1.0).any() else floor


@dataclass(frozen=True, eq=False)
class _Quiet:
    """Short-time powers of a channel, per line and for a window of unit power.

    Parameters
    ----------
    white : float
        Low quantile over time, then over frequency.
    low, high : (k,) array
        Two quantiles over time in each band.
    """

    white: float
    low: FloatArray
    high: FloatArray


def _quiet(values: FloatArray, length: int, first: int, cuts: tuple[int, ...]) -> _Quiet:
    window = hann(length)
    pieces = np.lib.stride_tricks.sliding_window_view(values, length)[:: length // 2]
    spectrum = scipy.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * window, axis=1)
    power = spectrum.real**2 + spectrum.imag**2
    usable = power[:, first : int(FLOOR_TO * length) + 1]
    together = min(LINES_TOGETHER, usable.shape[1])
    groups = usable.shape[1] // together
    # Line by line of all groups at once: numpy's mean over the last axis goes through short rows, and takes longer.
    level = sum(usable[:, place : groups * together : together] for place in range(together)) / together
    white = float(np.quantile(np.quantile(level, TIME_QUANTILE, axis=0), FREQUENCY_QUANTILE))
    bands = np.add.reduceat(power[:, : cuts[-1]], cuts[:-1], axis=1) / np.diff(cuts)
    low, high = np.quantile(bands, [TIME_QUANTILE, UPPER_QUANTILE], axis=0)
    return _Quiet(white, np.maximum(low, 1e-300), np.maximum(high, 1e-300))


def _third_octaves(first: int, length: int) -> tuple[int, ...]:
    """Cuts between lines: thirds of an octave, of two lines at least, up to half the sample rate."""
    top = length // 2
    cuts = [first]
    while cuts[-1] < top:
        cuts.append(max(cuts[-1] + 2, round(cuts[-1] * 2.0 ** (1.0 / 3.0))))
    if cuts[-1] > top and len(cuts) > 2:
        cuts.pop()
    cuts[-1] = top
    return tuple(cuts)


def _between_orders(values: FloatArray, rate: float, turn: float, wander: float, edges: FloatArray) -> FloatArray:
    """Density between the orders in each band, (k,): infinite where orders lie too close or are smeared."""
    count = scipy.fft.next_fast_len(len(values), real=True)
    window = hann(len(values))
    spectrum = scipy.fft.rfft((values - values.mean()) * window, count)
    power = (spectrum.real**2 + spectrum.imag**2) * 2.0 / (rate * float(np.square(window).sum()))
    frequency = np.arange(len(power)) * rate / count
    order = frequency / turn
    between = (np.abs(order - np.rint(order)) > AWAY_FROM_ORDERS) & (order * wander < SMEARED)
    found = np.full(len(edges) - 1, np.inf)
    for band in range(len(found)):
        inside = between & (frequency >= edges[band]) & (frequency < edges[band + 1])
        if inside.sum() >= 8:
            # Chi-square of two degrees of freedom: the median is ln 2 of the mean. Neighbouring lines share a window.
            found[band] = float(np.median(power[inside])) / math.log(2.0)
    return found


@lru_cache(maxsize=32)
def _reference(samples: int, length: int, first: int, cuts: tuple[int, ...]) -> _Quiet:
    """The same of white noise of unit variance; a few thousand windows settle it to a percent."""
    noise = np.random.default_rng(0).normal(size=max(samples, 1000 * length))
    parts = [_quiet(part, length, first, cuts) for part in np.array_split(noise, max(1, len(noise) // samples))]
    return _Quiet(
        float(np.mean([part.white for part in parts])),
        np.mean([part.low for part in parts], axis=0),
        np.mean([part.high for part in parts], axis=0),
    )
