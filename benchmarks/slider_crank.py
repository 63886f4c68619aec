"""P1 by hand: the slider-crank with clearance at B in minimal coordinates, scalar code for Numba.

What an engineer writes who needs this one machine and nothing else: all numbers are constants of the compiled code, the
mass matrix is reduced by hand to three unknowns. Shares no equation with the product. Coordinates: frame x, y, theta,
place of the slider along the frame's guide, absolute angle of the rod; then their rates.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIZE = 10
#: rad/s of the crank relative to the frame (600 rpm).
OMEGA = 20 * math.pi
CLEARANCE = 2e-4
GRAVITY = 9.81
FRAME_MASS, FRAME_INERTIA = 20.0, 0.5
CRANK_MASS, CRANK_INERTIA, CRANK, CRANK_CG = 0.3, 1e-4, 0.05, 0.025
ROD_MASS, ROD_INERTIA, ROD, ROD_CG = 0.25, 6e-4, 0.15, 0.075
SLIDER_MASS, SLIDER_INERTIA = 0.5, 1e-4
#: Height of crankshaft and guide above the frame's centre of gravity.
HEIGHT = 0.05
FOOT_X, FOOT_Y = 0.25, -0.1
FOOT_STIFFNESS = (2e5, 4e5)
FOOT_DAMPING = (200.0, 300.0)
STIFFNESS, DAMPING, FRICTION, FRICTION_VELOCITY = 1e7, 300.0, 0.05, 0.01
#: Sizes that errors are compared with: coordinates, then rates.
SCALES = np.array([0.2, 0.2, 1.0, 0.2, 1.0, 0.2 * OMEGA, 0.2 * OMEGA, OMEGA, 0.2 * OMEGA, OMEGA])
#: What decides whether the surfaces push: held open, held closed, or by the state.
APART, PUSHING, BY_STATE = 0, 1, 2


def start() -> Array:
    """As drawn, frame at rest, velocities of the ideal machine: the rod's end stands where the slider is."""
    y = np.zeros(SIZE)
    y[3] = CRANK + ROD
    # The crank pin moves up at OMEGA CRANK; the rod turns about the slider, which does not move at this dead centre.
    y[9] = -OMEGA * CRANK / ROD
    return y


@njit(inline="always", fastmath=True, error_model="numpy")
def foot(
    px: float, py: float, x: float, y: float, x_rate: float, y_rate: float, turn: float, c: float, s: float
) -> tuple[float, float, float]:
    """Force and moment about the frame's centre of gravity of the mount at (px, py) of the drawing."""
    rx, ry = c * px - s * py, s * px + c * py
    fx = -FOOT_STIFFNESS[0] * (x + rx - px) - FOOT_DAMPING[0] * (x_rate - turn * ry)
    fy = -FOOT_STIFFNESS[1] * (y + ry - py) - FOOT_DAMPING[1] * (y_rate + turn * rx)
    return fx, fy, rx * fy - ry * fx


@njit(fastmath=True, error_model="numpy")
def derivative(t: float, y: Array, contact: int, out: Array) -> tuple[float, float, float]:
    """State derivative into `out`; returns penetration, its rate, and the switch function, m, m/s, m.

    Parameters
    ----------
    t : float
    y : (10,) array
    contact : int
        :data:`APART`, :data:`PUSHING` or :data:`BY_STATE`.
    out : (10,) array
    """
    theta, place, place_rate, turn, rod_turn = y[2], y[3], y[8], y[7], y[9]
    c, s = math.cos(theta), math.sin(theta)
    crank_c, crank_s = math.cos(theta + OMEGA * t), math.sin(theta + OMEGA * t)
    rod_c, rod_s = math.cos(y[4]), math.sin(y[4])
    crank_turn = turn + OMEGA
    # Places relative to the frame's centre of gravity: shaft, crank cg, crank pin, slider.
    ox, oy = -s * HEIGHT, c * HEIGHT
    gx, gy = ox + CRANK_CG * crank_c, oy + CRANK_CG * crank_s
    ax, ay = ox + CRANK * crank_c, oy + CRANK * crank_s
    sx, sy = ox + c * place, oy + s * place
    # Contact: socket centre to pin centre, in the frame's fixed directions.
    ex, ey = ax + ROD * rod_c - sx, ay + ROD * rod_s - sy
    crank_vx, crank_vy = -CRANK * crank_s * crank_turn, CRANK * crank_c * crank_turn
    evx = -oy * turn + crank_vx - ROD * rod_s * rod_turn + sy * turn - c * place_rate
    evy = ox * turn + crank_vy + ROD * rod_c * rod_turn - sx * turn - s * place_rate
    e = math.sqrt(max(ex * ex + ey * ey, 1e-60))
    nx, ny = ex / e, ey / e
    penetration = e - CLEARANCE
    approach = nx * evx + ny * evy
    elastic = STIFFNESS * penetration + DAMPING * approach
    switch = min(penetration, elastic / STIFFNESS)
    fx = fy = 0.0  # on the pin
    if contact == PUSHING or (contact == BY_STATE and switch > 0.0):
        slip = nx * evy - ny * evx - turn * e
        rubbing = FRICTION * elastic * math.tanh(slip / FRICTION_VELOCITY)
        fx, fy = -nx * elastic + ny * rubbing, -ny * elastic - nx * rubbing
    # Accelerations that are there without any of the coordinates accelerating.
    crank2, turn2, rod2 = crank_turn * crank_turn, turn * turn, rod_turn * rod_turn
    crank_ax = -turn2 * ox - crank2 * CRANK_CG * crank_c
    crank_ay = -turn2 * oy - crank2 * CRANK_CG * crank_s
    rod_ax = -turn2 * ox - crank2 * CRANK * crank_c - rod2 * ROD_CG * rod_c
    rod_ay = -turn2 * oy - crank2 * CRANK * crank_s - rod2 * ROD_CG * rod_s
    slider_ax = -turn2 * sx - 2.0 * turn * place_rate * s
    slider_ay = -turn2 * sy + 2.0 * turn * place_rate * c
    # Applied forces less those inertia terms, on every cg.
    crank_fx, crank_fy = -CRANK_MASS * crank_ax, -CRANK_MASS * (crank_ay + GRAVITY)
    rod_fx, rod_fy = fx - ROD_MASS * rod_ax, fy - ROD_MASS * (rod_ay + GRAVITY)
    slider_fx, slider_fy = -fx - SLIDER_MASS * slider_ax, -fy - SLIDER_MASS * (slider_ay + GRAVITY)
    left_x, left_y, left_m = foot(-FOOT_X, FOOT_Y, y[0], y[1], y[5], y[6], turn, c, s)
    right_x, right_y, right_m = foot(FOOT_X, FOOT_Y, y[0], y[1], y[5], y[6], turn, c, s)
    q_x = crank_fx + rod_fx + slider_fx + left_x + right_x
    q_y = crank_fy + rod_fy + slider_fy + left_y + right_y - FRAME_MASS * GRAVITY
    # The force on the slider acts at the pin, e from the slider's cg.
    q_theta = (
        gx * crank_fy - gy * crank_fx + ax * rod_fy - ay * rod_fx + sx * slider_fy - sy * slider_fx
        - ex * fy + ey * fx + left_m + right_m
    )  # fmt: skip
    q_place = c * slider_fx + s * slider_fy
    inertial_x, inertial_y = rod_fx - fx, rod_fy - fy
    q_rod = ROD_CG * (rod_c * inertial_y - rod_s * inertial_x) + ROD * (rod_c * fy - rod_s * fx)
    # Mass matrix; place and rod angle do not couple with one another, so they are eliminated first.
    mass = FRAME_MASS + CRANK_MASS + ROD_MASS + SLIDER_MASS
    m_rod = ROD_INERTIA + ROD_MASS * ROD_CG * ROD_CG
    m_xt = -(CRANK_MASS * gy + ROD_MASS * ay + SLIDER_MASS * sy)
    m_yt = CRANK_MASS * gx + ROD_MASS * ax + SLIDER_MASS * sx
    m_tt = (
        FRAME_INERTIA + CRANK_INERTIA + SLIDER_INERTIA + CRANK_MASS * (gx * gx + gy * gy)
        + ROD_MASS * (ax * ax + ay * ay) + SLIDER_MASS * (sx * sx + sy * sy)
    )  # fmt: skip
    m_xr, m_yr = -ROD_MASS * ROD_CG * rod_s, ROD_MASS * ROD_CG * rod_c
    m_tr = ROD_MASS * ROD_CG * (ax * rod_c + ay * rod_s)
    m_tp = SLIDER_MASS * (sx * s - sy * c)
    rx, ry, rt = m_xr / m_rod, m_yr / m_rod, m_tr / m_rod
    pt = m_tp / SLIDER_MASS
    a_xx = mass - rx * m_xr - SLIDER_MASS * c * c
    a_xy = -rx * m_yr - SLIDER_MASS * c * s
    a_yy = mass - ry * m_yr - SLIDER_MASS * s * s
    a_xt = m_xt - rx * m_tr - c * m_tp
    a_yt = m_yt - ry * m_tr - s * m_tp
    a_tt = m_tt - rt * m_tr - pt * m_tp
    b_x = q_x - rx * q_rod - c * q_place
    b_y = q_y - ry * q_rod - s * q_place
    b_t = q_theta - rt * q_rod - pt * q_place
    # Symmetric 3 x 3 by elimination.
    u, w = a_xy / a_xx, a_xt / a_xx
    d_yy, d_yt, d_tt = a_yy - u * a_xy, a_yt - u * a_xt, a_tt - w * a_xt
    b_y -= u * b_x
    b_t -= w * b_x
    k = d_yt / d_yy
    acc_t = (b_t - k * b_y) / (d_tt - k * d_yt)
    acc_y = (b_y - d_yt * acc_t) / d_yy
    acc_x = (b_x - a_xy * acc_y - a_xt * acc_t) / a_xx
    for i in range(5):
        out[i] = y[5 + i]
    out[5], out[6], out[7] = acc_x, acc_y, acc_t
    out[8] = q_place / SLIDER_MASS - c * acc_x - s * acc_y - pt * acc_t
    out[9] = q_rod / m_rod - rx * acc_x - ry * acc_y - rt * acc_t
    return penetration, approach, switch
