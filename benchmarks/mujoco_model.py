"""P1 in MuJoCo: bodies on planar joints, forces of mounts and contact by a compiled callback in every evaluation.

With clearance at B the machine is a tree, so MuJoCo needs no constraint. It has no prescribed motion; the crank's joint
carries a flywheel (``armature``) of 1e9 kg m2 instead, which nothing in the machine can slow down.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numba import cfunc, njit, types
from numpy.typing import NDArray

from benchmarks import slider_crank as p1
from benchmarks.pointers import carray, doubles_at
from benchmarks.problem import by_hand, vertical_acceleration
from benchmarks.scenes import RATE

Array = NDArray[np.float64]

# The plane is MuJoCo's x-z plane; a hinge about -y turns from x to z. Frame cg in the origin.
_MODEL = f"""
<mujoco>
  <compiler angle="radian" inertiafromgeom="false"/>
  <option gravity="0 0 {-p1.GRAVITY}" integrator="{{integrator}}" timestep="{{step!r}}" iterations="1">
    <flag constraint="disable" contact="disable" equality="disable" limit="disable" frictionloss="disable"
      warmstart="disable" island="disable"/>
  </option>
  <worldbody>
    <body name="frame">
      <inertial pos="0 0 0" mass="{p1.FRAME_MASS}" diaginertia="1 {p1.FRAME_INERTIA} 1"/>
      <joint type="slide" axis="1 0 0"/>
      <joint type="slide" axis="0 0 1"/>
      <joint type="hinge" axis="0 -1 0"/>
      <body name="crank" pos="0 0 {p1.HEIGHT}">
        <inertial pos="{p1.CRANK_CG} 0 0" mass="{p1.CRANK_MASS}" diaginertia="1e-4 {p1.CRANK_INERTIA} 1e-4"/>
        <joint type="hinge" axis="0 -1 0" armature="1e9"/>
        <body name="rod" pos="{p1.CRANK} 0 0">
          <inertial pos="{p1.ROD_CG} 0 0" mass="{p1.ROD_MASS}" diaginertia="6e-4 {p1.ROD_INERTIA} 6e-4"/>
          <joint type="hinge" axis="0 -1 0"/>
        </body>
      </body>
      <body name="slider" pos="{p1.CRANK + p1.ROD} 0 {p1.HEIGHT}">
        <inertial pos="0 0 0" mass="{p1.SLIDER_MASS}" diaginertia="1e-4 {p1.SLIDER_INERTIA} 1e-4"/>
        <joint type="slide" axis="1 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
_JOINTS = 6  # frame x, z, angle; crank and rod relative to the link before; slider along the guide


@njit(inline="always", fastmath=True, error_model="numpy")
def _add_forces(q: Array, v: Array, out: Array) -> None:
    """Mounts and contact, by virtual work."""
    theta, turn = q[2], v[2]
    c, s = math.cos(theta), math.sin(theta)
    for side in (-1.0, 1.0):
        fx, fy, moment = p1.foot(side * p1.FOOT_X, p1.FOOT_Y, q[0], q[1], v[0], v[1], turn, c, s)
        out[0] += fx
        out[1] += fy
        out[2] += moment
    crank, rod = theta + q[3], theta + q[3] + q[4]
    place, place_rate = p1.CRANK + p1.ROD + q[5], v[5]
    crank_x, crank_y = p1.CRANK * math.cos(crank), p1.CRANK * math.sin(crank)
    rod_x, rod_y = p1.ROD * math.cos(rod), p1.ROD * math.sin(rod)
    crank_turn, rod_turn = turn + v[3], turn + v[3] + v[4]
    # Socket to pin, and its rate; the shaft is common to both ways from the frame.
    ex, ey = crank_x + rod_x - c * place, crank_y + rod_y - s * place
    evx = -crank_y * crank_turn - rod_y * rod_turn + s * place * turn - c * place_rate
    evy = crank_x * crank_turn + rod_x * rod_turn - c * place * turn - s * place_rate
    e = math.sqrt(max(ex * ex + ey * ey, 1e-60))
    nx, ny = ex / e, ey / e
    elastic = p1.STIFFNESS * (e - p1.CLEARANCE) + p1.DAMPING * (nx * evx + ny * evy)
    if e <= p1.CLEARANCE or elastic <= 0.0:
        return
    slip = nx * evy - ny * evx - turn * e
    rubbing = p1.FRICTION * elastic * math.tanh(slip / p1.FRICTION_VELOCITY)
    fx, fy = -nx * elastic + ny * rubbing, -ny * elastic - nx * rubbing
    about_rod = rod_x * fy - rod_y * fx
    out[3] += crank_x * fy - crank_y * fx + about_rod
    out[4] += about_rod
    out[5] -= c * fx + s * fy


def _callback(q_at: int, v_at: int, force_at: int) -> Any:
    """``void f(const mjModel*, mjData*)`` that adds to the generalised forces at these addresses."""

    @cfunc(types.void(types.voidptr, types.voidptr))
    def add(model: Any, data: Any) -> None:
        q, v = carray(doubles_at(q_at), (_JOINTS,)), carray(doubles_at(v_at), (_JOINTS,))
        _add_forces(q, v, carray(doubles_at(force_at), (_JOINTS,)))

    return add


def run(duration: float, step: float, integrator: str = "RK4") -> tuple[Array, float]:
    """Frame's y acceleration at 20 kHz, and processor seconds without the set-up."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(_MODEL.format(integrator=integrator, step=step))
    data = mujoco.MjData(model)
    callback = _callback(data.qpos.ctypes.data, data.qvel.ctypes.data, data.qfrc_passive.ctypes.data)
    rod = p1.start()[9]
    data.qvel[3], data.qvel[4] = p1.OMEGA, rod - p1.OMEGA
    every = round(1 / RATE / step)
    count = round(duration * RATE) + 1
    q, v = np.zeros((_JOINTS, count)), np.zeros((_JOINTS, count))
    mujoco.set_mjcb_passive(callback.ctypes)
    try:
        v[:, 0] = data.qvel
        began = time.process_time()
        for k in range(1, count):
            mujoco.mj_step(model, data, nstep=every)
            q[:, k], v[:, k] = data.qpos, data.qvel
        spent = time.process_time() - began
    finally:
        mujoco.set_mjcb_passive(None)
    # The evaluation at samples is left out of the time: MuJoCo has these accelerations, of the step's last stage.
    states = np.vstack([
        q[:3], p1.CRANK + p1.ROD + q[5], q[2] + q[3] + q[4], v[:3], v[5], v[2] + v[3] + v[4]
    ])  # fmt: skip
    return vertical_acceleration(by_hand(), np.arange(count) / RATE, states), spent
