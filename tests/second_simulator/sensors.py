"""From the frame's motion to what a logger writes: point, direction, filter, gain, noise, hum, offset, 16 bits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import signal

from second_simulator.machine import Array, Machine

#: Rate of a recording and of the motion it is filtered from, Hz; the filter lets through up to 4 kHz.
RATE, FINE_RATE = 10_000, 50_000
#: Full scales of the logger [m/s2]; the least that holds the signal is taken.
FULL_SCALES = (10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 1280.0, 2560.0, 5120.0)


@dataclass(frozen=True)
class Chain:
    """A logger and its sensors.

    ``flaws`` by sensor: ``inverted``, ``dead``, ``half``, or the name of the sensor whose signal it carries instead.
    ``clipped`` is the share of samples beyond the full scale.
    """

    gains: Mapping[str, float]
    noise: float
    hum: float
    offset: float
    flaws: Mapping[str, str] = field(default_factory=dict)
    clipped: float = 0.0

    @classmethod
    def drawn(cls, draw: np.random.Generator, names: Sequence[str]) -> Chain:
        """Gains within 5 %, noise of 0.01 to 0.1 m/s2, hum of 5 to 40 mm/s2."""
        gains = {name: float(1 + draw.uniform(-0.05, 0.05)) for name in names}
        noise, hum = 10 ** draw.uniform(-2, -1), draw.uniform(0.005, 0.04)
        return cls(gains, float(noise), float(hum), float(draw.uniform(0.1, 0.6)))


def point_accelerations(machine: Machine, motion: Array, rate: float) -> dict[str, Array]:
    """Accelerations at the sensors, in their directions: means over the steps of `motion` (n, 6), of length n - 1."""
    centre = machine.bodies[machine.frame].at
    c, s = np.cos(motion[:, 2]), np.sin(motion[:, 2])
    middle = 0.5 * (motion[1:, 2] + motion[:-1, 2])
    c_mid, s_mid = np.cos(middle), np.sin(middle)
    found = {}
    for sensor in machine.sensors:
        x, y = sensor.at[0] - centre[0], sensor.at[1] - centre[1]
        ax = np.diff(motion[:, 3] - motion[:, 5] * (s * x + c * y)) * rate
        ay = np.diff(motion[:, 4] + motion[:, 5] * (c * x - s * y)) * rate
        dx, dy = sensor.direction
        found[sensor.name] = ax * (c_mid * dx - s_mid * dy) + ay * (s_mid * dx + c_mid * dy)
    return found


def decimated(fine: Array) -> Array:
    """From FINE_RATE to RATE, without what would alias."""
    step = FINE_RATE // RATE
    taps = signal.firwin(301, 4300.0, fs=FINE_RATE, window=("kaiser", 8.0))
    return np.asarray(signal.upfirdn(taps, fine, 1, step)[150 // step : 150 // step + len(fine) // step])


def logged(clean: Mapping[str, Array], chain: Chain, draw: np.random.Generator) -> dict[str, Array]:
    """What the logger writes of clean signals at RATE."""
    t = np.arange(len(next(iter(clean.values())))) / RATE
    found = {}
    for name in clean:
        flaw = chain.flaws.get(name, "")
        own = clean[flaw] if flaw in clean else clean[name]
        factor = {"inverted": -1.0, "dead": 0.0, "half": 0.5}.get(flaw, 1.0) * chain.gains[name]
        phase, third, offset = draw.uniform(0, 2 * np.pi), draw.uniform(0, 0.3), draw.normal(0, 0.5) * chain.offset
        hum = np.sin(2 * np.pi * 50 * t + phase) + third * np.sin(2 * np.pi * 150 * t + 3 * phase)
        found[name] = factor * own + offset + chain.hum * hum + draw.normal(0, chain.noise, len(t))
    peak = max(float(np.abs(each).max()) for each in found.values())
    full = next(scale for scale in (*FULL_SCALES, 2 * peak) if scale > 1.2 * peak)
    if chain.clipped:
        full = float(np.quantile(np.abs(np.concatenate(list(found.values()))), 1 - chain.clipped))
    step = full / 2**15
    return {name: np.clip(np.rint(each / step), -(2**15), 2**15 - 1) * step for name, each in found.items()}
