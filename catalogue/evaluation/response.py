"""What a structure does to a vibration on its way to the sensors: one mode, or none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import FloatArray


@dataclass(frozen=True)
class Response:
    """Transfer function H = 1 + g r^2 / (1 - r^2 + 2 i z r), r = f / frequency, from the rigid frame to each sensor.

    A gain g of 1 is a sensor on a spring: H = (1 + 2 i z r) / (1 - r^2 + 2 i z r) but for the damping's share.

    Parameters
    ----------
    frequency : float
        Of the mode, Hz.
    damping : float
        Damping ratio z.
    gains : tuple of float, (s,)
        g of each sensor; none for a rigid structure.
    """

    frequency: float = 1.0
    damping: float = 0.0
    gains: tuple[float, ...] = ()

    def of(self, signal: FloatArray, sample_rate: float) -> FloatArray:
        """Return sensor signals (n, s) of a rigid frame as this structure passes them on."""
        if not any(self.gains):
            return signal
        count = len(signal)
        r = np.fft.rfftfreq(count, 1.0 / sample_rate)[:, None] / self.frequency
        function = 1.0 + np.array(self.gains) * r**2 / (1.0 - r**2 + 2j * self.damping * r)
        passed: FloatArray = np.fft.irfft(np.fft.rfft(signal, axis=0) * function, n=count, axis=0)
        return passed
