"""Where worn pins are in their sockets over one revolution of the drive, once the machine has settled."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import RotationDrive
from jointplay.solver.simulation.simulate import simulate

#: Evenly over the revolution, the drawn position first.
ORBIT = 360
#: Least rate of the samples between which pins are looked up, Hz.
_RATE = 4000.0


def pin_orbits(machine: Machine, fault: Fault) -> Mapping[str, FloatArray]:
    """Simulate a machine until it has settled, and follow its worn pins for one revolution more.

    Parameters
    ----------
    machine : Machine
    fault : Fault

    Returns
    -------
    mapping of str to (360, 2) array
        By worn turning joint: from the middle of its socket to that of its pin, m, global axes. None of a machine that
        is not turned at a constant speed, or whose simulation fails.
    """
    pins = [name for name in fault if isinstance(machine.joints[name], TurningJoint)]
    drive = machine.drive
    if not pins or not isinstance(drive, RotationDrive) or isinstance(drive.speed, tuple) or not drive.speed:
        return {}
    period = 2 * math.pi / abs(drive.speed)
    settings = Settings(
        revolutions=2.0, sample_rate=max(_RATE, ORBIT / period), links=True, settled=True, transient=False
    )
    history = simulate(machine, Case(fault), settings)
    if history.status is not Status.OK or history.links is None:
        return {}
    start = math.floor(history.t[-1] / period - 1) * period
    times = start + np.arange(ORBIT) * (period / ORBIT)
    found = {}
    for name in pins:
        joint = machine.joints[name]
        assert isinstance(joint, TurningJoint)
        socket = next(link for link in joint.links if link != joint.pin)
        places = []
        for link in (joint.pin, socket):
            assert link is not None
            x, y, turn = history.links.displacement[:, history.links.links.index(link)].T
            arm = complex(*joint.at) - complex(*machine.links[link].cg)
            places.append(x + 1j * y + arm * np.expm1(1j * turn))
        away = places[0] - places[1]
        found[name] = np.column_stack([np.interp(times, history.t, part) for part in (away.real, away.imag)])
    return found
