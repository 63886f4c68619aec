"""Reading a catalogue: all entries as one table and one block of arrays, or one entry with everything about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from catalogue.cross_power import unpack
from catalogue.directory import CatalogueDirectory, sha256_of
from catalogue.entry import Recipe
from catalogue.errors import CatalogueFileError, EntryNotFoundError
from catalogue.hdf5 import SCHEMA_VERSION, decode_shard
from catalogue.keys import content_digest
from catalogue.manifest import Manifest
from catalogue.plan import Plan
from catalogue.shard import Shard
from catalogue.table import EntryTable, catalogue_order, joined_table
from solver.machines.machine import Machine
from solver.spectra.bands import BandScheme

__all__ = ["Catalogue", "EntryTable", "StoredEntry"]


@dataclass(frozen=True)
class StoredEntry:
    """One entry with all that is known of it.

    Parameters
    ----------
    key, hypothesis, status, message : str
    clearances : mapping of str to float
        Radial clearance [m] of the joints that have one.
    parameters : mapping of str to float
        Numbers that differ from the machine's file, by path, SI.
    draw : int
    drive_speed : float
        rad/s.
    segments : int
        Windows averaged.
    transient : float
        Start-up time left out [s].
    guard_db : float or None
        Mean difference from the same case computed more finely [dB]; None if it was not.
    worn : tuple of str
        The worn joints; others with clearance have the play of new fits.
    stratum, law : str
        How much of the machine was uncertain ("trusted", "wide"); contact law, "own" being that of the machine file.
    scheme : BandScheme
        Bands of the spectrum, in orders of `drive_speed`.
    power : ndarray of complex64, shape (B, 3, 3), or None
        Cross-power of the frame's acceleration (x, y in m/s2; theta in rad/s2) at its centre of gravity, integrated
        over each band; None if the case failed.
    spread_db : ndarray of float32, shape (B, 3), or None
        Standard deviation of the band levels over the averaged windows [dB].
    """

    key: str
    hypothesis: str
    status: str
    message: str
    clearances: Mapping[str, float]
    parameters: Mapping[str, float]
    draw: int
    drive_speed: float
    segments: int
    transient: float
    guard_db: float | None
    worn: tuple[str, ...]
    stratum: str
    law: str
    scheme: BandScheme
    power: NDArray[np.complex64] | None
    spread_db: NDArray[np.float32] | None


class Catalogue:
    """A catalogue as it was when it was opened; opened by :meth:`open`.

    What a build adds later is seen by opening again. Spectra are read when they are first asked for, and kept.

    Parameters
    ----------
    directory : CatalogueDirectory
    manifest : Manifest
    shard_names : sequence of str
        The shards it consists of.
    """

    def __init__(self, directory: CatalogueDirectory, manifest: Manifest, shard_names: Sequence[str]) -> None:
        self._directory, self._manifest = directory, manifest
        self._shard_names = tuple(sorted(shard_names))

    @classmethod
    def open(cls, directory: str | Path) -> Self:
        """Open a catalogue for reading; a build may be going on in it.

        Raises
        ------
        CatalogueFileError
            There is none, or its manifest cannot be read.
        CatalogueMismatchError
            It has another schema version.
        """
        layout = CatalogueDirectory(Path(directory))
        return cls(layout, Manifest.read(layout), layout.shard_names())

    @cached_property
    def id(self) -> str:
        """SHA-256 over everything it holds: machine, recipe, and the checksums of all shards."""
        return content_digest(
            {
                "schema_version": SCHEMA_VERSION,
                "machine": self.machine.content_key,
                "recipe": self.recipe.content,
                "shards": self._shard_names,
            }
        )

    @property
    def path(self) -> Path:
        """Its folder."""
        return self._directory.root

    @property
    def manifest(self) -> Manifest:
        """What it is of, and what made it."""
        return self._manifest

    @property
    def machine(self) -> Machine:
        """The machine; links and joints are in alphabetical order."""
        return self._manifest.machine

    @property
    def plan(self) -> Plan:
        """The plan that last added to it."""
        return self._manifest.plan

    @property
    def recipe(self) -> Recipe:
        """How its entries were simulated and estimated."""
        return self._manifest.recipe

    @property
    def scheme(self) -> BandScheme:
        """Bands of its spectra, in orders of the drive."""
        return self._manifest.recipe.scheme

    @property
    def size(self) -> int:
        """Bytes of its shards."""
        return sum(self._directory.shard(name).stat().st_size for name in self._shard_names)

    @property
    def entries(self) -> EntryTable:
        """Entries that have a spectrum, in the order of the rows of :meth:`power`.

        Healthy first, then as-new, then worn joints in alphabetical order, singles before pairs; rising in clearance;
        then by draw.
        """
        return self._content.table

    @property
    def failed(self) -> EntryTable:
        """Entries without a spectrum, with status and message."""
        return self._content.failed

    @cached_property
    def hypotheses(self) -> tuple[str, ...]:
        """Labels of the hypotheses it has spectra of, in the order of :attr:`entries`."""
        return tuple(dict.fromkeys(self.entries.hypothesis.tolist()))

    def power(self) -> NDArray[np.complex64]:
        """Cross-power of the frame's acceleration in bands, of all entries.

        Returns
        -------
        ndarray of complex64, shape (n, B, 3, 3)
            Hermitian, read-only; x, y [(m/s2)^2] and theta [(rad/s2)^2] at the frame's centre of gravity.

        Raises
        ------
        CatalogueFileError
            A shard is missing, does not match its checksum, or cannot be read.
        """
        return self._content.power

    def spread_db(self) -> NDArray[np.float32]:
        """Standard deviation of the band levels over the windows averaged [dB], shape (n, B, 3), read-only."""
        return self._content.spread

    def entry(self, key: str) -> StoredEntry:
        """One entry.

        Parameters
        ----------
        key : str
            Its key, or the beginning of it (8 digits at least) if only one key begins so.

        Raises
        ------
        EntryNotFoundError
            There is none, or more than one.
        """
        for table, has_spectrum in ((self.entries, True), (self.failed, False)):
            found = [row for row, known in enumerate(table.key.tolist()) if known.startswith(key)]
            if len(found) == 1 and len(key) >= 8:
                return self._stored(table, found[0], has_spectrum)
        raise EntryNotFoundError(key)

    def _stored(self, table: EntryTable, row: int, has_spectrum: bool) -> StoredEntry:
        clearances = zip(table.joints, table.clearance[row].tolist(), strict=True)
        return StoredEntry(
            key=str(table.key[row]),
            hypothesis=str(table.hypothesis[row]),
            status=str(table.status[row]),
            message=str(table.message[row]),
            clearances={joint: clearance for joint, clearance in clearances if clearance > 0.0},
            parameters={path: float(numbers[row]) for path, numbers in table.parameters.items()},
            draw=int(table.draw[row]),
            drive_speed=float(table.drive_speed[row]),
            segments=int(table.segments[row]),
            transient=float(table.transient[row]),
            guard_db=None if np.isnan(table.guard_db[row]) else float(table.guard_db[row]),
            worn=table.worn_of(row),
            stratum=str(table.stratum[row]),
            law=str(table.law[row]),
            scheme=self.scheme,
            power=self.power()[row] if has_spectrum else None,
            spread_db=self.spread_db()[row] if has_spectrum else None,
        )

    @cached_property
    def _content(self) -> _Content:
        return _Content.of([self._read(name) for name in self._shard_names], self.machine, self.scheme.count)

    def _read(self, name: str) -> Shard:
        path = self._directory.shard(name)
        try:
            content = path.read_bytes()
        except OSError as error:
            raise CatalogueFileError(path, f"cannot be read ({error.strerror or error})") from error
        if sha256_of(content) != name:
            raise CatalogueFileError(path, "does not match its checksum: verify the catalogue")
        shard = decode_shard(content, path)
        if shard.header.recipe != self.recipe or shard.header.machine != self._manifest.machine_content:
            raise CatalogueFileError(path, "belongs to another catalogue: verify this one")
        return shard


@dataclass(frozen=True)
class _Content:
    """Everything in the shards, in the order of a catalogue."""

    table: EntryTable
    failed: EntryTable
    power: NDArray[np.complex64]
    spread: NDArray[np.float32]

    @classmethod
    def of(cls, shards: Sequence[Shard], machine: Machine, bands: int) -> _Content:
        table = joined_table(shards, machine)
        # Row in the joined arrays of every case; shards follow each other.
        starts = np.cumsum([0, *(len(shard.power) for shard in shards)])
        pairs = zip(shards, starts.tolist(), strict=False)
        rows = np.array([row + start if row >= 0 else -1 for shard, start in pairs for row in shard.row], np.int64)
        order = catalogue_order(table)
        good, bad = order[rows[order] >= 0], order[rows[order] < 0]
        packed = np.concatenate([np.empty((0, bands, 9), np.float32), *(shard.power for shard in shards)])
        spread = np.concatenate([np.empty((0, bands, 3), np.float32), *(shard.spread_db for shard in shards)])
        power, spread = unpack(packed[rows[good]]), spread[rows[good]]
        power.flags.writeable = spread.flags.writeable = False
        return cls(table.rows(good), table.rows(bad), power, spread)
