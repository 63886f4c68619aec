"""Dormand and Prince's pair for one case at a time, scalar Numba: what a program for one machine would be.

Error control, dense output of order 4 at 20 kHz, contact switch located on the dense output or left to error control.
Coefficients as in :mod:`jointplay.solver.integrators.dopri`, where the sources are.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.scenes import RATE
from benchmarks.slider_crank import APART, BY_STATE, PUSHING, SCALES, SIZE, derivative, start

Array = NDArray[np.float64]

_LONGEST = 1 / (120 * 10.0)  # s: a 120th of a revolution
_SHORTEST = 1e-12
#: A switch counts as met within this penetration, m; a shortened step aims so much of it past the switch.
_MET, _PAST = 1e-8, 0.3


@njit(fastmath=True, error_model="numpy")
def _trial(t: float, h: float, y: Array, contact: int, k: Array, y1: Array) -> tuple[float, float, float, float]:
    """One step from y and k[0] to y1 and k[6]; returns the scaled error and what `derivative` returns at the end."""
    w = np.empty(SIZE)
    for i in range(SIZE):
        w[i] = y[i] + h * (0.2 * k[0, i])
    derivative(t + 0.2 * h, w, contact, k[1])
    for i in range(SIZE):
        w[i] = y[i] + h * (3 / 40 * k[0, i] + 9 / 40 * k[1, i])
    derivative(t + 0.3 * h, w, contact, k[2])
    for i in range(SIZE):
        w[i] = y[i] + h * (44 / 45 * k[0, i] - 56 / 15 * k[1, i] + 32 / 9 * k[2, i])
    derivative(t + 0.8 * h, w, contact, k[3])
    for i in range(SIZE):
        w[i] = y[i] + h * (
            19372 / 6561 * k[0, i] - 25360 / 2187 * k[1, i] + 64448 / 6561 * k[2, i] - 212 / 729 * k[3, i]
        )
    derivative(t + 8 / 9 * h, w, contact, k[4])
    for i in range(SIZE):
        w[i] = y[i] + h * (
            9017 / 3168 * k[0, i] - 355 / 33 * k[1, i] + 46732 / 5247 * k[2, i] + 49 / 176 * k[3, i]
            - 5103 / 18656 * k[4, i]
        )  # fmt: skip
    derivative(t + h, w, contact, k[5])
    for i in range(SIZE):
        y1[i] = y[i] + h * (
            35 / 384 * k[0, i] + 500 / 1113 * k[2, i] + 125 / 192 * k[3, i] - 2187 / 6784 * k[4, i] + 11 / 84 * k[5, i]
        )
    penetration, approach, switch = derivative(t + h, y1, contact, k[6])
    error = 0.0
    for i in range(SIZE):
        e = (
            71 / 57600 * k[0, i] - 71 / 16695 * k[2, i] + 71 / 1920 * k[3, i] - 17253 / 339200 * k[4, i]
            + 22 / 525 * k[5, i] - 1 / 40 * k[6, i]
        )  # fmt: skip
        error = max(error, abs(h * e) / SCALES[i])
    return error, penetration, approach, switch


@njit(inline="always", fastmath=True)
def _dense(y: Array, y1: Array, h: float, k: Array, i: int, x: float) -> tuple[float, float]:
    """Value and slope (1/s) of component i at part x of the step."""
    change = y1[i] - y[i]
    bend = h * k[0, i] - change
    last = change - h * k[6, i] - bend
    quartic = h * (
        -12715105075 / 11282082432 * k[0, i] + 87487479700 / 32700410799 * k[2, i] - 10690763975 / 1880347072 * k[3, i]
        + 701980252875 / 199316789632 * k[4, i] - 1453857185 / 822651844 * k[5, i] + 69997945 / 29380423 * k[6, i]
    )  # fmt: skip
    r = 1.0 - x
    value = y[i] + x * (change + r * (bend + x * (last + r * quartic)))
    slope = change + (r - x) * bend + x * (2 * r - x) * last + 2 * x * r * (r - x) * quartic
    return value, slope / h


@njit(inline="always")
def _first_positive(p0: float, r0: float, p1: float, r1: float) -> float:
    """First part of a step at which the cubic through values and slopes (per step) is positive; above 1 for never."""
    a, b = 2 * p0 - 2 * p1 + r0 + r1, -3 * p0 + 3 * p1 - 2 * r0 - r1
    if p1 <= 0.0 and not (r0 > 0.0 and r1 < 0.0):
        return 2.0  # no hump between the ends
    before = 0.0
    for i in range(1, 9):
        x = i / 8
        if p0 + x * (r0 + x * (b + x * a)) > 0.0:
            for _ in range(30):
                middle = 0.5 * (before + x)
                if p0 + middle * (r0 + middle * (b + middle * a)) > 0.0:
                    x = middle
                else:
                    before = middle
            return x
        before = x
    return 2.0


@njit(error_model="numpy")
def integrate(y: Array, end: float, interval: float, tolerance: float, locate: bool, out: Array) -> tuple[int, int]:
    """Integrate from t = 0 and record place, rate and acceleration of the frame.

    Parameters
    ----------
    y : (10,) array
        Start; overwritten.
    end, interval : float
        s.
    tolerance : float
        Bound of the scaled error of a step.
    locate : bool
        Hold the contact's state over a step and end the step where it switches; else switch by the state.
    out : (9, samples) array
        x, y, theta; their rates; their accelerations at multiples of `interval`. Filled in.

    Returns
    -------
    (int, int)
        Steps tried and accepted.
    """
    k, y1 = np.empty((7, SIZE)), np.empty(SIZE)
    t, h, sample, tried, accepted = 0.0, 1e-5, 0, 0, 0
    held = APART if locate else BY_STATE
    penetration, approach, switch = derivative(t, y, held, k[0])
    natural = 0.0
    while sample < out.shape[1] and tried < 10_000_000:
        tried += 1
        error, penetration1, approach1, switch1 = _trial(t, h, y, held, k, y1)
        scaled = error / tolerance
        if not (scaled <= 1.0) and h > _SHORTEST:
            h *= max(0.2, 0.9 * scaled**-0.2) if scaled == scaled else 0.2
            continue
        switched, part = False, 2.0
        if locate:
            switched = (switch1 > 0.0) != (held == PUSHING)
            if held == APART and penetration <= 0.0:
                part = _first_positive(penetration, approach * h, penetration1, approach1 * h)
            elif switched:
                part = switch / (switch - switch1)
            if part < 0.999 and abs(switch1) > _MET and h > _SHORTEST:
                natural = max(natural, h)
                slope = max(abs(approach), abs(approach1), abs(switch1 - switch) / h, 1e-3)
                h = max(0.01, part) * h + _PAST * _MET / slope
                continue
        while sample < out.shape[1] and sample * interval <= t + h:
            x = (sample * interval - t) / h
            for i in range(3):
                out[i, sample], _ = _dense(y, y1, h, k, i, x)
                out[3 + i, sample], out[6 + i, sample] = _dense(y, y1, h, k, 5 + i, x)
            sample += 1
        accepted += 1
        t += h
        y[:] = y1
        k[0] = k[6]
        penetration, approach, switch = penetration1, approach1, switch1
        grown = h * min(4.0, 0.9 * max(scaled, 1e-8) ** -0.2)
        if switched:
            held = PUSHING if held == APART else APART
            derivative(t, y, held, k[0])
            grown = max(grown, natural)
        if t > end + 1.0:
            break
        natural = 0.0
        h = min(grown, _LONGEST)
    return tried, accepted


def run(duration: float, tolerance: float, locate: bool) -> Array:
    """P1's frame: y acceleration at 20 kHz."""
    out = np.zeros((9, round(duration * RATE) + 1))
    integrate(start(), duration, 1 / RATE, tolerance, locate, out)
    return np.asarray(out[7])
