"""Cases of a catalogue as one table: what they are, without their spectra."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from catalogue.entry import AS_NEW, HEALTHY
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
    joints : tuple of str
        Turning joints of the machine, in alphabetical order: the columns of `clearance`.
    clearance : ndarray, shape (n, len(joints))
        Radial clearance [m]; 0 where the joint is ideal.
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
    seconds : ndarray, shape (n,)
        Processor time of the simulation [s].
    """

    key: TextArray
    hypothesis: TextArray
    status: TextArray
    message: TextArray
    joints: tuple[str, ...]
    clearance: FloatArray
    parameters: Mapping[str, FloatArray]
    draw: IntArray
    drive_speed: FloatArray
    segments: IntArray
    transient: FloatArray
    seconds: FloatArray

    def __len__(self) -> int:
        return len(self.key)

    def joints_of(self, row: int) -> tuple[str, ...]:
        """Joints with clearance in a row."""
        return tuple(joint for joint, clearance in zip(self.joints, self.clearance[row], strict=True) if clearance > 0)

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
    parameters[:] = np.reshape(nominal, (-1, 1))
    start = 0
    for shard in shards:
        rows = slice(start, start + shard.count)
        clearance[rows, [joints.index(joint) for joint in shard.joints]] = shard.clearance
        parameters[[names.index(name) for name in shard.parameter_names], rows] = shard.parameters.T
        start += shard.count

    def numbers(column: str, kind: type[Any]) -> NDArray[Any]:
        parts = [np.asarray(getattr(shard, column), kind) for shard in shards]
        return np.concatenate(parts) if parts else np.empty(0, kind)

    return EntryTable(
        key=_text(shard.key for shard in shards),
        hypothesis=_text(shard.hypothesis for shard in shards),
        status=_text(shard.status for shard in shards),
        message=_text(shard.message for shard in shards),
        joints=joints,
        clearance=clearance,
        parameters=dict(zip(names, parameters, strict=True)),
        draw=numbers("draw", np.int64),
        drive_speed=numbers("drive_speed", np.float64),
        segments=numbers("segments", np.int64),
        transient=numbers("transient", np.float64),
        seconds=numbers("seconds", np.float64),
    )


def _nominal(machine: Machine, names: Sequence[str]) -> list[float]:
    numbers = MachineNumbers(machine) if names else None
    return [numbers.by_path[numbers.targets(name)[0]] for name in names] if numbers else []


def _text(columns: Iterable[tuple[str, ...]]) -> TextArray:
    return np.array([value for column in columns for value in column], dtype=np.str_)


def catalogue_order(table: EntryTable) -> IntArray:
    """Rows in the order of a catalogue, each key once."""
    ranks = {HEALTHY: 0, AS_NEW: 1}

    def place(row: int) -> tuple[int, int, str, tuple[float, ...], int, str]:
        label = str(table.hypothesis[row])
        worn = tuple(table.clearance[row][table.clearance[row] > 0].tolist())
        return ranks.get(label, 2), len(worn), label, worn, int(table.draw[row]), str(table.key[row])

    first = {key: row for row, key in reversed(list(enumerate(table.key.tolist())))}
    return np.array(sorted(first.values(), key=place), dtype=np.int64)
