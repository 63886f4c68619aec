"""Spectra that carry what they are: quantity, unit, scaling, window, resolution, averages, drive speed, point.

Bands of orders live in :mod:`solver.spectra.bands`, sensors in :mod:`solver.spectra.sensor`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy.signal

from solver.errors import SettingsError
from solver.spectra.bands import BandMatrix, BandScheme, band_matrices, band_matrix, transform_power
from solver.spectra.segments import ComplexArray, FloatArray, fast_length
from solver.spectra.sensor import RigidBody, rigid_body, sensor_signals, sensor_transform

__all__ = [
    "BandMatrix",
    "BandScheme",
    "CrossSpectrum",
    "Quantity",
    "RigidBody",
    "Scaling",
    "Spectrum",
    "band_matrices",
    "band_matrix",
    "convert",
    "cross_spectra",
    "order_levels",
    "rescale",
    "rigid_body",
    "sensor_signals",
    "sensor_transform",
    "transform_power",
    "undo_sample_mean",
    "welch",
]

Quantity = Literal["displacement", "velocity", "acceleration"]
Scaling = Literal["psd", "rms", "peak"]

#: How many time derivatives each quantity is from displacement, and the unit's ending that goes with it.
DERIVATIVES: dict[Quantity, int] = {"displacement": 0, "velocity": 1, "acceleration": 2}
_PER_TIME = ("", "/s", "/s2")

#: Equivalent noise bandwidth of a Hann window, in spectral lines.
HANN_NOISE_LINES = 1.5


@dataclass(frozen=True)
class Spectrum:
    """A one-sided spectrum of one or more channels.

    Parameters
    ----------
    frequency : (n,) array
        Hz, from 0, evenly spaced.
    values : (n, c) array
        Density [unit^2 / Hz] for "psd"; amplitude of a sine at that line [unit] for "rms" and "peak".
    channels : tuple of str, (c,)
    quantity : {"displacement", "velocity", "acceleration"}
    units : tuple of str, (c,)
        Of the signal, not of the density: "m/s2", "rad/s2".
    scaling : {"psd", "rms", "peak"}
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

    @property
    def value_units(self) -> tuple[str, ...]:
        """Units of ``values``: "(m/s2)^2/Hz", "m/s2 rms" or "m/s2 peak"."""
        if self.scaling == "psd":
            return tuple(f"({unit})^2/Hz" for unit in self.units)
        return tuple(f"{unit} {self.scaling}" for unit in self.units)

    @property
    def orders(self) -> FloatArray:
        """Frequencies as multiples of the drive's, (n,).

        Raises
        ------
        SettingsError
            When the spectrum has no drive speed.
        """
        return self.frequency / (_speed_of(self) / (2.0 * math.pi))


@dataclass(frozen=True)
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


def frame_units(channels: Sequence[str], quantity: Quantity) -> tuple[str, ...]:
    """Units of channels: rad for "theta", m for all others, with the time of the quantity."""
    return tuple(("rad" if name == "theta" else "m") + _PER_TIME[DERIVATIVES[quantity]] for name in channels)


def welch(
    signal: npt.ArrayLike,
    sample_rate: float,
    *,
    drive_speed: float | None,
    channels: Sequence[str],
    quantity: Quantity = "acceleration",
    units: Sequence[str] | None = None,
    revolutions_per_window: float = 4.0,
    window_length: int | None = None,
    transient: float = 0.0,
    point: str = "",
) -> Spectrum:
    """Power spectral density by Welch's method: Hann windows that overlap by half, mean taken off each.

    Parameters
    ----------
    signal : (n, c) array
        Without the transient.
    sample_rate : float
        Hz.
    drive_speed : float or None
        rad/s.
    channels, units : sequences of str, (c,)
        Units default to m and rad ("theta") with the quantity's time.
    quantity : {"displacement", "velocity", "acceleration"}
    revolutions_per_window : float
        Window in drive revolutions.
    window_length : int, optional
        Window in samples instead; the default without a drive is an eighth of the signal.
    transient : float
        What was dropped before, for the record [s].
    point : str
        For the record.

    Returns
    -------
    Spectrum

    Raises
    ------
    SettingsError
        When the signal is not finite, not (n, c), or shorter than a window.
    """
    return cross_spectra(
        signal,
        sample_rate,
        drive_speed=drive_speed,
        channels=channels,
        quantity=quantity,
        units=units,
        revolutions_per_window=revolutions_per_window,
        window_length=window_length,
        transient=transient,
        point=point,
        diagonal_only=True,
    ).auto


def cross_spectra(
    signal: npt.ArrayLike,
    sample_rate: float,
    *,
    drive_speed: float | None,
    channels: Sequence[str],
    quantity: Quantity = "acceleration",
    units: Sequence[str] | None = None,
    revolutions_per_window: float = 4.0,
    window_length: int | None = None,
    transient: float = 0.0,
    point: str = "",
    diagonal_only: bool = False,
) -> CrossSpectrum:
    """Cross-spectral densities of all pairs of channels; parameters as for :func:`welch`.

    Parameters
    ----------
    diagonal_only : bool
        Leave the pairs out (their density is zero then) and only estimate each channel by itself.

    Returns
    -------
    CrossSpectrum

    Raises
    ------
    SettingsError
        As :func:`welch`.
    """
    values = np.asarray(signal, dtype=np.float64)
    width = len(channels)
    if values.ndim != 2 or values.shape[1] != width:
        raise SettingsError(f"signal: shape {values.shape}: need samples x {width} channels")
    if not np.all(np.isfinite(values)):
        raise SettingsError("signal: holds a number that is not finite")
    length = window_length
    if length is None:
        if drive_speed:
            length = fast_length(revolutions_per_window * 2.0 * math.pi / abs(drive_speed) * sample_rate)
        else:
            length = len(values) // 8
    if not 8 <= length <= len(values):
        raise SettingsError(f"signal: {len(values)} samples: a window of {length} samples does not fit")
    hop = length - length // 2
    density = np.zeros((length // 2 + 1, width, width), dtype=np.complex128)
    for i in range(width):
        for j in range(i, i + 1 if diagonal_only else width):
            # scipy conjugates the first argument.
            _, pair = scipy.signal.csd(
                values[:, j], values[:, i], fs=sample_rate, window="hann", nperseg=length,
                noverlap=length - hop, detrend="constant",
            )  # fmt: skip
            density[:, i, j] = pair
            density[:, j, i] = np.conj(pair)
    auto = Spectrum(
        frequency=np.arange(length // 2 + 1, dtype=np.float64) * (sample_rate / length),
        values=np.ascontiguousarray(np.diagonal(density, axis1=1, axis2=2).real),
        channels=tuple(channels),
        quantity=quantity,
        units=tuple(units) if units is not None else frame_units(channels, quantity),
        scaling="psd",
        window="hann",
        resolution=sample_rate / length,
        noise_bandwidth=HANN_NOISE_LINES * sample_rate / length,
        averages=1 + (len(values) - length) // hop,
        drive_speed=None if not drive_speed else abs(drive_speed),
        transient=transient,
        point=point,
    )
    return CrossSpectrum(density, auto)


def convert(spectrum: Spectrum, quantity: Quantity) -> Spectrum:
    """The same motion as another quantity, by (2 pi f)^k (squared for a density).

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
    power = 2 * steps if spectrum.scaling == "psd" else steps
    factor = np.zeros(len(spectrum.frequency))
    moving = spectrum.frequency > 0
    factor[moving] = (2.0 * math.pi * spectrum.frequency[moving]) ** power
    old, new = _PER_TIME[DERIVATIVES[spectrum.quantity]], _PER_TIME[DERIVATIVES[quantity]]
    units = tuple((unit[: len(unit) - len(old)] if old else unit) + new for unit in spectrum.units)
    return dataclasses.replace(spectrum, values=spectrum.values * factor[:, None], quantity=quantity, units=units)


def rescale(spectrum: Spectrum, scaling: Scaling) -> Spectrum:
    """The same spectrum as density, rms or peak amplitude.

    Parameters
    ----------
    spectrum : Spectrum
    scaling : {"psd", "rms", "peak"}

    Returns
    -------
    Spectrum
    """
    if scaling == spectrum.scaling:
        return spectrum
    if spectrum.scaling == "psd":
        rms = np.sqrt(spectrum.values * spectrum.noise_bandwidth)
    else:
        rms = spectrum.values / (math.sqrt(2.0) if spectrum.scaling == "peak" else 1.0)
    if scaling == "psd":
        values = rms**2 / spectrum.noise_bandwidth
    else:
        values = rms * (math.sqrt(2.0) if scaling == "peak" else 1.0)
    return dataclasses.replace(spectrum, values=np.asarray(values, dtype=np.float64), scaling=scaling)


def order_levels(spectrum: Spectrum, orders: Sequence[float] | npt.NDArray[np.float64]) -> FloatArray:
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


def undo_sample_mean(frequency: npt.ArrayLike, sample_rate: float) -> FloatArray:
    """Factor on a density that undoes the loss of taking the mean over every sample interval.

    A mean over 1 / fs multiplies amplitudes by sin(pi f / fs) / (pi f / fs).

    Parameters
    ----------
    frequency : (n,) array
        Hz, below the sample rate.
    sample_rate : float
        Hz.

    Returns
    -------
    (n,) array
        1 at zero frequency, (pi / 2)^2 at half the sample rate.
    """
    return np.asarray(np.sinc(np.asarray(frequency, dtype=np.float64) / sample_rate) ** -2, dtype=np.float64)


def _speed_of(spectrum: Spectrum) -> float:
    if spectrum.drive_speed is None:
        raise SettingsError("spectrum: has no drive speed, so it has no orders")
    return spectrum.drive_speed
