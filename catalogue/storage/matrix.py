"""The feature matrix of a catalogue: what a measurement is matched with, of all entries, row by row.

It holds the spectra in feature bands (single orders, then third octaves) and the table of the entries, a fifth of the
catalogue's size. It is made from the shards at the end of a build, and mapped into memory: opening it reads a few kB,
and a query only what it touches.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import IO, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.plans.entry import HEALTHY, Hypothesis, Recipe, Stratum
from jointplay.catalogue.storage.cross_power import unpack
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.gathering import Columns, Gathered, MemoryColumns, Numbers, gather, hexadecimal
from jointplay.catalogue.storage.matrix_files import MappedColumns, write_matrix
from jointplay.catalogue.storage.matrix_header import LAWS, STRATA, Guard, MatrixHeader, Ranges
from jointplay.catalogue.storage.shard import OK, Shard
from jointplay.catalogue.storage.table import EntryTable
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray
from jointplay.solver.machines.machine import Machine


class MatrixSource(Protocol):
    """What a matrix is made of: a catalogue in some state."""

    @property
    def id(self) -> str:
        """Of the catalogue in this state."""

    @property
    def layout(self) -> CatalogueDirectory:
        """Its folder."""

    @property
    def machine(self) -> Machine:
        """What it is of."""

    @property
    def recipe(self) -> Recipe:
        """How every entry is computed."""

    def shards(self) -> Iterator[Shard]:
        """All of them, one at a time."""


class FeatureMatrix:
    """Entries of one catalogue, one a row; made by :meth:`open`, :meth:`publish` or :meth:`in_memory`.

    Rows are sorted by hypothesis (healthy, then faults by number of joints and name), stratum and number of the
    draw; entries without a spectrum stand behind all others.

    Parameters
    ----------
    header : MatrixHeader
    columns : Columns
    nominal_speed : float
        Drive speed of the machine's file [rad/s].
    """

    def __init__(self, header: MatrixHeader, columns: Columns, nominal_speed: float) -> None:
        self._header, self._columns = header, columns
        self.nominal_speed = nominal_speed

    @classmethod
    def in_memory(cls, catalogue: MatrixSource) -> Self:
        """Make the matrix of a catalogue without writing anything: about 2 kB an entry.

        Raises
        ------
        CatalogueFileError
            A shard is missing, does not match its checksum, or cannot be read.
        """
        with tempfile.TemporaryFile() as waiting:
            gathered = _gather(catalogue, waiting)
            return cls(gathered.header, MemoryColumns.of(gathered), catalogue.recipe.nominal_drive_speed)

    @classmethod
    def open(cls, catalogue: MatrixSource) -> Self | None:
        """Map the published matrix of a catalogue; None if there is none, or only one of another state of it.

        Raises
        ------
        CatalogueFileError
            It is damaged.
        """
        columns = MappedColumns.open(catalogue.layout, catalogue.id)
        return None if columns is None else cls(columns.header, columns, catalogue.recipe.nominal_drive_speed)

    @classmethod
    def publish(cls, catalogue: MatrixSource) -> Self:
        """Write the matrix of a catalogue, as a build and a check do at their ends, and map it.

        It takes its name only when it is complete; one that is there already and in order stays. What is returned was
        mapped before anybody could find it: another builder may have replaced or deleted it since.

        Raises
        ------
        CatalogueFileError
            A shard is missing, does not match its checksum or cannot be read, or the matrix cannot be written.
        """
        columns = MappedColumns.sound(catalogue.layout, catalogue.id)
        if columns is None:
            with tempfile.TemporaryFile(dir=catalogue.layout.root) as waiting:
                columns = write_matrix(catalogue.layout, _gather(catalogue, waiting))
        return cls(columns.header, columns, catalogue.recipe.nominal_drive_speed)

    @property
    def id(self) -> str:
        """Of the catalogue in the state it was made of; whatever is computed from it can be kept under this name."""
        return self._header.id

    @property
    def content(self) -> str:
        """SHA-256 over all entries with their spectra, however they are divided into shards."""
        return self._header.content

    @property
    def cuts(self) -> tuple[int, ...]:
        """Group g joins bands cuts[g] to cuts[g + 1] - 1 of the catalogue, (G + 1,).

        A recording with a lower sample rate uses the first groups: its cuts are a beginning of these.
        """
        return self._header.cuts

    @property
    def edges(self) -> tuple[float, ...]:
        """Edges of the groups [orders], (G + 1,)."""
        return tuple(self._header.edges[cut] for cut in self._header.cuts)

    @property
    def joints(self) -> tuple[str, ...]:
        """Turning joints of the machine in alphabetical order, the columns of :meth:`clearance`."""
        return self._header.joints

    @cached_property
    def speeds(self) -> tuple[float, ...]:
        """Factors on the drive speed that plans asked for, rising."""
        return tuple(np.unique(self._columns.column("speed")).tolist())

    @cached_property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Those it has spectra of, in the order of the rows."""
        return tuple(dict.fromkeys(block.hypothesis for block in self._header.blocks))

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of all hypotheses it has cases of, with or without spectrum."""
        return tuple(hypothesis.label for hypothesis in self._header.hypotheses)

    @property
    def failed_rows(self) -> IntArray:
        """Rows of the entries that have no spectrum."""
        return np.arange(self._header.count, self._header.total)

    @property
    def every_row(self) -> IntArray:
        """Rows of all entries, with or without spectrum."""
        return np.arange(self._header.total)

    @property
    def all_rows(self) -> IntArray:
        """Rows of the entries that have a spectrum."""
        return np.arange(self._header.count)

    def __len__(self) -> int:
        return self._header.count

    def statuses(self) -> dict[str, int]:
        """Number of entries by status; "ok" are those that have a spectrum."""
        failed = [status for status, _ in self._header.remarks.values() if status != OK]
        return {OK: len(self), **dict(sorted(Counter(failed).items()))}

    def rows(
        self, label: str, stratum: Stratum | None = None, *, draws: int | None = None, speed: float | None = None
    ) -> IntArray:
        """Rows of a hypothesis that have a spectrum.

        Parameters
        ----------
        label : str
            Of the hypothesis; one that is not there has no rows.
        stratum : {"trusted", "wide"}, optional
            Both by default, the trusted ones first.
        draws : int, optional
            Only draws of a number below it. The first draws of a hypothesis fill its range evenly, whatever their
            number, so that this is how to take fewer.
        speed : float, optional
            Only entries at the one of :attr:`speeds` that is nearest to this drive speed [rad/s].

        Returns
        -------
        ndarray of int, rising within a stratum
        """
        parts = [
            np.arange(block.start, block.stop)
            for block in self._header.blocks
            if block.hypothesis.label == label and stratum in (None, block.stratum)
        ]
        rows = np.concatenate(parts) if parts else np.empty(0, np.int64)
        if draws is not None:
            rows = rows[self._columns.column("draw")[rows] < draws]
        if speed is not None and len(self.speeds) > 1:
            rows = rows[self._columns.column("speed")[rows] == self.nearest_speed(speed)]
        return rows

    def individuals(self, rows: IntArray) -> IntArray:
        """Which machine each of some rows is of (m,): entries of one draw are of one, worn or not, on any day."""
        return self._individual[rows]

    def in_order(self, rows: IntArray) -> IntArray:
        """Rows (m,) of the same machines in order, at the same speed on another day; -1 where there is none."""
        return self._in_order[rows]

    @cached_property
    def _individual(self) -> IntArray:
        count = len(self)
        drawn = [self._columns.column("stratum")[:count], self._columns.column("draw")[:count]]
        _, first, group = np.unique(np.stack(drawn, axis=1), axis=0, return_index=True, return_inverse=True)
        alike = self._alike(first[np.ravel(group)])
        # Draws of catalogues from before this program drew the same machines for all hypotheses.
        sizes = [block.stop - block.start for block in self._header.blocks]
        block = np.where(alike, -1, np.repeat(np.arange(len(sizes)), sizes))
        clearances = np.where(alike[:, None], 0.0, self._columns.column("clearance")[:count])
        drawn = [block, *drawn, *clearances.T]
        _, first, number = np.unique(np.stack(drawn, axis=1), axis=0, return_index=True, return_inverse=True)
        # In the order in which they come, so that machines in order at one speed have the numbers of their rows.
        found: IntArray = np.argsort(np.argsort(first, kind="stable"), kind="stable")[np.ravel(number)]
        return found

    def _alike(self, other: IntArray) -> BoolArray:
        """Whether rows are of the same machine as others (n,): by its frame, its supports, and play that is no wear."""
        names, count = self._header.parameter_names, len(self)
        own = [place for place, name in enumerate(names) if name.startswith(("links.", "supports.", "modes."))]
        numbers = self._columns.column("parameters")[:count][:, own]
        clearance = np.where(
            self._header.worn[self._columns.column("hypothesis")[:count]],
            0.0,
            self._columns.column("clearance")[:count],
        )
        both = (clearance > 0.0) & (clearance[other] > 0.0)
        told = both.any(axis=1) | bool(own)
        same = (numbers == numbers[other]).all(axis=1) & ((clearance == clearance[other]) | ~both).all(axis=1)
        return np.asarray(told & same)

    @cached_property
    def _in_order(self) -> IntArray:
        speed = self._columns.column("speed")[: len(self)]
        sound: dict[tuple[int, float], list[int]] = {}
        for row in self.rows(HEALTHY).tolist():
            sound.setdefault((int(self._individual[row]), float(speed[row])), []).append(row)
        found = np.full(len(self), -1)
        for row, machine in enumerate(self._individual.tolist()):
            days = sound.get((machine, float(speed[row])), [])
            if row in days:
                # Another day than its own.
                days = days[days.index(row) + 1 :] + days[: days.index(row)]
            if days:
                found[row] = days[0]
        return found

    def nearest_speed(self, speed: float) -> float:
        """Return the one of :attr:`speeds` that is nearest to a drive speed [rad/s], as a ratio."""
        borders = np.sqrt(np.array(self.speeds[1:]) * self.speeds[:-1])
        return self.speeds[int(np.searchsorted(borders, abs(speed / self.nominal_speed)))]

    def packed(self, rows: IntArray) -> NDArray[np.float32]:
        """Spectra of some rows as they are stored, (m, G, 33): cross-powers, then cyclic ones, as
        :func:`jointplay.catalogue.storage.cross_power.pack` and `pack_cyclic` have them.

        Raises
        ------
        CatalogueFileError
            A part of the matrix that is read for the first time does not match its checksum.
        """
        return self._columns.power(np.asarray(rows, np.int64))

    def cross_power(self, rows: IntArray) -> NDArray[np.complex64]:
        """Cross-powers of the frame's acceleration in the groups, of some rows, (m, G, 3, 3).

        x, y [(m/s2)^2] and theta [(rad/s2)^2] at the frame's centre of gravity; raises as :meth:`packed`.
        """
        return unpack(self.packed(rows))

    def clearance(self, rows: IntArray) -> FloatArray:
        """Radial clearances of some rows, (m, joints), m."""
        return np.asarray(self._columns.column("clearance")[rows], dtype=np.float64)

    def numbers(self, paths: Iterable[str]) -> dict[str, FloatArray]:
        """Drawn numbers of all entries with a spectrum, SI, by path: those of `paths` that any entry varies."""
        drawn, names = self._columns.column("parameters"), self._header.parameter_names
        return {path: drawn[: len(self), names.index(path)] for path in paths if path in names}

    def table(self, rows: IntArray) -> EntryTable:
        """What the entries of some rows are."""
        header = self._header

        def take(name: str) -> Numbers:
            numbers: Numbers = self._columns.column(name)[rows]
            return numbers

        code = take("hypothesis")
        labels = np.array([hypothesis.label for hypothesis in header.hypotheses], dtype=np.str_)
        remarks = [header.remarks.get(row, (OK, "")) for row in np.asarray(rows).tolist()]
        numbers = take("parameters")
        return EntryTable(
            key=hexadecimal(take("key")),
            hypothesis=labels[code] if len(labels) else np.empty(0, np.str_),
            status=np.array([status for status, _ in remarks], dtype=np.str_),
            message=np.array([message for _, message in remarks], dtype=np.str_),
            stratum=np.array(STRATA)[take("stratum")],
            law=np.array(LAWS)[take("law")],
            joints=header.joints,
            clearance=take("clearance"),
            worn=header.worn[code],
            parameters={name: numbers[:, column] for column, name in enumerate(header.parameter_names)},
            draw=take("draw").astype(np.int64),
            speed=take("speed"),
            drive_speed=take("drive_speed"),
            segments=take("segments").astype(np.int64),
            period=take("period").astype(np.int64),
            transient=take("transient"),
            guard_db=take("guard_db"),
        )

    def find(self, key: str) -> tuple[int, ...]:
        """Rows, with or without spectrum, whose key begins so (hexadecimal digits, at least two)."""
        try:
            wanted = np.frombuffer(bytes.fromhex(key[: len(key) // 2 * 2]), np.uint8)
        except ValueError:
            return ()
        if not 1 <= len(wanted) <= 32:
            return ()
        found = np.flatnonzero((self._columns.column("key")[:, : len(wanted)] == wanted).all(axis=1))
        texts = hexadecimal(self._columns.column("key")[found]).tolist()
        return tuple(row for row, text in zip(found.tolist(), texts, strict=True) if text.startswith(key))

    def places(self, rows: IntArray) -> IntArray:
        """Where the entries of some rows are, (m, 2): number of the shard in the order of names, and position there."""
        return self._columns.column("place")[rows].astype(np.int64)

    @cached_property
    def ranges(self) -> Ranges:
        """What the entries with a spectrum span."""
        parameters = self._columns.column("parameters")[: len(self)]
        clearance = self._columns.column("clearance")
        spans = {}
        for code, hypothesis in enumerate(self._header.hypotheses):
            worn = self._header.worn[code] if hypothesis.joints else np.ones_like(self._header.worn[code])
            values = clearance[self.rows(hypothesis.label)][:, worn]
            if values.size and values.max() > 0.0:
                spans[hypothesis.label] = _span(values)
        return Ranges(
            speed=_span(np.abs(self._columns.column("drive_speed")[: len(self)])),
            clearance=spans,
            parameters={name: _span(parameters[:, i]) for i, name in enumerate(self._header.parameter_names)},
        )

    @cached_property
    def guard(self) -> Guard | None:
        """How far entries are from the same cases computed more finely; None if none was."""
        found = self._columns.column("guard_db")
        found = found[np.isfinite(found)]
        return Guard(len(found), float(found.mean()), float(np.quantile(found, 0.9))) if len(found) else None


def _gather(catalogue: MatrixSource, waiting: IO[bytes]) -> Gathered:
    return gather(catalogue.id, catalogue.machine, catalogue.recipe.scheme, catalogue.shards(), waiting)


def _span(values: FloatArray) -> tuple[float, float]:
    return (float(np.min(values)), float(np.max(values))) if values.size else (0.0, 0.0)
