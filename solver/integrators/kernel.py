"""Models to kernels: machine code that evaluates eight cases side by side."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.compiler import native
from jointplay.solver.compiler.emit import Program, straight_line
from jointplay.solver.compiler.ir import DECLARATIONS, LANES
from jointplay.solver.compiler.rows import WorkRows
from jointplay.solver.equations.model import Model
from jointplay.solver.integrators.between import advance_step, begin_step, suspect_step
from jointplay.solver.integrators.dopri import adaptive_rows, dopri_step
from jointplay.solver.integrators.gill import gill_rows, gill_step
from jointplay.solver.integrators.rosenbrock import jacobian_of, rosenbrock_rows, rosenbrock_step

_ALIGNMENT = 64  # bytes: a row never straddles two cache lines


@dataclass(frozen=True)
class Kernel:
    """A compiled model.

    Attributes
    ----------
    rows : WorkRows of range
        Where everything is in the work array.
    functions : tuple of int
        Addresses of ``void f(double* work)``: ``prepare`` (what depends on the parameters alone), the right-hand side,
        one step of the method, and ``project``, the correction of coordinates and velocities that restores the
        closures (0 where nothing is to close); error-controlled steps have ``begin`` in place of the right-hand side,
        and ``suspect`` and ``advance`` besides (:mod:`jointplay.solver.integrators.between`).
    operations : int
        Vector operations of one right-hand side.
    key : str
        SHA-256 of code, processor and compiler.
    """

    rows: WorkRows[range]
    functions: tuple[int, ...]
    operations: int
    key: str

    @property
    def first(self) -> WorkRows[int]:
        """The first row of everything, for compiled code."""
        return WorkRows(*(rows.start for rows in self.rows))

    def work_array(self) -> FloatArray:
        """A zeroed, aligned work array, (rows, LANES)."""
        length = self.rows[-1].stop * LANES
        raw = np.zeros(length + _ALIGNMENT // 8)
        skip = (-raw.ctypes.data % _ALIGNMENT) // 8
        return raw[skip : skip + length].reshape(-1, LANES)


@dataclass(frozen=True)
class KernelCode:
    """Source of a model, before compilation."""

    text: str
    rows: WorkRows[range]
    operations: int
    constrained: bool


#: Rows of a kernel, and what is read from them or written to them.
Placed = list[tuple[range, ca.SX]]


def _printed(name: str, reads: Placed, writes: Placed, hoist_at: int) -> Program:
    """A function after elimination of common subexpressions; the fourth of what it reads are the lane parameters."""
    simple = [ca.densify(out) for out in ca.cse([value for _, value in writes])]
    function = ca.Function(name, [symbol for _, symbol in reads], simple)
    places = ([rows for rows, _ in placed] for placed in (reads, writes))
    return straight_line(function, *places, fixed_input=3, hoist_at=hoist_at)


def _code(
    model: Model, rows: WorkRows[range], name: str, reads: Placed, writes: Placed, jam: ca.SX, step: str,
    jacobian: ca.SX | None = None,
) -> KernelCode:  # fmt: skip
    """Right-hand side `name`, projection, ``prepare`` and one step of a method; `reads` beside the state."""
    state = [(rows.time, model.t), (rows.z, model.z), (rows.v, model.v), (rows.parameters, model.p)]
    remembered = range(rows.memory.start, rows.slips.stop)
    reads = [*reads, (remembered, model.memory)]
    if model.bristles.contacts:
        writes = [*writes, (rows.pull, model.bristles.pull)]
    if model.rubbing is not None:
        met = ca.SX.sym("met")
        reads, writes = [*reads, (rows.jam, met)], [*writes, (rows.jam, ca.fmax(met, jam))]
    right = _printed(name, state + reads, writes, rows.hoisted.start)
    functions = [right.body.function(name)]
    prepare, slots = right.hoisted, right.hoist_slots
    constrained = bool(model.kinematics.closures)
    if constrained:
        # Velocities at the corrected pose: else a residual of gap times speed stays in them.
        dz, _ = model.projection.call([model.t, model.z, model.v, model.p])
        _, dv = model.projection.call([model.t, model.z + dz, model.v, model.p])
        restored = [(rows.z, model.z + dz), (rows.v, model.v + dv)]
        project = _printed("project", state, restored, rows.hoisted.start + slots)
        functions.append(project.body.function("project"))
        prepare.lines += project.hoisted.lines
        slots += project.hoist_slots
    if jacobian is not None:
        derived = _printed("jacobian", state + reads, [(rows.jacobian, jacobian)], rows.hoisted.start + slots)
        functions.append(derived.body.function("jacobian"))
        prepare.lines += derived.hoisted.lines
        slots += derived.hoist_slots
    functions += [prepare.function("prepare"), step]
    hoisted = range(rows.hoisted.start, rows.hoisted.start + slots)
    text = "\n".join([DECLARATIONS, *functions])
    return KernelCode(text, rows._replace(hoisted=hoisted), right.body.operations, constrained)


def _of_contacts(model: Model, name: str, contacts: Iterable[int]) -> ca.SX:
    column: ca.SX = ca.vertcat(*(getattr(model.contacts[j], name) for j in contacts))
    return column


def kernel_code(model: Model) -> KernelCode:
    """Print a model for Runge-Kutta-Gill: ``prepare``, ``rhs``, ``gill`` and ``project``."""
    rows = gill_rows(model)
    writes = [(rows.a, model.acceleration)]
    if model.remembering:
        for place, name in ((rows.penetration, "penetration"), (rows.approach, "approach")):
            writes.append((place, _of_contacts(model, name, model.remembering)))
    if model.bristles.contacts:
        switches = [ca.SX(1) if i < 0 else model.contacts[i].switch for i in model.bristles.contacts]
        writes.append((rows.switch, ca.vertcat(*switches)))
    return _code(model, rows, "rhs", [], writes, model.jam, gill_step(rows))


def adaptive_code(
    model: Model, scales: Sequence[float], recorded: tuple[int, ...], rates: Sequence[float] | None = None
) -> KernelCode:
    """Print a model for error-controlled steps: ``prepare``, ``begin``, the step, ``project`` and others.

    Parameters
    ----------
    model : Model
    scales : sequence of float
        Sizes of the coordinates that errors are compared with; n numbers.
    recorded : tuple of int
        Coordinates with dense output.
    rates : sequence of float, optional
        Those of the velocities, of implicit steps: ``rosenbrock`` in place of ``dopri``, and ``jacobian``.
    """
    rows = (adaptive_rows if rates is None else rosenbrock_rows)(model, len(recorded))
    reads = [(rows.touching, model.touching)]
    writes = [(rows.a, model.held_acceleration)]
    if model.contacts:
        for place, name in (
            (rows.switch, "switch"), (rows.penetration, "penetration"), (rows.approach, "approach"),
        ):  # fmt: skip
            writes.append((place, _of_contacts(model, name, range(len(model.contacts)))))
    jam = ca.SX(0) if model.rubbing is None else model.rubbing.jam
    if rates is None:
        step, jacobian = dopri_step(rows, recorded, scales), None
    else:
        step, jacobian = rosenbrock_step(rows, recorded, scales, rates), jacobian_of(model)
    steps = (begin_step(rows), step, suspect_step(rows), advance_step(rows))
    return _code(model, rows, "held", reads, writes, jam, "\n".join(steps), jacobian)


def _compile(code: KernelCode, names: tuple[str, ...]) -> Kernel:
    address = native.load(code.text)
    project = address("project") if code.constrained else 0
    functions = (address("prepare"), *map(address, names[:2]), project, *map(address, names[2:]))
    return Kernel(code.rows, functions, code.operations, native.content_key(code.text))


def compile_model(model: Model) -> Kernel:
    """Compile a model for Runge-Kutta-Gill, or load it from the disk cache.

    Raises
    ------
    SettingsError
        The cache directory cannot be used.
    """
    return _compile(kernel_code(model), ("rhs", "gill"))


def compile_adaptive(
    model: Model, scales: Sequence[float], recorded: tuple[int, ...], rates: Sequence[float] | None = None
) -> Kernel:
    """Compile a model for error-controlled steps, see :func:`adaptive_code`.

    Raises
    ------
    SettingsError
        The cache directory cannot be used.
    """
    names = ("begin", "dopri" if rates is None else "rosenbrock", "suspect", "advance")
    return _compile(adaptive_code(model, scales, recorded, rates), names)
