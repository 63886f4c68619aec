"""Spectra that carry what they are: quantity, unit, scaling, window, resolution, averages, drive speed, point."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.errors import SettingsError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Quantity = Literal["displacement", "velocity", "acceleration"]
Scaling = Literal["psd", "power", "rms", "peak"]

#: How many time derivatives each quantity is from displacement, and the unit's ending that goes with it.
DERIVATIVES: dict[Quantity, int] = {"displacement": 0, "velocity": 1, "acceleration": 2}
_PER_TIME = ("", "/s", "/s2")


@dataclass(frozen=True, eq=False, repr=False)
class Spectrum:
    """A one-sided spectrum of one or more channels.

    Parameters
    ----------
    frequency : (n,) array
        Hz, from 0, evenly spaced.
    values : (n, c) array
        Density [unit^2 / Hz] for "psd"; of a sine at that line mean square [unit^2] for "power" and amplitude [unit]
        for "rms" and "peak".
    channels : tuple of str, (c,)
    quantity : {"displacement", "velocity", "acceleration"}
    units : tuple of str, (c,)
        Of the signal, not of the density: "m/s2", "rad/s2".
    scaling : {"psd", "power", "rms", "peak"}
    window : str
    resolution : float
        Distance of lines [Hz].
    noise_bandwidth : float
        Equivalent noise bandwidth of the window [Hz]: what turns density into amplitude.
    averages : int
        Windows averaged; they overlap by half.
    drive_speed : float or None
        rad/s; None where nothing turns.
    transient : float
        Start-up dropped before the first window [s].
    point : str
        Which point and directions ("centre of gravity of bed, global axes").
    """

    frequency: FloatArray
    values: FloatArray
    channels: tuple[str, ...]
    quantity: Quantity
    units: tuple[str, ...]
    scaling: Scaling
    window: str
    resolution: float
    noise_bandwidth: float
    averages: int
    drive_speed: float | None
    transient: float
    point: str

    def __post_init__(self) -> None:
        if self.values.shape != (len(self.frequency), len(self.channels)) or len(self.units) != len(self.channels):
            raise SettingsError(
                f"spectrum: values of shape {self.values.shape} for {len(self.frequency)} lines, "
                f"{len(self.channels)} channels and {len(self.units)} units"
            )

    def __repr__(self) -> str:
        lines = f"0 to {self.frequency[-1]:.4g} Hz by {self.resolution:.3g} Hz" if len(self.frequency) else "no lines"
        what = f"{self.scaling} of {self.quantity}, {', '.join(self.channels)}"
        return f"<Spectrum {what}: {lines}, {self.averages} averages>"

    def to_pandas(self) -> pd.DataFrame:
        """Return a table over frequency [Hz], a column a channel; needs pandas."""
        import pandas as pd

        return pd.DataFrame(self.values, index=pd.Index(self.frequency, name="f"), columns=list(self.channels))

    def to_xarray(self) -> xr.DataArray:
        """Return values over ``f`` [Hz] and ``channel``, with what they are as attributes; needs xarray."""
        import xarray as xr

        coordinates = {"f": self.frequency, "channel": list(self.channels)}
        told = {
            "quantity": self.quantity,
            "scaling": self.scaling,
            "units": list(self.value_units),
            "window": self.window,
        }
        return xr.DataArray(self.values, coordinates, ("f", "channel"), self.quantity, told)

    @property
    def value_units(self) -> tuple[str, ...]:
        """Units of ``values``: "(m/s2)^2/Hz", "(m/s2)^2", "m/s2 rms" or "m/s2 peak"."""
        return value_units(self.units, self.scaling)

    @property
    def orders(self) -> FloatArray:
        """Frequencies as multiples of the drive's, (n,).

        Raises
        ------
        SettingsError
            When the spectrum has no drive speed.
        """
        return self.frequency / (_speed_of(self) / (2.0 * math.pi))


@dataclass(frozen=True, eq=False)
class CrossSpectrum:
    """Cross-spectral densities of all pairs of channels.

    Parameters
    ----------
    density : (n, c, c) complex array
        Hermitian, one-sided, [unit i x unit j / Hz]; ``density[:, i, j]`` averages X_i conj(X_j).
    auto : Spectrum
        Its diagonal, with everything there is to say about both.
    """

    density: ComplexArray
    auto: Spectrum


def value_units(units: Sequence[str], scaling: Scaling) -> tuple[str, ...]:
    """Units of a spectrum's values from those of its signals."""
    if scaling in ("psd", "power"):
        return tuple(f"({unit})^2{'/Hz' if scaling == 'psd' else ''}" for unit in units)
    return tuple(f"{unit} {scaling}" for unit in units)


def frame_units(channels: Sequence[str], quantity: Quantity) -> tuple[str, ...]:
    """Units of channels: rad for "theta", m for all others, with the time of the quantity."""
    return tuple(("rad" if name == "theta" else "m") + _PER_TIME[DERIVATIVES[quantity]] for name in channels)


def convert(spectrum: Spectrum, quantity: Quantity) -> Spectrum:
    """The same motion as another quantity, by (2 pi f)^k (squared for density and power).

    Parameters
    ----------
    spectrum : Spectrum
    quantity : {"displacement", "velocity", "acceleration"}

    Returns
    -------
    Spectrum
        The line at zero frequency is set to zero: standstill has no derivative and its integral is not known.
    """
    steps = DERIVATIVES[quantity] - DERIVATIVES[spectrum.quantity]
    if steps == 0:
        return spectrum
    power = 2 * steps if spectrum.scaling in ("psd", "power") else steps
    factor = np.zeros(len(spectrum.frequency))
    moving = spectrum.frequency > 0
    factor[moving] = (2.0 * math.pi * spectrum.frequency[moving]) ** power
    old, new = _PER_TIME[DERIVATIVES[spectrum.quantity]], _PER_TIME[DERIVATIVES[quantity]]
    units = tuple((unit[: len(unit) - len(old)] if old else unit) + new for unit in spectrum.units)
    return dataclasses.replace(spectrum, values=spectrum.values * factor[:, None], quantity=quantity, units=units)


def rescale(spectrum: Spectrum, scaling: Scaling) -> Spectrum:
    """The same spectrum as density, power, rms or peak amplitude.

    Parameters
    ----------
    spectrum : Spectrum
    scaling : {"psd", "power", "rms", "peak"}

    Returns
    -------
    Spectrum
    """
    if scaling == spectrum.scaling:
        return spectrum
    of, bandwidth = spectrum.values, spectrum.noise_bandwidth
    power = {"psd": of * bandwidth, "power": of, "rms": of**2, "peak": of**2 / 2.0}[spectrum.scaling]
    values = scale_power(power, bandwidth, scaling)
    return dataclasses.replace(spectrum, values=values, scaling=scaling)


def scale_power(power: FloatArray, bandwidth: float | FloatArray, scaling: Scaling) -> FloatArray:
    """Mean squares, each of a stretch of `bandwidth` [Hz], as density, power, rms or peak amplitude of a sine."""
    scaled = {"psd": power / bandwidth, "power": power, "rms": power**0.5, "peak": (2.0 * power) ** 0.5}
    return np.asarray(scaled[scaling], dtype=np.float64)


def order_levels(spectrum: Spectrum, orders: Sequence[float] | FloatArray) -> FloatArray:
    """Rms in the band one order wide around each order.

    Parameters
    ----------
    spectrum : Spectrum
        With a drive speed.
    orders : (k,) array
        Multiples of the drive's frequency.

    Returns
    -------
    (k, c) array
        In the channels' units.

    Raises
    ------
    SettingsError
        When the spectrum has no drive speed or an order's band reaches beyond its end.
    """
    density = rescale(spectrum, "psd").values
    base = _speed_of(spectrum) / (2.0 * math.pi)
    wanted = np.asarray(orders, dtype=np.float64)
    low, high = (wanted - 0.5) * base, (wanted + 0.5) * base
    step = spectrum.resolution
    top = float(spectrum.frequency[-1])
    if wanted.size and float(high.max()) > top + 0.5 * step:
        raise SettingsError(f"order {float(wanted.max()):g}: its band reaches beyond the spectrum's end at {top:g} Hz")
    # Each line stands for the stretch half way to its neighbours: integrate that staircase exactly.
    borders = np.concatenate([[0.0], spectrum.frequency[:-1] + 0.5 * step, [top + 0.5 * step]])
    running = np.vstack([np.zeros(density.shape[1]), np.cumsum(density * step, axis=0)])
    power = np.column_stack(
        [np.interp(high, borders, column) - np.interp(np.maximum(low, 0.0), borders, column) for column in running.T]
    )
    return np.asarray(np.sqrt(np.maximum(power, 0.0)), dtype=np.float64)


def _speed_of(spectrum: Spectrum) -> float:
    if spectrum.drive_speed is None:
        raise SettingsError("spectrum: has no drive speed, so it has no orders")
    return spectrum.drive_speed
