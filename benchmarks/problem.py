"""An initial value problem as compiled code, for integrators that know nothing of machines."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks import slider_crank
from benchmarks.scenes import RATE, Scene
from jointplay.solver.equations.model import build_model
from jointplay.solver.simulation.simulate import start_of

Array = NDArray[np.float64]

_FUNCTIONS = ("sqrt", "sin", "cos", "tanh", "exp", "log", "floor")
#: CasADi's operations in Python.
_OPERATIONS = {
    ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}",
    ca.OP_NEG: "-{}", ca.OP_INV: "1.0 / {}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}",
    ca.OP_FABS: "abs({})", ca.OP_FMAX: "max({}, {})", ca.OP_FMIN: "min({}, {})",
    ca.OP_LT: "{} < {}", ca.OP_LE: "{} <= {}", ca.OP_EQ: "{} == {}", ca.OP_NE: "{} != {}",
    ca.OP_AND: "{} and {}", ca.OP_OR: "{} or {}", ca.OP_NOT: "not {}", ca.OP_IF_ELSE_ZERO: "{1} if {0} else 0.0",
    **{getattr(ca, f"OP_{name.upper()}"): f"{name}({{}})" for name in _FUNCTIONS},
}  # fmt: skip


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
    """

    derivative: Any
    start: Array
    scales: Array
    vertical: int
    longest_step: float

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


def _as_python(function: ca.Function) -> str:
    """``derivative(t, y, out)``: a CasADi function of t and y, statement by statement."""
    lines, names = ["def derivative(t, y, out):"], dict[int, str]()
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        reads, writes = function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_OUTPUT:
            lines.append(f"    out[{writes[1]}] = {names[reads[0]]}")
            continue
        if op == ca.OP_INPUT:
            value = f"y[{reads[1]}]" if reads[0] else "t"
        elif op == ca.OP_CONST:
            value = repr(function.instruction_constant(k))
        else:
            value = _OPERATIONS[op].format(*(names[read] for read in reads))
        names[writes[0]] = f"v{k}"  # a name each: CasADi uses its registers again, for numbers and truths alike
        lines.append(f"    v{k} = {value}")
    return "\n".join(lines)


def from_equations(scene: Scene) -> Problem:
    """A scene, from the product's own equations printed as scalar code, with the scene's numbers in it."""
    model = build_model(scene.machine, scene.fault.joints)
    n = model.size
    clearances = {f"joints.{joint}.clearance": value for joint, value in scene.fault.items()}
    known = ca.substitute(model.acceleration, model.p, ca.DM(model.vector(clearances)))
    names: dict[str, Any] = {name: getattr(math, name) for name in _FUNCTIONS}
    y, rates = ca.vertcat(model.z, model.v), ca.vertcat(model.v, *ca.cse([known]))
    exec(_as_python(ca.Function("derivative", [model.t, y], [ca.densify(rates)])), names)
    derivative = njit(names["derivative"], error_model="numpy", fastmath={"nsz", "arcp", "contract"})
    begin = start_of(scene.machine, scene.case)
    rate = 2 * np.pi * scene.drive_hz
    sizes = np.array([1.0 if name.startswith("theta(") else 0.2 for name in model.kinematics.names])
    vertical = model.frame_indices[1]
    assert vertical is not None
    scales = np.concatenate([sizes, sizes * rate])
    first = np.concatenate([begin.z, begin.v])
    return Problem(derivative, first, scales, n + vertical, 1 / scene.drive_hz / 120)


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
