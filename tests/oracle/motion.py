"""Motion of every link as the fast solver's coordinates say it, by differentiating its poses and nothing else."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from jointplay.solver.equations.model import Model

Array = NDArray[np.float64]


class LinkMotion:
    """Positions, velocities and accelerations of all links, each (N, 3): x, y, theta, in the order of the file."""

    def __init__(self, model: Model) -> None:
        kin = model.kinematics
        parts = []
        for name in model.machine.links:
            pose = kin.poses[name]
            parts.append(ca.vertcat(kin.terms.to_ground(kin.terms.value(pose.centre)).column, pose.theta))
        place = ca.vertcat(*parts)
        a = ca.SX.sym("a", model.size)
        rate = ca.jtimes(place, model.z, model.v) + ca.jacobian(place, model.t)
        acceleration = ca.jtimes(rate, model.z, model.v) + ca.jtimes(rate, model.v, a) + ca.jacobian(rate, model.t)
        inputs = [model.t, model.z, model.v, a, model.p]
        self._function = ca.Function("motion", inputs, [place, rate, acceleration])

    def __call__(self, t: float, z: ArrayLike, v: ArrayLike, a: ArrayLike, p: ArrayLike) -> tuple[Array, Array, Array]:
        parts = self._function(t, z, v, a, p)
        positions, velocities, accelerations = (np.asarray(part.full()).reshape(-1, 3) for part in parts)
        return positions, velocities, accelerations
