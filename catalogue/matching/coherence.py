"""Feature vectors: levels of channels, and beside them the coherences of their pairs, with their phases.

A level says how much a channel moves, a coherence whether two channels move together, and which of them leads. Real and
imaginary part of the complex coherence X_ij / sqrt(P_i P_j) stand behind the levels, times :data:`SCALE`.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

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


def compose(power: FloatArray, cross: ComplexArray | None) -> FloatArray:
    """Return feature vectors of powers, noise included.

    Parameters
    ----------
    power : ndarray, shape (n, G, c)
        > 0.
    cross : ndarray of complex, shape (n, G, p), optional
        Cross-powers of the pairs.

    Returns
    -------
    ndarray, shape (n, G c) or (n, G c + 2 G p)
        Levels, dB, band by band, the channels of a band side by side; then all real and all imaginary parts.
    """
    levels = 10.0 * np.log10(power).reshape(len(power), -1)
    if cross is None:
        return levels
    root = np.sqrt(power)
    scale = np.stack([root[..., i] * root[..., j] for i, j in pairs_of(power.shape[2])], axis=-1)
    coherence = cross / scale
    # What two estimates of one recording contradict each other by must not make more than all of it.
    coherence = coherence / np.maximum(1.0, np.abs(coherence))
    parts = [SCALE * part.reshape(len(power), -1) for part in (coherence.real, coherence.imag)]
    found: FloatArray = np.concatenate([levels, *parts], axis=1)
    return found


def decompose(features: FloatArray, bands: int, channels: int) -> tuple[FloatArray, ComplexArray | None]:
    """Return the powers (n, G, c) and cross-powers (n, G, p) that feature vectors (n, d) were composed of."""
    size = bands * channels
    power = 10.0 ** (0.1 * features[:, :size].reshape(len(features), bands, channels))
    if features.shape[1] == size:
        return power, None
    parts = features[:, size:].reshape(len(features), 2, bands, -1) / SCALE
    root = np.sqrt(power)
    scale = np.stack([root[..., i] * root[..., j] for i, j in pairs_of(channels)], axis=-1)
    return power, (parts[:, 0] + 1j * parts[:, 1]) * scale


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
    power, cross = decompose(features, *missing.shape)
    if cross is not None:
        cross = cross + common_noise(missing, alike)
    return compose(power + missing, cross)


def common_noise(noise: FloatArray, alike: FloatArray) -> FloatArray:
    """Return the cross-power (..., p) of a noise power (..., c) whose pairs of channels are so much alike."""
    root = np.sqrt(noise)
    pairs = pairs_of(noise.shape[-1])
    found: FloatArray = alike * np.stack([root[..., i] * root[..., j] for i, j in pairs], axis=-1)
    return found
