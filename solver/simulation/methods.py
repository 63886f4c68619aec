"""Methods for teaching and cross-checks: the paper's whole system of equations, and Gill's steps halved by their error.

Both take more time than the usual ones and are no more accurate; what they share with them is as little as can be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.cases.case import Method, Settings, Status
from jointplay.solver.cases.preparation import Prepared
from jointplay.solver.cases.rates import error_scales
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.equations.links import expand, expanded_state
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.integrators import gill
from jointplay.solver.integrators.kernel import Kernel, compile_model
from jointplay.solver.machines.machine import Machine, keep_by_machine
from jointplay.solver.simulation.runs import (
    Run,
    adaptive_runs,
    describe_failure,
    even_runs,
    gill_group,
    gill_kernel,
    gill_runs,
    tolerance_of,
)

#: Time over which steps have one length, s; at least that between two recorded samples, and only that where this many
#: steps between them are not enough: where a contact begins, the error falls with the step alone.
BLOCK, CROWDED = 2e-4, 64
#: Most steps between two recorded samples; beyond, there is none that is small enough.
MOST_STEPS = 2**20
#: What halving a step of fourth order leaves of its error, and how much of it the difference of both results is.
_LEFT = 1.0 / 16.0


@keep_by_machine(16)
def _full_kernel(machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...]) -> Kernel:
    return compile_model(expand(machine, joints, varying))


def full_runs(
    machine: Machine, model: Model, varying: tuple[str, ...], prepared: Sequence[Prepared], recorded: Sequence[int],
    settings: Settings,
) -> Iterator[Run]:  # fmt: skip
    """The paper's [A]{B} = {C}: three accelerations of every link and the reactions of every joint, by Gill's steps.

    Nothing is eliminated but by the solution of the system itself, whose zeros are known beforehand and left out.
    Parameters as :func:`jointplay.solver.simulation.runs.gill_runs`; of the frame only. Where a run ended is said in
    coordinates of the links, and this method goes on from there.
    """
    full = expand(machine, model.clearance_joints, varying)
    assert full.parameters == model.parameters and full.remembering == model.remembering
    state = expanded_state(model, full)

    def expanded(case: Prepared) -> Prepared:
        if case.z.size == full.size != model.size:
            return case
        z, v = (part.ravel() for part in evaluate(state, [case.begin], case.z, case.v, case.vector))
        return replace(case, z=z, v=v)

    places = full.frame_coordinates
    kernel = _full_kernel(machine, model.clearance_joints, varying)
    yield from even_runs(full, kernel, [expanded(case) for case in prepared], places, settings)


@dataclass
class HalvedSteps:
    """Gill's steps of which the error is known: each block of time is integrated anew with half the step until both
    results agree.

    It takes and gives what :func:`jointplay.solver.integrators.gill.integrate` does, for one case in all lanes.

    Parameters
    ----------
    tolerance : float
        Of the error of a block, in parts of `sizes`.
    sizes : (2 n,) array
        Of coordinates and velocities.
    steps : int
        Accepted ones so far.
    stalled : bool
        Whether no step was small enough.
    """

    tolerance: float
    sizes: FloatArray
    steps: int = 0
    stalled: bool = False

    def __call__(
        self, functions: Any, work: FloatArray, first: Any, begins: FloatArray, h: float, substeps: int,
        record: IntArray, out: FloatArray, broken: IntArray, counts: IntArray, finals: FloatArray,
    ) -> None:  # fmt: skip
        """Integrate, from recorded sample to recorded sample in `substeps` steps at first."""
        interval, last, at = h * substeps, out.shape[2] - 1, 0
        longest = max(1, round(BLOCK / interval))
        while True:
            count = min(longest, last - at)
            start, coarse = work.copy(), None
            while True:
                if substeps > CROWDED and count > 1:
                    count, coarse = 1, None
                work[:] = start
                part = np.zeros((LANES, len(record), count + 1))
                gill.integrate(
                    functions, work, first, begins + at * interval, interval / substeps, substeps, record, part,
                    broken, np.full(LANES, count + 1), finals,
                )  # fmt: skip
                fine = None if broken[0] >= 0 else finals[0, 2:].copy()
                error = np.inf
                if fine is not None and coarse is not None:
                    error = float(np.max(np.abs(fine - coarse) / self.sizes)) * _LEFT / (1.0 - _LEFT)
                if error <= self.tolerance or substeps >= MOST_STEPS or count == 0:
                    break
                coarse, substeps = fine, 2 * substeps
            out[:, :, at : at + count + 1] = part
            self.steps += substeps * count
            self.stalled = fine is not None and count > 0 and not error <= self.tolerance
            if self.stalled:
                broken[:] = at
            elif fine is None:
                broken += at
            at += count
            if fine is None or self.stalled or at == last:
                return
            # The next block begins with twice the step, and four times where the error leaves room for it.
            substeps = max(1, substeps // (4 if error < 0.5 * _LEFT * self.tolerance else 2))


def halved_runs(
    machine: Machine, model: Model, varying: tuple[str, ...], prepared: Sequence[Prepared], recorded: Sequence[int],
    settings: Settings,
) -> Iterator[Run]:  # fmt: skip
    """Runge-Kutta-Gill with a variable step; parameters as :func:`jointplay.solver.simulation.runs.gill_runs`."""
    kernel = gill_kernel(machine, model.clearance_joints, varying)
    scales = np.array(error_scales(machine, model))
    for case in prepared:
        steps = HalvedSteps(tolerance_of(case, settings), np.concatenate([scales, scales / case.pace]))
        for run in gill_group(model, kernel, [case], recorded, 1, settings, steps):
            spent = max(1, run.samples - 1) * run.step
            run = replace(run, step=spent / max(1, steps.steps))
            if steps.stalled:
                where = f"no step was small enough at {spent:.6g} s"
                message = describe_failure(where, "", "another tolerance or method")
                run = replace(run, status=Status.STEP_TOO_SMALL, message=message)
            yield run


RUNS: dict[Method, Callable[..., Iterator[Run]]] = {
    "adaptive": adaptive_runs,
    "rosenbrock": adaptive_runs,
    "gill": gill_runs,
    "gill-variable": halved_runs,
    "full": full_runs,
}
