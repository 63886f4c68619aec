"""Everything that is remarked of a machine: what its file may say and hardly means, of the drawing and of how it moves.

Nothing here is refused: a remark names the part, the value and what is implausible, for whoever wrote the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.positions import change_point_remarks, grips_of
from jointplay.solver.cases.preparation import find_stiff_part, standing_model
from jointplay.solver.cases.rates import without_dry_friction
from jointplay.solver.cases.reach import reach_of
from jointplay.solver.cases.steps import RESIDUE, Suspension, suspension_of
from jointplay.solver.equations.drive import drive_rates
from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import ForceDrive, RotationDrive, TorqueDrive
from jointplay.solver.machines.remarks import drawing_remarks, film_remarks, restitution_remarks

#: Orders that every crank shakes its frame with, by masses that go round and to and fro; those of the shipped
#: slider-crank above are a fiftieth of them.
MAIN_ORDERS = (1.0, 2.0)
#: A frequency of the frame is known to this part at best: stiffness of mounts to a tenth.
LEAST_WIDTH = 0.05
#: Damping ratio from which on a mode has no peak: its answer is less than 3 dB above that at rest, sin 22.5 deg.
NO_PEAK = math.sin(math.pi / 8)
#: A motion counts as held by springs above this part of the stiffest, in squares of frequencies: less is rounding.
_HELD = 1e-12
#: What implicit steps of `standard` were seen to be off where the motion repeats: docs/measured/solver.md.
_IMPLICIT = (
    "steps are implicit: the model stays whole, their error is the tolerance's (less than 0.1 dB of a harmonic, as "
    "measured where motions repeat); `--method adaptive` keeps explicit ones"
)


def find_remarks(machine: Machine, fault: Fault = HEALTHY) -> list[str]:
    """Find what is implausible in a machine, or makes it stiff, one line each; nothing in most.

    Parameters
    ----------
    machine : Machine
        That can be assembled.
    fault : Fault
        Clearances with which it is to run.

    Raises
    ------
    AssemblyError
        It cannot, at some angle of its drive.
    """
    reach = reach_of(machine)
    felt, worn = reach.machine, reach.case(Case(fault)).fault
    stiff = find_stiff_part(felt, worn, Settings().sample_rate)
    return [
        *drawing_remarks(machine),
        *change_point_remarks(machine, (), {}),
        *_freedom_remarks(felt),
        *_suspension_remarks(felt),
        *_wedging_remarks(felt),
        *restitution_remarks(machine, machine.wearing_joints),
        *film_remarks(machine, machine.turning_joints),
        *([f"{stiff}: {_IMPLICIT}"] if stiff else []),
    ]


@dataclass(frozen=True)
class SuspensionMode:
    """How the frame swings on its supports, the machine standing as drawn.

    Parameters
    ----------
    motion : str
        That has most of its energy: x, y, theta, or a mode of the frame.
    frequency : float
        Hz; 0 where it comes back without swinging.
    damping_ratio : float
        1 where it does not swing.
    """

    motion: str
    frequency: float
    damping_ratio: float


def suspension_modes(machine: Machine) -> list[SuspensionMode]:
    """Find how the frame swings on its supports, by frequency; nothing for one that no spring holds."""
    found = [
        SuspensionMode(motion, abs(mode) / (2 * math.pi) if mode.imag else 0.0, min(1.0, -mode.real / abs(mode)))
        for motion, mode in _modes_of(machine)
    ]
    return sorted(found, key=lambda mode: (mode.frequency, mode.motion))


def _modes_of(machine: Machine) -> Iterator[tuple[str, complex]]:
    """Modes of the frame on its supports, as :func:`_modes` gives them."""
    if machine.supports:
        model = standing_model(without_dry_friction(machine), (), ())
        yield from _modes(suspension_of(model, model.vector({})))


def _freedom_remarks(machine: Machine) -> Iterator[str]:
    """Motions that neither are the frame's nor follow from the drive."""
    if machine.drive is None:
        return
    model = standing_model(machine, (), ())
    forced = isinstance(machine.drive, (TorqueDrive, ForceDrive))
    free = model.degrees_of_freedom - len(model.frame_coordinates) - forced
    if free > 0:
        motions = f"{free} motion{'s' * (free > 1)} of links besides the frame's"
        yield f"drive: {motions} do{'es' * (free == 1)} not follow from it; is a joint missing?"


def _suspension_remarks(machine: Machine) -> Iterator[str]:
    """Modes of the frame on its supports that do not swing, or that an order of the drive meets."""
    speed = abs(drive_rates(machine, {})[0]) / (2 * math.pi) if machine.supports else 0.0
    for motion, mode in _modes_of(machine):
        if not mode.imag:
            what = f"it does not swing, it needs {math.log(RESIDUE) / mode.real:.3g} s to come back to {RESIDUE:.0%}"
            yield f"supports: motion of {machine.frame} in {motion}: over-damped: {what}; is the damping in N s/m?"
            continue
        frequency, ratio = abs(mode) / (2 * math.pi), -mode.real / abs(mode)
        for order in sorted(strong_orders(machine)) if speed and ratio < NO_PEAK else ():
            if abs(order * speed - frequency) <= max(ratio, LEAST_WIDTH) * frequency:
                what = (
                    f"in the resonance of {machine.frame} in {motion} at {frequency:.3g} Hz, damping ratio {ratio:.2g}"
                )
                yield f"drive: order {order:g} is at {order * speed:.3g} Hz, {what}"


def _modes(suspension: Suspension) -> Iterator[tuple[str, complex]]:
    """Modes that springs hold, 1/s, each with the motion that has most of its energy.

    One of each conjugate pair; of motions that do not swing the slow half of their real numbers.
    """
    if not suspension.motions:
        return
    stiffness, damping = (-0.5 * (part + part.T) for part in suspension.gradients)
    squares, shapes = linalg.eigh(stiffness, suspension.mass)
    held = squares > _HELD * squares[-1]
    squares, shapes = squares[held], shapes[:, held]
    n = len(squares)
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(squares), -shapes.T @ damping @ shapes]])
    modes, vectors = np.linalg.eig(system)
    creeping = np.flatnonzero(modes.imag == 0)
    slow = creeping[modes[creeping].real.argsort()[len(creeping) // 2 :]]
    for k in (*slow, *np.flatnonzero(modes.imag > 0)):
        energies = np.abs(shapes @ vectors[:n, k]) ** 2 * np.diag(suspension.mass)
        yield suspension.motions[int(energies.argmax())], complex(modes[k])


def strong_orders(machine: Machine) -> set[float]:
    """Orders with which the drive shakes the frame: the main ones, and those that the file gives itself."""
    orders = {*MAIN_ORDERS, *(float(load.order) for load in machine.loads if load.order is not None)}
    orders |= {part.order for support in machine.supports for part in support.motion if part.order is not None}
    if isinstance(machine.drive, RotationDrive):
        orders |= {ripple.order for ripple in machine.drive.ripple if ripple.amplitude}
    return orders


def _wedging_remarks(machine: Machine) -> Iterator[str]:
    """Guides whose friction holds them whatever pushes: what it adds to the normal force is no less than that force."""
    for name, (grip, gone) in grips_of(machine).items():
        joint = machine.joints[name]
        if grip >= 1 and isinstance(joint, SlidingJoint):
            turned = isinstance(machine.drive, RotationDrive)
            where = f"after {math.degrees(gone):.0f} deg of the drive" if turned else "as drawn"
            what = f"times its leverage on the normal force {grip:.3g} {where}; from 1 on a guide wedges"
            yield f"joints.{name}.friction: {joint.friction:g}: {what} where its load presses it on"
