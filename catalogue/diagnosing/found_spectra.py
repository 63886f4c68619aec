"""Spectra that were simulated for one recording, in place of a catalogue's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jointplay.catalogue.plans.entry import Entry, Hypothesis, Stratum, content_digest
from jointplay.catalogue.storage.matrix import FeatureMatrix
from jointplay.solver.arrays import FloatArray, IntArray


@dataclass(eq=False)
class FoundSpectra:
    """Cases and their spectra: a :class:`jointplay.catalogue.matching.learning.SpectraSource`.

    Parameters
    ----------
    matrix : FeatureMatrix
        Of the catalogue whose bands and joints they have.
    entries : tuple of Entry
        All of the stratum "trusted": what a recording has shown is all that is off.
    spectra : ndarray, shape (n, G, 33)
    id : str
        Which cases they are, where what is learned from them is kept.
    """

    matrix: FeatureMatrix
    entries: tuple[Entry, ...]
    spectra: FloatArray

    id: str = "as found"
    speeds: tuple[float, ...] = (1.0,)
    nominal_speed: float = field(init=False)

    def __post_init__(self) -> None:
        self.nominal_speed = self.matrix.nominal_speed

    @property
    def cuts(self) -> tuple[int, ...]:
        """Edges of the feature bands in stored bands."""
        return self.matrix.cuts

    @property
    def edges(self) -> tuple[float, ...]:
        """Edges of the feature bands, orders of the drive."""
        return self.matrix.edges

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints, the columns of :meth:`clearance`."""
        return self.matrix.joints

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Those it has spectra of."""
        return tuple(dict.fromkeys(entry.hypothesis for entry in self.entries))

    def nearest_speed(self, speed: float) -> float:
        """The one speed there is, as a ratio."""
        return self.speeds[0]

    def rows(
        self, label: str, stratum: Stratum | None = None, *, draws: int | None = None, speed: float | None = None
    ) -> IntArray:
        """Rows of a hypothesis: all of them, however few are asked for."""
        own = [row for row, entry in enumerate(self.entries) if entry.hypothesis.label == label]
        return np.array(own if stratum != "wide" else [], np.int64)

    def individuals(self, rows: IntArray) -> IntArray:
        """A draw is the same machine in every set of joints."""
        return np.array([self.entries[row].draw for row in rows.tolist()], np.int64)

    def in_order(self, rows: IntArray) -> IntArray:
        """None of them was simulated in order."""
        return np.full(len(rows), -1)

    def packed(self, rows: IntArray) -> FloatArray:
        """Spectra of rows, (m, G, 33)."""
        return self.spectra[rows]

    def clearance(self, rows: IntArray) -> FloatArray:
        """Radial clearances of rows, (m, joints), m."""
        faults = [self.entries[row].fault for row in rows.tolist()]
        return np.array([[fault.get(joint, 0.0) for joint in self.joints] for fault in faults]).reshape(len(rows), -1)

    def kept(self, rows: Sequence[int]) -> FoundSpectra:
        """Some of its cases."""
        return replace(self, entries=tuple(self.entries[row] for row in rows), spectra=self.spectra[list(rows)])

    def __add__(self, other: FoundSpectra) -> FoundSpectra:
        """Cases of both."""
        return replace(
            self,
            entries=(*self.entries, *other.entries),
            spectra=np.concatenate([self.spectra, other.spectra]),
            id=content_digest([self.id, other.id]),
        )
