"""What the sensors would report of a catalogue entry, with everything the entry does not know.

A catalogue stores clean band powers of the frame's motion. A measurement has sensor noise, sensors whose gains are off
by some per cent, and a machine that differs from its model in ways that are not modelled. All of that is added here to
every entry, so that a matcher learns which differences mean nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from catalogue.errors import DiagnosisError
from catalogue.matching import FloatArray, IntArray

ComplexArray = NDArray[np.complexfloating]


@dataclass(frozen=True)
class Discrepancy:
    """What a model is known not to know.

    Parameters
    ----------
    gain : float
        Standard deviation of a sensor's gain error, relative.
    level_db : float
        Standard deviation of a smooth error of the levels, dB.
    correlation : float
        Bands over which that error keeps its sign (standard deviation of a Gaussian).
    noise_level_db : float
        Standard deviation of the error of the noise floor itself, dB.
    """

    gain: float = 0.03
    level_db: float = 1.0
    correlation: float = 3.0
    noise_level_db: float = 0.3

    def levels(self, generator: np.random.Generator, shape: tuple[int, int, int]) -> FloatArray:
        """Draw smooth errors (n, bands, channels), dB; half of their variance is common to all channels."""
        n, bands, channels = shape
        place = np.arange(bands, dtype=float)
        covariance = np.exp(-0.5 * ((place[:, None] - place[None, :]) / self.correlation) ** 2)
        factor = np.linalg.cholesky(covariance + 1e-9 * np.eye(bands))
        common = generator.normal(size=(n, 1, bands)) @ factor.T
        own = generator.normal(size=(n, channels, bands)) @ factor.T
        drawn: FloatArray = self.level_db * np.sqrt(0.5) * np.swapaxes(common + own, 1, 2)
        return drawn


@dataclass(frozen=True)
class Sensing:
    """How the frame's motion becomes the levels that are compared.

    Parameters
    ----------
    transform : ndarray, shape (s, 3)
        Sensor signals from the frame's [ax, ay, alpha].
    channels : ndarray, shape (c, s)
        Compared channels from sensor signals: the least-squares rigid body, or the identity.
    cuts : tuple of int, (G + 1,)
        Group g joins stored bands cuts[g] to cuts[g + 1] - 1.
    noise : ndarray, shape (G, c)
        Power of the measurement's own noise in each compared band.
    degrees_of_freedom : ndarray, shape (G,)
        Of that power's scatter.
    """

    transform: FloatArray
    channels: FloatArray
    cuts: tuple[int, ...]
    noise: FloatArray
    degrees_of_freedom: FloatArray

    def __post_init__(self) -> None:
        if self.channels.shape[1] != len(self.transform):
            raise DiagnosisError(f"channels of {self.channels.shape[1]} sensors: {len(self.transform)} are there")
        if self.noise.shape != (len(self.cuts) - 1, len(self.channels)):
            raise DiagnosisError(f"noise of shape {self.noise.shape}: must be (bands, channels)")
        if not (self.noise > 0.0).all():
            raise DiagnosisError("noise power: must be greater than 0 in every band")

    @property
    def key(self) -> tuple[object, ...]:
        """Everything it consists of, to be compared."""
        arrays = (self.transform, self.channels, self.noise, self.degrees_of_freedom)
        return (self.cuts, *((array.shape, array.tobytes()) for array in arrays))

    def powers(self, power: ComplexArray, gains: FloatArray | None = None) -> FloatArray:
        """Return clean channel powers (n, G, c) of frame powers (n, B, 3, 3), with sensor gains (n, s) if given."""
        if gains is None:
            gains = np.ones((1, len(self.transform)))
        matrix = np.einsum("cs,ns,sj->ncj", self.channels, gains, self.transform)
        grouped = np.add.reduceat(power[:, : self.cuts[-1]], self.cuts[:-1], axis=1)
        seen = np.einsum("nci,ngij,ncj->ngc", matrix, grouped.real, matrix, optimize=True)
        clean: FloatArray = np.maximum(seen.astype(np.float64), 0.0)
        return clean

    def levels(self, powers: FloatArray) -> FloatArray:
        """Return dB levels (..., G, c) of powers, clipped below at the noise."""
        clipped: FloatArray = 10.0 * np.log10(np.maximum(powers, self.noise))
        return clipped


def rounded_up(values: FloatArray, step_db: float) -> FloatArray:
    """Round powers up to whole steps of decibels.

    Parameters
    ----------
    values : ndarray
        > 0.
    step_db : float
        > 0.
    """
    # A value that is a step already stays where it is, whatever the rounding of its logarithm.
    steps = np.ceil(10.0 * np.log10(values) / step_db - 1e-9)
    rounded: FloatArray = 10.0 ** (0.1 * step_db * steps)
    return rounded


def observe(
    power: ComplexArray, sensing: Sensing, discrepancy: Discrepancy, copies: IntArray, seed: int = 0
) -> tuple[FloatArray, IntArray]:
    """Draw feature vectors of catalogue entries as a measurement would show them.

    Parameters
    ----------
    power : ndarray, shape (n, B, 3, 3)
        Stored cross-powers of the frame's motion.
    sensing : Sensing
    discrepancy : Discrepancy
    copies : ndarray of int, shape (n,)
        How many times each entry is drawn.
    seed : int
        The same seed gives the same draws.

    Returns
    -------
    features : ndarray, shape (sum of copies, G * c)
        dB; band by band, the channels of a band side by side.
    entry : ndarray of int, shape (sum of copies,)
        Row of `power` each was made from.

    Notes
    -----
    A band with signal power P and noise power N measured over K independent cells has mean P + N and variance
    (N^2 + 2 P N) / K: noise alone, and its product with the signal. A gamma law of these moments is drawn.
    """
    generator = np.random.default_rng(seed)
    entry = np.repeat(np.arange(len(power)), copies)
    gains = 1.0 + discrepancy.gain * generator.normal(size=(len(entry), len(sensing.transform)))
    clean = sensing.powers(power[entry], gains)
    clean *= 10.0 ** (0.1 * discrepancy.levels(generator, clean.shape))
    shift = discrepancy.noise_level_db * generator.normal(size=(len(entry), 1, clean.shape[2]))
    noise = sensing.noise * 10.0 ** (0.1 * shift)
    cells = 0.5 * sensing.degrees_of_freedom[None, :, None]
    mean = clean + noise
    shape = cells * mean**2 / (noise**2 + 2.0 * clean * noise)
    measured = generator.gamma(np.minimum(shape, 1e9)) * mean / np.minimum(shape, 1e9)
    return sensing.levels(measured).reshape(len(entry), -1), entry.astype(np.int64)
