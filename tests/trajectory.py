"""Runs from any start: a pin that flies at its socket, a mass at its stop.

The product starts with pins concentric and the velocities of the ideal machine; some published cases do not. This is
the same compiled kernel, the same integrator and the same evaluation of links, started from given coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.compiler.ir import LANES
from jointplay.solver.equations.links import LinkMotion, link_motion
from jointplay.solver.equations.model import Model, build_model
from jointplay.solver.equations.numbers import contact_paths
from jointplay.solver.integrators.gill import integrate
from jointplay.solver.integrators.kernel import compile_model
from jointplay.solver.machines.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Samples (n,) in time; coordinates and rates (n, k); what contacts remember (n, m)."""

    model: Model
    p: list[float]
    t: Array
    z: Array
    v: Array
    memory: Array

    def coordinate(self, name: str) -> tuple[Array, Array]:
        """A coordinate and its rate, (n,) each."""
        k = self.model.kinematics.names.index(name)
        return self.z[:, k], self.v[:, k]

    @cached_property
    def motion(self) -> LinkMotion:
        """Of all links, and the reactions."""
        return link_motion(self.model, self.p, self.t, self.z, self.v, self.memory)


def trajectory(
    machine: Machine,
    clearances: Mapping[str, float],
    start: Mapping[str, tuple[float, float]],
    *,
    step: float,
    samples: int,
    steps_a_sample: int = 1,
) -> Trajectory:
    """Runge-Kutta-Gill from the named coordinates and rates in `start`; what is not named starts at 0, as drawn."""
    return trajectories(machine, [clearances], [start], step=step, samples=samples, steps_a_sample=steps_a_sample)[0]


def trajectories(
    machine: Machine,
    clearances: Sequence[Mapping[str, float]],
    starts: Sequence[Mapping[str, tuple[float, float]]],
    *,
    step: float,
    samples: int,
    steps_a_sample: int = 1,
    parameters: Sequence[Mapping[str, float]] = (),
) -> list[Trajectory]:
    """Up to eight runs side by side: the same worn joints, other clearances, starts and contact numbers."""
    # What the file has as 0 is folded into the equations unless it is said to vary.
    given = {path for one in parameters or () for path in one}
    usual = {path for joint in clearances[0] for path in contact_paths(machine, joint)} | {"drive.speed"}
    model = build_model(machine, clearances[0], sorted(given - usual))
    kernel = compile_model(model)
    names, rows, n = model.kinematics.names, kernel.rows, model.size
    vectors = []
    work = kernel.work_array()
    for lane in range(LANES):
        run = min(lane, len(starts) - 1)
        values = {f"joints.{joint}.clearance": c for joint, c in clearances[min(run, len(clearances) - 1)].items()}
        vectors.append(model.vector(values | dict(parameters[run] if parameters else {})))
        work[rows.parameters, lane] = vectors[-1]
        for name, (place, rate) in starts[run].items():
            k = names.index(name)
            work[rows.z[k], lane], work[rows.v[k], lane] = place, rate
    record = np.array([*rows.z, *rows.v, *range(rows.memory.start, rows.slips.stop)])
    out = np.zeros((LANES, record.size, samples))
    broken = np.zeros(LANES, dtype=np.int64)
    counts, finals = np.full(LANES, samples), np.zeros((LANES, 2 + 2 * n))
    integrate(
        kernel.functions, work, kernel.first, np.zeros(LANES), step, steps_a_sample, record, out, broken, counts, finals
    )  # fmt: skip
    assert (broken < 0).all()
    t = np.arange(samples) * step * steps_a_sample
    runs = []
    for lane in range(len(starts)):
        z, v, memory = (part.T.copy() for part in np.split(out[lane], [n, 2 * n]))
        runs.append(Trajectory(model, vectors[lane], t, z, v, memory))
    return runs
