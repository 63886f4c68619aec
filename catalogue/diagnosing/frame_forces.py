"""What the links of an ideal machine do to its frame in one revolution, and what further forces would add.

The links' motion relative to the frame is prescribed, so the frame with its links is one body on its supports: the
forces of inertia and weight of the links, and forces from outside wherever they act, move it as a wrench on a rigid
body does. That holds for the low orders, where play adds little.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.plans.parameters import DRIVE_SPEED
from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.cases.history import Case, Settings, Status
from jointplay.solver.machines.kept import keep_by_machine
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.simulate import simulate_batch

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

    def rippled(self, order: int, sine: float, cosine: float) -> FloatArray:
        """Wrench (n, 3) with a ripple [rad] of the drive angle."""
        at = 2.0 * math.pi * np.arange(SAMPLES) / SAMPLES
        late = sine * np.sin(order * at) + cosine * np.cos(order * at)
        shift = np.sign(self.speed) * late
        place = np.stack([_shifted(self.place[..., axis], shift) for axis in (0, 1)], axis=-1)
        angle = _shifted(self.angle, shift) + self.turns * shift[:, None]
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
            turning = _derived(self.angle[:, index], abs(self.speed)) + self.turns[index] * abs(self.speed)
            return np.asarray(turning, dtype=np.float64)
        return _derived(self.place[:, index] @ np.array(direction), abs(self.speed))

    def _inertial(self, place: FloatArray, angle: FloatArray, factors: dict[str, float]) -> FloatArray:
        total = np.zeros((SAMPLES, 3))
        for index, name in enumerate(self.links):
            body, factor = self.machine.links[name], factors.get(name, 1.0)
            mass, inertia = factor * (body.mass or 0.0), factor * (body.inertia or 0.0)
            motion = np.concatenate([place[:, index], angle[:, index, None]], axis=1)
            acceleration = _derived(_derived(motion, abs(self.speed)), abs(self.speed))
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
    held = machine.model_copy(update={"links": {**machine.links, machine.frame: frame}})
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


def _derived(values: FloatArray, speed: float) -> FloatArray:
    """Derivative in time of values (n, ...) over one revolution at a speed, rad/s."""
    spectrum = np.fft.rfft(values, axis=0)
    harmonic = 1j * speed * np.arange(len(spectrum)).reshape(-1, *(1,) * (values.ndim - 1))
    harmonic[-1] = 0.0  # half the sample rate has no sign
    return np.asarray(np.fft.irfft(spectrum * harmonic, len(values), axis=0), dtype=np.float64)


def _shifted(values: FloatArray, shift: FloatArray) -> FloatArray:
    """Values (n, k) over one revolution, taken at angles later by a shift (n,), rad."""
    spectrum = np.fft.rfft(values, axis=0) / len(values)
    at = 2.0 * math.pi * np.arange(len(values)) / len(values) + shift
    basis = np.exp(1j * np.outer(at, np.arange(len(spectrum))))
    weight = np.full(len(spectrum), 2.0)
    weight[[0, -1]] = 1.0
    return np.asarray((basis @ (weight[:, None] * spectrum)).real, dtype=np.float64)
