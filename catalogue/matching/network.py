"""A network that tells hypotheses apart: a second opinion on what the curves of the hypotheses say.

Curves take what scatters around them for a Gaussian. Where much is uncertain at once - loads that hold a joint shut,
modes of the frame, machines that differ from their file - it is not, and a network that has seen many simulated
recordings of it tells more (docs/explanation/method.md, "The second opinion").
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import log_softmax

from jointplay.catalogue.matching.coherence import with_more_noise
from jointplay.catalogue.matching.observation import Sensing
from jointplay.solver.arrays import FloatArray

AS_FILED, DIFFERS = "as filed", "differs"
"""What a network of strata tells apart."""


@dataclass(frozen=True, eq=False)
class Network:
    """A trained perceptron with rectified linear units.

    Parameters
    ----------
    labels : tuple of str
        Hypotheses, all equally probable beforehand; or :data:`AS_FILED` and :data:`DIFFERS`.
    centre, scale : ndarray, shape (d + c,)
        Of its inputs: d features and the noise of c channels.
    weights : tuple of ndarray
        Of each layer, (inputs, outputs).
    biases : tuple of ndarray
        Of each layer, (outputs,).
    quietest, loudest : float
        Mean noise of the channels it was trained for, dB re 1 (m/s2)^2/Hz.
    """

    labels: tuple[str, ...]
    centre: FloatArray
    scale: FloatArray
    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    quietest: float
    loudest: float

    def opinion(self, sensing: Sensing, width: FloatArray) -> Opinion | None:
        """Return its opinion on recordings of some sensors and noise, in bands of some width (G,), Hz.

        Noise below what it was trained for is raised to that. None where the noise is above: nobody has trained it.
        """
        noise = sensing.noise
        level = density_db(noise, width)
        lacking = self.quietest - float(np.mean(level))
        if float(np.mean(level)) > self.loudest:
            return None
        if lacking <= 0.0:
            return Opinion(self, level, np.zeros(noise.shape), sensing.alike)
        missing = noise * (10.0 ** (0.1 * lacking) - 1.0)
        return Opinion(self, level + lacking, missing, sensing.alike)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of everything it is."""
        found = hashlib.sha256(repr((self.labels, self.quietest, self.loudest)).encode())
        for array in (self.centre, self.scale, *self.weights, *self.biases):
            found.update(np.ascontiguousarray(array, np.float64).tobytes())
        return found.hexdigest()

    def log_likelihoods(self, features: FloatArray, noise_db: FloatArray) -> FloatArray:
        """Return log likelihoods (m, hypotheses), up to a constant of each row, of features (m, d) with noise (c,)."""
        noise = np.broadcast_to(noise_db, (len(features), len(noise_db)))
        layer = (np.concatenate([features, noise], axis=1) - self.centre) / self.scale
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            layer = np.maximum(layer @ weights + biases, 0.0)
        out: FloatArray = log_softmax(layer @ self.weights[-1] + self.biases[-1], axis=1)
        return out


@dataclass(frozen=True, eq=False)
class Opinion:
    """A network, asked about recordings of one noise.

    Parameters
    ----------
    network : Network
    noise_db : ndarray, shape (c,)
        Noise density of each channel, dB.
    missing : ndarray, shape (G, c)
        Noise power that is added before features are shown to it.
    alike : ndarray, shape (p,)
        Correlation of the noise of pairs of channels.
    """

    network: Network
    noise_db: FloatArray
    missing: FloatArray
    alike: FloatArray

    def log_evidences(self, features: FloatArray, labels: Sequence[str]) -> FloatArray:
        """Return log likelihoods (m, labels), up to a constant of each row, of features (m, d)."""
        columns = [self.network.labels.index(label) for label in labels]
        shown = with_more_noise(features, self.missing, self.alike)
        found: FloatArray = self.network.log_likelihoods(shown, self.noise_db)[:, columns]
        return found

    def doubts(self, features: FloatArray) -> FloatArray:
        """Return by how much features (m, d) are rather of machines that differ from their file, log (m,).

        Of a network of strata.
        """
        found = self.log_evidences(features, (AS_FILED, DIFFERS))
        ratio: FloatArray = found[:, 1] - found[:, 0]
        return ratio


def density_db(noise: FloatArray, width: FloatArray) -> FloatArray:
    """Return the median density (c,) of a noise power (G, c) in bands of some width (G,), Hz; dB re 1 (m/s2)^2/Hz."""
    found: FloatArray = np.median(10.0 * np.log10(noise / width[: len(noise), None]), axis=0)
    return found
