"""What shakes the frame besides the machine itself: shocks, a neighbour's lines, a gear mesh, bearing-like bursts.

Each is a force and torque (n, 3) on the frame at given times, in proportion to what the machine's own moving parts do.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import signal

from second_simulator.ideal import Ideal
from second_simulator.individual import Individual, Shaking, log_uniform
from second_simulator.machine import Array, Machine
from second_simulator.simulation import base_angles
from second_simulator.turning import turning


def inertia_force(machine: Machine, speed: float) -> float:
    """Root mean square [N] of the force by which the moving parts of the ideal machine shake their frame."""
    _, rates = Ideal(machine).revolution(180)
    masses = np.array([0.0 if name == machine.frame else body.mass for name, body in machine.bodies.items()])
    momentum = np.einsum("n,tnc->tc", masses, rates[:, :, :2])
    force = speed**2 * np.gradient(np.vstack([momentum[-1:], momentum, momentum[:1]]), 2 * math.pi / 180, axis=0)[1:-1]
    return float(np.sqrt((force**2).sum(axis=1).mean()))


def _on_frame(force: Array, draw: np.random.Generator) -> Array:
    """A force (n,) in some direction at some point of the frame."""
    direction, x, y = draw.uniform(0, 2 * math.pi), draw.uniform(-0.25, 0.25), draw.uniform(-0.1, 0.1)
    c, s = math.cos(direction), math.sin(direction)
    return np.stack([force * c, force * s, force * (x * s - y * c)], axis=1)


def shocks(individual: Individual, times: Array, draw: np.random.Generator) -> Array:
    """Blows of 1 to 10 ms, about one in five revolutions, each at a place of its own."""
    size = inertia_force(individual.machine, individual.speed)
    found = np.zeros((len(times), 3))
    turn = 2 * math.pi / abs(individual.speed)
    for _ in range(3 + draw.poisson(times[-1] / turn / 5)):
        at, length = draw.uniform(0, times[-1]), log_uniform(draw, 1e-3, 1e-2)
        inside = (times > at) & (times < at + length)
        blow = size * log_uniform(draw, 2.0, 20.0) * np.sin(math.pi * (times[inside] - at) / length)
        found[inside] += _on_frame(blow, draw)
    return found


def neighbour(individual: Individual, times: Array, draw: np.random.Generator) -> Array:
    """A machine beside this one: five harmonics of a speed of its own."""
    size = inertia_force(individual.machine, individual.speed)
    base = abs(individual.speed) * log_uniform(draw, 0.6, 6.0)
    found = np.zeros((len(times), 3))
    for harmonic in range(1, 6):
        force = size * log_uniform(draw, 0.03, 0.3) / harmonic
        found += _on_frame(force * np.sin(harmonic * base * times + draw.uniform(0, 2 * math.pi)), draw)
    return found


def gear_mesh(individual: Individual, times: Array, draw: np.random.Generator) -> Array:
    """Teeth of a gear on the driven shaft: their order, its double, and one order either side."""
    size = inertia_force(individual.machine, individual.speed) * log_uniform(draw, 0.03, 0.3)
    teeth = int(draw.integers(17, 42))
    angles = base_angles(turning(individual.speed, individual.wander), times)
    carrier = np.sin(teeth * angles) + 0.3 * np.sin(2 * teeth * angles + 1.0)
    individual.notes["teeth"] = teeth
    return _on_frame(size * carrier * (1 + 0.4 * np.sin(angles + draw.uniform(0, 6))), draw)


def bursts(individual: Individual, times: Array, draw: np.random.Generator) -> Array:
    """Ringing of 1.2 to 3.5 kHz that begins anew at an order which is no whole number, a little unevenly."""
    size = inertia_force(individual.machine, individual.speed) * log_uniform(draw, 0.3, 3.0)
    order, ringing = draw.uniform(2.6, 7.4), 2 * math.pi * log_uniform(draw, 1200.0, 3500.0)
    angles = abs(base_angles(turning(individual.speed, individual.wander), times)) * order / (2 * math.pi)
    beats = np.flatnonzero(np.diff(np.floor(angles)) > 0)
    jitter = draw.normal(0, 0.01, len(beats)) * 2 * math.pi / abs(individual.speed) / order / (times[1] - times[0])
    places = np.clip(beats + jitter.astype(int), 0, len(times) - 1)
    train = np.zeros(len(times))
    train[places] = draw.uniform(0.7, 1.3, len(places))
    lags = np.arange(0, 0.006, times[1] - times[0])
    individual.notes["burst_order"] = round(float(order), 3)
    ring = np.exp(-lags / 1.0e-3) * np.sin(ringing * lags)
    return _on_frame(size * signal.fftconvolve(train, ring)[: len(times)], draw)


DISTURBANCES: dict[str, Shaking | None] = {
    "shocks": shocks,
    "neighbour": neighbour,
    "gear-mesh": gear_mesh,
    "bursts": bursts,
    "clipping": None,
}
