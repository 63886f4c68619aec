"""A machine that no motion is prescribed to, in its limit cycle: where several runs of it start."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.cases.start import Start
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.simulate import simulate, simulate_batch
from jointplay.solver.spectra.by_angle import resample_by_angle

#: Revolutions by which it is told whether the frame comes back.
_REVOLUTIONS = 8.0


def find_limit_cycle(machine: Machine, case: Case, settings: Settings) -> History:
    """A record of a case in its limit cycle, from which :attr:`History.end` goes on.

    Parameters
    ----------
    machine : Machine
        Whose drive is a torque or a force.
    case : Case
    settings : Settings
        Accuracy, method and sample rate.

    Raises
    ------
    SettingsError
        It reaches none, or loads change in time.
    """
    asked = replace(
        settings, duration=None, revolutions=_REVOLUTIONS, links=False, motion=True, transient=False, settled=True
    )
    history = simulate(machine, case, asked)
    if history.status is not Status.OK or history.turning is None or not history.turning.is_steady:
        kind = "none" if machine.drive is None else machine.drive.kind
        told = history.message if history.status is Status.OK else f"{history.status}: {history.message}"
        raise SettingsError(f"{machine.name}: drive: {kind}: must reach a limit cycle for spectra in orders: {told}")
    repeating_frequency(machine, history.drive_speed)
    return history


def starts_in(
    machine: Machine, case: Case, settings: Settings, history: History, phases: Sequence[float],
    displacement: FloatArray, coordinates: Sequence[int | None],
) -> list[Start]:  # fmt: skip
    """Starts in a limit cycle.

    Parameters
    ----------
    machine, case, settings
        As for :func:`find_limit_cycle`.
    history : History
        Of that.
    phases : sequence of float
        Parts of a revolution by which each start is later than the first of them, growing.
    displacement : (m, 3) array
        Of the frame besides what it moves by, m and rad.
    coordinates : sequence of int or None
        Where these are, :attr:`~jointplay.solver.equations.model.Model.frame_indices`.
    """
    assert history.end is not None
    short = replace(settings, links=False, motion=False, settled=False, duration=1.0)
    starts, at, done = [], history.end, 0.0
    for phase, away in zip(phases, displacement, strict=True):
        if phase > done:
            further = replace(short, duration=(phase - done) * 2 * math.pi / abs(history.drive_speed))
            run = simulate_batch(machine, [case], further, starts=[at])[0]
            assert run.end is not None
            at, done = run.end, phase
        z = at.z.copy()
        for coordinate, part in zip(coordinates, away, strict=True):
            if coordinate is not None:
                z[coordinate] += part
        starts.append(replace(at, z=z))
    return starts


def samples_of_angle(history: History) -> int:
    """Samples of a revolution that are enough wherever the driver turns slowly."""
    assert history.turning is not None
    _, samples = resample_by_angle(np.zeros((len(history.t), 1)), history.turning.angle)
    return samples
