"""The drive's angle over time: a mean speed that wanders slowly, and a ripple that repeats with the turns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from second_simulator.machine import Array


class Turning(NamedTuple):
    """Arrays of the march: speed; wander (W, 3): part of the speed, rad/s, phase; ripple (R, 3): order, rad, phase."""

    speed: float
    wander: Array
    ripple: Array


@dataclass(frozen=True)
class Ripple:
    """A sine on the drive's angle."""

    order: int
    amplitude: float
    phase: float = 0.0


def turning(speed: float, wander: Array | None = None, ripple: Sequence[Ripple] = ()) -> Turning:
    """A course of the drive's angle."""
    rows = np.array([(each.order, each.amplitude, each.phase) for each in ripple], dtype=np.float64).reshape(-1, 3)
    return Turning(speed, np.zeros((0, 3)) if wander is None else wander, rows)


def drawn_wander(draw: np.random.Generator, most: float) -> Array:
    """Three slow sines that reach `most` as a part of the speed."""
    parts = draw.dirichlet([1.0, 1.0, 1.0]) * most
    slow = 2 * math.pi * draw.uniform(0.04, 0.4, 3)
    return np.stack([parts, slow, draw.uniform(0, 2 * math.pi, 3)], axis=1)


@numba.njit(cache=True)
def angle(course: Turning, t: float) -> tuple[float, float, float, float]:
    """Angle, its first and second rate, and the angle without ripple."""
    base, rate, second = t, 1.0, 0.0
    for row in course.wander:
        s, c = math.sin(row[1] * t + row[2]), math.cos(row[1] * t + row[2])
        base += row[0] / row[1] * (math.cos(row[2]) - c)
        rate += row[0] * s
        second += row[0] * row[1] * c
    base, rate, second = base * course.speed, rate * course.speed, second * course.speed
    theta, theta1, theta2 = base, rate, second
    for row in course.ripple:
        s, c = math.sin(row[0] * base + row[2]), math.cos(row[0] * base + row[2])
        theta += row[1] * (s - math.sin(row[2]))
        theta1 += row[1] * row[0] * rate * c
        theta2 += row[1] * row[0] * (second * c - row[0] * rate * rate * s)
    return theta, theta1, theta2, base
