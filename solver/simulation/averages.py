"""Mean, spread and standard error of spectra over members of an ensemble and over blocks of time."""

from __future__ import annotations

import math

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.simulation.blocks import MOTIONS, BlockSpectra
from jointplay.solver.spectra.harmonics import FLOOR_DB

#: dB per part by which a power changes.
_DB_PER_PART = 10 / math.log(10)
_TINY = np.finfo(np.float64).tiny
#: Blocks differ by more than their scatter explains if by this many times what it makes expect.
_BEYOND_SCATTER = 1.5


def decibels(power: FloatArray) -> FloatArray:
    """10 log10, with a floor instead of minus infinity."""
    return np.asarray(10 * np.log10(np.maximum(power, _TINY)))


def spread_db(power: FloatArray) -> FloatArray:
    """Standard deviation over members, along the first axis, of levels, dB."""
    return np.asarray(np.std(decibels(power), axis=0, ddof=1))


def standard_error_db(power: FloatArray) -> FloatArray:
    """Standard error of the mean power of members and blocks, as a level, dB.

    Parameters
    ----------
    power : (m, b, k, c) array
        Of `m` members in `b` blocks of time, at least two of each.

    Returns
    -------
    (k, c) array
        The larger of two estimates: between members over all blocks, which holds where one block resembles the next,
        and between blocks over all members, which holds where one member resembles the other.
    """
    members, blocks = power.shape[:2]
    mean = np.maximum(power.mean(axis=(0, 1)), _TINY)
    between_members = power.mean(axis=1).std(axis=0, ddof=1) / math.sqrt(members)
    between_blocks = power.mean(axis=0).std(axis=0, ddof=1) / math.sqrt(blocks)
    return np.asarray(_DB_PER_PART * np.maximum(between_members, between_blocks) / mean)


def overall(values_db: FloatArray, power: FloatArray) -> float:
    """Root mean square over bands (k, c) of the channel in which it is largest, dB; 0 where nothing moves.

    Bands far below the strongest of their channel are left out, as in :mod:`jointplay.solver.spectra.harmonics`.
    """
    largest = 0.0
    for column, levels in zip(values_db.T, power.T, strict=True):
        strongest = levels.max(initial=0.0)
        if strongest > 0:
            kept = levels > strongest * 10 ** (-FLOOR_DB / 10)
            largest = max(largest, float(np.sqrt(np.mean(column[kept] ** 2))))
    return largest


def has_settled(before: FloatArray, after: FloatArray, allowed_db: float) -> bool:
    """Whether the earlier of two successive blocks shows nothing more of a transient.

    Parameters
    ----------
    before, after : (m, k, c) arrays
        Powers of the members in either block.
    allowed_db : float
        Difference of the mean levels that is allowed in any case.
    """
    first, second = before.mean(axis=0), after.mean(axis=0)
    change = overall(decibels(first) - decibels(second), second)
    scatter = np.hypot(
        before.std(axis=0, ddof=1) / np.maximum(first, _TINY), after.std(axis=0, ddof=1) / np.maximum(second, _TINY)
    )
    expected = overall(_DB_PER_PART * scatter / math.sqrt(len(before)), second)
    return change <= max(allowed_db, _BEYOND_SCATTER * expected)


class Average:
    """Blocks of an ensemble as they come: the first are left out until one resembles the next.

    Parameters
    ----------
    allowed_db : float
        As for :func:`settled`.

    Attributes
    ----------
    dropped : int
        Blocks left out so far.
    """

    def __init__(self, allowed_db: float) -> None:
        self.dropped = 0
        self._allowed = allowed_db
        self._waiting: BlockSpectra | None = None
        self._members: tuple[int, ...] = ()
        self._bands: list[FloatArray] = []
        self._psd = np.zeros(0)

    @property
    def blocks(self) -> int:
        """Blocks averaged."""
        return len(self._bands)

    @property
    def seen(self) -> int:
        """Blocks taken: averaged, left out, or waiting for another like it."""
        return self.blocks + self.dropped + (self._waiting is not None)

    @property
    def bands(self) -> FloatArray:
        """Powers in bands, (members, blocks, k, c)."""
        return np.stack(self._bands, axis=1)

    @property
    def psd(self) -> FloatArray:
        """Mean densities of the members, (members, n, c)."""
        return self._psd / len(self._bands)

    def error(self) -> float:
        """Standard error of the levels of the frame's motions, see :func:`overall`; infinite before there are two."""
        if self.blocks < 2:
            return math.inf
        bands = self.bands[..., : len(MOTIONS)]
        return overall(standard_error_db(bands), bands.mean(axis=(0, 1)))

    def take(self, block: BlockSpectra) -> None:
        """Take the next block; members that are not in it are left out of the earlier ones too."""
        if self._members and block.members != self._members:
            rows = [self._members.index(member) for member in block.members]
            self._bands = [bands[rows] for bands in self._bands]
            self._psd = self._psd[rows] if self._bands else self._psd
            self._waiting = self._waiting and self._waiting.of(block.members)
        self._members = block.members
        if self._bands:
            self._add(block)
        elif self._waiting is None:
            self._waiting = block
        elif has_settled(self._waiting.bands[..., : len(MOTIONS)], block.bands[..., : len(MOTIONS)], self._allowed):
            self._add(self._waiting)
            self._add(block)
            self._waiting = None
        else:
            self.dropped += 1
            self._waiting = block

    def finish(self) -> bool:
        """Take what still waits for another block like it; whether nothing did."""
        if self._waiting is None:
            return True
        self._add(self._waiting)
        self._waiting = None
        return False

    def _add(self, block: BlockSpectra) -> None:
        self._psd = self._psd + block.psd if self._bands else block.psd
        self._bands.append(block.bands)
