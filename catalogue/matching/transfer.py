"""Random flexible modes between the joints and the sensors: what a rigid frame does not know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.matching.coherence import pairs_of
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.machines.modes import swing

#: Points of a band over which the squared magnitude of a response is averaged; a resonance of 1 % damping lies well
#: within a third octave and is not missed by them (0.3 dB of the band's mean at worst).
POINTS = 8


@dataclass(frozen=True)
class RandomTransfer:
    """Transfer functions of one to three modes, drawn anew for every machine.

    Parameters
    ----------
    modes : (int, int)
        Fewest and most modes of a draw.
    frequency : (float, float)
        Natural frequencies, log-uniform, Hz.
    damping : (float, float)
        Damping ratios, log-uniform.
    gain : (float, float)
        Share of a channel's motion that goes through a mode, uniform, one a mode and channel: 1 is all of it (a
        second-order system), negative ones move against the rigid body.

    Notes
    -----
    H_c = 1 + sum over k of g_kc times :func:`~jointplay.solver.machines.modes.swing` of f / f_k and z_k: modes that are
    excited through the rigid body.
    """

    modes: tuple[int, int] = (1, 3)
    frequency: tuple[float, float] = (60.0, 3000.0)
    damping: tuple[float, float] = (0.01, 0.05)
    gain: tuple[float, float] = (-0.6, 1.0)

    def draw(
        self, generator: np.random.Generator, count: int, edges_hz: FloatArray, channels: int
    ) -> tuple[FloatArray, ComplexArray, ComplexArray]:
        """Draw responses, and products of them, averaged over bands.

        Parameters
        ----------
        generator : Generator
        count : int
            Machines.
        edges_hz : ndarray, shape (G + 1,)
            Edges of the bands, Hz, rising.
        channels : int

        Returns
        -------
        squared : ndarray, shape (count, G, channels)
            |H|^2, > 0.
        product : ndarray of complex, shape (count, G, p)
            H_i conj(H_j) of the pairs of channels.
        mean : ndarray of complex, shape (count, G, channels)
            H.
        """
        bands = len(edges_hz) - 1
        places = (np.arange(POINTS) + 0.5) / POINTS
        frequency = (edges_hz[:-1, None] + np.diff(edges_hz)[:, None] * places).ravel().astype(np.float32)
        most = self.modes[1]
        number = generator.integers(self.modes[0], most + 1, count)
        natural = _log_uniform(generator, self.frequency, (count, most))
        damping = _log_uniform(generator, self.damping, (count, most))
        gain = generator.uniform(*self.gain, (count, most, channels))
        gain[np.arange(most)[None, :] >= number[:, None]] = 0.0
        squared = np.empty((count, bands, channels))
        pairs = pairs_of(channels)
        product = np.empty((count, bands, len(pairs)), np.complex128)
        mean = np.empty((count, bands, channels), np.complex128)
        # Single precision in slices: the levels need no more, and 800 draws of 320 frequencies stay in the cache.
        for start in range(0, count, 256):
            rows = slice(start, start + 256)
            ratio = np.asarray(frequency[None, None, :] / natural[rows, :, None].astype(np.float32), np.float32)
            mode = swing(ratio, damping[rows, :, None].astype(np.float32))
            response = 1.0 + np.einsum("nkc,nkf->ncf", gain[rows].astype(np.float32), mode, optimize=True)
            magnitude = response.real**2 + response.imag**2
            squared[rows] = np.swapaxes(magnitude.reshape(*magnitude.shape[:2], bands, POINTS).mean(axis=3), 1, 2)
            mean[rows] = np.swapaxes(response.reshape(*magnitude.shape[:2], bands, POINTS).mean(axis=3), 1, 2)
            for place, (i, j) in enumerate(pairs):
                each = response[:, i] * response[:, j].conj()
                product[rows, :, place] = each.reshape(len(each), bands, POINTS).mean(axis=2)
        return np.maximum(squared, 1e-6), product, mean


def _log_uniform(generator: np.random.Generator, between: tuple[float, float], shape: tuple[int, int]) -> FloatArray:
    low, high = between
    drawn: FloatArray = low * (high / low) ** generator.uniform(size=shape)
    return drawn
