"""The drive's angle over time: a mean speed, or one that changes, a slow wander, a ripple of its turns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from second_simulator.machine import Array


class Turning(NamedTuple):
    """Arrays of the march: speed; wander (W, 3): part of the speed, rad/s, phase; ripple (R, 3): order, rad, phase.

    ``steps`` (K, 4) are times from which on a factor on the speed changes linearly: time, factor, its rate, and the
    factor's integral from 0 to there; none where the speed is one.
    """

    speed: float
    wander: Array
    ripple: Array
    steps: Array


@dataclass(frozen=True)
class Ripple:
    """A sine on the drive's angle."""

    order: int
    amplitude: float
    phase: float = 0.0


def turning(
    speed: float,
    wander: Array | None = None,
    ripple: Sequence[Ripple] = (),
    course: Sequence[tuple[float, float]] = (),
    begin: float = 0.0,
) -> Turning:
    """A course of the drive's angle; `course` are times [s] after `begin` and factors on the speed, linear between."""
    rows = np.array([(each.order, each.amplitude, each.phase) for each in ripple], dtype=np.float64).reshape(-1, 3)
    points = np.array([(0.0, course[0][1]), *((begin + t, factor) for t, factor in course)]) if course else None
    steps = np.zeros((0, 4))
    if points is not None:
        length, rise = np.diff(points, axis=0).T
        rate = np.append(np.divide(rise, length, out=np.zeros_like(rise), where=length > 0), 0.0)
        covered = np.cumsum(np.append(0.0, length * 0.5 * (points[1:, 1] + points[:-1, 1])))
        steps = np.column_stack([points, rate, covered])
    return Turning(speed, np.zeros((0, 3)) if wander is None else wander, rows, steps)


def drawn_wander(draw: np.random.Generator, most: float) -> Array:
    """Three slow sines that reach `most` as a part of the speed."""
    parts = draw.dirichlet([1.0, 1.0, 1.0]) * most
    slow = 2 * math.pi * draw.uniform(0.04, 0.4, 3)
    return np.stack([parts, slow, draw.uniform(0, 2 * math.pi, 3)], axis=1)


@numba.njit(cache=True)
def angle(course: Turning, t: float) -> tuple[float, float, float, float]:
    """Angle, its first and second rate, and the angle without ripple."""
    base, rate, second = t, 1.0, 0.0
    for row in course.steps:
        if t < row[0]:
            break
        past = t - row[0]
        base, rate, second = row[3] + (row[1] + 0.5 * row[2] * past) * past, row[1] + row[2] * past, row[2]
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
