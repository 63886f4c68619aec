"""The solver's own steps and driver without compilation: CasADi evaluates equations, Python the step and the driver.

The step is the printed one, printed as Python; the driver of lanes runs as the Python that it is, with one lane.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import casadi as ca
import numpy as np
from fuzz.scalar_block import HEAD, ScalarBlock
from numpy.typing import NDArray

from jointplay.solver.cases.preparation import model_of
from jointplay.solver.cases.rates import error_scales, velocity_scales
from jointplay.solver.compiler.rows import WorkRows
from jointplay.solver.equations.model import Model
from jointplay.solver.integrators import adaptive, between, dense, dopri, lanes, rosenbrock
from jointplay.solver.integrators.dopri import adaptive_rows, dopri_step
from jointplay.solver.integrators.kernel import Kernel
from jointplay.solver.integrators.lanes import GROUP, Lanes, Queue
from jointplay.solver.integrators.rosenbrock import jacobian_of, rosenbrock_rows, rosenbrock_step
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation import runs

_BETWEEN = (between.begin_step, between.suspect_step, between.advance_step)

Work = NDArray[np.float64]
Values = list[float]


class _Kernel(Kernel):
    """Functions of Python."""

    def work_array(self) -> Work:
        return np.zeros((self.rows[-1].stop, 1))


def _kernel(
    machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...], recorded: tuple[int, ...], implicit: bool
) -> _Kernel:
    model = model_of(machine, joints, varying)
    scales = error_scales(machine, model)
    rows = (rosenbrock_rows if implicit else adaptive_rows)(model, len(recorded))
    held = _held(model, rows)
    space: dict[str, Any] = {"held": held, "jacobian": _jacobian(model, rows)}
    if implicit:
        step = rosenbrock_step(rows, recorded, scales, velocity_scales(model, scales))
    else:
        step = dopri_step(rows, recorded, scales)
    exec(HEAD + "\n".join((step, *(part(rows) for part in _BETWEEN))), space)
    project: Any = _in_place(_project(model, rows)) if model.kinematics.closures else 0
    names = ("begin", "rosenbrock" if implicit else "dopri", "suspect", "advance")
    begin, step, suspect, advance = (_in_place(space[name]) for name in names)
    functions: Any = (_nothing, begin, step, project, suspect, advance)
    return _Kernel(rows, functions, 0, "")


def _nothing(w: Work) -> None:
    """What ``prepare`` has to do where nothing is hoisted."""


def _in_place(function: Callable[[Values], None]) -> Callable[[Work], None]:
    """A function of a list, many times faster than one of an array's elements."""

    def call(w: Work) -> None:
        values = w[:, 0].tolist()
        try:
            function(values)
            w[:, 0] = values
        except ArithmeticError:  # Python refuses to overflow; the processor goes on with what is no number
            w[2:] = math.nan

    return call


def _inputs(model: Model, rows: WorkRows[range]) -> tuple[ca.SX, list[int]]:
    """What right-hand side and Jacobian depend on, and its rows."""
    state = ca.vertcat(model.t, model.z, model.v, model.p, model.touching, model.memory)
    remembered = range(rows.memory.start, rows.slips.stop)
    return state, [*rows.time, *rows.z, *rows.v, *rows.parameters, *rows.touching, *remembered]


def _jacobian(model: Model, rows: WorkRows[range]) -> Callable[[Values], None]:
    state, given = _inputs(model, rows)
    evaluate = ca.Function("jacobian", [state], [jacobian_of(model)])

    def jacobian(w: Values) -> None:
        found = evaluate([w[i] for i in given]).full()[:, 0].tolist()
        w[rows.jacobian.start : rows.jacobian.stop] = found

    return jacobian


def _held(model: Model, rows: WorkRows[range]) -> Callable[[Values], None]:
    outputs = [model.held_acceleration]
    outputs += [
        ca.vertcat(*(getattr(c, name) for c in model.contacts)) for name in ("switch", "penetration", "approach")
    ]
    outputs += [model.bristles.pull, ca.SX(0) if model.rubbing is None else model.rubbing.jam]
    state, given = _inputs(model, rows)
    evaluate = ca.Function("held", [state], [ca.vertcat(*ca.cse(outputs))])

    def held(w: Values) -> None:
        *found, jam = evaluate([w[i] for i in given]).full()[:, 0].tolist()
        for i, value in zip((*rows.a, *rows.switch, *rows.penetration, *rows.approach, *rows.pull), found, strict=True):
            w[i] = value
        w[rows.jam[0]] = max(w[rows.jam[0]], jam)

    return held


def _project(model: Model, rows: WorkRows[range]) -> Callable[[Values], None]:
    def project(w: Values) -> None:
        z, v, p = (np.array([w[i] for i in place]) for place in (rows.z, rows.v, rows.parameters))
        z = z + model.projection(w[0], z, v, p)[0].full()[:, 0]
        v = v + model.projection(w[0], z, v, p)[1].full()[:, 0]
        w[rows.z.start : rows.a.start] = [*z.tolist(), *v.tolist()]

    return project


def _call(function: Callable[[Work], None], w: Work) -> None:
    function(w)


def _write_values(w: Work, at: int, out: Work, where: int, start: float, scale: float, x0: float, dx: float) -> None:
    """A group of samples of the dense output."""
    c2, c3, c4, c5 = w[at : at + 4, 0]
    x = x0 + dx * np.arange(GROUP)
    y = 1 - x
    out.reshape(-1)[where : where + GROUP] = scale * (start + x * (c2 + y * (c3 + x * (c4 + y * c5))))


def _write_in_turn(w: Work, at: int, out: Work, even: int, odd: int, start: float, x0: float, dx: float) -> None:
    """A group of samples of the dense output, in turn to two places."""
    group = np.zeros(GROUP)
    _write_values(w, at, group, 0, start, 1.0, x0, dx)
    flat = out.reshape(-1)
    flat[even : even + GROUP // 2], flat[odd : odd + GROUP // 2] = group[::2], group[1::2]


def _write_slopes(w: Work, at: int, out: Work, where: int, start: float, scale: float, x0: float, dx: float) -> None:
    """A group of samples of its derivative."""
    c2, c3, c4, c5 = w[at : at + 4, 0]
    x = x0 + dx * np.arange(GROUP)
    y = 1 - x
    inner = c4 + y * c5
    middle = c3 + x * inner
    out.reshape(-1)[where : where + GROUP] = scale * (c2 + y * middle - x * middle + x * y * (inner - x * c5))


def _queue(*arguments: Any) -> Queue:
    """The queue, its cases with their fields as attributes, as compiled code has them."""
    queue = runs_queue_of(*arguments)
    return queue._replace(cases=queue.cases.view(np.recarray))


def _lanes(*arguments: Any) -> Lanes:
    lanes = lanes_idle(*arguments)
    return lanes._replace(lanes=lanes.lanes.view(np.recarray))


runs_queue_of, lanes_idle = runs.queue_of, runs.idle_lanes


@contextlib.contextmanager
def uncompiled(trials: int) -> Iterator[None]:
    """Simulate with the adaptive method in plain Python; a case gives up after so many trial steps."""
    with contextlib.ExitStack() as patches:

        def put(module: Any, name: str, value: Any) -> None:
            patches.enter_context(mock.patch.object(module, name, value))

        for module in (adaptive, dense):
            for name, value in list(vars(module).items()):
                if hasattr(value, "py_func"):
                    put(module, name, value.py_func)
        for module in (adaptive, lanes, dense):
            put(module, "LANES", 1)
        for module in (dopri, rosenbrock, between):
            put(module, "Block", ScalarBlock)
        put(adaptive, "call", _call)
        put(dense, "_write_values", _write_values)
        put(dense, "_write_in_turn", _write_in_turn)
        put(dense, "_write_slopes", _write_slopes)
        put(runs, "_adaptive_kernel", _kernel)
        put(runs, "queue_of", _queue)
        put(runs, "idle_lanes", _lanes)
        put(runs, "_LEAST_PATIENCE", trials)
        put(runs, "_PATIENCE", 0)
        put(runs, "_EASE", 1.0)
        yield
