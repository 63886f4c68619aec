"""The files of a feature matrix: written whole or not at all, mapped, and checked where they are read."""

from __future__ import annotations

import hashlib
import math
import os
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.storage.cross_power import COLUMNS
from jointplay.catalogue.storage.directory import CatalogueDirectory, sha256_of, sync_folder
from jointplay.catalogue.storage.gathering import BLOCK_ROWS, Gathered, Numbers
from jointplay.catalogue.storage.matrix_header import ColumnFile, MatrixHeader, OtherVersionError
from jointplay.solver.arrays import IntArray

_HEADER, _POWER, _DIGESTS = "header.json", "power.npy", "power.sha256"
_HEAD = 192  # bytes before the numbers of a file, at most
_DAMAGED = "does not match its checksum: `jointplay reindex` makes the matrix again"


def write_matrix(layout: CatalogueDirectory, gathered: Gathered) -> MappedColumns:
    """Write a matrix into its folder, in the place of a damaged one under the same id, and map it.

    Parameters
    ----------
    layout : CatalogueDirectory
    gathered : Gathered

    Returns
    -------
    MappedColumns
        What was written; or, where another builder was faster, its matrix of the same state, which stays.

    Raises
    ------
    CatalogueFileError
        It cannot be written.
    """
    target = layout.matrix(gathered.header.id)
    try:
        with layout.temporary_folder(layout.matrices) as folder:
            files = {name: _write_column(folder, name, column) for name, column in gathered.columns.items()}
            digests = _write_power(folder / _POWER, gathered)
            _write(folder / _DIGESTS, digests)
            header = replace(gathered.header, files=files, digests=sha256_of(digests))
            _write(folder / _HEADER, header.to_json())
            sync_folder(folder)
            columns = MappedColumns(folder, header, target)
            while (other := MappedColumns.sound(layout, header.id)) is None:
                layout.remove_folder(target)
                try:
                    os.replace(folder, target)
                except OSError:
                    if not target.exists():
                        raise
                else:
                    break
        sync_folder(layout.matrices)
    except OSError as error:
        raise CatalogueFileError(target, f"cannot be written ({error.strerror or error})") from error
    return other or columns


def _write_column(folder: Path, name: str, column: Numbers) -> ColumnFile:
    column = np.ascontiguousarray(column)
    with open(folder / f"{name}.npy", "xb") as file:
        np.save(file, column, allow_pickle=False)
        _sync(file)
    return ColumnFile(column.dtype.str, column.shape, _digest(column))


def _write_power(path: Path, gathered: Gathered) -> bytes:
    """Write the spectra and return the checksums of their blocks."""
    shape = (gathered.header.count, len(gathered.header.cuts) - 1, COLUMNS)
    digests = []
    with open(path, "xb") as file:
        head = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, head)
        for block in gathered.power():
            content = np.ascontiguousarray(block, "<f4").tobytes()
            file.write(content)
            digests.append(hashlib.sha256(content).digest())
        _sync(file)
    return b"".join(digests)


def _write(path: Path, content: bytes) -> None:
    with open(path, "xb") as file:
        file.write(content)
        _sync(file)


def _sync(file: IO[bytes]) -> None:
    file.flush()
    os.fsync(file.fileno())


def _digest(column: Numbers) -> str:
    return hashlib.sha256(column.data if column.size else b"").hexdigest()


class MappedColumns:
    """Columns in files; each is checked when it is read for the first time, spectra block by block.

    Parameters
    ----------
    folder : Path
    header : MatrixHeader
    named : Path, optional
        What messages call the folder, if it is to get another name.

    Raises
    ------
    ValueError, OSError
        A file is missing or is not what the header says.
    """

    def __init__(self, folder: Path, header: MatrixHeader, named: Path | None = None) -> None:
        self._folder, self.header = named or folder, header
        # All files are opened at once: a reader keeps them when a later build removes the folder.
        files = header.files.items()
        self._columns = {name: _map(folder / f"{name}.npy", file.dtype, file.shape) for name, file in files}
        self._power = _map(folder / _POWER, "<f4", (header.count, len(header.cuts) - 1, COLUMNS))
        digests = (folder / _DIGESTS).read_bytes()
        if sha256_of(digests) != header.digests:
            raise ValueError(f"{_DIGESTS} does not match its checksum")
        self._digests = np.frombuffer(digests, np.uint8).reshape(-1, 32)
        self._checked_columns: set[str] = set()
        self._checked_blocks = np.zeros(len(self._digests), dtype=np.bool_)

    @classmethod
    def open(cls, layout: CatalogueDirectory, catalogue_id: str) -> MappedColumns | None:
        """Map the matrix of this state of the catalogue; None if there is none that this version can read.

        Raises
        ------
        CatalogueFileError
            It is damaged.
        """
        folder = layout.matrix(catalogue_id)
        path = folder / _HEADER
        try:
            header = MatrixHeader.from_json(path.read_bytes())
            return cls(folder, header) if header.id == catalogue_id else None
        except OtherVersionError:
            return None
        except FileNotFoundError:
            if not path.exists():
                return None
            raise CatalogueFileError(folder, f"lacks a file: {_DAMAGED.split(': ')[1]}") from None
        except (ValueError, KeyError, TypeError, OSError) as error:
            rule = f"cannot be used ({error}): {_DAMAGED.split(': ')[1]}"
            raise CatalogueFileError(folder, rule) from None

    @classmethod
    def sound(cls, layout: CatalogueDirectory, catalogue_id: str) -> MappedColumns | None:
        """Map the matrix of this state of the catalogue if it is there and all of it is in order."""
        try:
            columns = cls.open(layout, catalogue_id)
            if columns is not None:
                columns.check()
        except CatalogueFileError:
            return None
        return columns

    def column(self, name: str) -> Numbers:
        """One column of the table, read-only.

        Raises
        ------
        CatalogueFileError
            It does not match its checksum.
        """
        column = self._columns[name]
        if name not in self._checked_columns:
            if _digest(column) != self.header.files[name].sha256:
                raise CatalogueFileError(self._folder / f"{name}.npy", _DAMAGED)
            self._checked_columns.add(name)
        return column

    def power(self, rows: IntArray) -> NDArray[np.float32]:
        """Packed spectra of some rows, (m, G, 33).

        Raises
        ------
        CatalogueFileError
            A block that is read for the first time does not match its checksum.
        """
        for block in np.unique(rows // BLOCK_ROWS).tolist():
            if not self._checked_blocks[block]:
                content = self._power[block * BLOCK_ROWS : (block + 1) * BLOCK_ROWS]
                if hashlib.sha256(content.data).digest() != self._digests[block].tobytes():
                    raise CatalogueFileError(self._folder / _POWER, _DAMAGED)
                self._checked_blocks[block] = True
        spectra: NDArray[np.float32] = self._power[rows]
        return spectra

    def check(self) -> None:
        """Check all of it.

        Raises
        ------
        CatalogueFileError
            Names the file that does not match its checksum.
        """
        for name in self._columns:
            self.column(name)
        for start in range(0, self.header.count, BLOCK_ROWS):
            self.power(np.array([start]))


def _map(path: Path, dtype: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """The numbers at the end of a file; its head, in which NumPy says the same, is for other programs."""
    head = path.stat().st_size - np.dtype(dtype).itemsize * math.prod(shape)
    if not 0 < head <= _HEAD:
        raise ValueError(f"{path.name} is not as long as it should be")
    if math.prod(shape) == 0:  # cannot be mapped
        return np.empty(shape, dtype)
    return np.asarray(np.memmap(path, dtype, "r", offset=head, shape=shape))
