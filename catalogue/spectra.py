"""What matching needs of a catalogue: spectra in feature bands and clearances, by hypothesis."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from catalogue.cross_power import pack
from catalogue.entry import AS_NEW, HEALTHY, Hypothesis, Stratum
from catalogue.feature_bands import FEATURE_ORDERS
from catalogue.matching import FloatArray, IntArray
from catalogue.observation import PackedArray, grouped
from catalogue.store import Catalogue


class Spectra(Protocol):
    """What is learned from: the feature matrix of a catalogue."""

    @property
    def id(self) -> str:
        """Of the state of the catalogue."""

    @property
    def cuts(self) -> tuple[int, ...]:
        """Edges of the feature bands in stored bands."""

    @property
    def edges(self) -> tuple[float, ...]:
        """Edges of the feature bands, orders of the drive."""

    @property
    def nominal_speed(self) -> float:
        """Drive speed of the machine's file, rad/s."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Turning joints, the columns of :meth:`clearance`."""

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """Those it has spectra of."""

    def rows(
        self, label: str, stratum: Stratum | None = None, *, draws: int | None = None, speed: float | None = None
    ) -> IntArray:
        """Rows of a hypothesis."""

    def packed(self, rows: IntArray) -> PackedArray:
        """Spectra of rows, (m, G, 9)."""

    def clearance(self, rows: IntArray) -> FloatArray:
        """Radial clearances of rows, (m, joints), m."""


class SpectraInMemory:
    """Spectra of a catalogue that is read whole.

    Parameters
    ----------
    catalogue : Catalogue
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._table = catalogue.entries
        scheme = catalogue.scheme
        self.id = catalogue.id
        self.cuts: tuple[int, ...] = tuple(scheme.third_octave_groups(FEATURE_ORDERS))
        self.edges: tuple[float, ...] = tuple(np.asarray(scheme.edges)[list(self.cuts)].tolist())
        self.nominal_speed = catalogue.recipe.nominal_drive_speed
        self.joints = self._table.joints
        self._speeds = np.array(sorted(catalogue.plan.speeds)) * abs(self.nominal_speed)
        self._packed = grouped(pack(catalogue.power()), self.cuts)
        first = {label: row for row, label in reversed(list(enumerate(self._table.hypothesis.tolist())))}
        self.hypotheses: tuple[Hypothesis, ...] = tuple(
            Hypothesis(label, () if label in (HEALTHY, AS_NEW) else self._table.worn_of(first[label]))
            for label in catalogue.hypotheses
        )

    def rows(
        self, label: str, stratum: Stratum | None = None, *, draws: int | None = None, speed: float | None = None
    ) -> IntArray:
        """Rows of a hypothesis, see :class:`Spectra`."""
        table = self._table
        keep: NDArray[np.bool_] = table.hypothesis == label
        if stratum is not None:
            keep &= table.stratum == stratum
        if draws is not None:
            keep &= table.draw < draws
        if speed is not None and len(self._speeds) > 1:
            borders = np.sqrt(self._speeds[1:] * self._speeds[:-1])
            keep &= np.searchsorted(borders, np.abs(table.drive_speed)) == np.searchsorted(borders, abs(speed))
        return np.flatnonzero(keep).astype(np.int64)

    def packed(self, rows: IntArray) -> PackedArray:
        """Spectra of rows, (m, G, 9)."""
        return self._packed[rows]

    def clearance(self, rows: IntArray) -> FloatArray:
        """Radial clearances of rows, (m, joints), m."""
        clearance: FloatArray = self._table.clearance[rows]
        return clearance
