"""Columns of a feature matrix, wherever they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.storage.cross_power import COLUMNS
from jointplay.catalogue.storage.gathering import BLOCK_ROWS, Gathered, Numbers
from jointplay.solver.arrays import IntArray


class Columns(Protocol):
    """Where the numbers of a matrix are."""

    def column(self, name: str) -> Numbers:
        """One column of the table."""

    def power(self, rows: IntArray) -> NDArray[np.float32]:
        """Packed spectra of some rows, (m, G, 33)."""


@dataclass(frozen=True, eq=False)
class MemoryColumns:
    """Columns in memory.

    Parameters
    ----------
    columns : mapping of str to ndarray
    spectra : ndarray of float32, shape (n, G, 33)
    """

    columns: Mapping[str, Numbers]
    spectra: NDArray[np.float32]

    @classmethod
    def of(cls, gathered: Gathered) -> Self:
        """Read all spectra of what was gathered."""
        header = gathered.header
        spectra = np.empty((header.count, len(header.cuts) - 1, COLUMNS), np.float32)
        for number, block in enumerate(gathered.power()):
            spectra[number * BLOCK_ROWS : number * BLOCK_ROWS + len(block)] = block
        return cls(gathered.columns, spectra)

    def column(self, name: str) -> Numbers:
        """One column of the table."""
        return self.columns[name]

    def power(self, rows: IntArray) -> NDArray[np.float32]:
        """Packed spectra of some rows, (m, G, 33)."""
        return self.spectra[rows]


def hexadecimal(keys: NDArray[np.uint8]) -> NDArray[np.str_]:
    """Keys of 32 bytes, (n, 32), as texts of 64 hexadecimal digits, (n,)."""
    digits = np.frombuffer(b"0123456789abcdef", np.uint8)
    texts = np.stack([digits[keys >> 4], digits[keys & 15]], axis=-1).reshape(len(keys), 64)
    return texts.view("S64").ravel().astype(np.str_)
