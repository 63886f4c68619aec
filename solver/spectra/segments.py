"""Windows cut from a signal: how long, where, and their Fourier coefficients.

Everything that estimates a spectrum of a signal with a drive speed cuts it here, so that simulated and measured
signals go through the very same estimator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft

from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.errors import SettingsError

#: How far a window may be longer or shorter than whole revolutions for the sake of a fast transform. At order 20 and
#: three revolutions a window this shifts a line by 0.06 of a spectral line: no leakage to speak of.
LENGTH_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Segmentation:
    """Where the windows of a signal lie.

    Parameters
    ----------
    length : int
        Samples in a window.
    starts : tuple of int
        First sample of each window.
    sample_rate : float
        Hz.
    """

    length: int
    starts: tuple[int, ...]
    sample_rate: float

    @property
    def count(self) -> int:
        """Number of windows."""
        return len(self.starts)

    @property
    def resolution(self) -> float:
        """Distance of spectral lines [Hz]."""
        return self.sample_rate / self.length

    @property
    def frequency(self) -> FloatArray:
        """Frequencies of the one-sided transform, (length // 2 + 1,) [Hz]."""
        return np.arange(self.length // 2 + 1, dtype=np.float64) * self.resolution

    def coefficients(self, signal: npt.ArrayLike, lines: int | None = None) -> ComplexArray:
        """Hann-windowed Fourier coefficients, scaled so that squares are power a line (one-sided).

        Parameters
        ----------
        signal : (n, c) array
            The signal; the mean of every window is taken off first.
        lines : int, optional
            Keep only so many lines from zero frequency up.

        Returns
        -------
        (count, c, lines) complex array
            ``abs(.)**2`` summed over lines is the (window-weighted) mean square of the signal.
        """
        values = np.ascontiguousarray(np.asarray(signal, dtype=np.float64).T)
        window = hann(self.length)
        pieces = np.stack([values[:, start : start + self.length] for start in self.starts])
        pieces -= pieces.mean(axis=-1, keepdims=True)
        pieces *= window
        spectrum: ComplexArray = scipy.fft.rfft(pieces, axis=-1)[..., :lines]
        # One-sided: every line but zero and Nyquist stands for itself and its negative-frequency twin.
        scale = np.full(spectrum.shape[-1], math.sqrt(2.0 / (self.length * float(np.square(window).sum()))))
        scale[0] /= math.sqrt(2.0)
        if self.length % 2 == 0 and spectrum.shape[-1] == self.length // 2 + 1:
            scale[-1] /= math.sqrt(2.0)
        scaled: ComplexArray = spectrum * scale  # its lines side by side, unlike those of a part of the transform
        return scaled

    def weight(self) -> FloatArray:
        """How much each sample of the signal counts in the average over windows, (n,), sum of squared windows."""
        total = np.zeros(self.starts[-1] + self.length)
        square = hann(self.length) ** 2
        for start in self.starts:
            total[start : start + self.length] += square
        return total


def revolution_segments(
    samples: int, sample_rate: float, drive_speed: float, revolutions: float = 3.0, hop: float = 1.0
) -> Segmentation:
    """Windows of whole drive revolutions.

    With three revolutions a window the lines of a Hann window at an order fall exactly on the order and its two
    neighbours at a third of an order: inside the order's own one-order band, none outside.

    Parameters
    ----------
    samples : int
        Length of the signal.
    sample_rate : float
        Hz.
    drive_speed : float
        rad/s; its sign does not matter.
    revolutions : float
        Drive revolutions in a window.
    hop : float
        Revolutions from one window to the next.

    Returns
    -------
    Segmentation
        As many windows as fit, the first at sample 0.

    Raises
    ------
    SettingsError
        When the drive stands still or not one window fits.
    """
    if not (sample_rate > 0 and math.isfinite(sample_rate)):
        raise SettingsError(f"sample rate: {sample_rate} Hz: must be positive and finite")
    if not (abs(drive_speed) > 0 and math.isfinite(drive_speed)):
        raise SettingsError(f"drive speed: {drive_speed} rad/s: a spectrum in orders needs a turning drive")
    period = 2.0 * math.pi / abs(drive_speed) * sample_rate
    length = fast_length(revolutions * period)
    if length < 8:
        raise SettingsError(
            f"sample rate: {sample_rate} Hz: only {period:.3g} samples a revolution, too few for a spectrum"
        )
    if length > samples:
        raise SettingsError(
            f"signal: {samples / period:.3g} revolutions: a window needs {revolutions:g} revolutions ({length} samples)"
        )
    count = 1 + math.floor((samples - length) / (hop * period) + 1e-9)
    starts = tuple(min(round(index * hop * period), samples - length) for index in range(count))
    return Segmentation(length, starts, sample_rate)


def fast_length(target: float) -> int:
    """Length near ``target`` (within 0.1 %) whose Fourier transform is cheap: small prime factors only.

    A window of, say, 14 963 samples (a prime) takes fifteen times as long as one of 14 960. A whole number without
    large factors is taken as it is.
    """
    return _fast_length(float(target))


@lru_cache(maxsize=4096)
def _fast_length(target: float) -> int:
    nearest = max(1, round(target))
    if abs(target - nearest) < 1e-9 * target and _is_smooth(nearest):
        return nearest
    slack = LENGTH_TOLERANCE * target
    candidates = range(max(1, math.ceil(target - slack)), math.floor(target + slack) + 1)
    if not candidates:
        return nearest
    return min(candidates, key=lambda n: (_transform_cost(n), abs(n - target)))


def _is_smooth(length: int) -> bool:
    """Whether no prime factor is larger than 11."""
    for factor in (2, 3, 5, 7, 11):
        while length % factor == 0:
            length //= factor
    return length == 1


@lru_cache(maxsize=65536)  # every case of a catalogue has its own speed, and they look at the same lengths
def _transform_cost(length: int) -> float:
    """Operations of a mixed-radix transform: each prime factor costs itself, unusual ones a little more."""
    rest, total, factor = length, 0.0, 2
    while factor * factor <= rest:
        while rest % factor == 0:
            total += factor if factor <= 5 else 1.1 * factor
            rest //= factor
        factor += 1
    if rest > 1:
        total += rest if rest <= 5 else 1.1 * rest
    return total * length


@lru_cache(maxsize=64)
def hann(length: int) -> FloatArray:
    """Periodic Hann window, (length,), read-only."""
    from scipy.signal import windows  # takes half a second to load, which a server can begin without

    window = np.asarray(windows.hann(length, sym=False), dtype=np.float64)
    window.flags.writeable = False
    return window
