"""What may act on a frame besides the links of its machine: wrenches of unbalance, loads, ripple, and heavier links.

The poses of the ideal links do not depend on the speed: a wrench is a part that does not either, of weight and loads,
and one that goes with the square of the speed, of inertia. Both are kept by machine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointplay.catalogue.diagnosing.frame_forces import MACHINES_KEPT, Revolution, pose_speed, wrench_orders
from jointplay.catalogue.plans.variants import output_load
from jointplay.catalogue.storage.feature_bands import FEATURE_ORDERS
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.kept import keep_by_machine
from jointplay.solver.machines.machine import Machine

#: Factors on the mass of a link that a search starts from.
MASSES = (0.5, 0.65, 0.8, 1.2, 1.5, 2.0)
#: Mass times radius that turns with the drive, as a part of the moving mass times the length of the driven link.
UNBALANCES = (0.02, 0.1, 0.5)
#: Process loads, as multiples of the weight of the moving links.
LOADS = (-8.0, -2.0, -0.5, 0.5, 2.0, 8.0)
#: Orders and amplitudes [rad] of a ripple of the drive.
RIPPLE_ORDERS, RIPPLES = (1, 2, 3, 4, 6, 8, 12), (5e-4, 3e-3, 2e-2)
#: Ripple [rad] whose wrench is in proportion to it.
SMALL_RIPPLE = 1e-4
#: Phases of what turns or swings with the drive, which the recording does not know.
PHASES = 2.0 * math.pi * np.arange(6) / 6


@dataclass(frozen=True, eq=False)
class Wrench:
    """Wrenches of one or more causes of unit size, in orders 1 to K.

    Parameters
    ----------
    still : (p, K, 3) array
        Complex amplitudes [N, N, N m] that do not depend on the speed.
    square : (p, K, 3) array
        Those that go with its square, for 1 rad/s.
    """

    still: ComplexArray
    square: ComplexArray

    def at(self, speed: float) -> ComplexArray:
        """Complex amplitudes (p, K, 3) at a speed, rad/s."""
        return self.still + speed**2 * self.square


@dataclass(frozen=True, eq=False)
class FamilyWrench:
    """A family of further forces: numbers (p,) times wrenches of unit size.

    Parameters
    ----------
    name, unit : str
    starts : (n, p) array
        Numbers of the members that a search starts from.
    wrench : Wrench
    none : float
        Size of a member whose numbers are zero.
    """

    name: str
    unit: str
    starts: FloatArray
    wrench: Wrench
    none: float = 0.0


#: Name, unit, starts (n, p), wrenches over a revolution (p, N, 3), and size where there is no change.
_Over = tuple[str, str, FloatArray, FloatArray, float]


def family_wrenches(machine: Machine, speed: float) -> tuple[Wrench, tuple[FamilyWrench, ...]]:
    """Return what the links make at a speed [rad/s], and every family of further forces.

    Raises
    ------
    DiagnosisError
        The ideal machine does not come round.
    """
    return _family_wrenches(machine, pose_speed(machine, speed))


@keep_by_machine(MACHINES_KEPT)
def _family_wrenches(machine: Machine, speed: float) -> tuple[Wrench, tuple[FamilyWrench, ...]]:
    slow = Revolution.of(machine, speed)
    fast = replace(slow, speed=2.0 * speed)
    families = [
        FamilyWrench(name, unit, starts, _split(one, other, speed), none)
        for (name, unit, starts, one, none), (*_, other, _) in zip(_over(slow), _over(fast), strict=True)
    ]
    return _split(slow.inertial()[None], fast.inertial()[None], speed), tuple(families)


def _split(slow: FloatArray, fast: FloatArray, speed: float) -> Wrench:
    """Parts of wrenches (p, N, 3) at a speed and at twice the speed."""
    one, other = (np.array([wrench_orders(each, FEATURE_ORDERS) for each in parts]) for parts in (slow, fast))
    square = (other - one) / (3.0 * speed**2)
    return Wrench(one - speed**2 * square, square)


def _over(revolution: Revolution) -> Iterator[_Over]:
    """Yield every family that a machine may have, over a revolution at its speed."""
    machine, own = revolution.machine, revolution.inertial()
    for link in revolution.links:
        if link == _driven(machine):
            continue  # a heavier crank is unbalance
        more = revolution.inertial({link: 2.0}) - own
        yield f"mass of {link}", "x mass", np.array(MASSES)[:, None] - 1.0, more[None], 1.0
    yield from _unbalances(revolution)
    yield from _loads(revolution)
    starts = _turned(RIPPLES)
    for order in RIPPLE_ORDERS:
        two = [revolution.rippled(order, *each) - own for each in ((SMALL_RIPPLE, 0.0), (0.0, SMALL_RIPPLE))]
        yield f"ripple of the drive, order {order}", "rad", starts, np.array(two) / SMALL_RIPPLE, 0.0


def _turned(sizes: Sequence[float]) -> FloatArray:
    """Sine and cosine parts (n, 2) of every size with every phase."""
    return np.array([[size * math.sin(phase), size * math.cos(phase)] for size in sizes for phase in PHASES])


def _driven(machine: Machine) -> str:
    """Link that turns on the frame with the drive; empty where what turns does not turn on the frame."""
    joint = machine.joints[str(getattr(machine.drive, "joint", ""))]
    others = [name for name in joint.links if name != machine.frame]
    return others[0] if len(others) == 1 else ""


def _unbalances(revolution: Revolution) -> Iterator[_Over]:
    machine = revolution.machine
    driven = _driven(machine)
    if not driven:
        return
    joint = machine.joints[str(getattr(machine.drive, "joint", ""))]
    others = [each.at for each in machine.joints.values() if isinstance(each, TurningJoint) and driven in each.links]
    length = max(math.dist(joint.at, at) for at in others)
    product = length * sum(machine.links[name].mass or 0.0 for name in revolution.links)
    two = [revolution.rotating(joint.at, 1.0, phase) for phase in (0.0, 0.5 * math.pi)]
    yield "unbalance", "kg m", product * _turned(UNBALANCES), np.array(two), 0.0


def _loads(revolution: Revolution) -> Iterator[_Over]:
    """Loads of the process on the output link: constant, and over either half of its way.

    On a link that turns, both a torque and a force across the end of its arm.
    """
    machine = revolution.machine
    place = output_load(machine)
    if place is None:
        return
    weight = 9.81 * sum(machine.links[name].mass or 0.0 for name in revolution.links)
    forward = revolution.velocity(place.link, place.direction) > 0.0
    courses = {"load": np.ones(len(forward)), "load on one stroke": 1.0 * forward, "load on the other": 1.0 * ~forward}
    along = np.broadcast_to(place.direction, (len(forward), 2))
    ways = [(place.at, along, place.arm)]
    ends = [each.at for each in machine.joints.values() if place.link in each.links and each.at != place.at]
    if place.direction == (0.0, 0.0) and ends:
        end = max(ends, key=lambda at: math.dist(place.at, at))
        ways.append((end, revolution.across(place.link, place.at, end), 0.0))
    starts = weight * np.array(LOADS)[:, None]
    for name, course in courses.items():
        for at, direction, arm in ways:
            force, torque = np.asarray(course[:, None] * direction, np.float64), np.asarray(course * arm, np.float64)
            added = revolution.force(place.link, at, force, torque)
            yield name.replace("the other", "one stroke"), "N", starts, added[None], 0.0
