"""Bands of orders: one order wide around the first multiples of the drive's frequency, parts of an octave above."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.spectrum import DERIVATIVES, Quantity, Scaling, scale_power

#: Single orders that are compared; a recording must reach them.
FEATURE_ORDERS = 20

#: A power that stands for "nothing at all": far below any sensor, far above rounding.
LEAST_POWER = 1e-20


@dataclass(frozen=True)
class BandScheme:
    """Bands side by side, in orders (multiples of the drive's frequency).

    Parameters
    ----------
    edges : tuple of float, (B + 1,)
        Rising edges in orders; band ``b`` reaches from ``edges[b]`` to ``edges[b + 1]``.
    orders : int
        The first so many bands are one order wide, centred on orders 1, 2, ...
    per_octave : int
        Bands an octave above them (the last one may be narrower).
    """

    edges: tuple[float, ...]
    orders: int
    per_octave: int = 12

    def __post_init__(self) -> None:
        edges = np.asarray(self.edges, dtype=np.float64)
        if edges.ndim != 1 or edges.size < 2 or not np.all(np.isfinite(edges)):
            raise SettingsError("band edges: need at least two finite numbers")
        if edges[0] < 0 or np.any(np.diff(edges) <= 0):
            raise SettingsError("band edges: must not be negative and must rise")
        if not 0 <= self.orders <= edges.size - 1:
            raise SettingsError(f"band scheme: {self.orders} one-order bands of {edges.size - 1} bands")

    @classmethod
    def for_drive(cls, drive_speed: float, f_max: float = 4000.0, orders: int = 40, per_octave: int = 12) -> BandScheme:
        """One-order bands on orders 1 .. ``orders``, then ``per_octave`` bands an octave up to ``f_max``.

        Parameters
        ----------
        drive_speed : float
            Nominal drive speed [rad/s]; at other speeds the bands keep their orders.
        f_max : float
            Upper end at the nominal speed [Hz].
        orders : int
            One-order bands; fewer where ``f_max`` does not reach so far.
        per_octave : int
            Width of the bands above.
        """
        if not (abs(drive_speed) > 0 and math.isfinite(drive_speed)):
            raise SettingsError(f"drive speed: {drive_speed} rad/s: bands in orders need a turning drive")
        top = f_max * 2.0 * math.pi / abs(drive_speed)
        count = min(orders, math.floor(top - 0.5 + 1e-9))
        if count < 1:
            raise SettingsError(f"band scheme: upper end {f_max} Hz lies below order 1.5 of the drive")
        edges = [0.5 + n for n in range(count + 1)]
        step = 2.0 ** (1.0 / per_octave)
        # A last sliver of less than a third of a band is joined to the one before it.
        while top / edges[-1] > step ** (4.0 / 3.0):
            edges.append(edges[-1] * step)
        if top > edges[-1] * (1.0 + 1e-9):
            edges.append(top)
        return cls(tuple(edges), count, per_octave)

    @property
    def count(self) -> int:
        """Number of bands."""
        return len(self.edges) - 1

    @cached_property
    def centres(self) -> FloatArray:
        """Middle of each band [orders], (B,): arithmetic for one-order bands, geometric above."""
        edges = np.asarray(self.edges)
        low, high = edges[:-1], edges[1:]
        narrow = np.arange(self.count) < self.orders
        return np.asarray(np.where(narrow, 0.5 * (low + high), np.sqrt(low * high)), dtype=np.float64)

    def edges_hz(self, drive_speed: float) -> FloatArray:
        """Edges in Hz at a drive speed [rad/s], (B + 1,)."""
        return np.asarray(self.edges, dtype=np.float64) * (abs(drive_speed) / (2.0 * math.pi))

    def scale(
        self, power: FloatArray, drive_speed: float, quantity: Quantity = "acceleration", scaling: Scaling = "power"
    ) -> FloatArray:
        """Return mean squares of accelerations in the bands as another quantity and scaling.

        Parameters
        ----------
        power : (..., B, C) array
            (m/s2)^2.
        drive_speed : float
            rad/s.
        quantity : {"displacement", "velocity", "acceleration"}
            Every band counts as a sine at its middle: right for orders of a motion that repeats with the drive, and
            within 12 % of the mean square of a displacement for whatever lies in a twelfth of an octave.
        scaling : {"psd", "power", "rms", "peak"}

        Returns
        -------
        (..., B, C) array
        """
        rate = self.centres[:, None] * abs(drive_speed)
        width = np.diff(self.edges_hz(drive_speed))[:, None]
        return scale_power(power / rate ** (4 - 2 * DERIVATIVES[quantity]), width, scaling)

    def third_octave_groups(self, orders: int = 20) -> tuple[int, ...]:
        """Where to cut the bands into single orders 1 .. ``orders`` and third octaves above.

        Returns
        -------
        tuple of int, (G + 1,)
            Group ``g`` joins bands ``cuts[g]`` to ``cuts[g + 1] - 1``. Every band is in one group; above ``orders`` the
            cut is at the band edge next to the exact third of an octave.
        """
        single = min(orders, self.orders)
        cuts = list(range(single + 1))
        edges = np.asarray(self.edges)
        while cuts[-1] < self.count:
            wanted = edges[cuts[-1]] * 2.0 ** (1.0 / 3.0)
            nearest = int(np.argmin(np.abs(np.log(edges[1:] / wanted)))) + 1
            cuts.append(max(nearest, cuts[-1] + 1))
        # A last group of less than half a third octave is joined to the one before it.
        if len(cuts) > single + 2 and edges[cuts[-1]] / edges[cuts[-2]] < 2.0 ** (1.0 / 6.0):
            del cuts[-2]
        return tuple(cuts)
