"""Changes other than play that a machine may have, family by family, and what each makes of the frame's motion.

A family changes what acts on the frame (unbalance, process load, ripple of the drive, mass of a link) or the frame and
its supports (mass, a mount, all mounts). Its members differ by a number or two.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
import numpy.typing as npt

from catalogue.diagnosing.frame_forces import Revolution, wrench_orders
from catalogue.plans.variants import output_load
from catalogue.signals.suspension import accelerance
from catalogue.storage.feature_bands import FEATURE_ORDERS
from solver.machines.joints import TurningJoint
from solver.machines.machine import Machine
from solver.machines.parts import Mount

__all__ = ["Family", "IdealFrame", "families_of", "power_of"]

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

#: Factors on the stiffness of mounts that a search starts from.
STIFFNESSES = (0.02, 0.1, 0.3, 0.5, 0.7, 1.3, 2.0)
#: Factors on a mass that a search starts from.
MASSES = (0.5, 0.65, 0.8, 1.2, 1.5, 2.0)
#: Mass times radius that turns with the drive, as a part of the moving mass times the length of the driven link.
UNBALANCES = (0.02, 0.1, 0.5)
#: Process loads, as multiples of the weight of the moving links.
LOADS = (-8.0, -2.0, -0.5, 0.5, 2.0, 8.0)
#: Orders and amplitudes [rad] of a ripple of the drive.
RIPPLE_ORDERS, RIPPLES = (1, 2, 3, 4, 6, 8, 12), (5e-4, 3e-3, 2e-2)
#: Phases of what turns or swings with the drive, which the recording does not know.
PHASES = 2.0 * math.pi * np.arange(6) / 6
#: Standard deviation of the logarithm of a second factor, of damping or inertia, from what it usually is.
SECOND_FACTOR = 0.3


class Family(Protocol):
    """Changes of one kind."""

    @property
    def name(self) -> str:
        """As it is told."""

    @property
    def unit(self) -> str:
        """Of the size."""

    @property
    def starts(self) -> FloatArray:
        """Numbers (n, p) of the members that a search starts from."""

    def size(self, numbers: FloatArray) -> float:
        """What a member is told by."""

    def oddity(self, numbers: FloatArray) -> float:
        """Squared distance of its numbers from what such a change usually has, in standard deviations."""

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        """Numbers of frame and supports that a member has, by path."""

    def changed(self, power: ComplexArray, motion: ComplexArray, numbers: FloatArray) -> ComplexArray:
        """Cross-powers (K, 3, 3) after a change, of those before and of the ideal frame's motion (K, 3)."""

    def added(self, numbers: FloatArray) -> ComplexArray:
        """Cross-powers (K, 3, 3) of what is added to the motion, by itself; zero where nothing is."""


@dataclass(frozen=True, eq=False)
class _Forces:
    """What acts on the frame besides: numbers (p,) times motions (p, K, 3) that they add."""

    name: str
    unit: str
    starts: FloatArray
    basis: ComplexArray

    def size(self, numbers: FloatArray) -> float:
        return float(numbers[0]) if len(numbers) == 1 else float(np.linalg.norm(numbers))

    def oddity(self, numbers: FloatArray) -> float:
        return 0.0

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        return {}

    def changed(self, power: ComplexArray, motion: ComplexArray, numbers: FloatArray) -> ComplexArray:
        # Powers are mean squares, twice |amplitude|^2.
        new, own = np.tensordot(numbers, self.basis, 1)[:, :, None], motion[:, :, None]
        cross = own @ new.conj().swapaxes(1, 2)
        return np.asarray(power + 2.0 * (cross + cross.conj().swapaxes(1, 2)) + self.added(numbers))

    def added(self, numbers: FloatArray) -> ComplexArray:
        new = np.tensordot(numbers, self.basis, 1)
        return power_of(np.asarray(new, np.complex128))


@dataclass(frozen=True, eq=False)
class _Factor:
    """The frame or its supports: numbers of the machine with two factors, given by their logarithms.

    The second is usually the first to a power.
    """

    name: str
    unit: str
    starts: FloatArray
    model: IdealFrame
    usual: float
    numbers: Callable[[float, float], dict[str, float]]

    def size(self, numbers: FloatArray) -> float:
        return math.exp(float(numbers[0]))

    def oddity(self, numbers: FloatArray) -> float:
        return float((numbers[1] - self.usual * numbers[0]) / SECOND_FACTOR) ** 2

    def suspension(self, numbers: FloatArray) -> dict[str, float]:
        return self.numbers(*np.exp(numbers).tolist())

    def changed(self, power: ComplexArray, motion: ComplexArray, numbers: FloatArray) -> ComplexArray:
        model = self.model
        passed = accelerance(model.machine, self.suspension(numbers), model.frequency) @ model.inverse
        return np.asarray(passed @ power @ passed.conj().swapaxes(1, 2))

    def added(self, numbers: FloatArray) -> ComplexArray:
        return np.zeros((FEATURE_ORDERS, 3, 3), np.complex128)


@dataclass(frozen=True, eq=False)
class IdealFrame:
    """The machine as filed: motion (K, 3) of its ideal frame, its accelerance (K, 3, 3), and a revolution of links."""

    machine: Machine
    revolution: Revolution
    frequency: FloatArray
    accelerance: ComplexArray
    inverse: ComplexArray
    motion: ComplexArray

    @classmethod
    def of(cls, machine: Machine, speed: float) -> IdealFrame:
        """Simulate a revolution of a machine on its mounts at a speed, rad/s.

        Raises
        ------
        DiagnosisError
            The ideal machine does not come round.
        """
        revolution = Revolution.of(machine, speed)
        frequency = np.arange(1.0, FEATURE_ORDERS + 1.0) * (abs(speed) / (2.0 * math.pi))
        own = accelerance(machine, {}, frequency)
        motion = _moved(own, revolution.inertial())
        return cls(machine, revolution, frequency, own, np.asarray(np.linalg.inv(own), np.complex128), motion)

    def added(self, wrench: FloatArray) -> ComplexArray:
        """What a further wrench (n, 3) adds to the frame's motion."""
        return _moved(self.accelerance, wrench)


def power_of(motion: ComplexArray) -> ComplexArray:
    """Cross-powers (K, 3, 3) of a motion (K, 3): mean squares, twice those of its complex amplitudes."""
    return np.asarray(2.0 * motion[:, :, None] @ motion[:, None, :].conj(), np.complex128)


def _moved(accelerance: ComplexArray, wrench: FloatArray) -> ComplexArray:
    return np.asarray(np.einsum("kij,kj->ki", accelerance, wrench_orders(wrench, len(accelerance))), np.complex128)


def families_of(machine: Machine, model: IdealFrame) -> Iterator[Family]:
    """Yield every family that a machine may have."""
    # Rubber that is softer damps less, and a frame that is lighter is easier to turn.
    stiffnesses = np.log(STIFFNESSES)[:, None] * [1.0, 0.5]
    masses = np.log(MASSES)[:, None] * [1.0, 1.0]
    mounts = [index for index, support in enumerate(machine.supports) if isinstance(support, Mount)]
    for name, group in [*((f"mount {index}", [index]) for index in mounts), ("all mounts", mounts)]:
        yield _Factor(name, "x stiffness", stiffnesses, model, 0.5, partial(_mounts, machine, group))
    yield _Factor(f"mass of {machine.frame}", "x mass", masses, model, 1.0, partial(_frame, machine))
    revolution = model.revolution
    own = revolution.inertial()
    for link in revolution.links:
        if link == _driven(machine):
            continue  # a heavier crank is unbalance
        one = model.added(revolution.inertial({link: 2.0}) - own)
        yield _Mass(f"mass of {link}", "x mass", np.array(MASSES)[:, None] - 1.0, one[None])
    yield from _unbalances(machine, model)
    yield from _loads(machine, model)
    small = 1e-4
    starts = _turned(RIPPLES)
    for order in RIPPLE_ORDERS:
        parts = [model.added(revolution.rippled(order, *each)) - model.motion for each in ((small, 0.0), (0.0, small))]
        yield _Forces(f"ripple of the drive, order {order}", "rad", starts, np.array(parts) / small)


class _Mass(_Forces):
    """Mass of a link: the number is what its factor is above 1."""

    def size(self, numbers: FloatArray) -> float:
        return 1.0 + float(numbers[0])


def _turned(sizes: Sequence[float]) -> FloatArray:
    """Sine and cosine parts (n, 2) of every size with every phase."""
    return np.array([[size * math.sin(phase), size * math.cos(phase)] for size in sizes for phase in PHASES])


def _mounts(machine: Machine, group: Sequence[int], factor: float, damping: float) -> dict[str, float]:
    """Numbers of mounts whose stiffness has a factor, and whose damping another one."""
    found: dict[str, float] = {}
    for index in group:
        mount = machine.supports[index]
        assert isinstance(mount, Mount)
        for axis in (0, 1):
            found[f"supports.{index}.stiffness.{axis}"] = factor * mount.stiffness[axis]
            found[f"supports.{index}.damping.{axis}"] = damping * mount.damping[axis]
    return found


def _frame(machine: Machine, mass: float, inertia: float) -> dict[str, float]:
    """Numbers of a frame whose mass has a factor, and whose inertia another one."""
    link = machine.links[machine.frame]
    return {
        f"links.{machine.frame}.mass": mass * (link.mass or 0.0),
        f"links.{machine.frame}.inertia": inertia * (link.inertia or 0.0),
    }


def _driven(machine: Machine) -> str:
    """Link that turns on the frame with the drive; empty where what turns does not turn on the frame."""
    joint = machine.joints[str(getattr(machine.drive, "joint", ""))]
    others = [name for name in joint.links if name != machine.frame]
    return others[0] if len(others) == 1 else ""


def _unbalances(machine: Machine, model: IdealFrame) -> Iterator[Family]:
    driven = _driven(machine)
    if not driven:
        return
    joint = machine.joints[str(getattr(machine.drive, "joint", ""))]
    others = [each.at for each in machine.joints.values() if isinstance(each, TurningJoint) and driven in each.links]
    length = max(math.dist(joint.at, at) for at in others)
    product = length * sum(machine.links[name].mass or 0.0 for name in model.revolution.links)
    parts = [model.added(model.revolution.rotating(joint.at, 1.0, phase)) for phase in (0.0, 0.5 * math.pi)]
    yield _Forces("unbalance", "kg m", product * _turned(UNBALANCES), np.array(parts))


def _loads(machine: Machine, model: IdealFrame) -> Iterator[Family]:
    """Loads of the process on the output link: constant, and over either half of its way.

    On a link that turns, both a torque and a force across the end of its arm.
    """
    place = output_load(machine)
    if place is None:
        return
    revolution = model.revolution
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
            added = model.added(revolution.force(place.link, at, force, torque))
            yield _Forces(name.replace("the other", "one stroke"), "N", starts, added[None])
