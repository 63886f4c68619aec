"""A run of one individual machine: settle, then the frame's motion over the revolutions that are recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np

from second_simulator.elements import Elements, elements
from second_simulator.ideal import Ideal
from second_simulator.individual import Individual
from second_simulator.machine import Array, Machine
from second_simulator.march import march
from second_simulator.sensors import FINE_RATE
from second_simulator.turning import Turning, angle, turning

#: Steps within one sample of FINE_RATE: 2 us each.
STEPS = 10


@dataclass(frozen=True, eq=False)
class Run:
    """Frame's place and velocity (n, 6) at FINE_RATE from time `begin`, and the course of the drive."""

    motion: Array
    begin: float
    course: Turning

    @property
    def mean_speed(self) -> float:
        """Of the drive over the recording, rad/s."""
        length = (len(self.motion) - 1) / FINE_RATE
        return (angle(self.course, self.begin + length)[0] - angle(self.course, self.begin)[0]) / length


def settling(machine: Machine) -> float:
    """Time [s] in which the frame's own motion on its mounts falls to a thousandth."""
    total = sum(body.mass for body in machine.bodies.values() if math.isfinite(body.mass))
    least = min(sum(mount.damping[axis] for mount in machine.mounts if not mount.to) for axis in (0, 1))
    return 6.9 * 2 * total / least


def start(machine: Machine, course: Turning) -> tuple[Array, Array]:
    """Places and velocities (N, 3) of the ideal machine in its drawn pose, sunk onto its mounts."""
    ideal = Ideal(machine)
    theta, speed, _, _ = angle(course, 0.0)
    q = ideal.places(theta, ideal.drawn)
    v = ideal.velocities(q, theta, speed)
    stiffness = sum(mount.stiffness[1] for mount in machine.mounts if not mount.to)
    if stiffness:
        q[:, 1] -= machine.gravity * sum(body.mass for body in machine.bodies.values()) / stiffness
    return q, v


def run(individual: Individual, draw: np.random.Generator, steps: int = STEPS) -> Run:
    """March an individual machine over time."""
    machine = individual.machine
    turn = 2 * math.pi / abs(individual.speed)
    before = math.ceil(max(settling(machine), 3 * turn) * FINE_RATE)
    whole = individual.course[-1][0] if individual.course else individual.revolutions * turn
    count = math.ceil(min(whole, individual.longest) * FINE_RATE) + 1
    begin = (before + 1) / FINE_RATE
    course = turning(individual.speed, individual.wander, individual.ripple, individual.course, begin)
    q, v = start(machine, course)
    parts: Elements = elements(machine, individual.clearances)
    shaking = np.zeros((0, 3))
    if individual.shaking is not None:
        shaking = individual.shaking(individual, np.arange(before + count + 1) / FINE_RATE, draw)
    out = np.empty((before + count, 6))
    march(parts, course, q, v, 0.0, 1 / (FINE_RATE * steps), steps, shaking, out, parts.frame)
    if not np.isfinite(out[-1]).all():
        raise ArithmeticError(f"the march over {machine.name} with {individual.clearances} diverged")
    # Row k is at time (k + 1) / FINE_RATE.
    return Run(out[before:], begin, course)


@numba.njit(cache=True)
def base_angles(course: Turning, times: Array) -> Array:
    """Angle of the drive without ripple at many times."""
    found = np.empty_like(times)
    for k in range(len(times)):
        found[k] = angle(course, times[k])[3]
    return found
