"""Welch's method: spectra as means over Hann windows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy.signal

from jointplay.solver.arrays import FloatArray
from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.segments import fast_length
from jointplay.solver.spectra.spectrum import CrossSpectrum, Quantity, Spectrum, frame_units

#: Equivalent noise bandwidth of a Hann window, in spectral lines.
HANN_NOISE_LINES = 1.5


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
    if diagonal_only:  # given one array twice, scipy transforms it once
        for i, column in enumerate(np.ascontiguousarray(values.T)):
            density[:, i, i] = scipy.signal.csd(
                column, column, fs=sample_rate, window="hann", nperseg=length, noverlap=length - hop,
                detrend="constant",
            )[1]  # fmt: skip
    for i in range(0 if diagonal_only else width):
        for j in range(i, width):
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
