"""Cases of a catalogue as one table: what they are, without their spectra."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray

TextArray = NDArray[np.str_]


@dataclass(frozen=True, eq=False)
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
        Whether the joint is worn; other joints with clearance have the play of their fits.
    parameters : mapping of str to ndarray, shape (n,)
        The numbers that were drawn, by path, SI.
    draw : ndarray of int, shape (n,)
        Number of the draw within its hypothesis, clearance levels and speed, from 0.
    speed : ndarray, shape (n,)
        Factor on the drive speed of the machine's file that the plan asked for.
    drive_speed : ndarray, shape (n,)
        rad/s.
    segments : ndarray of int, shape (n,)
        Windows averaged.
    period : ndarray of int, shape (n,)
        Revolutions after which the motion repeats; 0 where it was not seen to.
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
    worn: BoolArray
    parameters: Mapping[str, FloatArray]
    draw: IntArray
    speed: FloatArray
    drive_speed: FloatArray
    segments: IntArray
    period: IntArray
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

    def rows(self, keep: BoolArray | NDArray[np.integer]) -> EntryTable:
        """The table of some rows, by mask or by number."""
        values: dict[str, object] = {field.name: getattr(self, field.name) for field in fields(self)}
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                values[name] = value[keep]
        values["parameters"] = {path: numbers[keep] for path, numbers in self.parameters.items()}
        return EntryTable(**values)  # type: ignore[arg-type]
