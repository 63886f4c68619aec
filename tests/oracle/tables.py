"""Tables and prescribed motions by their definition: search, interpolate, add trapeziums."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.machines.parts import AnchorMotion, MotionDrive, RotationDrive

Points = Sequence[tuple[float, float]]


def table(points: Points, x: float) -> float:
    """Linear between the points, ends held."""
    return _segment(points, x)[0]


def _segment(points: Points, x: float) -> tuple[float, float]:
    """Value and slope."""
    if x < points[0][0]:
        return points[0][1], 0.0
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        if x < x1:
            slope = (y1 - y0) / (x1 - x0)
            return y0 + slope * (x - x0), slope
    return points[-1][1], 0.0


def area(points: Points, x: float) -> float:
    """Integral from 0 to x >= 0; between two knots it is a trapezium."""
    knots = sorted({0.0, x, *(p[0] for p in points if 0 < p[0] < x)})
    return sum((b - a) * (table(points, a) + table(points, b)) / 2 for a, b in itertools.pairwise(knots))


def periodic_row(rows: Sequence[tuple[float, ...]], angle: float) -> NDArray[np.float64]:
    """Columns 1 to 3 of a table over the drive angle, repeated with 2 pi and linear across the seam."""
    repeated = [*rows, (rows[0][0] + 2 * math.pi, *rows[0][1:])]
    inside = rows[0][0] + (angle - rows[0][0]) % (2 * math.pi)
    return np.array([table([(row[0], row[k]) for row in repeated], inside) for k in (1, 2, 3)])


def time_row(rows: Sequence[tuple[float, ...]], t: float) -> NDArray[np.float64]:
    """Columns 1 to 3 of a table over time."""
    return np.array([table([(row[0], row[k]) for row in rows], t) for k in (1, 2, 3)])


def prescribed(drive: MotionDrive, t: float) -> tuple[float, float, float]:
    """Displacement of a prescribed drive since t = 0, its rate and its acceleration."""
    if isinstance(drive.speed, tuple):
        base, (speed, slope) = area(drive.speed, t), _segment(drive.speed, t)
    else:
        base, speed, slope = drive.speed * t, drive.speed, 0.0
    value, rate, acceleration = base, speed, slope
    if isinstance(drive, RotationDrive):
        for term in drive.ripple:  # a [sin(k b + p) - sin p] with b = b(t)
            a, k, angle = term.amplitude, term.order, term.order * base + term.phase
            value += a * (math.sin(angle) - math.sin(term.phase))
            rate += a * k * speed * math.cos(angle)
            acceleration += a * k * slope * math.cos(angle) - a * (k * speed) ** 2 * math.sin(angle)
    else:
        for harmonic in drive.harmonics:
            a, w = harmonic.amplitude, 2 * math.pi * harmonic.frequency
            angle = w * t + harmonic.phase
            value += a * (math.sin(angle) - math.sin(harmonic.phase))
            rate += a * w * math.cos(angle)
            acceleration -= a * w * w * math.sin(angle)
    return value, rate, acceleration


def shift(
    motion: Sequence[AnchorMotion], t: float, angle: float, speed: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Displacement of an anchor since drawn and its rate, at a drive angle and its rate."""
    moved, rate = np.zeros(2), np.zeros(2)
    for part in motion:
        if part.over_time is not None:
            both = np.array([_segment([(row[0], row[k]) for row in part.over_time], t) for k in (1, 2)])
            moved, rate = moved + both[:, 0], rate + both[:, 1]
        elif part.frequency is not None:
            w = 2 * math.pi * part.frequency
            moved = moved + np.array(part.displacement) * math.sin(w * t + part.phase)
            rate = rate + np.array(part.displacement) * w * math.cos(w * t + part.phase)
        elif part.order is not None:
            moved = moved + np.array(part.displacement) * math.sin(part.order * angle + part.phase)
            rate = rate + np.array(part.displacement) * part.order * speed * math.cos(part.order * angle + part.phase)
    return moved, rate
