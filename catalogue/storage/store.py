"""Reading a catalogue: its entries as a table and a matrix, their spectra, or one entry with everything about it."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from cachetools import LRUCache
from numpy.typing import NDArray

from jointplay.catalogue.errors import CatalogueFileError, EntryNotFoundError
from jointplay.catalogue.plans.entry import Entry, Recipe
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.storage.cross_power import unpack
from jointplay.catalogue.storage.directory import CatalogueDirectory, sha256_of
from jointplay.catalogue.storage.hdf5 import decode_shard
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.matrix import FeatureMatrix
from jointplay.catalogue.storage.shard import CaseOutcome, Shard
from jointplay.catalogue.storage.table import EntryTable
from jointplay.solver.arrays import IntArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.bands import BandScheme


@dataclass(frozen=True, eq=False)
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
    period : int
        Revolutions after which the motion repeats; 0 where it was not seen to.
    transient : float
        Start-up time left out [s].
    guard_db : float or None
        Mean difference from the same case computed more finely [dB]; None if it was not.
    worn : tuple of str
        The worn joints; others with clearance have the play of their fits.
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
    period: int
    transient: float
    guard_db: float | None
    worn: tuple[str, ...]
    stratum: str
    law: str
    scheme: BandScheme
    power: NDArray[np.complex64] | None
    spread_db: NDArray[np.float32] | None


KEPT_SHARDS = 8
"""Shards kept in memory (a megabyte each): neighbouring draws of a hypothesis lie in one for each contact law."""


class Catalogue:
    """A catalogue as it was when it was opened; opened by :meth:`open`.

    Opening reads the manifest alone. The table and the spectra that measurements are matched with come from the
    :attr:`matrix`; full spectra from the shards, one at a time. What a build adds later is seen by opening again.

    Parameters
    ----------
    layout : CatalogueDirectory
    manifest : Manifest
    shard_names : sequence of str
        The shards it consists of.
    """

    def __init__(self, layout: CatalogueDirectory, manifest: Manifest, shard_names: Sequence[str]) -> None:
        self._layout, self._manifest = layout, manifest
        self._shard_names = tuple(sorted(shard_names))
        self._shards: LRUCache[str, Shard] = LRUCache(KEPT_SHARDS)
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        return f"<Catalogue {self.path.name} of {self.machine.name}: {self.id[:12]}>"

    @classmethod
    def open(cls, directory: str | Path) -> Self:
        """Open a catalogue for reading; a build may be going on in it.

        It is in the state in which the last build or check that came to its end left it; before the first end of a
        build, it consists of all shards there are.

        Raises
        ------
        CatalogueFileError
            There is none, its manifest cannot be read, or a shard is gone.
        CatalogueMismatchError
            It has another layout.
        """
        layout = CatalogueDirectory(Path(directory))
        manifest = Manifest.read(layout)
        if manifest.seal is None:
            return cls(layout, manifest, layout.shard_names())
        gone = sorted(set(manifest.seal.names) - set(layout.shard_names()))
        if gone:
            raise CatalogueFileError(layout.shard(gone[0]), "is missing: verify the catalogue")
        return cls(layout, manifest, manifest.seal.names)

    @cached_property
    def id(self) -> str:
        """Root hash: SHA-256 over everything it holds: machine, recipe, and the checksums of all shards."""
        sealed = self._manifest.seal
        return self._manifest.root_of(self._shard_names) if sealed is None else sealed.root

    @property
    def layout(self) -> CatalogueDirectory:
        """Paths inside it."""
        return self._layout

    @property
    def path(self) -> Path:
        """Its folder."""
        return self._layout.root

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
    def drive_speeds(self) -> tuple[float, ...]:
        """Drive speeds [rad/s] about which it has entries, rising."""
        return tuple(factor * self.matrix.nominal_speed for factor in self.matrix.speeds)

    @property
    def size(self) -> int:
        """Bytes of its shards."""
        sealed = self._manifest.seal
        if sealed is not None:
            return sum(shard.size for shard in sealed.shards)
        return sum(self._layout.shard(name).stat().st_size for name in self._shard_names)

    @cached_property
    def matrix(self) -> FeatureMatrix:
        """What measurements are matched with; mapped if it was published, else made in memory from the shards.

        Raises
        ------
        CatalogueFileError
            A file of it, or a shard, is damaged.
        """
        published = FeatureMatrix.open(self)
        return FeatureMatrix.in_memory(self) if published is None else published

    @cached_property
    def entries(self) -> EntryTable:
        """Entries that have a spectrum, one a row of :attr:`matrix` and of :meth:`power`, in the same order.

        Healthy first, then faults by number of joints and name; within a hypothesis by stratum and number
        of the draw.
        """
        return self.matrix.table(self.matrix.all_rows)

    @cached_property
    def failed(self) -> EntryTable:
        """Entries without a spectrum, with status and message."""
        return self.matrix.table(self.matrix.failed_rows)

    @property
    def hypotheses(self) -> tuple[str, ...]:
        """Labels of the hypotheses it has spectra of, in the order of :attr:`entries`."""
        return tuple(hypothesis.label for hypothesis in self.matrix.hypotheses)

    def shards(self) -> Iterator[Shard]:
        """All shards, one after the other, in the order of their names; each is checked.

        Raises
        ------
        CatalogueFileError
            A shard is missing, does not match its checksum, or cannot be read.
        """
        return (self._read(name) for name in self._shard_names)

    def power(self) -> NDArray[np.complex64]:
        """Cross-power of the frame's acceleration in bands, of all entries: about 11 kB an entry in memory.

        Returns
        -------
        ndarray of complex64, shape (n, B, 3, 3)
            Hermitian, read-only; x, y [(m/s2)^2] and theta [(rad/s2)^2] at the frame's centre of gravity.

        Raises
        ------
        CatalogueFileError
            A shard is missing, does not match its checksum, or cannot be read.
        """
        return self._spectra[0]

    def spread_db(self) -> NDArray[np.float32]:
        """Standard deviation of the band levels over the windows averaged [dB], shape (n, B, 3), read-only."""
        return self._spectra[1]

    def entry(self, key: str) -> StoredEntry:
        """One entry; only its shard is read.

        Parameters
        ----------
        key : str
            Its key, or the beginning of it (8 digits at least) if only one key begins so.

        Raises
        ------
        EntryNotFoundError
            There is none, or more than one.
        CatalogueFileError
            Its shard is missing, does not match its checksum, or cannot be read.
        """
        entry, outcome = next(self.cases(np.array([self.row(key)])))
        return StoredEntry(
            key=entry.key,
            hypothesis=entry.hypothesis.label,
            status=outcome.status,
            message=outcome.message,
            clearances=dict(entry.fault),
            parameters=entry.parameters,
            draw=entry.draw,
            drive_speed=outcome.drive_speed,
            segments=outcome.segments,
            period=outcome.period,
            transient=outcome.transient,
            guard_db=outcome.guard_db,
            worn=entry.worn,
            stratum=entry.stratum,
            law=entry.variant.law,
            scheme=self.scheme,
            power=None if outcome.power is None else outcome.power.astype(np.complex64),
            spread_db=None if outcome.spread_db is None else outcome.spread_db.astype(np.float32),
        )

    def row(self, key: str) -> int:
        """Row of :attr:`matrix` of one entry; raises EntryNotFoundError as :meth:`entry`, which names a key so."""
        found = self.matrix.find(key) if len(key) >= 8 else ()
        if len(found) != 1:
            raise EntryNotFoundError(key)
        return found[0]

    def address(self, key: str) -> tuple[str, int]:
        """Where one entry is: SHA-256 of its shard, and position there. The two determine all of it; nothing is read.

        Raises
        ------
        EntryNotFoundError
            There is none, or more than one.
        """
        number, position = self.matrix.places(np.array([self.row(key)]))[0].tolist()
        return self._shard_names[number], position

    def cases(self, rows: IntArray) -> Iterator[tuple[Entry, CaseOutcome]]:
        """Cases of some rows of :attr:`matrix` in full, in the order of the rows; only their shards are read.

        Raises
        ------
        CatalogueFileError
            A shard is missing, does not match its checksum, or cannot be read.
        """
        for number, position in self.matrix.places(rows).tolist():
            shard = self._shard(self._shard_names[number])
            yield shard.entry(position), shard.outcome(position)

    def parts(self, rows: IntArray) -> Iterator[tuple[Shard, IntArray]]:
        """Shards that hold cases of some rows, and their positions there; rows of a shard must follow each other.

        Raises
        ------
        CatalogueFileError
            As :meth:`cases`.
        """
        places = self.matrix.places(rows)
        for run in np.split(places, np.flatnonzero(np.diff(places[:, 0])) + 1):
            if len(run):
                yield self._read(self._shard_names[int(run[0, 0])]), run[:, 1]

    @cached_property
    def _spectra(self) -> tuple[NDArray[np.complex64], NDArray[np.float32]]:
        """Full spectra and their spread, in the order of the rows."""
        places = self.matrix.places(self.matrix.all_rows)
        power = np.empty((len(places), self.scheme.count, 3, 3), np.complex64)
        spread = np.empty((len(places), self.scheme.count, 3), np.float32)
        for number, shard in enumerate(self.shards()):
            rows = np.flatnonzero(places[:, 0] == number)
            spectra = shard.row[places[rows, 1]]
            power[rows], spread[rows] = unpack(shard.power[spectra]), shard.spread_db[spectra]
        power.flags.writeable = spread.flags.writeable = False
        return power, spread

    def _shard(self, name: str) -> Shard:
        """A shard, from memory if it is one of those that were asked for last; threads may share the catalogue."""
        with self._lock:
            shard = self._shards.get(name)
        if shard is None:
            shard = self._read(name)
            with self._lock:
                self._shards[name] = shard
        return shard

    def _read(self, name: str) -> Shard:
        path = self._layout.shard(name)
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
