"""Where everything is and how it moves, from the positions and velocities of all links; written by hand, NumPy only."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from oracle.tables import shift

from jointplay.solver.machines.joints import Contact, SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import PositionDrive, Support

Array = NDArray[np.float64]
Point: TypeAlias = tuple[float, float]


def across(vector: Array) -> Array:
    """k x vector: a quarter turn counter-clockwise."""
    return np.array([-vector[1], vector[0]])


def cross(a: Array, b: Array) -> float:
    """k . (a x b)."""
    return float(a[0] * b[1] - a[1] * b[0])


@dataclass(frozen=True)
class Slide:
    """A sliding pair: links, unit vectors along and across the line (fixed in the guide), and the gap d.

    d goes from the guide's point to the slider's point, both drawn at the joint; `point` is the slider's, in space.
    """

    slider: int
    guide: int
    along: Array
    normal: Array
    point: Array
    gap: Array
    gap_rate: Array
    omega: float

    @property
    def rate(self) -> float:
        """Sliding velocity in the rotating guide: u . d' + u' . d with u' = w n."""
        return float(self.along @ self.gap_rate + self.omega * (self.normal @ self.gap))

    @property
    def normal_rate(self) -> float:
        """Rate of the normal distance: n . d' + n' . d with n' = -w u."""
        return float(self.normal @ self.gap_rate - self.omega * (self.along @ self.gap))


#: Of surfaces with bristles, by joint (``G.2`` for the third corner of a block): their deflection, and 1 or -1 where
#: they slip.
Held: TypeAlias = Mapping[str, tuple[float, float]]


class State:
    """Positions and velocities (N, 3) of the links of a machine, in the order of the file, what is held, and the
    coordinates of the frame's modes with their rates (m, 2), all 0 unless given.

    A frame with modes moves near a point that carries something as a body does that is displaced and turned there.
    """

    def __init__(
        self, machine: Machine, positions: Array, velocities: Array, held: Held | None = None, bent: Array | None = None
    ) -> None:
        self.machine, self.positions, self.velocities, self.held = machine, positions, velocities, held or {}
        self.names = list(machine.links)
        self.bent = np.zeros((len(machine.modes), 2)) if bent is None else bent

    def index(self, link: str) -> int:
        return self.names.index(link)

    def shapes(self, i: int, at: Point) -> tuple[Array, Array]:
        """Displacements (m, 2), in space, and rotations (m,) by the modes at a point of link i; 0 but for the frame."""
        count = len(self.machine.modes)
        if self.names[i] != self.machine.frame or not count:
            return np.zeros((count, 2)), np.zeros(count)
        found = [next(point for point in mode.shape if point.at == at) for mode in self.machine.modes]
        return np.array([self.turned(i, p.displacement) for p in found]), np.array([p.rotation for p in found])

    def angle(self, i: int, at: Point) -> float:
        """Angle of link i at a point of it."""
        return float(self.positions[i, 2] + self.shapes(i, at)[1] @ self.bent[:, 0])

    def omega(self, i: int, at: Point) -> float:
        """Its rate."""
        return float(self.velocities[i, 2] + self.shapes(i, at)[1] @ self.bent[:, 1])

    def turned(self, i: int, vector: Point, at: Point | None = None) -> Array:
        """A vector drawn on link i, as it has turned; near a point of it."""
        angle = self.positions[i, 2] if at is None else self.angle(i, at)
        c, s = math.cos(angle), math.sin(angle)
        return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])

    def point(self, i: int, drawn: Point, at: Point | None = None) -> Array:
        """Where a point of link i is that was drawn at `drawn`, near a point that carries something."""
        near = at or drawn
        cg = self.machine.links[self.names[i]].cg
        rigid = self.positions[i, :2] + self.turned(i, (near[0] - cg[0], near[1] - cg[1]))
        bent = rigid + self.bent[:, 0] @ self.shapes(i, near)[0]
        return bent + self.turned(i, (drawn[0] - near[0], drawn[1] - near[1]), near)

    def velocity_at(self, i: int, point: Array, at: Point) -> Array:
        """Velocity of the matter of link i at a point in space, near where `at` was drawn."""
        near = self.point(i, at)
        velocity = self.velocities[i, :2] + self.velocities[i, 2] * across(near - self.positions[i, :2])
        return velocity + self.bent[:, 1] @ self.shapes(i, at)[0] + self.omega(i, at) * across(point - near)

    def velocity(self, i: int, drawn: Point) -> Array:
        """Velocity of a point of link i that was drawn at `drawn`."""
        return self.velocity_at(i, self.point(i, drawn), drawn)

    def shift(self, support: Support, t: float) -> tuple[Array, Array]:
        """Displacement of the ground end of a support since drawn and its rate."""
        by_angle = any(part.order is not None for part in support.motion)
        return shift(support.motion, t, *(self.drive_motion() if by_angle else (0.0, 0.0)))

    def slide(self, joint: SlidingJoint) -> Slide:
        i, j = (self.index(link) for link in joint.links)
        along = self.turned(j, joint.direction, joint.at)
        gap = self.point(i, joint.at) - self.point(j, joint.at)
        rate = self.velocity(i, joint.at) - self.velocity(j, joint.at)
        omega = self.omega(j, joint.at)
        return Slide(i, j, along, across(along), self.point(i, joint.at), gap, rate, omega)

    def drive_motion(self) -> tuple[float, float]:
        """Relative rotation, or travel, of the drive's joint or link since drawn, and its rate."""
        drive = self.machine.drive
        assert drive is not None
        if isinstance(drive, PositionDrive):
            i, cg, along = self.index(drive.link), self.machine.links[drive.link].cg, np.array(drive.direction)
            return float(along @ (self.point(i, cg) - cg)), float(along @ self.velocity(i, cg))
        joint = self.machine.joints[drive.joint]
        if isinstance(joint, SlidingJoint):
            slide = self.slide(joint)
            return float(slide.along @ slide.gap), slide.rate
        i, j = (self.index(link) for link in joint.links)
        angles, rates = ([of(link, joint.at) for link in (i, j)] for of in (self.angle, self.omega))
        return angles[0] - angles[1], rates[0] - rates[1]

    @property
    def momentum(self) -> Array:
        """Momentum along x and y, kg m/s, and its moment about the origin, kg m2/s, of all links that have a mass."""
        masses = [(link.mass or 0.0, link.inertia or 0.0) for link in self.machine.links.values()]
        parts = zip(masses, self.positions, self.velocities, strict=True)
        rows = [(m * v[0], m * v[1], m * (p[0] * v[1] - p[1] * v[0]) + i * v[2]) for (m, i), p, v in parts]
        return np.sum(rows, axis=0)

    def energy(self, clearances: dict[str, float], t: float = 0.0) -> float:
        """Kinetic energy, weight, springs with their ends as they are at `t`, springs of contacts that touch, J."""
        total = 0.0
        for i, link in enumerate(self.machine.links.values()):
            if link.mass is not None and link.inertia is not None:
                vx, vy, w = self.velocities[i]
                total += 0.5 * link.mass * (vx * vx + vy * vy) + 0.5 * link.inertia * w * w
                total += link.mass * self.machine.gravity * self.positions[i, 1]
        for support in self.machine.supports:
            if support.kind == "damper":
                continue
            i = self.index(support.link)
            anchor = support.at if support.kind == "mount" else support.anchor
            base = np.array(anchor)
            if support.to_link is not None:
                base = self.point(self.index(support.to_link), anchor)
            gap = self.point(i, support.at) - base - self.shift(support, t)[0]
            if support.kind == "mount":
                total += 0.5 * float(np.array(support.stiffness) @ gap**2)
            else:
                total += 0.5 * support.stiffness * (math.hypot(*gap) - float(support.free_length or 0.0)) ** 2
        for mode, (q, rate) in zip(self.machine.modes, self.bent, strict=True):
            total += 0.5 * mode.mass * float(rate**2 + (2 * math.pi * mode.frequency * q) ** 2)
        for name, clearance in clearances.items():
            law = self.machine.joints[name].contact
            n = law.exponent or 1.0
            for contact in contacts(self, name, clearance):
                total += law.stiffness * max(0.0, contact.penetration) ** (n + 1) / (n + 1)
        return total


def hysteresis(contact: Contact, rate: float, began: float) -> float:
    """a of K d^n (1 + a d'), s/m; `began` is the velocity with which the contact began, 0 where it begins now."""
    if contact.law == "hertz":
        return float(contact.hysteresis or 0.0)
    e = float(contact.restitution or 0.0)
    c = {
        "hunt-crossley": 3 * (1 - e) / 2,
        "flores": 8 * (1 - e) / (5 * e),
        "gonthier": (1 - e**2) / e,
        "lankarani-nikravesh": 3 * (1 - e**2) / 4,
    }[contact.law]
    return c / (began or max(abs(rate), 1e-3))


def sliding_sign(law: Contact | SlidingJoint, slip: float, held: tuple[float, float] | None) -> float:
    """What stands for the sign of the slip; `held`: deflection of bristles, and 1 or -1 where they slip."""
    if law.friction_law == "tanh":
        return math.tanh(slip / law.friction_velocity)
    if law.friction_law == "threshold":
        return math.copysign(min(1.0, max(0.0, (abs(slip) / law.friction_velocity - 0.1) / 0.9)), slip)
    deflection, slips = held or (0.0, 0.0)
    return slips or min(1.0, max(-1.0, deflection + 1e-5 * slip / law.presliding))


def pushing(law: Contact, depth: float, rate: float, began: float) -> float:
    """Normal force of a contact law, which never pulls."""
    if depth <= 0:
        return 0.0
    if law.law == "linear":
        return max(0.0, law.stiffness * depth + law.damping * rate)
    loss = 1 + hysteresis(law, rate, began) * rate
    return max(0.0, law.stiffness * depth ** float(law.exponent or 0.0) * loss)


@dataclass(frozen=True)
class CornerState:
    """A corner of a block between two walls: links, the force on the block, where it acts, and how deep it is in."""

    block: int
    guide: int
    point: Array
    force: Array
    penetration: float
    normal_force: float

    @classmethod
    def all(
        cls, state: State, name: str, clearance: float, began: Mapping[str, float] | None = None
    ) -> list[CornerState]:
        joint = state.machine.joints[name]
        assert isinstance(joint, SlidingJoint) and joint.length is not None
        law, half = joint.contact, joint.height / 2
        i, j = (state.index(link) for link in joint.links)
        along, line = state.turned(j, joint.direction, joint.at), state.point(j, joint.at)
        normal, drawn = across(along), np.array(joint.direction)
        corners = []
        for s in (-joint.length / 2, joint.length / 2):
            for side in (-1, 1):
                key = f"{name}.{len(corners)}"
                x, y = np.array(joint.at) + s * drawn + side * half * across(drawn)
                point = state.point(i, (x, y), joint.at)
                depth = float(side * normal @ (point - line) - half - clearance)
                relative = state.velocity_at(i, point, joint.at) - state.velocity_at(j, point, joint.at)
                push = pushing(law, depth, float(side * normal @ relative), (began or {}).get(key, 0.0))
                slip = float(along @ relative)
                rub = law.friction * push * sliding_sign(law, slip, state.held.get(key)) + law.viscous * slip
                force = -side * push * normal - (rub if push > 0 else 0.0) * along
                corners.append(cls(i, j, point, force, depth, push))
        return corners


def contacts(state: State, name: str, clearance: float) -> Sequence[ContactState | CornerState]:
    """Of a worn joint: a pin has one, a block four."""
    if isinstance(state.machine.joints[name], SlidingJoint):
        return CornerState.all(state, name, clearance)
    return [ContactState.of(state, name, clearance)]


@dataclass(frozen=True)
class ContactState:
    """A pin in its socket: links, force on the pin, and the common contact point in space."""

    pin: int
    socket: int
    point: Array
    force: Array
    penetration: float
    normal_force: float

    @classmethod
    def of(cls, state: State, name: str, clearance: float, began: float = 0.0) -> ContactState:
        joint = state.machine.joints[name]
        assert isinstance(joint, TurningJoint)
        pin = state.index(joint.pin)
        socket = state.index(joint.links[0] if joint.pin == joint.links[1] else joint.links[1])
        law = joint.contact
        centre = state.point(pin, joint.at)
        e = centre - state.point(socket, joint.at)
        size = math.hypot(*e)
        if size <= clearance:
            return cls(pin, socket, centre, np.zeros(2), size - clearance, 0.0)
        n = e / size
        point = centre + joint.pin_radius * n
        rate = float(n @ (state.velocity(pin, joint.at) - state.velocity(socket, joint.at)))
        depth = size - clearance
        push = pushing(law, depth, rate, began)
        tangent = across(n)
        slip = float(tangent @ (state.velocity_at(pin, point, joint.at) - state.velocity_at(socket, point, joint.at)))
        rubbing = -(law.friction * push * sliding_sign(law, slip, state.held.get(name)) + law.viscous * slip)
        force = -push * n + (rubbing if push > 0 else 0.0) * tangent
        return cls(pin, socket, point, force, depth, push)
