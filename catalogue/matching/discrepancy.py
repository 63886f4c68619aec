"""What a model is known not to know, drawn on every copy of an entry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.matching.transfer import RandomTransfer
from jointplay.solver.arrays import ComplexArray, FloatArray


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
        Standard deviation of the error of a channel's noise floor, dB: floors of silent machines are right to 0.2 dB,
        those of machines whose joints rattle are too high, by 1 dB in the middle and by 7 to 14 in one of ten.
    rigid_level_db : float, optional
        The same in bands up to the lowest flexible mode, where the machine is rigid; `level_db` unless given.
    delay : float
        Standard deviation of the time [s] that a channel lags behind the others: filters and multiplexers of loggers.
    phase : float
        Standard deviation [rad] of a smooth error of a channel's phase, as `level_db` is one of its level.
    cyclic : float
        Standard deviation of an error of the cyclic coherences, in either part.
    transfer : RandomTransfer, optional
        Flexible modes that the rigid machine does not have.
    """

    gain: float = 0.03
    level_db: float = 1.0
    correlation: float = 3.0
    noise_level_db: float = 1.5
    rigid_level_db: float | None = None
    delay: float = 1e-5
    phase: float = 0.1
    cyclic: float = 0.05
    transfer: RandomTransfer | None = None

    def levels(
        self, generator: np.random.Generator, shape: tuple[int, int, int], edges_hz: FloatArray | None = None
    ) -> FloatArray:
        """Draw smooth errors (n, bands, channels), dB; half of their variance is common to all channels."""
        n, bands, channels = shape
        factor = self._smooth(bands)
        common = generator.normal(size=(n, 1, bands)) @ factor.T
        own = generator.normal(size=(n, channels, bands)) @ factor.T
        size = np.full(bands, self.level_db)
        if self.rigid_level_db is not None and self.transfer is not None and edges_hz is not None:
            size[np.asarray(edges_hz)[1 : bands + 1] <= self.transfer.frequency[0]] = self.rigid_level_db
        drawn: FloatArray = size[:, None] * np.sqrt(0.5) * np.swapaxes(common + own, 1, 2)
        return drawn

    def turns(
        self, generator: np.random.Generator, shape: tuple[int, int, int], edges_hz: FloatArray | None
    ) -> ComplexArray:
        """Draw what errors of phase turn the channels by, (n, bands, channels) of magnitude 1."""
        n, bands, channels = shape
        drawn = generator.normal(size=(n, channels, bands)) @ self._smooth(bands).T
        angle: FloatArray = self.phase * np.swapaxes(drawn, 1, 2)
        if edges_hz is not None:
            middle = 0.5 * (edges_hz[:bands] + edges_hz[1 : bands + 1])
            angle += 2.0 * np.pi * self.delay * middle[:, None] * generator.normal(size=(n, 1, channels))
        found: ComplexArray = np.exp(1j * angle)
        return found

    def _smooth(self, bands: int) -> FloatArray:
        """Factor (bands, bands) that makes errors of neighbouring bands alike."""
        place = np.arange(bands, dtype=float)
        covariance = np.exp(-0.5 * ((place[:, None] - place[None, :]) / self.correlation) ** 2)
        return np.asarray(np.linalg.cholesky(covariance + 1e-9 * np.eye(bands)), dtype=np.float64)
