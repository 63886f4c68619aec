"""What the links of an ideal machine do to its frame in one revolution, and what further forces would add.

The links' motion relative to the frame is prescribed, so the frame with its links is one body on its supports: the
forces of inertia and weight of the links, and forces from outside wherever they act, move it as a wrench on a rigid
body does. That holds for the low orders, where play adds little.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.plans.driving import DRIVE_SPEED
from jointplay.catalogue.plans.variants import ProcessLoad, output_load
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine, keep_by_machine
from jointplay.solver.machines.parts import RotationDrive, TorqueDrive
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.bands import FEATURE_ORDERS

SAMPLES = 256
"""Points of a revolution: orders up to 20 need a fraction of them, rough loads more."""

MACHINES_KEPT = 8
"""Machines whose poses are kept, and what follows from them: 50 kB each."""


@dataclass(frozen=True, eq=False)
class Revolution:
    """Poses of the moving links at evenly spaced drive angles, the frame standing still.

    Parameters
    ----------
    machine : Machine
    speed : float
        rad/s.
    links : tuple of str
        Moving links.
    place : (n, k, 2) array
        Centres of gravity of k links [m].
    angle : (n, k) array
        Angles since the drawn pose [rad], without whole turns.
    turns : (k,) array
        Whole turns of each link in the revolution.
    """

    machine: Machine
    speed: float
    links: tuple[str, ...]
    place: FloatArray
    angle: FloatArray
    turns: FloatArray

    @classmethod
    def of(cls, machine: Machine, speed: float) -> Revolution:
        """Simulate it, or what has been simulated of it at another speed.

        Raises
        ------
        DiagnosisError
            The ideal machine does not come round.
        """
        return cls(machine, speed, *_poses(machine, pose_speed(machine, speed)))

    def inertial(self, factors: dict[str, float] | None = None) -> FloatArray:
        """Wrench (n, 3) of inertia and weight on the frame, masses of some links times a factor."""
        return self._inertial(self.place, self.angle, factors or {})

    def with_ripple(self, order: int, sine: float, cosine: float) -> FloatArray:
        """Wrench (n, 3) with a ripple [rad] of the drive angle."""
        at = 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES
        late = sine * np.sin(order * at) + cosine * np.cos(order * at)
        shift = np.sign(self.speed) * late
        place = np.stack([_shift(self.place[..., axis], shift) for axis in (0, 1)], axis=-1)
        angle = _shift(self.angle, shift) + self.turns * shift[:, None]
        return self._inertial(place, angle, {})

    def force(
        self, link: str, at: tuple[float, float], force: FloatArray, torque: FloatArray | float = 0.0
    ) -> FloatArray:
        """Wrench (n, 3) of a force (n, 2) at a point of a link, given where it was drawn, and a torque on it."""
        index = self.links.index(link)
        drawn = np.array(at) - np.array(self.machine.links[link].cg)
        even = 2.0 * math.pi * self.turns[index] * np.arange(SAMPLES) / SAMPLES
        angle = self.angle[:, index] + even
        arm = np.stack(
            [drawn[0] * np.cos(angle) - drawn[1] * np.sin(angle), drawn[0] * np.sin(angle) + drawn[1] * np.cos(angle)],
            axis=1,
        )
        return self._wrench(self.place[:, index] + arm, force, np.broadcast_to(torque, len(force)))

    def across(self, link: str, centre: tuple[float, float], at: tuple[float, float]) -> FloatArray:
        """Unit vectors (n, 2) across the arm of a link from one of its points to another."""
        index = self.links.index(link)
        turned = 2.0 * math.pi * self.turns[index] * np.arange(SAMPLES) / SAMPLES
        angle = self.angle[:, index] + turned + math.atan2(at[1] - centre[1], at[0] - centre[0])
        return np.column_stack([-np.sin(angle), np.cos(angle)])

    def rotating(self, centre: tuple[float, float], product: float, phase: float) -> FloatArray:
        """Wrench (n, 3) of a mass times radius [kg m] that turns with the drive about a point of the frame."""
        angle = np.sign(self.speed) * 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES + phase
        pull = product * self.speed**2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        weight = -product * (self.machine.gravity or 0.0) * np.cos(angle)
        return self._wrench(np.broadcast_to(centre, pull.shape), pull, weight)

    def velocity(self, link: str, direction: tuple[float, float]) -> FloatArray:
        """Velocity (n,) of a link's centre of gravity along a direction, m/s; of its angle where that is (0, 0)."""
        index = self.links.index(link)
        if direction == (0.0, 0.0):
            turning = _differentiate(self.angle[:, index], abs(self.speed)) + self.turns[index] * abs(self.speed)
            return np.asarray(turning, dtype=np.float64)
        return _differentiate(self.place[:, index] @ np.array(direction), abs(self.speed))

    def _inertial(self, place: FloatArray, angle: FloatArray, factors: dict[str, float]) -> FloatArray:
        total = np.zeros((SAMPLES, 3))
        for index, name in enumerate(self.links):
            body, factor = self.machine.links[name], factors.get(name, 1.0)
            mass, inertia = factor * (body.mass or 0.0), factor * (body.inertia or 0.0)
            motion = np.concatenate([place[:, index], angle[:, index, None]], axis=1)
            acceleration = _differentiate(_differentiate(motion, abs(self.speed)), abs(self.speed))
            push = -mass * acceleration[:, :2]
            push[:, 1] -= mass * (self.machine.gravity or 0.0)
            total += self._wrench(place[:, index], push, -inertia * acceleration[:, 2])
        return total

    def _wrench(self, at: FloatArray, force: FloatArray, torque: FloatArray) -> FloatArray:
        arm = at - np.array(self.machine.links[self.machine.frame].cg)
        moment = arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0] + torque
        return np.column_stack([force, moment])


def pose_speed(machine: Machine, speed: float) -> float:
    """Speed [rad/s] at which a machine has the poses that it has at another one: its own, turning the same way.

    The drive alone says where the links are, unless they have further freedoms than that, whose poses are its own.
    """
    moving = sum(name != machine.frame and not link.fixed for name, link in machine.links.items())
    freedoms = 3 * moving - 2 * len(machine.joints) - 1
    own = abs(float(getattr(machine.drive, "speed", 0.0)))
    return math.copysign(own, speed) if own and freedoms <= 0 else speed


@keep_by_machine(MACHINES_KEPT)
def _poses(machine: Machine, speed: float) -> tuple[tuple[str, ...], FloatArray, FloatArray, FloatArray]:
    """Moving links, with place (n, k, 2), angle (n, k) and turns (k,) as :class:`Revolution` has them."""
    frame = machine.links[machine.frame].model_copy(update={"fixed": True})
    links = {**machine.links, machine.frame: frame}
    changes: dict[str, Any] = {"links": links, "modes": (), "decoupled": False, "response": None}
    if isinstance(machine.drive, TorqueDrive):  # as if a motor turned evenly
        changes["drive"] = RotationDrive(joint=machine.drive.joint, speed=speed)
    held = machine.model_copy(update=changes)
    rate = SAMPLES * abs(speed) / (2.0 * math.pi)
    settings = Settings(sample_rate=rate, revolutions=1.0 + 2.0 / SAMPLES, links=True)
    history = next(iter(simulate_batch(held, [Case(parameters={DRIVE_SPEED: speed})], settings)))
    if history.status is not Status.OK or history.links is None:
        raise DiagnosisError(f"{machine.name} with its frame held: {history.status.value} {history.message}")
    moving = [index for index, name in enumerate(history.links.links) if name != machine.frame]
    last = history.links.displacement[-SAMPLES - 1 :, moving]
    names = tuple(history.links.links[index] for index in moving)
    drawn = np.array([machine.links[name].cg for name in names])
    turns = np.rint((last[-1, :, 2] - last[0, :, 2]) / (2.0 * math.pi))
    even = 2.0 * math.pi * turns * np.arange(SAMPLES)[:, None] / SAMPLES
    found = (last[:-1, :, :2] + drawn, last[:-1, :, 2] - even, turns)
    for each in found:
        each.flags.writeable = False
    return names, *found


def wrench_orders(wrench: FloatArray, orders: int) -> ComplexArray:
    """Complex amplitudes (orders, 3) of a wrench (n, 3) at orders 1 and up; its rms in an order is sqrt(2) of them."""
    found: ComplexArray = np.fft.rfft(wrench, axis=0)[1 : orders + 1] / len(wrench)
    return found


def _differentiate(values: FloatArray, speed: float) -> FloatArray:
    """Derivative in time of values (n, ...) over one revolution at a speed, rad/s."""
    spectrum = np.fft.rfft(values, axis=0)
    harmonic = 1j * speed * np.arange(len(spectrum)).reshape(-1, *(1,) * (values.ndim - 1))
    harmonic[-1] = 0.0  # half the sample rate has no sign
    return np.asarray(np.fft.irfft(spectrum * harmonic, len(values), axis=0), dtype=np.float64)


def _shift(values: FloatArray, shift: FloatArray) -> FloatArray:
    """Values (n, k) over one revolution, taken at angles later by a shift (n,), rad."""
    spectrum = np.fft.rfft(values, axis=0) / len(values)
    at = 2.0 * math.pi * np.arange(len(values)) / len(values) + shift
    basis = np.exp(1j * np.outer(at, np.arange(len(spectrum))))
    weight = np.full(len(spectrum), 2.0)
    weight[[0, -1]] = 1.0
    return np.asarray((basis @ (weight[:, None] * spectrum)).real, dtype=np.float64)


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
        FamilyWrench(name, unit, starts, split(one, other, speed), none)
        for (name, unit, starts, one, none), (*_, other, _) in zip(_over(slow), _over(fast), strict=True)
    ]
    return split(slow.inertial()[None], fast.inertial()[None], speed), tuple(families)


def split(slow: FloatArray, fast: FloatArray, speed: float) -> Wrench:
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
    starts = _turn(RIPPLES)
    for order in RIPPLE_ORDERS:
        two = [revolution.with_ripple(order, *each) - own for each in ((SMALL_RIPPLE, 0.0), (0.0, SMALL_RIPPLE))]
        yield f"ripple of the drive, order {order}", "rad", starts, np.array(two) / SMALL_RIPPLE, 0.0


def _turn(sizes: Sequence[float]) -> FloatArray:
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
    yield "unbalance", "kg m", product * _turn(UNBALANCES), np.array(two), 0.0


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
    if place.arm and (end := _end(machine, place)) != place.at:
        ways.append((end, revolution.across(place.link, place.at, end), 0.0))
    starts = weight * np.array(LOADS)[:, None]
    for name, course in courses.items():
        for at, direction, arm in ways:
            force, torque = np.asarray(course[:, None] * direction, np.float64), np.asarray(course * arm, np.float64)
            added = revolution.force(place.link, at, force, torque)
            yield name.replace("the other", "one stroke"), "N", starts, added[None], 0.0


def _end(machine: Machine, place: ProcessLoad) -> tuple[float, float]:
    """The joint of the output link that is farthest from where it turns."""
    return max(
        (each.at for each in machine.joints.values() if place.link in each.links),
        key=lambda at: math.dist(place.at, at),
    )


def output_forces(revolution: Revolution) -> tuple[str, tuple[float, float], FloatArray, FloatArray] | None:
    """Link, point and unit forces (n, 2) of the process on the output, and 1 where that moves so (n,), else 0.

    None where nothing but the driven link moves on the frame, or where that has no end.
    """
    place = output_load(revolution.machine)
    if place is None:
        return None
    forward = np.asarray(revolution.velocity(place.link, place.direction) > 0.0, np.float64)
    if not place.arm:
        return place.link, place.at, np.tile(np.asarray(place.direction, np.float64), (len(forward), 1)), forward
    end = _end(revolution.machine, place)
    if end == place.at:
        return None
    return place.link, end, revolution.across(place.link, place.at, end), forward


def drive_angle(revolution: Revolution) -> FloatArray:
    """Angles (n,) of the drive at the poses of a revolution, rad."""
    even = math.copysign(2.0 * math.pi, revolution.speed) * np.arange(SAMPLES) / SAMPLES
    driven = _driven(revolution.machine)
    if not driven:
        return even
    first = revolution.machine.joints[str(getattr(revolution.machine.drive, "joint", ""))].links[0]
    turned = float(revolution.angle[0, revolution.links.index(driven)])
    return even + (turned if first == driven else -turned)
