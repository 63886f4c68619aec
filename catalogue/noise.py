"""Sensor noise of a recording: a floor that is white in the recorded quantity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft

from catalogue.errors import MeasurementError

FloatArray = npt.NDArray[np.float64]

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


@dataclass(frozen=True, eq=False)
class NoiseFloor:
    """White noise of each channel.

    Parameters
    ----------
    density : (c,) array
        One-sided spectral density, [unit^2 / Hz].
    sample_rate : float
        Hz.
    """

    density: FloatArray
    sample_rate: float

    @property
    def rms(self) -> FloatArray:
        """Root mean square from zero to half the sample rate, (c,) [unit]."""
        return np.asarray(np.sqrt(self.density * 0.5 * self.sample_rate), dtype=np.float64)

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
            exponent = 2 * count + 1
            power[:, index] = density * (2.0 * np.pi) ** (2 * count) * np.diff(edges**exponent) / exponent
        return power


def noise_floor(signal: npt.ArrayLike, sample_rate: float, source: str = "recording") -> NoiseFloor:
    """Noise floor of each channel.

    Parameters
    ----------
    signal : (n, c) array
        As recorded, not differentiated.
    sample_rate : float
        Hz.
    source : str
        What messages call the recording.

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
    """
    values = np.asarray(signal, dtype=np.float64)
    if len(values) < 256:
        raise MeasurementError(source, rule=f"{len(values)} samples are too few for a noise floor")
    length = 2 ** int(np.clip(round(math.log2(WINDOW * sample_rate)), 6, 10))
    length = min(length, 2 ** int(math.log2(len(values) / 4)))
    # The first lines hold what the window leaks from slow motion, which no quiet moment is free of.
    first = max(4, min(math.ceil(FLOOR_FROM * length / sample_rate), length // 5))
    reference = _reference_level(len(values), length, first)
    floor = [_quiet_level(column, length, first) for column in np.ascontiguousarray(values.T)]
    return NoiseFloor(np.asarray(floor) / (reference * 0.5 * sample_rate), sample_rate)


def _quiet_level(values: FloatArray, length: int, first: int) -> float:
    """Low quantile over time and frequency of the short-time power, per line and for a window of unit power."""
    window = np.hanning(length + 1)[:-1]
    pieces = np.lib.stride_tricks.sliding_window_view(values, length)[:: length // 2]
    power = np.abs(scipy.fft.rfft((pieces - pieces.mean(axis=1, keepdims=True)) * window, axis=1)) ** 2
    power = power[:, first : int(FLOOR_TO * length) + 1]
    together = min(LINES_TOGETHER, power.shape[1])
    groups = power.shape[1] // together
    level = power[:, : groups * together].reshape(len(power), groups, together).mean(axis=2)
    return float(np.quantile(np.quantile(level, TIME_QUANTILE, axis=0), FREQUENCY_QUANTILE))


@lru_cache(maxsize=32)
def _reference_level(samples: int, length: int, first: int) -> float:
    """The same of white noise of unit variance; a few thousand windows settle it to a percent."""
    noise = np.random.default_rng(0).normal(size=max(samples, 1000 * length))
    parts = np.array_split(noise, max(1, len(noise) // samples))
    return float(np.mean([_quiet_level(part, length, first) for part in parts]))
