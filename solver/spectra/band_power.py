"""Power of a signal in bands of orders: what a catalogue stores and what a diagnosis compares.

A band's power is the integral of the (cross-)spectral density over it. Spectral lines that straddle an edge are split
in proportion, so that bands side by side add up to the power of the range they cover (Parseval).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import numpy.typing as npt

from jointplay.solver.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from jointplay.solver.compiler.native import compiled
from jointplay.solver.errors import SettingsError
from jointplay.solver.spectra.bands import BandScheme
from jointplay.solver.spectra.segments import Segmentation, revolution_segments

#: Window of the band estimator in drive revolutions, and the step from one window to the next.
WINDOW_REVOLUTIONS = 3.0
HOP_REVOLUTIONS = 1.0

#: Cyclic orders: how many orders apart the lines are whose products say what comes back with every revolution.
CYCLES = (1, 2)


@dataclass(frozen=True, eq=False)
class BandMatrix:
    """Cross-power of channels in bands, averaged over windows of one signal.

    Parameters
    ----------
    power : (B, c, c) complex array
        Hermitian; [unit of channel i x unit of channel j], integrated over the band. The diagonal is real.
    spread_db : (B, c) array
        Standard deviation over the windows of the band's level [dB]; 0 when there is one window only.
    segments : int
        Windows averaged; they overlap by two thirds.
    degrees_of_freedom : (B,) array
        Of the chi-square law that the power of steady broadband noise would follow.
    covered : (B,) bool array
        False where the band reaches beyond half the sample rate: its power is then incomplete.
    scheme : BandScheme
    drive_speed : float
        rad/s.
    sample_rate : float
        Hz.
    channels : tuple of str
    cyclic : (G, len(CYCLES), c, c) complex array
        Cyclic cross-power of joined bands: as `power`, but of lines that are 1, 2, ... orders apart, the mean of both
        orders of the channels (symmetric). Its phase is that of the drive's angle, zero where it is counted from. No
        bands unless they were asked for.

    Notes
    -----
    What is periodic with the drive, or noise whose strength is, has cyclic power; what knows nothing of the drive has
    none (W. A. Gardner, Introduction to Random Processes, 2nd ed. (1990), chapter 12; J. Antoni, Mechanical Systems
    and Signal Processing 23 (2009) 987).
    """

    power: ComplexArray
    spread_db: FloatArray
    segments: int
    degrees_of_freedom: FloatArray
    covered: BoolArray
    scheme: BandScheme
    drive_speed: float
    sample_rate: float
    channels: tuple[str, ...] = field(default=())
    cyclic: ComplexArray = field(default_factory=lambda: np.empty((0, len(CYCLES), 0, 0), np.complex128))

    @property
    def auto_power(self) -> FloatArray:
        """Power of each channel in each band, (B, c)."""
        return np.ascontiguousarray(np.diagonal(self.power, axis1=-2, axis2=-1).real)


def band_matrix(
    signal: npt.ArrayLike,
    sample_rate: float,
    drive_speed: float,
    scheme: BandScheme,
    *,
    channels: tuple[str, ...] = (),
    derivatives: Sequence[int] | None = None,
    combine: npt.ArrayLike | None = None,
    sample_mean: bool = False,
    window_revolutions: float = WINDOW_REVOLUTIONS,
    cuts: Sequence[int] = (),
    angle: float = 0.0,
    period: int = 0,
) -> BandMatrix:
    """Band powers and cross-powers of one signal.

    Parameters
    ----------
    signal : (n, c) array
        Without the start-up transient.
    sample_rate : float
        Hz.
    drive_speed : float
        Drive speed of *this* signal [rad/s].
    scheme : BandScheme
    channels : tuple of str
        Names, for the record.
    derivatives : sequence of int, optional
        How many times each channel is to be differentiated in time, by (2 pi i f)^k; negative to integrate.
    combine : (k, c) array, optional
        The channels of the result are these combinations of the (differentiated) channels.
    sample_mean : bool
        True when every sample is the mean over its sample interval (alias-free output of the simulator); the known loss
        of such a mean is then undone, see :func:`jointplay.solver.spectra.welch.undo_sample_mean`.
    window_revolutions : float
        Window in drive revolutions.
    cuts : sequence of int, (G + 1,)
        Band g of the cyclic powers joins bands ``cuts[g]`` to ``cuts[g + 1] - 1``; there are none unless given.
    angle : float
        Of the drive at the first sample [rad].
    period : int
        The signal is exactly one period, of so many revolutions: what one window of three of them sees. 0 for any
        other.

    Returns
    -------
    BandMatrix

    Raises
    ------
    SettingsError
        When the signal is not a table of numbers, shorter than one window, or the drive stands still.
    """
    values = np.asarray(signal, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] < 1:
        raise SettingsError(f"signal: shape {values.shape}: need samples x channels")
    if not np.all(np.isfinite(values)):
        raise SettingsError("signal: holds a number that is not finite")
    if period:
        values = np.tile(values, (round(WINDOW_REVOLUTIONS), 1))
        window_revolutions = period * WINDOW_REVOLUTIONS
        segmentation = Segmentation(len(values), (0,), sample_rate)
    else:
        segmentation = revolution_segments(len(values), sample_rate, drive_speed, window_revolutions, HOP_REVOLUTIONS)
    edges = scheme.edges_hz(drive_speed)
    apart = [round(cycle * window_revolutions) for cycle in CYCLES] if len(cuts) else [0]
    lines = min(segmentation.length // 2 + 1, int(edges[-1] / segmentation.resolution + 0.5) + 2 + max(apart))
    spectrum = segmentation.coefficients(values, lines)
    factor = _line_factors(segmentation, lines, values.shape[1], derivatives, sample_mean)
    if factor is not None:
        spectrum *= factor
    if combine is not None:
        spectrum = np.einsum("kc,scf->skf", np.asarray(combine, dtype=np.float64), spectrum)
    windows, width = spectrum.shape[:2]
    auto = np.empty((windows, width, scheme.count))
    power = np.zeros((scheme.count, width, width), dtype=np.complex128)
    limits = _band_limits(scheme, window_revolutions, segmentation)
    _sum_bands(spectrum, limits, 0.5 * segmentation.length, auto, power)
    for i in range(width):
        power[:, i, i] = auto[:, i].mean(axis=0)
    cyclic = np.zeros((max(0, len(cuts) - 1), len(CYCLES), width, width), dtype=np.complex128)
    if len(cuts):
        begin = angle + abs(drive_speed) / sample_rate * np.array(segmentation.starts)
        turns = np.exp(-1j * np.outer(CYCLES, begin)) / windows
        _sum_cyclic(spectrum, limits[list(cuts)], np.array(apart), turns, 0.5 * segmentation.length, cyclic)
    tiny = np.finfo(np.float64).tiny
    if windows > 1:
        spread = np.std(10.0 * np.log10(np.maximum(auto, tiny)), axis=0, ddof=1).T
    else:
        spread = np.zeros((scheme.count, width))
    return BandMatrix(
        power=power,
        spread_db=np.ascontiguousarray(spread),
        segments=windows,
        degrees_of_freedom=_degrees_of_freedom(segmentation, edges),
        covered=edges[1:] <= 0.5 * sample_rate * (1.0 + 1e-9),
        scheme=scheme,
        drive_speed=abs(drive_speed),
        sample_rate=sample_rate,
        channels=channels,
        cyclic=cyclic,
    )


def transform_power(power: npt.ArrayLike, transform: npt.ArrayLike) -> ComplexArray:
    """Cross-powers seen through a linear map of the channels, ``T P T^H``.

    Parameters
    ----------
    power : (..., B, c, c) array
    transform : (s, c) array
        For instance of :func:`jointplay.solver.spectra.sensor.sensor_transform`.

    Returns
    -------
    (..., B, s, s) complex array
    """
    matrix = np.asarray(transform, dtype=np.float64)
    return np.asarray(matrix @ np.asarray(power) @ matrix.T, dtype=np.complex128)


def _line_factors(
    segmentation: Segmentation, lines: int, channels: int, derivatives: Sequence[int] | None, sample_mean: bool
) -> ComplexArray | None:
    """Amplitude factor of every line and channel, (c, lines), or None when there is nothing to do."""
    if derivatives is None and not sample_mean:
        return None
    frequency = segmentation.frequency[:lines]
    factor = np.ones((channels, lines), dtype=np.complex128)
    if sample_mean:
        factor /= np.sinc(frequency / segmentation.sample_rate)
    if derivatives is not None:
        if len(derivatives) != channels:
            raise SettingsError(f"derivatives: {len(derivatives)} numbers for {channels} channels")
        for row, count in zip(factor, derivatives, strict=True):
            row[1:] *= (2j * math.pi * frequency[1:]) ** count
            if count != 0:
                row[0] = 0.0  # what stands still has no derivative, and its integral is not known
    return factor


def _band_limits(scheme: BandScheme, revolutions: float, segmentation: Segmentation) -> FloatArray:
    """Edges in lines of the transform, none beyond the last.

    A window counts as the revolutions that it is meant to be. Where it is 0.1 % off, exact edges would give a band of
    order 3 a hundredth of the line that a Hann window sets beside order 2: all there is of an order 30 dB weaker.
    """
    return np.clip(np.asarray(scheme.edges) * revolutions, 0.0, 0.5 * segmentation.length)


@partial(compiled, fastmath={"contract", "nsz", "reassoc"}, forceinline=True)
def _weigh(one: ComplexArray, other: ComplexArray, first: float, last: float) -> tuple[float, float]:
    """Sum of ``one conj(other)``, of which the end lines count only in part: real and imaginary part."""
    real = imaginary = 0.0
    for k in range(1, one.size - 1):
        a, b = one[k], other[k]
        real += a.real * b.real + a.imag * b.imag
        imaginary += a.imag * b.real - a.real * b.imag
    a, b = one[0], other[0]
    real += first * (a.real * b.real + a.imag * b.imag)
    imaginary += first * (a.imag * b.real - a.real * b.imag)
    if one.size > 1:
        a, b = one[one.size - 1], other[other.size - 1]
        real += last * (a.real * b.real + a.imag * b.imag)
        imaginary += last * (a.imag * b.real - a.real * b.imag)
    return real, imaginary


@compiled
def _sum_bands(spectrum: ComplexArray, limits: FloatArray, end: float, auto: FloatArray, power: ComplexArray) -> None:
    """Powers of the bands, and their cross-powers averaged over windows.

    A line stands for the stretch half way to its neighbours, the first and (even length) last for half of that; it
    counts in a band with the part of the stretch that lies there.

    Parameters
    ----------
    spectrum : (windows, c, lines) array
    limits : (B + 1,) array
        In lines.
    end : float
        Half the length of a window: where the last line's stretch ends.
    auto : (windows, c, B) array
        Filled in.
    power : (B, c, c) array
        Zeros; what is not on its diagonal is filled in.
    """
    windows, width, lines = spectrum.shape
    for band in range(limits.size - 1):
        low, high = limits[band], limits[band + 1]
        if high <= low:
            auto[:, :, band] = 0.0
            continue
        i, j = math.floor(low + 0.5), min(math.ceil(high + 0.5) - 1, lines - 1)
        begin = max(i - 0.5, 0.0)
        first = (min(high, i + 0.5) - low) / (min(i + 0.5, end) - begin)
        last = (high - max(low, j - 0.5)) / (min(j + 0.5, end) - max(j - 0.5, 0.0))
        for window in range(windows):
            for a in range(width):
                one = spectrum[window, a, i : j + 1]
                auto[window, a, band] = _weigh(one, one, first, last)[0]
                for b in range(a + 1, width):
                    real, imaginary = _weigh(one, spectrum[window, b, i : j + 1], first, last)
                    power[band, a, b] += complex(real, imaginary) / windows
        for a in range(width):
            for b in range(a + 1, width):
                power[band, b, a] = power[band, a, b].conjugate()


@compiled
def _sum_cyclic(
    spectrum: ComplexArray,
    limits: FloatArray,
    apart: IntArray,
    turns: ComplexArray,
    end: float,
    cyclic: ComplexArray,
) -> None:
    """Cyclic powers of the bands, averaged over windows; lines count as in :func:`_sum_bands`.

    Parameters
    ----------
    spectrum : (windows, c, lines) array
    limits : (G + 1,) array
        In lines.
    apart : (k,) array of int
        Distance of the lines that are multiplied, one a cyclic order.
    turns : (k, windows) array
        What takes each window's phase back to that of the drive, over the number of windows.
    end : float
        As for :func:`_sum_bands`.
    cyclic : (G, k, c, c) array
        Zeros; filled in.
    """
    windows, width, lines = spectrum.shape
    for band in range(limits.size - 1):
        low, high = limits[band], limits[band + 1]
        for k in range(apart.size):
            i, j = math.floor(low + 0.5), min(math.ceil(high + 0.5) - 1, lines - 1 - apart[k])
            if high <= low or j < i:
                continue
            begin = max(i - 0.5, 0.0)
            first = (min(high, i + 0.5) - low) / (min(i + 0.5, end) - begin)
            last = (high - max(low, j - 0.5)) / (min(j + 0.5, end) - max(j - 0.5, 0.0))
            last = min(last, 1.0)  # the last line there is need not be the band's
            for window in range(windows):
                for a in range(width):
                    one = spectrum[window, a, i + apart[k] : j + 1 + apart[k]]
                    for b in range(width):
                        real, imaginary = _weigh(one, spectrum[window, b, i : j + 1], first, last)
                        half = 0.5 * complex(real, imaginary) * turns[k, window]
                        cyclic[band, k, a, b] += half
                        cyclic[band, k, b, a] += half


def _degrees_of_freedom(segmentation: Segmentation, edges: FloatArray) -> FloatArray:
    """Twice the squared mean over the variance of band power of white noise.

    The band's power is the mean over time of the squared envelope weighted by ``w(t)``; an envelope of bandwidth W is
    independent after 1 / W, so mean^2 / variance = W (sum w)^2 / sum w^2 (Welch 1967, written for a wide band).
    """
    weight = segmentation.weight()
    # not weight @ weight: the threads of a linear-algebra library cost more than this sum when cores are busy
    duration = float(weight.sum() ** 2 / np.square(weight).sum()) / segmentation.sample_rate
    return np.maximum(2.0, 2.0 * np.diff(edges) * duration)
