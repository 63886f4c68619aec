"""What matching needs of a catalogue: spectra in feature bands and clearances, by hypothesis."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from jointplay.catalogue.matching.observation import PackedArray
from jointplay.catalogue.plans.entry import Hypothesis, Stratum
from jointplay.solver.arrays import FloatArray, IntArray


class Spectra(Protocol):
    """What is learned from: :class:`jointplay.catalogue.storage.matrix.FeatureMatrix`, or anything that answers like
    it.
    """

    @property
    def id(self) -> str:
        """Of the state of the catalogue."""

    @property
    def cuts(self) -> tuple[int, ...]:
        """Edges of the feature bands in stored bands."""

    @property
    def edges(self) -> tuple[float, ...]:
        """Edges of the feature bands, orders of the drive."""

    nominal_speed: float
    """Drive speed of the machine's file, rad/s."""

    @property
    def speeds(self) -> tuple[float, ...]:
        """Factors on that speed which it has spectra at, rising."""

    def nearest_speed(self, speed: float) -> float:
        """The one of them that is nearest to a drive speed, rad/s."""

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
        """Spectra of rows, (m, G, 33): :data:`jointplay.catalogue.storage.cross_power.COLUMNS`."""

    def clearance(self, rows: IntArray) -> FloatArray:
        """Radial clearances of rows, (m, joints), m."""


def band_widths(spectra: Spectra) -> FloatArray:
    """Return the widths (G,) of the feature bands at the machine's own drive speed, Hz."""
    widths: FloatArray = np.diff(spectra.edges) * abs(spectra.nominal_speed) / (2.0 * np.pi)
    return widths
