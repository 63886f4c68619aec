"""What the joints, locks and drive of a machine allow, by hand: the judge of a state, not of its accelerations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from oracle.state import Array, State
from oracle.tables import prescribed

from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import MotionDrive


def lacking(
    machine: Machine, clearances: Mapping[str, float], t: float, positions: Array, velocities: Array,
    bent: Array | None = None,
) -> float:  # fmt: skip
    """Most that positions (m, rad) and velocities (m/s, rad/s) lack to fulfil every ideal joint, lock and drive."""
    state = State(machine, positions, velocities, bent=bent)
    gaps: list[float] = [0.0]
    for name, joint in machine.joints.items():
        i, j = (state.index(link) for link in joint.links)
        if name in clearances:
            continue
        if isinstance(joint, SlidingJoint):
            slide = state.slide(joint)
            gaps += [float(slide.normal @ slide.gap), slide.normal_rate]
            gaps += [of(i, joint.at) - of(j, joint.at) for of in (state.angle, state.omega)]
        else:
            gaps += list(state.point(i, joint.at) - state.point(j, joint.at))
            gaps += list(state.velocity(i, joint.at) - state.velocity(j, joint.at))
    for i, k in blocked_motions(machine):
        drawn = (*list(machine.links.values())[i].cg, 0.0)[k]
        gaps += [positions[i, k] - drawn, velocities[i, k]]
    if isinstance(machine.drive, MotionDrive):
        gaps += [a - b for a, b in zip(state.drive_motion(), prescribed(machine.drive, t), strict=False)]
    return float(np.abs(gaps).max())


def blocked_motions(machine: Machine) -> list[tuple[int, int]]:
    """Motions that cannot be, as (link, 0 | 1 | 2 for x | y | theta)."""
    names = ("x", "y", "theta")
    links = list(machine.links.values())
    return [(i, k) for i, link in enumerate(links) for k in range(3) if link.fixed or names[k] in link.locked]
