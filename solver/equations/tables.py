"""Piecewise-linear tables as symbols: speed ramps, motor curves, loads over time or over the drive angle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import casadi as ca

from jointplay.solver.equations.numbers import Number


def linear(x: Number, points: Sequence[tuple[float, float]]) -> ca.SX:
    """Linear between the points, ends held.

    Parameters
    ----------
    x : symbol
        Argument.
    points : sequence of (x, y)
        Strictly increasing in x; one point is a constant.
    """
    value = ca.SX(points[0][1])
    for (x0, y0), (x1, y1) in pairwise(points):
        # Each segment adds its own rise, clamped outside of it: no nest of conditions.
        value += (y1 - y0) / (x1 - x0) * (ca.fmin(ca.fmax(x, x0), x1) - x0)
    return value


def linear_integral(x: Number, points: Sequence[tuple[float, float]]) -> ca.SX:
    """Integral of :func:`linear` from 0 to `x`, exact, for x >= 0.

    Its second derivative at a point of the table is the slope that follows: comparisons, because that of `fmin` and
    `fmax` where both are equal would be half of either, and runs begin at such a point.
    """

    def primitive(s: Number) -> ca.SX:
        y0 = points[0][1]
        total = y0 * s
        for (xa, ya), (xb, yb) in pairwise(points):
            slope = (yb - ya) / (xb - xa)
            inside = ca.if_else(s < xa, 0.0, ca.if_else(s < xb, s - xa, xb - xa))
            total += slope * (inside * inside / 2 + inside * ca.if_else(s < xb, 0.0, s - xb))
        return ca.SX(total)

    return primitive(x) - primitive(0.0)


def periodic(angle: Number, points: Sequence[tuple[float, float]]) -> ca.SX:
    """Linear between the points, repeated with 2 pi, linear across the seam.

    Parameters
    ----------
    angle : symbol
        Drive angle, rad, unbounded.
    points : sequence of (angle, value)
        Angles strictly increasing within one turn (last - first < 2 pi).
    """
    turn = 2 * math.pi
    first = points[0][0]
    closed = [(a - first, v) for a, v in points] + [(turn, points[0][1])]
    wrapped = angle - first
    return linear(wrapped - turn * ca.floor(wrapped / turn), closed)
