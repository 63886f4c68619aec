"""SciPy's integrators, and CVODE, on a compiled right-hand side: frame's y acceleration at 20 kHz.

CVODE in two ways: as scikit-sundae offers it, and without Python in the loop, by the SUNDIALS libraries that come in
its wheel, with compiled code as the right-hand side and as the loop over samples, as a C program would use them.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numba import cfunc, njit, types
from numpy.typing import NDArray
from scipy import integrate

from benchmarks.pointers import carray
from benchmarks.problem import Problem, returning, vertical_acceleration

Array = NDArray[np.float64]

#: Typed for functions that Python knows; ours are Numba's.
_solve_ivp: Any = integrate.solve_ivp
_odeint: Any = integrate.odeint
_MOST_STEPS = 100_000
_ADAMS, _NORMAL = 1, 1


def initial_value_problem(problem: Problem, method: str, duration: float, tolerance: float) -> Array:
    """``solve_ivp`` with DOP853 or Radau."""
    t = problem.times(duration)
    found = _solve_ivp(
        returning(problem), (0.0, t[-1]), problem.start, method=method, t_eval=t, rtol=tolerance,
        atol=tolerance * problem.scales, max_step=problem.longest_step,
    )  # fmt: skip
    if not found.success:
        raise RuntimeError(found.message)
    return vertical_acceleration(problem, t, found.y)


def lsoda(problem: Problem, duration: float, tolerance: float) -> Array:
    """LSODA by ``odeint``: its samples are interpolated in compiled code, which ``solve_ivp`` does in Python."""
    t = problem.times(duration)
    y = _odeint(
        returning(problem), problem.start, t, tfirst=True, rtol=tolerance, atol=tolerance * problem.scales,
        hmax=problem.longest_step, mxstep=_MOST_STEPS,
    )  # fmt: skip
    return vertical_acceleration(problem, t, y.T)


def cvode_from_python(problem: Problem, duration: float, tolerance: float) -> Array:
    """Adams' methods by scikit-sundae: the compiled right-hand side is called from Python."""
    from sksundae.cvode import CVODE

    derivative = problem.derivative
    t = problem.times(duration)
    solver = CVODE(
        lambda t, y, rate: derivative(t, y, rate), method="Adams", rtol=tolerance, atol=tolerance * problem.scales,
        max_step=problem.longest_step, max_num_steps=_MOST_STEPS,
    )  # fmt: skip
    found = solver.solve(t, problem.start)
    if not found.success:
        raise RuntimeError(found.message)
    return vertical_acceleration(problem, np.asarray(found.t), found.y.T)


class _Sundials:
    """Functions of the libraries, with their types."""

    def __init__(self) -> None:
        import sksundae

        folder = Path(sksundae.__file__).parents[1] / "scikit_sundae.libs"
        load = {}
        for name in ("core", "nvecserial", "cvode"):
            (path,) = folder.glob(f"libsundials_{name}-*.so*")
            load[name] = ctypes.CDLL(str(path))
        pointer, real, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_int

        def function(library: str, name: str, *arguments: Any, returns: Any = integer) -> Any:
            found = getattr(load[library], name)
            found.argtypes, found.restype = list(arguments), returns
            return found

        self.context = function("core", "SUNContext_Create", integer, pointer)
        self.data = function("core", "N_VGetArrayPointer", pointer, returns=ctypes.POINTER(real))
        self.vector = function("nvecserial", "N_VMake_Serial", ctypes.c_int64, pointer, pointer, returns=pointer)
        self.create = function("cvode", "CVodeCreate", integer, pointer, returns=pointer)
        self.init = function("cvode", "CVodeInit", pointer, pointer, real, pointer)
        self.tolerances = function("cvode", "CVodeSVtolerances", pointer, real, pointer)
        self.fixed_point = function("cvode", "SUNNonlinSol_FixedPoint", pointer, integer, pointer, returns=pointer)
        self.set_solver = function("cvode", "CVodeSetNonlinearSolver", pointer, pointer)
        self.set_most_steps = function("cvode", "CVodeSetMaxNumSteps", pointer, ctypes.c_long)
        self.set_longest_step = function("cvode", "CVodeSetMaxStep", pointer, real)
        self.advance = function("cvode", "CVode", pointer, real, pointer, pointer, integer)


@cache
def _compiled(problem: Problem) -> tuple[_Sundials, Any, Any]:
    """Libraries, right-hand side and loop, compiled once."""
    sundials = _Sundials()
    data, advance, derivative, size = sundials.data, sundials.advance, problem.derivative, problem.size

    @cfunc(types.int32(types.float64, types.voidptr, types.voidptr, types.voidptr))
    def right_hand_side(t: float, y: Any, rate: Any, _: Any) -> int:
        derivative(t, carray(data(y), (size,)), carray(data(rate), (size,)))
        return 0

    @njit
    def loop(memory: int, vector: int, reached: int, t: Array, y: Array, out: Array) -> int:
        for k in range(1, t.size):
            status = advance(memory, t[k], vector, reached, _NORMAL)
            if status < 0:
                return int(status)
            out[:, k] = y
        return 0

    return sundials, right_hand_side, loop


def cvode(problem: Problem, duration: float, tolerance: float) -> Array:
    """Adams' methods, the SUNDIALS libraries alone."""
    sundials, right_hand_side, loop = _compiled(problem)
    context = ctypes.c_void_p()
    sundials.context(0, ctypes.byref(context))
    y, absolute, reached = problem.start.copy(), tolerance * problem.scales, np.zeros(1)
    vector = sundials.vector(problem.size, y.ctypes.data, context)
    memory = sundials.create(_ADAMS, context)
    results = [
        sundials.init(memory, right_hand_side.address, 0.0, vector),
        sundials.tolerances(memory, tolerance, sundials.vector(problem.size, absolute.ctypes.data, context)),
        sundials.set_solver(memory, sundials.fixed_point(vector, 0, context)),
        sundials.set_most_steps(memory, _MOST_STEPS),
        sundials.set_longest_step(memory, problem.longest_step),
    ]
    t = problem.times(duration)
    out = np.zeros((problem.size, t.size))
    out[:, 0] = y
    results.append(loop(memory, vector, reached.ctypes.data, t, y, out))
    if min(results) < 0:
        raise RuntimeError(f"CVODE returned {results}")
    return vertical_acceleration(problem, t, out)
