"""What is locked to the crank: cyclic coherences, at which angle of a revolution a machine shakes.

Lines one or two orders apart have products whose mean is not zero where a motion, or its strength, comes back with
every revolution; their phases say when. Two joints that shake a frame as much, and as high, knock at other angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from jointplay.catalogue.storage.feature_bands import FEATURE_ORDERS
from jointplay.solver.arrays import ComplexArray, FloatArray, IntArray
from jointplay.solver.spectra.band_power import CYCLES

REFERENCE_ORDERS = 8
"""Orders whose cyclic coherences say together where in a revolution a recording begins: what moves by its kinematics
more than by its play."""


@dataclass(frozen=True, eq=False)
class CyclicBands:
    """Which cyclic coherences there are: all bands one order apart, those above single orders two orders apart, too.

    Parameters
    ----------
    band, other, cycle : ndarray of int, shape (f,)
        Feature band; the one that lines as many orders above it are in (itself, where bands are wide); place in
        :data:`jointplay.solver.spectra.band_power.CYCLES`.
    """

    band: IntArray
    other: IntArray
    cycle: IntArray

    def chosen(self, cyclic: ComplexArray) -> ComplexArray:
        """Return those of cyclic powers (n, G, k, c): (n, f, c)."""
        found: ComplexArray = cyclic[:, self.band, self.cycle]
        return found

    def products(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Return one quantity (n, G, c) in a band times another in the one beside it, (n, f, c)."""
        found: FloatArray = first[:, self.band] * second[:, self.other]
        return found

    def scale(self, power: FloatArray) -> FloatArray:
        """Return the largest cyclic power (n, f, c) that motions of a power (n, G, c) can have."""
        return np.sqrt(self.products(power, power))

    def from_crank(self, coherence: ComplexArray) -> ComplexArray:
        """Return cyclic coherences (n, f, c) whose phases count from wherever, with phases that no longer do.

        The angle is that of the sum over the lowest orders and all channels.
        """
        low = (self.cycle == 0) & (self.band < REFERENCE_ORDERS)
        angle = np.angle(coherence[:, low].sum(axis=(1, 2)))
        turned: ComplexArray = coherence * np.exp(-1j * np.outer(angle, np.array(CYCLES)[self.cycle]))[..., None]
        return turned


@lru_cache
def cyclic_bands(count: int) -> CyclicBands:
    """Return the cyclic coherences of so many feature bands."""
    single = min(count, FEATURE_ORDERS)
    places = [(band, 0) for band in range(count)] + [(band, 1) for band in range(single, count)]
    band, cycle = (np.array(column, np.int64) for column in zip(*places, strict=True))
    above = band + np.array(CYCLES)[cycle]
    return CyclicBands(band, np.where(above < single, above, band), cycle)
