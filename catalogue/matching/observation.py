"""What the sensors would report of a catalogue entry, with everything the entry does not know.

A catalogue stores clean cross-powers of the frame's motion. A measurement has sensor noise, sensors whose gains are off
by some per cent, and a machine that differs from its model in ways that are not modelled. All of that is added here to
every entry, so that a matcher learns which differences mean nothing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.coherence import (
    CyclicBands,
    common_noise,
    compose,
    cyclic_bands,
    noise_alike,
    pair_scale,
    pairs_of,
    with_more_noise,
)
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.storage.cross_power import PACKED
from jointplay.solver.arrays import ComplexArray, FloatArray, IntArray
from jointplay.solver.spectra.band_power import CYCLES

PackedArray = NDArray[np.float32] | FloatArray

_ABOVE = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, eq=False)
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
    phases : bool
        Whether phases are known, so that coherences and what is locked to the crank are compared, too: not of spectra.
    past : bool
        Whether recordings of the same machine in order, by the same sensors, are there to compare with: their features
        stand behind the recording's own.
    """

    transform: FloatArray
    channels: FloatArray
    cuts: tuple[int, ...]
    noise: FloatArray
    degrees_of_freedom: FloatArray
    phases: bool = True
    past: bool = False

    def __post_init__(self) -> None:
        if self.channels.shape[1] != len(self.transform):
            raise DiagnosisError(f"channels of {self.channels.shape[1]} sensors: {len(self.transform)} are there")
        if self.noise.shape != (len(self.cuts) - 1, len(self.channels)):
            raise DiagnosisError(f"noise of shape {self.noise.shape}: must be (bands, channels)")
        if not (self.noise > 0.0).all():
            raise DiagnosisError("noise power: must be greater than 0 in every band")

    @property
    def digest(self) -> str:
        """SHA-256 over everything it consists of."""
        found = hashlib.sha256(repr((self.cuts, self.phases, *["past"] * self.past)).encode())
        for array in (self.transform, self.channels, self.noise, self.degrees_of_freedom):
            found.update(repr(array.shape).encode())
            found.update(np.ascontiguousarray(array, np.float64).tobytes())
        return found.hexdigest()

    @property
    def bands(self) -> int:
        """Number of compared bands G."""
        return len(self.cuts) - 1

    @property
    def cyclic(self) -> CyclicBands:
        """Which cyclic coherences are compared, where phases are known."""
        return cyclic_bands(self.bands)

    @property
    def plain_count(self) -> int:
        """How many features are levels and coherences, which stand before cyclic ones."""
        return self.noise.size + (2 * self.bands * len(self.alike) if self.phases else 0)

    @property
    def own_count(self) -> int:
        """How many features are of the recording itself: all but those of the past."""
        return self.plain_count + (2 * len(self.cyclic.band) * len(self.channels) if self.phases else 0)

    @property
    def features_count(self) -> int:
        """Length d of feature vectors."""
        return self.own_count * (2 if self.past else 1)

    @property
    def alike(self) -> FloatArray:
        """Correlation (p,) of the noise of pairs of channels."""
        return noise_alike(self.channels)

    def powers(self, packed: PackedArray, gains: FloatArray | None = None) -> tuple[FloatArray, ComplexArray | None]:
        """Return what ideal sensors would see of frame cross-powers in feature bands, with sensor gains if given.

        Parameters
        ----------
        packed : ndarray, shape (n, G or more, 9 or more)
            Cross-powers of :func:`jointplay.catalogue.storage.cross_power.pack`; bands beyond the compared ones are
            left out.
        gains : ndarray, shape (n, s), optional

        Returns
        -------
        power : ndarray, shape (n, G, c)
        cross : ndarray of complex, shape (n, G, p), or None
            Of pairs of channels, where phases are known.
        """
        mix = self._mix(gains)
        count = len(self.channels)
        pairs = pairs_of(count) if self.phases else ()
        products = [(i, i) for i in range(count)] + list(pairs)
        # Linear in the nine real numbers: real parts of all products, then imaginary ones of the pairs.
        form = np.zeros((len(mix), 9, len(products) + len(pairs)))
        for column, (i, j) in enumerate(products):
            form[:, :3, column] = mix[:, i] * mix[:, j]
            for place, (a, b) in enumerate(_ABOVE):
                form[:, 3 + 2 * place, column] = mix[:, i, a] * mix[:, j, b] + mix[:, i, b] * mix[:, j, a]
        for column, (i, j) in enumerate(pairs, start=len(products)):
            for place, (a, b) in enumerate(_ABOVE):
                form[:, 4 + 2 * place, column] = mix[:, i, a] * mix[:, j, b] - mix[:, i, b] * mix[:, j, a]
        seen = packed[:, : self.bands, :9].astype(np.float64) @ form
        power: FloatArray = np.maximum(seen[..., :count], 0.0)
        if not self.phases:
            return power, None
        return power, seen[..., count : len(products)] + 1j * seen[..., len(products) :]

    def cyclic_powers(self, packed: PackedArray, gains: FloatArray | None = None) -> ComplexArray:
        """Return the compared cyclic powers (n, f, c) of spectra (n, G or more, 33), with sensor gains if given."""
        mix = self._mix(gains)
        values = packed[:, : self.bands, len(PACKED) :]
        # Symmetric in the channels: each motion with itself, then the pairs, which count twice.
        form = np.stack(
            [mix[..., i] * mix[..., i] for i in range(3)] + [2.0 * mix[..., a] * mix[..., b] for a, b in _ABOVE]
        )
        numbers = np.ascontiguousarray(values, np.float32).view(np.complex64).reshape(*values.shape[:2], len(CYCLES), 6)
        chosen = self.cyclic.chosen(np.asarray(numbers, np.complex128))
        return np.asarray(chosen @ np.moveaxis(form, 0, 1), np.complex128)

    def _mix(self, gains: FloatArray | None) -> FloatArray:
        """Compared channels from the frame's motions, (n, c, 3), with sensor gains (n, s) if given."""
        if gains is None:
            gains = np.ones((1, len(self.transform)))
        mix: FloatArray = np.einsum("cs,ns,sj->ncj", self.channels, gains, self.transform)
        return mix

    def with_more_noise(self, features: FloatArray, missing: FloatArray) -> FloatArray:
        """Return feature vectors (n, d) with more noise power (G, c) in them, >= 0."""
        parts = np.split(features, 2, axis=1) if self.past else [features]
        return np.hstack([with_more_noise(part, missing, self.alike) for part in parts])

    def features(
        self, power: FloatArray, cross: ComplexArray | None = None, cyclic: ComplexArray | None = None
    ) -> FloatArray:
        """Return feature vectors (n, d) of powers (n, G, c), noise included, clipped below at the noise.

        Cross-powers (n, G, p) and cyclic powers (n, f, c), whose phases count from wherever, where phases are known.
        """
        power = np.maximum(power, self.noise)
        if not self.phases or cyclic is None:
            return compose(power)
        scale = self.cyclic.scale(power)
        return compose(power, cross, self.cyclic.from_crank(cyclic / scale) * scale)


def group(packed: PackedArray, cuts: tuple[int, ...]) -> PackedArray:
    """Join stored bands (n, B, 9) into feature bands (n, G, 9)."""
    joined: PackedArray = np.add.reduceat(packed[:, : cuts[-1]], cuts[:-1], axis=1)
    return joined


def round_up(values: FloatArray, step_db: float) -> FloatArray:
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


def round_sensing(sensing: Sensing, width: FloatArray, step_db: float) -> Sensing:
    """Return the sensing that stands for all recordings of about this noise and length.

    The level of each channel's noise is rounded up to whole steps; its course over the bands, relative to white noise,
    to steps twice as large where it is more than half a decibel off; the length down to whole steps.

    Parameters
    ----------
    sensing : Sensing
    width : ndarray, shape (G or more,)
        Widths of the feature bands at the machine's own speed, Hz.
    step_db : float
        > 0.
    """
    width = width[: sensing.bands]
    seconds = float(np.median(sensing.degrees_of_freedom / (2.0 * width)))
    shorter = 1.0 / float(round_up(np.array(1.0 / seconds), step_db))
    density = sensing.noise / width[:, None]
    level = np.median(density, axis=0)
    course = round_up(density / level / 10.0**0.05, 2.0 * step_db)
    noise = round_up(level, step_db) * course * width[:, None]
    return replace(sensing, noise=noise, degrees_of_freedom=2.0 * np.maximum(1.0, shorter * width))


def observe(
    packed: PackedArray,
    sensing: Sensing,
    discrepancy: Discrepancy,
    copies: IntArray,
    seed: int | Sequence[int] = 0,
    edges_hz: FloatArray | None = None,
    noise_seed: int | Sequence[int] | None = None,
    past: PackedArray | None = None,
) -> tuple[FloatArray, IntArray]:
    """Draw feature vectors of catalogue entries as a measurement would show them.

    Parameters
    ----------
    packed : ndarray, shape (n, G or more, 33)
        Powers of the frame's motion in feature bands, :data:`jointplay.catalogue.storage.cross_power.COLUMNS` numbers
        each.
    sensing : Sensing
    discrepancy : Discrepancy
    copies : ndarray of int, shape (n,)
        How many times each entry is drawn.
    seed : int or sequence of int
        The same seed gives the same draws.
    edges_hz : ndarray, shape (G + 1 or more,), optional
        Edges of the feature bands, Hz; needed where the discrepancy has transfer functions.
    noise_seed : int or sequence of int, optional
        Seed of what differs from one recording of a machine by the same sensors to the next, where there are several:
        the noise. Gains and what the model does not know stay with `seed`.
    past : ndarray, shape (n, G or more, 33), optional
        Of the same machines in order, seen through the same sensors; needed where the sensing asks for it.

    Returns
    -------
    features : ndarray, shape (sum of copies, d)
        Levels, and coherences and cyclic ones where phases are known:
        :func:`jointplay.catalogue.matching.coherence.compose`.
    entry : ndarray of int, shape (sum of copies,)
        Row of `packed` each was made from.

    Notes
    -----
    A band with signal power P and noise power N measured over K independent cells has mean P + N and variance
    (N^2 + 2 P N) / K: noise alone, and its product with the signal. A gamma law of these moments is drawn. The
    cross-power of two channels scatters about its mean by (P_i N_j + P_j N_i + N_i N_j) / K, half of it in each part,
    and so does a cyclic power, the product of two bands of one channel.
    """
    generator = np.random.default_rng(seed)
    entry = np.repeat(np.arange(len(packed)), copies)
    if len(entry) == 0:
        return np.empty((0, sensing.features_count)), entry.astype(np.int64)
    if discrepancy.transfer is not None and edges_hz is None:
        raise DiagnosisError("transfer functions: need the edges of the bands in Hz")
    edges = None if edges_hz is None else np.asarray(edges_hz)[: sensing.bands + 1]
    if sensing.past != (past is not None):
        raise DiagnosisError("spectra of the past: needed where they are compared, and nowhere else")
    gains = 1.0 + discrepancy.gain * generator.normal(size=(len(entry), len(sensing.transform)))
    path = _Path.draw(generator, discrepancy, sensing, len(entry), edges)
    days = [path.seen(sensing, each[entry], gains) for each in (packed, *([] if past is None else [past]))]
    if noise_seed is not None:
        generator = np.random.default_rng(noise_seed)
    measured = [_measure(generator, sensing, discrepancy, *day) for day in days]
    return np.hstack(measured), entry.astype(np.int64)


@dataclass(frozen=True, eq=False)
class _Path:
    """What lies between the motion of n machines and their sensors, and is the same in all recordings of one.

    Factors on powers (n, G, c), turns (n, G, c), and what modes of the frame make of powers, of pairs (n, G, p), and
    of a channel in the mean (n, G, c); None where there are none.
    """

    change: FloatArray
    turn: ComplexArray | None
    modes: tuple[FloatArray, ComplexArray, ComplexArray] | None

    @classmethod
    def draw(
        cls,
        generator: np.random.Generator,
        discrepancy: Discrepancy,
        sensing: Sensing,
        count: int,
        edges: FloatArray | None,
    ) -> _Path:
        shape = (count, sensing.bands, len(sensing.channels))
        change = 10.0 ** (0.1 * discrepancy.levels(generator, shape, edges))
        turn = discrepancy.turns(generator, shape, edges) if sensing.phases else None
        modes = None
        if discrepancy.transfer is not None and edges is not None:
            modes = discrepancy.transfer.draw(generator, count, edges, shape[2])
        return cls(change, turn, modes)

    def seen(
        self, sensing: Sensing, packed: PackedArray, gains: FloatArray
    ) -> tuple[FloatArray, ComplexArray | None, ComplexArray | None]:
        """Powers (n, G, c), of pairs (n, G, p), and cyclic ones (n, f, c) that come through it, without noise."""
        clean, cross = sensing.powers(packed, gains)
        cyclic = sensing.cyclic_powers(packed, gains) if sensing.phases else None
        bands, pairs = sensing.cyclic, np.array(pairs_of(clean.shape[2]), np.int64).reshape(-1, 2).T
        clean *= self.change
        if cross is not None and cyclic is not None and self.turn is not None:
            turn = self.turn
            cross *= pair_scale(self.change) * turn[..., pairs[0]] * turn[..., pairs[1]].conj()
            cyclic *= bands.scale(self.change) * turn[:, bands.other] * turn[:, bands.band].conj()
        if self.modes is not None:
            squared, product, mean = self.modes
            clean *= squared
            if cross is not None and cyclic is not None:
                cross *= product
                apart = mean[:, bands.other] * mean[:, bands.band].conj()
                cyclic *= np.where((bands.other == bands.band)[:, None], squared[:, bands.band], apart)
        return clean, cross, cyclic


def _measure(
    generator: np.random.Generator,
    sensing: Sensing,
    discrepancy: Discrepancy,
    clean: FloatArray,
    cross: ComplexArray | None,
    cyclic: ComplexArray | None,
) -> FloatArray:
    """Feature vectors (n, d) of recordings of powers, with noise."""
    bands, pairs = sensing.cyclic, np.array(pairs_of(clean.shape[2]), np.int64).reshape(-1, 2).T
    shift = discrepancy.noise_level_db * generator.normal(size=(len(clean), 1, clean.shape[2]))
    noise = sensing.noise * 10.0 ** (0.1 * shift)
    cells = 0.5 * sensing.degrees_of_freedom[None, :, None]
    mean_power = clean + noise
    shape = cells * mean_power**2 / (noise**2 + 2.0 * clean * noise)
    measured = generator.gamma(np.minimum(shape, 1e9)) * mean_power / np.minimum(shape, 1e9)
    if cross is not None and cyclic is not None:
        i, j = pairs
        variance = clean[..., i] * noise[..., j] + clean[..., j] * noise[..., i] + noise[..., i] * noise[..., j]
        cross = cross + common_noise(noise, sensing.alike) + _scatter(generator, variance / cells)
        both = bands.products(mean_power, mean_power)
        variance = (both - bands.products(clean, clean)) / cells[:, bands.band] + 2.0 * discrepancy.cyclic**2 * both
        cyclic = cyclic + _scatter(generator, variance)
    return sensing.features(measured, cross, cyclic)


def _scatter(generator: np.random.Generator, variance: FloatArray) -> ComplexArray:
    """Draw complex normal numbers of a variance, half of it in each part."""
    # Single precision is drawn in half the time.
    drawn = generator.standard_normal((*variance.shape, 2), np.float32).view(np.complex64)[..., 0]
    return np.asarray(drawn * np.sqrt(0.5 * variance), np.complex128)
