"""Starts in the steady state of the healthy machine, which is cheap to simulate.

A worn machine that starts there has the motion of its suspension already, but for what the wear itself changes; what is
left to wait for is the contact's own transient.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import Case, History, Settings, Status
from jointplay.solver.cases.start import Start, start_with_frame, walk
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.machines.fault import HEALTHY
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.simulate import simulate

#: Samples of the healthy machine in a revolution: phases are met to a degree.
PHASES = 360
#: The healthy machine runs for so many times its transient, so that a ten-thousandth of that is left.
_PATIENCE = 2.0


def healthy_revolution(machine: Machine, case: Case, settings: Settings) -> History:
    """The last revolution of the healthy machine, :data:`PHASES` samples, after its transient.

    Parameters
    ----------
    machine : Machine
    case : Case
        Its fault is left out; its parameters count.
    settings : Settings
        Accuracy and method.

    Returns
    -------
    History
        Of status ok, or of the one that says why there is no steady state.

    Raises
    ------
    SettingsError
        A machine that does not come round.
    """
    healthy = replace(case, fault=HEALTHY)
    short = simulate(machine, healthy, replace(settings, duration=1e-3, links=False))
    if short.status is not Status.OK:
        return short
    revolution = 1 / repeating_frequency(machine, short.drive_speed)
    revolutions = math.ceil(_PATIENCE * short.transient / revolution - 1e-9) + 1
    found = simulate(
        machine, healthy,
        replace(settings, duration=revolutions * revolution, sample_rate=PHASES / revolution, links=False, step=None),
    )  # fmt: skip
    last = slice(-PHASES - 1, -1)
    return replace(
        found, t=found.t[last], displacement=found.displacement[last], velocity=found.velocity[last],
        acceleration=found.acceleration[last], band_limited_acceleration=found.band_limited_acceleration[last],
    )  # fmt: skip


def starts_at(
    machine: Machine,
    case: Case,
    settings: Settings,
    phases: Sequence[int],
    displacement: FloatArray,
    velocity: FloatArray,
) -> list[Start]:
    """Starts of a worn machine at given angles of its drive with its frame moving as given.

    Pins are concentric, and velocities the least mass-weighted that fulfil closures and drive.

    Parameters
    ----------
    machine : Machine
    case : Case
    settings : Settings
    phases : (m,) sequence of int
        Where in the revolution, in parts of :data:`PHASES`; the start's time is that part of the first revolution.
    displacement, velocity : (m, 3) arrays
        Of the frame (m, m, rad).

    Raises
    ------
    AssemblyError
        The machine does not close there.
    """
    group = next(groups(machine, [case], settings))
    for _, error in group.failed:
        raise error
    model, prepared = group.model, group.ready[0]
    poses = walk(model, prepared.vector, prepared.speed, PHASES)
    held = [column for column, index in enumerate(model.frame_indices) if index is not None]
    return [
        start_with_frame(model, prepared.vector, *poses[phase], displacement[i, held], velocity[i, held])
        for i, phase in enumerate(phases)
    ]
