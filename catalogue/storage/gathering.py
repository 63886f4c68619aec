"""From shards to the columns of a feature matrix: every entry once, in the order of a catalogue."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.plans.entry import HEALTHY, Hypothesis
from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.storage.cross_power import COLUMNS
from jointplay.catalogue.storage.matrix_header import LAWS, STRATA, MatrixBlock, MatrixHeader
from jointplay.catalogue.storage.shard import OK, Shard
from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.bands import FEATURE_ORDERS, BandScheme

Numbers = NDArray[Any]
"""A column: numbers of a type that the column has by its name."""

BLOCK_ROWS = 256
"""Spectra of a matrix that are written, and checked, together."""


@dataclass(frozen=True)
class Gathered:
    """A catalogue as columns.

    Parameters
    ----------
    header : MatrixHeader
    columns : mapping of str to ndarray
        All but the spectra, by name; one row an entry.
    power : callable
        Yields the grouped spectra in the order of the rows, (at most :data:`BLOCK_ROWS`, G, 33) float32 at a time.
    """

    header: MatrixHeader
    columns: Mapping[str, Numbers]
    power: Callable[[], Iterator[NDArray[np.float32]]]


def gather(
    catalogue_id: str, machine: Machine, scheme: BandScheme, shards: Iterable[Shard], waiting: IO[bytes]
) -> Gathered:
    """Put the entries of shards below each other.

    Parameters
    ----------
    catalogue_id : str
    machine : Machine
        All shards are of it.
    scheme : BandScheme
        Bands of all shards.
    shards : iterable of Shard
        In the order in which `place` counts them; taken one at a time, so that memory holds only one. An entry
        that is in several counts in the first.
    waiting : binary file
        Empty and open for writing and reading; keeps the grouped spectra until their order is known, so that memory
        holds only the columns (some 300 bytes an entry).

    Returns
    -------
    Gathered
        Sorted by hypothesis (healthy, then faults by number of joints and name), stratum, number of the draw:
        so the first draws of a hypothesis stand together, and being the beginning of a Sobol sequence they fill its
        range evenly. Entries without a spectrum stand at the end. A number that only some entries vary has, in the
        others, the value of the machine's file; 0 if the file has no such number.
    """
    cuts = scheme.third_octave_groups(FEATURE_ORDERS)
    parts: list[_ShardPart] = []
    written = 0
    for number, shard in enumerate(shards):
        parts.append(_ShardPart.of(number, shard, cuts, waiting, written))
        written += len(shard.power)
    joints = tuple(sorted(machine.wearing_joints))
    names = tuple(sorted({name for part in parts for name in part.parameter_names}))
    hypotheses = tuple(sorted({part.hypothesis for part in parts}, key=_rank))
    columns, remarks, digests = _join(parts, joints, names, hypotheses, machine)
    order, count = _order(columns)
    columns = {name: column[order] for name, column in columns.items()}
    spectrum = columns.pop("spectrum")[:count]
    groups = len(cuts) - 1

    def power() -> Iterator[NDArray[np.float32]]:
        if count == 0:
            return
        waiting.flush()
        spectra: NDArray[np.float32] = np.memmap(waiting, np.float32, "r").reshape(-1, groups, COLUMNS)
        for start in range(0, count, BLOCK_ROWS):
            yield spectra[spectrum[start : start + BLOCK_ROWS]]

    kept = sorted(key.tobytes() + digests[old] for key, old in zip(columns["key"], order.tolist(), strict=True))
    header = MatrixHeader(
        id=catalogue_id,
        content=hashlib.sha256(b"".join(kept)).hexdigest(),
        edges=scheme.edges,
        cuts=cuts,
        joints=joints,
        parameter_names=names,
        hypotheses=hypotheses,
        blocks=tuple(_blocks(columns, hypotheses, count)),
        count=count,
        total=len(order),
        remarks={new: remarks[old] for new, old in enumerate(order.tolist()) if old in remarks},
    )
    return Gathered(header, columns, power)


@dataclass(frozen=True, eq=False)
class _ShardPart:
    """What is kept of one shard: everything but its spectra, which go to `waiting`."""

    hypothesis: Hypothesis
    joints: tuple[str, ...]
    parameter_names: tuple[str, ...]
    clearance: FloatArray
    parameters: FloatArray
    columns: Mapping[str, Numbers]
    remarks: Mapping[int, tuple[str, str]]
    digests: tuple[bytes, ...]

    @classmethod
    def of(cls, number: int, shard: Shard, cuts: tuple[int, ...], waiting: IO[bytes], first: int) -> _ShardPart:
        """Take a shard apart; `first` spectra wait already."""
        count = shard.count
        grouped = np.add.reduceat(shard.power[:, : cuts[-1]], cuts[:-1], axis=1)
        np.concatenate([grouped, shard.cyclic], axis=2, dtype=np.float32).tofile(waiting)
        place = np.stack([np.full(count, number), np.arange(count)], axis=1)
        remarks = zip(shard.status, shard.message, strict=True)
        return cls(
            hypothesis=shard.hypothesis,
            joints=shard.joints,
            parameter_names=shard.parameter_names,
            clearance=shard.clearance,
            parameters=shard.parameters,
            columns={
                "key": np.frombuffer(bytes.fromhex("".join(shard.key)), np.uint8).reshape(count, 32),
                "stratum": np.full(count, STRATA.index(shard.stratum), np.int8),
                "law": np.full(count, LAWS.index(shard.variant.law), np.int8),
                "draw": shard.draw,
                "speed": np.full(count, shard.speed),
                "place": place.astype(np.int32),
                "drive_speed": shard.drive_speed,
                "transient": shard.transient,
                "segments": shard.segments,
                "period": shard.period,
                "guard_db": shard.guard_db,
                "spectrum": np.where(shard.row >= 0, shard.row.astype(np.int64) + first, -1),
            },
            remarks={row: remark for row, remark in enumerate(remarks) if remark != (OK, "")},
            digests=tuple(_digests(shard)),
        )


def _digests(shard: Shard) -> Iterator[bytes]:
    """SHA-256 of everything that was computed of each entry; what it is a case of is in its key."""
    columns = (shard.drive_speed, shard.transient, shard.segments, shard.period, shard.guard_db, shard.draw)
    table = np.column_stack(columns)
    for position, row in enumerate(shard.row.tolist()):
        words = (shard.hypothesis.label, shard.stratum, shard.status[position], shard.message[position])
        digest = hashlib.sha256("\0".join(words).encode())
        digest.update(table[position].tobytes())
        if row >= 0:
            digest.update(shard.power[row].tobytes())
            digest.update(shard.spread_db[row].tobytes())
            digest.update(shard.cyclic[row].tobytes())
        yield digest.digest()


def _rank(hypothesis: Hypothesis) -> tuple[bool, int, str]:
    """Place of a hypothesis among others."""
    return hypothesis.label != HEALTHY, len(hypothesis.joints), hypothesis.label


def _join(
    parts: Sequence[_ShardPart],
    joints: tuple[str, ...],
    names: tuple[str, ...],
    hypotheses: tuple[Hypothesis, ...],
    machine: Machine,
) -> tuple[dict[str, Numbers], dict[int, tuple[str, str]], list[bytes]]:
    """Columns, remarks and digests of all parts, one below the other."""
    counts = [len(part.digests) for part in parts]
    starts = np.cumsum([0, *counts])
    clearance = np.zeros((starts[-1], len(joints)))
    parameters = np.tile(_nominal(machine, names), (starts[-1], 1))
    for part, start, count in zip(parts, starts.tolist(), counts, strict=False):
        rows = slice(start, start + count)
        clearance[rows, [joints.index(joint) for joint in part.joints]] = part.clearance
        parameters[rows, [names.index(name) for name in part.parameter_names]] = part.parameters
    codes = [hypotheses.index(part.hypothesis) for part in parts]
    columns: dict[str, Numbers] = {
        "hypothesis": np.repeat(np.array(codes, np.int16), counts),
        "clearance": clearance,
        "parameters": parameters,
    }
    for name, empty in _EMPTY.items():
        columns[name] = np.concatenate([empty, *(part.columns[name] for part in parts)])
    shifted = zip(parts, starts.tolist(), strict=False)
    remarks = {row + start: remark for part, start in shifted for row, remark in part.remarks.items()}
    return columns, remarks, [digest for part in parts for digest in part.digests]


_EMPTY: Mapping[str, Numbers] = {
    "key": np.empty((0, 32), np.uint8),
    "stratum": np.empty(0, np.int8),
    "law": np.empty(0, np.int8),
    "draw": np.empty(0, np.int32),
    "speed": np.empty(0),
    "place": np.empty((0, 2), np.int32),
    "drive_speed": np.empty(0),
    "transient": np.empty(0),
    "segments": np.empty(0, np.int32),
    "period": np.empty(0, np.int32),
    "guard_db": np.empty(0),
    "spectrum": np.empty(0, np.int64),
}


def _nominal(machine: Machine, names: Sequence[str]) -> FloatArray:
    """What the machine's file has in the place of each number; 0 where it has none, as of a load that is not there."""
    numbers = MachineNumbers(machine)
    return np.array([numbers.nominal(name) for name in names], np.float64)


def _order(columns: Mapping[str, Numbers]) -> tuple[IntArray, int]:
    """Rows in the order of a catalogue, each key once, and the number of those with a spectrum."""
    keys = columns["key"]
    _, first = np.unique(np.ascontiguousarray(keys).ravel().view("S32"), return_index=True)  # in the order of keys
    has_none = columns["spectrum"][first] < 0
    by = (columns["draw"][first], columns["stratum"][first], columns["hypothesis"][first], has_none)
    return first[np.lexsort(by)].astype(np.int64), int(np.sum(~has_none))


def _blocks(columns: Mapping[str, Numbers], hypotheses: tuple[Hypothesis, ...], count: int) -> Iterator[MatrixBlock]:
    codes = columns["hypothesis"][:count].astype(np.int64) * len(STRATA) + columns["stratum"][:count]
    found, starts = np.unique(codes, return_index=True)
    for code, start, stop in zip(found.tolist(), starts.tolist(), [*starts.tolist(), count][1:], strict=True):
        hypothesis, stratum = divmod(code, len(STRATA))
        yield MatrixBlock(hypotheses[hypothesis], STRATA[stratum], start, stop)


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
