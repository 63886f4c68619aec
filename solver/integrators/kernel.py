"""Models to kernels: machine code that evaluates eight cases side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from jointplay.solver.compiler import native
from jointplay.solver.compiler.emit import straight_line
from jointplay.solver.compiler.ir import DECLARATIONS, LANES
from jointplay.solver.compiler.layout import Layout
from jointplay.solver.equations.model import Model
from jointplay.solver.integrators.dopri import StepRows, dopri_step
from jointplay.solver.integrators.gill import gill_step

_ALIGNMENT = 64  # bytes: a row never straddles two cache lines


@dataclass(frozen=True)
class Kernel:
    """A compiled model.

    Attributes
    ----------
    layout : Layout
        Where everything is in the work array.
    functions : tuple of int
        Addresses of ``void f(double* work)``: ``prepare`` (what depends on the parameters alone), the right-hand side,
        one step of the method, and ``project``, the correction of coordinates and velocities that restores the
        closures (0 where nothing is to close).
    operations : int
        Vector operations of one right-hand side.
    key : str
        SHA-256 of code, processor and compiler.
    jam : int
        Row that a right-hand side sets to 1 where a sliding joint jams, and leaves else; -1 where none rubs.
    """

    layout: Layout
    functions: tuple[int, int, int, int]
    operations: int
    key: str
    jam: int

    def work_array(self) -> NDArray[np.float64]:
        """A zeroed, aligned work array."""
        spare = _ALIGNMENT // 8
        raw = np.zeros(self.layout.total + spare)
        skip = (-raw.ctypes.data % _ALIGNMENT) // 8
        return raw[skip : skip + self.layout.total]


@dataclass(frozen=True)
class KernelCode:
    """Source of a model, before compilation."""

    text: str
    layout: Layout
    operations: int
    constrained: bool
    jam: int = -1


def _simplified(name: str, symbols: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    """A function after elimination of common subexpressions."""
    return ca.Function(name, symbols, [ca.densify(out) for out in ca.cse(outputs)])


def _code(
    model: Model, layout: Layout, name: str, symbols: list[ca.SX], inputs: list[list[int]], outputs: list[ca.SX],
    targets: list[list[int]], step: str, jam: tuple[ca.SX, int],
) -> KernelCode:  # fmt: skip
    """Right-hand side `name`, projection, ``prepare`` and one step of a method; `jam` and the place of its row."""
    if model.rubbing is not None:
        met, place = ca.SX.sym("met"), [jam[1]]
        symbols, inputs = [*symbols, met], [*inputs, place]
        outputs, targets = [*outputs, ca.fmax(met, jam[0])], [*targets, place]
    simplified = _simplified(name, symbols, outputs)
    right = straight_line(simplified, inputs, targets, fixed_input=3, hoist_at=layout.hoist)
    functions = [right.body.function(name)]
    prepare, slots = right.hoisted, right.hoist_slots
    constrained = bool(model.kinematics.closures)
    if constrained:
        # Velocities at the corrected pose: else a residual of gap times speed stays in them.
        dz, _ = model.projection.call(symbols[:4])
        _, dv = model.projection.call([symbols[0], model.z + dz, *symbols[2:4]])
        project = straight_line(
            _simplified("project", symbols[:4], [model.z + dz, model.v + dv]), inputs[:4], inputs[1:3],
            fixed_input=3, hoist_at=layout.hoist + LANES * slots,
        )  # fmt: skip
        functions.append(project.body.function("project"))
        prepare.lines += project.hoisted.lines
        slots += project.hoist_slots
    functions += [prepare.function("prepare"), step]
    text = "\n".join([DECLARATIONS, *functions])
    row = -1 if model.rubbing is None else jam[1] // LANES
    return KernelCode(text, replace(layout, hoisted=slots), right.body.operations, constrained, row)


def kernel_code(model: Model) -> KernelCode:
    """Print a model for Runge-Kutta-Gill: ``prepare``, ``rhs``, ``gill`` and ``project``."""
    n, k, memories = model.size, len(model.parameters), len(model.remembering)
    layout = Layout(n, k, extra=2 * memories + (model.rubbing is not None), memories=memories)
    symbols = [model.t, model.z, model.v, model.p, model.memory]
    inputs = [
        [layout.time], layout.rows(layout.z, n), layout.rows(layout.v, n), layout.rows(layout.p, k),
        layout.rows(layout.memory, memories),
    ]  # fmt: skip
    outputs, targets = [model.acceleration], [layout.rows(layout.a, n)]
    at = layout.extra_at
    if memories:
        for name in ("penetration", "approach"):
            outputs.append(ca.vertcat(*(getattr(model.contacts[j], name) for j in model.remembering)))
            targets.append(layout.rows(at, memories))
            at += LANES * memories
    return _code(model, layout, "rhs", symbols, inputs, outputs, targets, gill_step(layout), (model.jam, at))


def adaptive_code(model: Model, scales: Sequence[float], recorded: tuple[int, ...]) -> KernelCode:
    """Print a model for error-controlled steps: ``prepare``, ``held``, ``dopri`` and ``project``.

    Parameters
    ----------
    model : Model
    scales : sequence of float
        Sizes of the coordinates that errors are compared with; n numbers.
    recorded : tuple of int
        Coordinates with dense output.
    """
    n, k, contacts = model.size, len(model.parameters), len(model.contacts)
    memories = len(model.remembering)
    extra = StepRows.count(n, contacts, len(recorded)) + (model.rubbing is not None)
    layout = Layout(n, k, extra=extra, memories=memories)
    rows = StepRows(layout, contacts, recorded)
    symbols = [model.t, model.z, model.v, model.p, model.touching, model.memory]
    inputs = [
        [layout.time], layout.rows(layout.z, n), layout.rows(layout.v, n), layout.rows(layout.p, k),
        layout.rows(rows.touching, contacts), layout.rows(layout.memory, memories),
    ]  # fmt: skip
    outputs, targets = [model.held_acceleration], [layout.rows(layout.a, n)]
    if contacts:
        for start, name in ((rows.switch, "switch"), (rows.penetration, "penetration"), (rows.approach, "approach")):
            outputs.append(ca.vertcat(*(getattr(contact, name) for contact in model.contacts)))
            targets.append(layout.rows(start, contacts))
    jam = (ca.SX(0) if model.rubbing is None else model.rubbing.jam, rows.jam)
    step = dopri_step(rows, scales)
    return _code(model, layout, "held", symbols, inputs, outputs, targets, step, jam)


def _compiled(code: KernelCode, names: tuple[str, str]) -> Kernel:
    address = native.load(code.text)
    project = address("project") if code.constrained else 0
    functions = (address("prepare"), address(names[0]), address(names[1]), project)
    return Kernel(code.layout, functions, code.operations, native.content_key(code.text), code.jam)


def compile_model(model: Model) -> Kernel:
    """Compile a model for Runge-Kutta-Gill, or load it from the disk cache.

    Raises
    ------
    SettingsError
        The cache directory cannot be used.
    """
    return _compiled(kernel_code(model), ("rhs", "gill"))


def compile_adaptive(model: Model, scales: Sequence[float], recorded: tuple[int, ...]) -> Kernel:
    """Compile a model for error-controlled steps, see :func:`adaptive_code`.

    Raises
    ------
    SettingsError
        The cache directory cannot be used.
    """
    return _compiled(adaptive_code(model, scales, recorded), ("held", "dopri"))
