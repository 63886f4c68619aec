"""Worn machines that no motion is prescribed to, started in the limit cycle of the machine without wear.

That one is cheap to simulate, and runs up in place of the worn one: frame and driver start as they move there when the
driver is where it was drawn. What is left is what the wear changes of the mean speed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.preparation import Prepared
from jointplay.solver.cases.start import start_with_frame
from jointplay.solver.cases.steps import SETTLED_PART
from jointplay.solver.cases.turning import cycles
from jointplay.solver.equations.model import Model
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.limit_cycle import Driver, reach_limit_cycle, turning_at
from jointplay.solver.simulation.runs import OVERSAMPLING, Run
from jointplay.solver.spectra import sampling

#: Revolutions of the ideal machine in its limit cycle, at the end of which the worn one starts.
_REVOLUTIONS = 1.5


def start_turning(
    machine: Machine, model: Model, driver: Driver, ready: Sequence[Prepared], ideal: Sequence[Case],
    settings: Settings, runs: Callable[..., Iterator[Run]],
) -> list[Prepared]:  # fmt: skip
    """Give worn cases of a machine with a known effort a start near their limit cycle.

    Left as they are: machines without wear, drivers that slide, and machines in which more than driver and frame moves
    freely while nothing is worn. Where the ideal machine gives no start, the remark says so.

    Parameters
    ----------
    machine : Machine
    model : Model
        Of the cases.
    driver : Driver
        Of that model.
    ready : sequence of Prepared
        As drawn.
    ideal : sequence of Case
        The same without wear.
    settings : Settings
    runs : callable
        As for :func:`jointplay.solver.simulation.simulate.settle`.
    """
    if not (model.clearance_joints and driver.rotates):
        return list(ready)
    given = list(ready)
    short = replace(settings, revolutions=_REVOLUTIONS, motion=True, links=False, settled=False, repeating=False)
    for group in groups(machine, ideal, short, [case.accuracy for case in ready]):
        for place, error in group.failed:
            given[place] = _as_drawn(given[place], str(error))
        own, recorded = Driver(group.model), group.model.frame_coordinates
        if group.model.degrees_of_freedom != len(recorded) + 1:
            continue
        recorded += [i for i in own.coordinates if i not in recorded]
        kernel = (machine, group.model, group.varying)
        steady = []
        for case in reach_limit_cycle(*kernel, own, recorded, group.ready, short, runs):
            assert isinstance(case, Prepared)  # none of them starts near its limit cycle
            if case.unsteady:
                given[case.index] = _as_drawn(given[case.index], case.unsteady)
            else:
                steady.append(case)
        for run in runs(*kernel, steady, recorded, short):
            given[run.case.index] = _started(model, driver, given[run.case.index], own, run, recorded, settings)
    return given


def _as_drawn(case: Prepared, reason: str) -> Prepared:
    remark = f"run up as drawn: the machine without wear gave no start ({reason})"
    return replace(case, remark="; ".join(filter(None, (case.remark, remark))))


def _started(
    model: Model, driver: Driver, case: Prepared, own: Driver, run: Run, recorded: Sequence[int], settings: Settings
) -> Prepared:
    """A worn machine when the ideal one's driver comes by where that of the worn one was drawn, for the last time."""
    case = replace(case, spent=run.case.spent + run.seconds)
    if run.status is not Status.OK:
        return _as_drawn(case, f"{run.status}: {run.message}")
    assert run.z is not None
    rate = run.case.sample_rate
    position = own.position(recorded, run.z, run.case.vector)
    samples = np.arange(len(position), dtype=np.float64)
    last = float(cycles(samples, position - driver.at(case.z, case.vector), rotates=True)[0][-1])
    velocities = run.v[:, 0, sampling.head(OVERSAMPLING) :]
    frame = len(model.frame_coordinates)
    displacement, velocity = (
        np.array([np.interp(last, samples, row) for row in motion[:frame, : len(samples)]])
        for motion in (run.z, velocities)
    )
    speed = float(np.interp(last, samples, np.gradient(position) * rate))
    try:
        start = start_with_frame(
            model, case.vector, 0.0, case.z, displacement, velocity, driver.gradient(case.z, case.vector)[None], [speed]
        )
    except AssemblyError as error:
        return _as_drawn(case, str(error))
    case = turning_at(case, run.case.speed, settings)
    return replace(case, z=start.z, v=start.v, transient=SETTLED_PART * case.transient)
