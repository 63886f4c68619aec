"""Cases of a catalogue as one table: what they are, without their spectra."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from catalogue.entry import AS_NEW, HEALTHY, Hypothesis
from catalogue.parameters import MachineNumbers
from catalogue.shard import Shard
from solver.machines.machine import Machine

__all__ = ["EntryTable", "catalogue_order", "joined_table"]

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
TextArray = NDArray[np.str_]


@dataclass(frozen=True)
class EntryTable:
    """Cases of a catalogue, one a row.

    Parameters
    ----------
    key, hypothesis, status, message : ndarray of str, shape (n,)
        Key; label of the hypothesis; "ok" or what went wrong, and details.
    stratum : ndarray of str, shape (n,)
        "trusted" or "wide": how much of the machine was uncertain.
    law : ndarray of str, shape (n,)
        Contact law: "own" of the machine file, or another one. Numbers of contacts are those of this law.
    joints : tuple of str
        Turning joints of the machine, in alphabetical order: the columns of `clearance` and `worn`.
    clearance : ndarray, shape (n, len(joints))
        Radial clearance [m]; 0 where the joint is ideal.
    worn : ndarray of bool, shape (n, len(joints))
        Whether the joint is worn; other joints with clearance have the play of new fits.
    parameters : mapping of str to ndarray, shape (n,)
        The numbers that were drawn, by path, SI.
    draw : ndarray of int, shape (n,)
        Number of the draw within its hypothesis, clearance levels and speed, from 0.
    drive_speed : ndarray, shape (n,)
        rad/s.
    segments : ndarray of int, shape (n,)
        Windows averaged.
    transient : ndarray, shape (n,)
        Start-up time left out [s].
    guard_db : ndarray, shape (n,)
        Mean difference from the same case computed more finely [dB]; NaN where it was not.
    """

    key: TextArray
    hypothesis: TextArray
    status: TextArray
    message: TextArray
    stratum: TextArray
    law: TextArray
    joints: tuple[str, ...]
    clearance: FloatArray
    worn: NDArray[np.bool_]
    parameters: Mapping[str, FloatArray]
    draw: IntArray
    drive_speed: FloatArray
    segments: IntArray
    transient: FloatArray
    guard_db: FloatArray

    def __len__(self) -> int:
        return len(self.key)

    def joints_of(self, row: int) -> tuple[str, ...]:
        """Joints with clearance in a row."""
        return tuple(joint for joint, clearance in zip(self.joints, self.clearance[row], strict=True) if clearance > 0)

    def worn_of(self, row: int) -> tuple[str, ...]:
        """Worn joints in a row."""
        return tuple(joint for joint, is_worn in zip(self.joints, self.worn[row], strict=True) if is_worn)

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The hypotheses in the order in which they appear first."""
        labels, first = np.unique(self.hypothesis, return_index=True)
        places = zip(first.tolist(), labels.tolist(), strict=True)
        return tuple(Hypothesis(label, self.worn_of(row)) for row, label in sorted(places))

    def rows(self, keep: NDArray[np.bool_] | NDArray[np.integer]) -> EntryTable:
        """The table of some rows, by mask or by number."""
        values: dict[str, object] = {field.name: getattr(self, field.name) for field in fields(self)}
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                values[name] = value[keep]
        values["parameters"] = {path: numbers[keep] for path, numbers in self.parameters.items()}
        return EntryTable(**values)  # type: ignore[arg-type]


def joined_table(shards: Sequence[Shard], machine: Machine) -> EntryTable:
    """Tables of shards one below the other.

    Parameters
    ----------
    shards : sequence of Shard
        All of `machine`.
    machine : Machine

    Returns
    -------
    EntryTable
        A number that only some shards vary has, in the others, the value of the machine's file.
    """
    joints = tuple(sorted(machine.turning_joints))
    names = sorted({name for shard in shards for name in shard.parameter_names})
    nominal = _nominal(machine, names)
    count = sum(shard.count for shard in shards)
    clearance, parameters = np.zeros((count, len(joints))), np.empty((len(names), count))
    worn = np.zeros((count, len(joints)), dtype=np.bool_)
    parameters[:] = np.reshape(nominal, (-1, 1))
    start = 0
    for shard in shards:
        rows = slice(start, start + shard.count)
        clearance[rows, [joints.index(joint) for joint in shard.joints]] = shard.clearance
        worn[rows, [joints.index(joint) for joint in shard.hypothesis.joints]] = True
        parameters[[names.index(name) for name in shard.parameter_names], rows] = shard.parameters.T
        start += shard.count

    def numbers(column: str, kind: type[Any]) -> NDArray[Any]:
        parts = [np.asarray(getattr(shard, column), kind) for shard in shards]
        return np.concatenate(parts) if parts else np.empty(0, kind)

    return EntryTable(
        key=_text(shard.key for shard in shards),
        hypothesis=_text((shard.hypothesis.label,) * shard.count for shard in shards),
        status=_text(shard.status for shard in shards),
        message=_text(shard.message for shard in shards),
        stratum=_text((shard.stratum,) * shard.count for shard in shards),
        law=_text((shard.variant.law,) * shard.count for shard in shards),
        joints=joints,
        clearance=clearance,
        worn=worn,
        parameters=dict(zip(names, parameters, strict=True)),
        draw=numbers("draw", np.int64),
        drive_speed=numbers("drive_speed", np.float64),
        segments=numbers("segments", np.int64),
        transient=numbers("transient", np.float64),
        guard_db=numbers("guard_db", np.float64),
    )


def _nominal(machine: Machine, names: Sequence[str]) -> list[float]:
    numbers = MachineNumbers(machine) if names else None
    return [numbers.by_path[numbers.targets(name)[0]] for name in names] if numbers else []


def _text(columns: Iterable[tuple[str, ...]]) -> TextArray:
    return np.array([value for column in columns for value in column], dtype=np.str_)


def catalogue_order(table: EntryTable) -> IntArray:
    """Rows in the order of a catalogue, each key once."""
    ranks = {HEALTHY: 0, AS_NEW: 1}

    def place(row: int) -> tuple[int, int, str, str, tuple[float, ...], int, str]:
        label, stratum = str(table.hypothesis[row]), str(table.stratum[row])
        worn = tuple(table.clearance[row][table.worn[row]].tolist())
        rank = 2 if worn else ranks.get(label, 2)
        return rank, len(worn), label, stratum, worn, int(table.draw[row]), str(table.key[row])

    first = {key: row for row, key in reversed(list(enumerate(table.key.tolist())))}
    return np.array(sorted(first.values(), key=place), dtype=np.int64)
