"""A motion in the units that people read it in: g and m/s2, mm/s, um are the same motion, integrated or not."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft

from jointplay.catalogue.signals.signal_question import UnitShown
from jointplay.solver.arrays import FloatArray
from jointplay.solver.spectra.spectrum import Quantity

#: Without a drive speed, what is slower than this is not integrated [Hz]: where velocities of machines begin.
HIGH_PASS = 10.0
#: With one, half an order.
HIGH_PASS_ORDER = 0.5
#: Share of the high-pass from which on nothing is kept; between, a cosine.
_STOP = 0.7
#: Periods of the high-pass that a signal is continued by at either end.
_CONTINUED = 6.0


@dataclass(frozen=True)
class MotionUnit:
    """A unit of a translation, and the one of a rotation that goes with it.

    Parameters
    ----------
    quantity : {"displacement", "velocity", "acceleration"}
    factor : float
        Of SI.
    rotation : str
        Unit of the rotation.
    rotation_factor : float
        Of SI.
    """

    quantity: Quantity
    factor: float
    rotation: str
    rotation_factor: float


UNITS: dict[UnitShown, MotionUnit] = {
    "m/s2": MotionUnit("acceleration", 1.0, "rad/s2", 1.0),
    "g": MotionUnit("acceleration", 1.0 / 9.80665, "rad/s2", 1.0),
    "mm/s": MotionUnit("velocity", 1e3, "mrad/s", 1e3),
    "um": MotionUnit("displacement", 1e6, "urad", 1e6),
}


def high_pass_for(drive_speed: float | None) -> float:
    """Frequency [Hz] below which nothing is integrated, for a drive speed [rad/s] or without one."""
    return HIGH_PASS if drive_speed is None else HIGH_PASS_ORDER * abs(drive_speed) / (2.0 * math.pi)


def continued_samples(sample_rate: float, high_pass: float) -> int:
    """Samples beyond either end of a stretch that its integral rests on."""
    return math.ceil(_CONTINUED * sample_rate / high_pass)


def pass_factor(frequency: FloatArray, high_pass: float) -> FloatArray:
    """What the high-pass leaves of amplitudes at some frequencies [Hz], (n,), 0 to 1."""
    ramp = np.clip((frequency / high_pass - _STOP) / (1.0 - _STOP), 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(math.pi * ramp))


def differentiate(
    signal: FloatArray, sample_rate: float, times: int, high_pass: float, period: float | None = None
) -> FloatArray:
    """Differentiate a signal in the frequency domain, or integrate it.

    Parameters
    ----------
    signal : (n,) array
    sample_rate : float
        Hz.
    times : int
        How often; negative to integrate. As it is for 0.
    high_pass : float
        Hz; what is slower is left out where it is integrated.
    period : float, optional
        Samples after which the signal is much the same again: a revolution.

    Returns
    -------
    (n,) array
    """
    if times == 0:
        return signal
    count = len(signal)
    level = signal - signal.mean()
    # Continued at its ends, fading away: the jump from its end to its beginning would be integrated, too.
    beyond = min(count - 1, continued_samples(sample_rate, high_pass))
    fade = 0.5 - 0.5 * np.cos(math.pi * (np.arange(beyond) + 0.5) / beyond)
    revolutions = math.ceil(beyond / period) if period else 0
    back = math.ceil(revolutions * period) if period else 0
    if 0 < back < count:
        before, after = level[back - beyond : back], level[count - back : count - back + beyond]
    else:  # by what mirrors it there
        before, after = level[beyond:0:-1], level[-2 : -beyond - 2 : -1]
    whole = np.concatenate([before * fade, level, after * fade[::-1]])
    length = scipy.fft.next_fast_len(len(whole), real=True)
    frequency = scipy.fft.rfftfreq(length, 1.0 / sample_rate)
    factor = np.zeros(len(frequency), dtype=np.complex128)
    factor[1:] = (2j * math.pi * frequency[1:]) ** times
    if times < 0:
        factor *= pass_factor(frequency, high_pass)
    found = scipy.fft.irfft(scipy.fft.rfft(whole, length) * factor, length)
    return np.asarray(found[beyond : beyond + count])
