"""The march over time: velocity Verlet with a predicted velocity, every body with its three coordinates.

Positions go on with the accelerations of the step's beginning, forces are taken once a step, at the new positions and
with velocities predicted by Euler (R. D. Groot and P. B. Warren, J. Chem. Phys. 107 (1997) 4423, lambda = 1): second
order, one evaluation a step. Joints are nothing but forces. The driven body's angle is given; its torque follows from
the angular accelerations that it and its base would have without.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from second_simulator.elements import SLOWEST_APPROACH, Elements
from second_simulator.machine import TABLE, Array
from second_simulator.turning import Turning, angle

_FAST = {"contract", "nsz", "arcp", "reassoc"}


@numba.njit(cache=True, fastmath=_FAST, error_model="numpy")
def _put(f: Array, body: int, x: float, y: float, arm_x: float, arm_y: float) -> None:
    """Add a force at an arm from a body's centre of gravity."""
    f[body, 0] += x
    f[body, 1] += y
    f[body, 2] += arm_x * y - arm_y * x


@numba.njit(cache=True, fastmath=_FAST, error_model="numpy")
def pin_forces(e: Elements, q: Array, v: Array, turn: Array, approach: Array, f: Array) -> None:
    """Contacts of pins and sockets; `approach` keeps the speed at which each began, below 0 where there is none."""
    for k in range(len(e.pin_bodies)):
        i, j = e.pin_bodies[k]
        p, n = e.pin_points[k], e.pin_numbers[k]
        ax, ay = turn[i, 0] * p[0] - turn[i, 1] * p[1], turn[i, 1] * p[0] + turn[i, 0] * p[1]
        bx, by = turn[j, 0] * p[2] - turn[j, 1] * p[3], turn[j, 1] * p[2] + turn[j, 0] * p[3]
        ex, ey = q[i, 0] + ax - q[j, 0] - bx, q[i, 1] + ay - q[j, 1] - by
        apart = math.sqrt(ex * ex + ey * ey)
        depth = apart - n[1]
        if depth <= 0.0 or apart == 0.0:
            approach[k] = -1.0
            continue
        nx, ny = ex / apart, ey / apart
        rx = v[i, 0] - v[i, 2] * ay - v[j, 0] + v[j, 2] * by
        ry = v[i, 1] + v[i, 2] * ax - v[j, 1] - v[j, 2] * bx
        rate = nx * rx + ny * ry
        if approach[k] < 0.0:
            approach[k] = max(rate, SLOWEST_APPROACH)
        if n[2] > 0.0:
            force = n[3] * depth * math.sqrt(depth) * (1.0 + n[5] * rate / approach[k])
        else:
            force = n[3] * depth + n[4] * rate
        if force <= 0.0:
            continue
        slip = ny * -rx + nx * ry + v[i, 2] * n[0] - v[j, 2] * (n[0] + apart)
        rub = -n[6] * force * slip / math.sqrt(slip * slip + n[7] * n[7])
        fx, fy = -force * nx - rub * ny, -force * ny + rub * nx
        cx, cy = n[0] * nx, n[0] * ny
        _put(f, i, fx, fy, ax + cx, ay + cy)
        _put(f, j, -fx, -fy, bx + ex + cx, by + ey + cy)


@numba.njit(cache=True, fastmath=_FAST, error_model="numpy")
def guide_forces(e: Elements, q: Array, v: Array, turn: Array, f: Array) -> None:
    """Stiff guides: across the line, and against turning."""
    for k in range(len(e.guide_bodies)):
        i, j = e.guide_bodies[k]
        p, n = e.guide_points[k], e.guide_numbers[k]
        ax, ay = turn[i, 0] * p[0] - turn[i, 1] * p[1], turn[i, 1] * p[0] + turn[i, 0] * p[1]
        bx, by = turn[j, 0] * p[2] - turn[j, 1] * p[3], turn[j, 1] * p[2] + turn[j, 0] * p[3]
        dx, dy = turn[j, 0] * p[4] - turn[j, 1] * p[5], turn[j, 1] * p[4] + turn[j, 0] * p[5]
        ex, ey = q[i, 0] + ax - q[j, 0] - bx, q[i, 1] + ay - q[j, 1] - by
        # The velocity of the slider's point against the rail's material there.
        rx = v[i, 0] - v[i, 2] * ay - v[j, 0] + v[j, 2] * (by + ey)
        ry = v[i, 1] + v[i, 2] * ax - v[j, 1] - v[j, 2] * (bx + ex)
        across = -n[0] * (dx * ey - dy * ex) - n[1] * (dx * ry - dy * rx)
        slip = dx * rx + dy * ry
        along = -n[4] * abs(across) * slip / math.sqrt(slip * slip + n[5] * n[5]) - n[6] * slip
        couple = -n[2] * (q[i, 2] - q[j, 2]) - n[3] * (v[i, 2] - v[j, 2])
        fx, fy = along * dx - across * dy, along * dy + across * dx
        _put(f, i, fx, fy, ax, ay)
        _put(f, j, -fx, -fy, bx + ex, by + ey)
        f[i, 2] += couple
        f[j, 2] -= couple


@numba.njit(cache=True, fastmath=_FAST, error_model="numpy")
def mount_forces(e: Elements, q: Array, v: Array, turn: Array, f: Array) -> None:
    """Springs and dampers in x and y, to the ground or to another body."""
    for k in range(len(e.mount_bodies)):
        i, j = e.mount_bodies[k]
        p, n = e.mount_points[k], e.mount_numbers[k]
        ax, ay = turn[i, 0] * p[0] - turn[i, 1] * p[1], turn[i, 1] * p[0] + turn[i, 0] * p[1]
        ex, ey = q[i, 0] + ax, q[i, 1] + ay
        rx, ry = v[i, 0] - v[i, 2] * ay, v[i, 1] + v[i, 2] * ax
        if j < 0:
            ex, ey = ex - p[2], ey - p[3]
            _put(f, i, -n[0] * ex - n[2] * rx, -n[1] * ey - n[3] * ry, ax, ay)
        else:
            bx, by = turn[j, 0] * p[2] - turn[j, 1] * p[3], turn[j, 1] * p[2] + turn[j, 0] * p[3]
            ex, ey = ex - q[j, 0] - bx, ey - q[j, 1] - by
            rx, ry = rx - v[j, 0] + v[j, 2] * (by + ey), ry - v[j, 1] - v[j, 2] * (bx + ex)
            fx, fy = -n[0] * ex - n[2] * rx, -n[1] * ey - n[3] * ry
            _put(f, i, fx, fy, ax, ay)
            _put(f, j, -fx, -fy, bx + ex, by + ey)


@numba.njit(cache=True, fastmath=_FAST, error_model="numpy")
def load_forces(e: Elements, turn: Array, theta: float, f: Array) -> None:
    """Loads over the drive's angle."""
    if len(e.load_bodies) == 0:
        return
    place = theta / (2 * math.pi) * TABLE
    lower = math.floor(place)
    part, here = place - lower, int(lower % TABLE)
    for k in range(len(e.load_bodies)):
        i, p = e.load_bodies[k], e.load_points[k]
        ax, ay = turn[i, 0] * p[0] - turn[i, 1] * p[1], turn[i, 1] * p[0] + turn[i, 0] * p[1]
        now = e.load_tables[k, here] * (1 - part) + e.load_tables[k, (here + 1) % TABLE] * part
        _put(f, i, now[0], now[1], ax, ay)
        f[i, 2] += now[2]


@numba.njit(cache=True, fastmath=_FAST, error_model="numpy")
def march(
    e: Elements,
    course: Turning,
    q: Array,
    v: Array,
    begin: float,
    h: float,
    steps: int,
    shaking: Array,
    out: Array,
    watched: int,
) -> None:
    """Go `steps` steps of `h` for every row of `out` (n, 6): place and velocity of one body; `q`, `v` end at the end.

    `shaking` (n + 1, 3) is a force and torque on the frame at the rows' times, or empty.
    """
    count = len(q)
    a, f, turn = np.zeros_like(q), np.zeros_like(q), np.zeros((count, 2))
    approach = np.full(len(e.pin_bodies), -1.0)
    for step in range(len(out) * steps + 1):
        t = begin + step * h
        if step > 0:
            for i in range(count):
                for c in range(3):
                    q[i, c] += h * (v[i, c] + 0.5 * h * a[i, c])
                    v[i, c] += h * a[i, c]
        theta, theta1, theta2 = 0.0, 0.0, 0.0
        if e.driven >= 0:
            theta, theta1, theta2, _ = angle(course, t)
            q[e.driven, 2], v[e.driven, 2] = q[e.base, 2] + theta, v[e.base, 2] + theta1
        for i in range(count):
            turn[i, 0], turn[i, 1] = math.cos(q[i, 2]), math.sin(q[i, 2])
            f[i, :] = 0.0
        pin_forces(e, q, v, turn, approach, f)
        guide_forces(e, q, v, turn, f)
        mount_forces(e, q, v, turn, f)
        load_forces(e, turn, theta, f)
        if len(shaking) > 0:
            row = min(step // steps, len(shaking) - 2)
            part = step / steps - row
            for c in range(3):
                f[e.frame, c] += shaking[row, c] * (1 - part) + shaking[row + 1, c] * part
        if e.driven >= 0:
            i, j = e.driven, e.base
            mine, other = e.inverse_inertia[i], e.inverse_inertia[j]
            torque = (theta2 - f[i, 2] * mine + f[j, 2] * other) / (mine + other)
            f[i, 2] += torque
            f[j, 2] -= torque
        for i in range(count):
            falls = e.gravity if e.inverse_mass[i] > 0 else 0.0
            x, y, z = f[i, 0] * e.inverse_mass[i], f[i, 1] * e.inverse_mass[i] - falls, f[i, 2] * e.inverse_inertia[i]
            if step > 0:
                v[i, 0] += 0.5 * h * (x - a[i, 0])
                v[i, 1] += 0.5 * h * (y - a[i, 1])
                v[i, 2] += 0.5 * h * (z - a[i, 2])
            a[i, 0], a[i, 1], a[i, 2] = x, y, z
        if step > 0 and step % steps == 0:
            out[step // steps - 1, :3], out[step // steps - 1, 3:] = q[watched], v[watched]
