"""An initial value problem as compiled code, for integrators that know nothing of machines."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks import slider_crank
from benchmarks.pointers import carray, doubles_at
from benchmarks.scenes import RATE, Scene
from jointplay.solver.compiler.emit import straight_line
from jointplay.solver.compiler.layout import Layout
from jointplay.solver.compiler.scalar import SCALAR
from jointplay.solver.equations.model import build_model
from jointplay.solver.simulation.simulate import start_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Problem:
    """y' = f(t, y).

    Attributes
    ----------
    derivative : compiled function
        ``f(t, y, out)``; the contact switches by the state.
    start, scales : (n,) arrays
        State at t = 0, and the sizes that its errors are compared with.
    vertical : int
        Component that is the frame's rate in y.
    longest_step : float
        s; so that no bounce is stepped over.
    work : array, optional
        What `derivative` refers to by its address.
    """

    derivative: Any
    start: Array
    scales: Array
    vertical: int
    longest_step: float
    work: Array | None = None

    @property
    def size(self) -> int:
        """n."""
        return len(self.start)

    def times(self, duration: float) -> Array:
        """Instants of the samples."""
        return np.asarray(np.arange(round(duration * RATE) + 1) / RATE)


@njit(error_model="numpy")
def _slider_crank(t: float, y: Array, out: Array) -> None:
    slider_crank.derivative(t, y, slider_crank.BY_STATE, out)


def by_hand() -> Problem:
    """P1, derived by hand."""
    longest = 2 * np.pi / slider_crank.OMEGA / 120
    return Problem(_slider_crank, slider_crank.start(), slider_crank.SCALES, 6, longest)


def from_equations(scene: Scene) -> Problem:
    """A scene, from the product's own equations printed as scalar code."""
    model = build_model(scene.machine, scene.fault.joints)
    n, k = model.size, len(model.parameters)
    layout = Layout(n, k, stride=1)
    symbols = [model.t, model.z, model.v, model.p]
    inputs = [[layout.time], layout.rows(layout.z, n), layout.rows(layout.v, n), layout.rows(layout.p, k)]
    function = ca.Function("right", symbols, [ca.densify(part) for part in ca.cse([model.acceleration])])
    outputs = [layout.rows(layout.a, n)]
    code = straight_line(function, inputs, outputs, fixed_input=3, hoist_at=layout.hoist, dialect=SCALAR)
    names: dict[str, Any] = {}
    exec("\n".join([SCALAR.head, code.hoisted.function("prepare"), code.body.function("right")]), names)
    work = np.zeros(layout.total + code.hoist_slots)
    clearances = {f"joints.{joint}.clearance": value for joint, value in scene.fault.items()}
    work[layout.p : layout.p + k] = model.vector(clearances)
    names["prepare"](work)
    right = njit(names["right"], error_model="numpy", fastmath={"nsz", "arcp", "contract"})
    address, length, z, a = work.ctypes.data, work.size, layout.z, layout.a

    @njit(error_model="numpy")
    def derivative(t: float, y: Array, out: Array) -> None:
        w = carray(doubles_at(address), (length,))
        w[0] = t
        for i in range(2 * n):
            w[z + i] = y[i]
        right(w)
        for i in range(n):
            out[i] = y[n + i]
            out[n + i] = w[a + i]

    begin = start_of(scene.machine, scene.case)
    rate = 2 * np.pi * scene.drive_hz
    sizes = np.array([1.0 if name.startswith("theta(") else 0.2 for name in model.kinematics.names])
    vertical = model.frame_indices[1]
    assert vertical is not None
    scales = np.concatenate([sizes, sizes * rate])
    first = np.concatenate([begin.z, begin.v])
    return Problem(derivative, first, scales, n + vertical, 1 / scene.drive_hz / 120, work)


@cache
def returning(problem: Problem) -> Any:
    """``f(t, y) -> y'`` for integrators in Python."""
    derivative, size = problem.derivative, problem.size

    @njit(error_model="numpy")
    def returned(t: float, y: Array) -> Array:
        out = np.empty(size)
        derivative(t, y, out)
        return out

    return returned


@cache
def _along(problem: Problem) -> Any:
    derivative, size, row = problem.derivative, problem.size, problem.vertical

    @njit(error_model="numpy")
    def along(t: Array, states: Array) -> Array:
        y, out, found = np.empty(size), np.empty(size), np.empty(t.size)
        for k in range(t.size):
            y[:] = states[:, k]
            derivative(t[k], y, out)
            found[k] = out[row]
        return found

    return along


def vertical_acceleration(problem: Problem, t: Array, states: Array) -> Array:
    """Frame's y acceleration at (k,) times and (n, k) states."""
    return np.asarray(_along(problem)(t, np.ascontiguousarray(states)))
