"""Feature vectors: levels of channels, and beside them the coherences of their pairs, with their phases.

A level says how much a channel moves, a coherence whether two channels move together, and which of them leads. Real and
imaginary part of the complex coherence X_ij / sqrt(P_i P_j) stand behind the levels, times :data:`SCALE`, and those of
the cyclic coherences of every channel behind them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from jointplay.solver.arrays import ComplexArray, FloatArray, IntArray
from jointplay.solver.spectra.band_power import CYCLES
from jointplay.solver.spectra.bands import FEATURE_ORDERS

REFERENCE_ORDERS = 8
"""Orders whose cyclic coherences say together where in a revolution a recording begins: what moves by its kinematics
more than by its play."""


@dataclass(frozen=True, eq=False)
class CyclicBands:
    """Which cyclic coherences there are: all bands one order apart, those above single orders two orders apart, too.

    Parameters
    ----------
    band, other, cycle : ndarray of int, shape (f,)
        Feature band; the one that lines as many orders above it are in (itself, where bands are wide); place in
        :data:`jointplay.solver.spectra.band_power.CYCLES`.
    """

    band: IntArray
    other: IntArray
    cycle: IntArray

    def chosen(self, cyclic: ComplexArray) -> ComplexArray:
        """Return those of cyclic powers (n, G, k, c): (n, f, c)."""
        found: ComplexArray = cyclic[:, self.band, self.cycle]
        return found

    def products(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return one quantity (n, G, c) in a band times another in the one beside it, (n, f, c)."""
        found: FloatArray = first[:, self.band] * second[:, self.other]
        return found

    def scale(self, power: FloatArray) -> FloatArray:
        """Return the largest cyclic power (n, f, c) that motions of a power (n, G, c) can have."""
        return np.sqrt(self.products(power, power))

    def from_crank(self, coherence: ComplexArray) -> ComplexArray:
        """Return cyclic coherences (n, f, c) whose phases count from wherever, with phases that no longer do.

        The angle is that of the sum over the lowest orders and all channels.
        """
        low = (self.cycle == 0) & (self.band < REFERENCE_ORDERS)
        angle = np.angle(coherence[:, low].sum(axis=(1, 2)))
        turned: ComplexArray = coherence * np.exp(-1j * np.outer(angle, np.array(CYCLES)[self.cycle]))[..., None]
        return turned


@lru_cache
def cyclic_bands(count: int) -> CyclicBands:
    """Return the cyclic coherences of so many feature bands."""
    single = min(count, FEATURE_ORDERS)
    places = [(band, 0) for band in range(count)] + [(band, 1) for band in range(single, count)]
    band, cycle = (np.array(column, np.int64) for column in zip(*places, strict=True))
    above = band + np.array(CYCLES)[cycle]
    return CyclicBands(band, np.where(above < single, above, band), cycle)


SCALE = 10.0
"""What a coherence of 1 counts as, dB: coherences then scatter about as much as levels do."""


def pairs_of(channels: int) -> tuple[tuple[int, int], ...]:
    """Return the p pairs (i, j), i < j, of so many channels."""
    return tuple(itertools.combinations(range(channels), 2))


def noise_alike(channels: FloatArray) -> FloatArray:
    """Return the correlation (p,) of the noise of pairs of channels that are made of equally noisy sensors.

    Parameters
    ----------
    channels : ndarray, shape (c, s)
        Compared channels from sensor signals.
    """
    own = np.sqrt(np.sum(channels**2, axis=1))
    found: FloatArray = np.array([channels[i] @ channels[j] / (own[i] * own[j]) for i, j in pairs_of(len(channels))])
    return found


def compose(power: FloatArray, cross: ComplexArray | None = None, cyclic: ComplexArray | None = None) -> FloatArray:
    """Return feature vectors of powers, noise included.

    Parameters
    ----------
    power : ndarray, shape (n, G, c)
        > 0.
    cross : ndarray of complex, shape (n, G, p), optional
        Cross-powers of the pairs.
    cyclic : ndarray of complex, shape (n, f, c), optional
        Cyclic powers, see :class:`jointplay.catalogue.matching.coherence.CyclicBands`; only with `cross`.

    Returns
    -------
    ndarray, shape (n, G c) or (n, G c + 2 G p + 2 f c)
        Levels, dB, band by band, the channels of a band side by side; then all real and all imaginary parts of
        coherences, then those of cyclic ones.
    """
    parts = [10.0 * np.log10(power).reshape(len(power), -1)]
    if cross is not None:
        parts += _parts(cross / pair_scale(power))
    if cyclic is not None:
        parts += _parts(cyclic / cyclic_bands(power.shape[1]).scale(power))
    return np.concatenate(parts, axis=1)


def _parts(coherence: ComplexArray) -> list[FloatArray]:
    # What two estimates of one recording contradict each other by must not make more than all of it.
    coherence = coherence / np.maximum(1.0, np.abs(coherence))
    return [SCALE * part.reshape(len(coherence), -1) for part in (coherence.real, coherence.imag)]


def highest_there_are(bands: int, of: int, channels: int) -> tuple[IntArray, IntArray]:
    """Say which features of recordings that end below the highest bands stand for those of all bands.

    Parameters
    ----------
    bands, of : int
        Feature bands of the recordings, and all of them; 0 < bands <= of.
    channels : int

    Returns
    -------
    fewer, all : ndarray of int, shape (d,)
        Of each feature of all bands: its place among those of the recordings, and the same one's among those of all
        bands. Above the highest band of the recordings it is that of the highest.
    """
    nearest, kinds = np.minimum(np.arange(of), bands - 1), cyclic_bands(of)
    # Of the highest single order there is nothing above that it could be locked to.
    last = bands - 1 if bands >= min(of, FEATURE_ORDERS) else max(bands - 2, 0)
    band = np.minimum(kinds.band, last)
    # Where single orders are the highest there are, nothing is two orders apart.
    wanted = list(zip(band.tolist(), np.where(band < FEATURE_ORDERS, 0, kinds.cycle).tolist(), strict=True))
    return _places(bands, nearest, wanted, channels), _places(of, nearest, wanted, channels)


def _places(count: int, bands: IntArray, cyclic: Sequence[tuple[int, int]], channels: int) -> IntArray:
    """Places of levels and coherences of some bands, and of cyclic coherences (band, cycle), among all of `count`."""
    kinds = cyclic_bands(count)
    known = {each: place for place, each in enumerate(zip(kinds.band.tolist(), kinds.cycle.tolist(), strict=True))}
    chosen = np.array([known[each] for each in cyclic], np.int64)
    parts, begin = [], 0
    for rows, length, width, numbers in (
        (bands, count, channels, 1),
        (bands, count, len(pairs_of(channels)), 2),
        (chosen, len(known), channels, 2),
    ):
        for _ in range(numbers):
            parts.append(begin + (rows[:, None] * width + np.arange(width)).ravel())
            begin += length * width
    return np.concatenate(parts)


def pair_scale(power: FloatArray) -> FloatArray:
    """Return the largest cross-power (..., p) of the pairs of channels of some power (..., c)."""
    root = np.sqrt(power)
    scale = np.empty((*power.shape[:-1], len(pairs_of(power.shape[-1]))))
    for place, (i, j) in enumerate(pairs_of(power.shape[-1])):
        scale[..., place] = root[..., i] * root[..., j]
    return scale


def decompose(
    features: FloatArray, bands: int, channels: int
) -> tuple[FloatArray, ComplexArray | None, ComplexArray | None]:
    """Return the powers (n, G, c), cross-powers (n, G, p) and cyclic powers (n, f, c) of feature vectors (n, d)."""
    size, pairs = bands * channels, len(pairs_of(channels))
    power = 10.0 ** (0.1 * features[:, :size].reshape(len(features), bands, channels))
    if features.shape[1] == size:
        return power, None, None
    end = size + 2 * bands * pairs
    first = features[:, size:end].reshape(len(features), 2, bands, pairs) / SCALE
    second = features[:, end:].reshape(len(features), 2, -1, channels) / SCALE
    cross, cyclic = (np.asarray(each[:, 0] + 1j * each[:, 1], np.complex128) for each in (first, second))
    return power, cross * pair_scale(power), cyclic * cyclic_bands(bands).scale(power)


def with_more_noise(features: FloatArray, missing: FloatArray, alike: FloatArray) -> FloatArray:
    """Return feature vectors (n, d) with more noise power (G, c) in them.

    Parameters
    ----------
    features : ndarray, shape (n, d)
    missing : ndarray, shape (G, c)
        >= 0.
    alike : ndarray, shape (p,)
        Of :func:`noise_alike`.
    """
    if not missing.any():
        return features
    power, cross, cyclic = decompose(features, *missing.shape)
    if cross is not None:
        cross = cross + common_noise(missing, alike)
    return compose(power + missing, cross, cyclic)


def common_noise(noise: FloatArray, alike: FloatArray) -> FloatArray:
    """Return the cross-power (..., p) of a noise power (..., c) whose pairs of channels are so much alike."""
    found: FloatArray = alike * pair_scale(noise)
    return found
