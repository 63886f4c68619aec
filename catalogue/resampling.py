"""A recording of a drive that wanders, sampled anew as if it had turned at its mean speed (angular resampling)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.ndimage

from catalogue.drivespeed import SpeedTrack

FloatArray = npt.NDArray[np.float64]

#: Wander, relative, from which bands are taken at the drive's own angle. At a tenth of a percent order 20 moves by a
#: fiftieth of an order, which its band does not notice.
WANDER = 1e-3
#: Samples are made this many times denser before cubic splines go through them: then the splines, too, are flat (to
#: 0.02 dB) up to 0.4 of the sample rate.
DENSER = 2


def at_mean_speed(signal: npt.ArrayLike, sample_rate: float, track: SpeedTrack) -> FloatArray:
    """Sample a signal at equal steps of the drive's angle.

    Parameters
    ----------
    signal : (n, c) array
    sample_rate : float
        Hz.
    track : SpeedTrack
        Course of the speed; what is added to it as a factor changes nothing.

    Returns
    -------
    (n, c) array
        As many samples over the same angle: the drive turns at its mean speed in it, and orders are sharp. Frequencies
        that do not turn with the drive are smeared by the wander, far less than a band is wide.

    Notes
    -----
    Fyfe and Munck, Mech. Syst. Signal Process. 11 (1997) 187 (computed order tracking).
    """
    values = np.ascontiguousarray(np.asarray(signal, dtype=np.float64).T)
    count = values.shape[1]
    time = np.arange(count) / sample_rate
    speed = np.interp(time, track.time, track.speed)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    place = np.interp(np.linspace(0.0, angle[-1], count), angle, np.arange(count, dtype=np.float64))
    mean = values.mean(axis=1, keepdims=True)
    length = scipy.fft.next_fast_len(count, real=True)
    spectrum = scipy.fft.rfft(values - mean, length)
    dense = DENSER * scipy.fft.irfft(spectrum, DENSER * length)[:, : DENSER * count]
    taken = [scipy.ndimage.map_coordinates(row, [DENSER * place], order=3, mode="nearest") for row in dense]
    return np.asarray((np.stack(taken) + mean).T, dtype=np.float64)
