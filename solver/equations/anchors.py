"""Prescribed motion of what stands on the ground: a floor that shakes, a belt, a gear; and when tables have rows.

An anchor has no coordinate. Its place is one more term of the vector from it to the link, which moves in time or with
the drive angle; it takes up the force of its support without giving any to the drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import casadi as ca

from jointplay.solver.equations.drive import Harmonics, interpolate
from jointplay.solver.equations.geometry import GROUND, ZERO, Complex, Term
from jointplay.solver.equations.numbers import Number, Numbers
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import AnchorMotion


def anchor_term(
    path: str, motion: Sequence[AnchorMotion], number: Numbers, t: ca.SX, angle: Callable[[], tuple[ca.SX, ca.SX]]
) -> Term:
    """Displacement of an anchor since drawn.

    Parameters
    ----------
    path : str
        Of its motion in the machine file.
    motion : sequence of AnchorMotion
        What is summed.
    number : Numbers
    t : casadi.SX
        Time, s.
    angle : callable
        Drive angle, rad, and its rate, rad/s; asked for where there is one.
    """
    size, rate = ZERO, ZERO
    for k, part in enumerate(motion):
        if part.over_time is not None:
            columns = [[(row[0], row[1 + axis]) for row in part.over_time] for axis in range(2)]
            size += Complex(*(interpolate(t, column) for column in columns))
            rate += Complex(*(_slope(t, column) for column in columns))
            continue
        x, y = (number(f"{path}.{k}.displacement.{axis}", value) for axis, value in enumerate(part.displacement))
        if part.order is not None:
            turned, omega = angle()
            sine, cosine = Harmonics(turned).wave(part.order, part.phase)
            swing = part.order * omega * cosine
        else:
            w = 2 * math.pi * (part.frequency or 0.0)
            sine, swing = ca.sin(w * t + part.phase), w * ca.cos(w * t + part.phase)
        size += Complex(x * sine, y * sine)
        rate += Complex(x * swing, y * swing)
    return Term(GROUND, size, rate, GROUND, {}, ZERO)


def _slope(x: Number, points: Sequence[tuple[float, float]]) -> ca.SX:
    """Derivative of :func:`interpolate`; at a row that of what follows."""
    total = ca.SX(0)
    for (x0, y0), (x1, y1) in pairwise(points):
        total += ca.if_else(x < x0, 0.0, ca.if_else(x < x1, (y1 - y0) / (x1 - x0), 0.0))
    return total


def fastest_anchor(machine: Machine, drive_speed: float) -> tuple[float, str]:
    """Fastest sine that an anchor moves with at a speed of the drive, rad/s, and its path; 0 without one."""
    found = [(0.0, "supports")]
    for i, support in enumerate(machine.supports):
        for k, part in enumerate(support.motion):
            path = f"supports.{i}.motion.{k}"
            if part.frequency is not None:
                found.append((2 * math.pi * part.frequency, f"{path}.frequency"))
            elif part.order is not None:
                found.append((part.order * abs(drive_speed), f"{path}.order"))
    return max(found)


def row_times(machine: Machine) -> list[float]:
    """Times of the rows of all tables over time, s: there accelerations or their rates jump."""
    speed = getattr(machine.drive, "speed", None)
    tables: list[Sequence[tuple[float, ...]]] = [speed] if isinstance(speed, tuple) else []
    tables += [load.over_time for load in machine.loads if load.over_time is not None]
    parts = (part for support in machine.supports for part in support.motion)
    tables += [part.over_time for part in parts if part.over_time is not None]
    return sorted({row[0] for table in tables for row in table})
