"""A machine as this simulator sees it: bodies in one drawing, and what acts between them. SI units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Point = tuple[float, float]

#: Points of a load's table over one turn of the drive.
TABLE = 720


@dataclass(frozen=True)
class Body:
    """A rigid body; `at` is its centre of gravity in the drawing. Infinite mass and inertia: it stands still."""

    mass: float
    inertia: float
    at: Point


@dataclass(frozen=True)
class Pin:
    """A turning joint: bodies that carry pin and socket, where, and the pin's radius."""

    pin: str
    socket: str
    at: Point
    radius: float


@dataclass(frozen=True)
class Guide:
    """A sliding joint: `slider` moves along a line in `rail`."""

    slider: str
    rail: str
    at: Point
    direction: Point
    friction: float = 0.0
    viscous: float = 0.0
    friction_velocity: float = 0.01


@dataclass(frozen=True)
class Mount:
    """A spring and damper in x and y from a point of a body to the ground, or to the same point of another body."""

    body: str
    at: Point
    stiffness: Point
    damping: Point
    to: str = ""


@dataclass(frozen=True, eq=False)
class Load:
    """A force (global components) and torque on a body, table (TABLE, 3) over the drive's angle."""

    body: str
    at: Point
    table: Array


@dataclass(frozen=True)
class Sensor:
    """An accelerometer on the frame."""

    name: str
    at: Point
    direction: Point


@dataclass(frozen=True)
class Contact:
    """Contact of pin and socket.

    ``linear``: stiffness * d + damping * d'. ``hertz``: stiffness * d^1.5 (1 + 0.75 (1 - e^2) d' / v0), with e the
    restitution and v0 the speed at which the contact began (Lankarani and Nikravesh 1990). Friction is
    ``friction * F * v / sqrt(v^2 + friction_velocity^2)``.
    """

    law: str = "linear"
    stiffness: float = 1.0e7
    damping: float = 300.0
    restitution: float = 0.7
    friction: float = 0.05
    friction_velocity: float = 0.01


@dataclass(frozen=True)
class Drive:
    """Joint whose first body turns against its second at a mean speed."""

    joint: str
    driven: str
    base: str
    speed: float


@dataclass(frozen=True)
class Machine:
    """All of it; `contacts` has one for every turning joint."""

    name: str
    frame: str
    bodies: Mapping[str, Body]
    pins: Mapping[str, Pin]
    guides: Mapping[str, Guide]
    contacts: Mapping[str, Contact]
    mounts: tuple[Mount, ...] = ()
    loads: tuple[Load, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    drive: Drive | None = None
    gravity: float = 9.81

    @property
    def names(self) -> list[str]:
        """Bodies in the order of their coordinates."""
        return list(self.bodies)

    @property
    def moving(self) -> list[str]:
        """Bodies but the frame."""
        return [name for name in self.bodies if name != self.frame]

    @property
    def moving_mass(self) -> float:
        """Of all bodies but the frame, kg."""
        return sum(self.bodies[name].mass for name in self.moving)

    def with_body(self, name: str, **numbers: Any) -> Machine:
        """The machine with other numbers of one body."""
        return replace(self, bodies={**self.bodies, name: replace(self.bodies[name], **numbers)})

    def with_contact(self, contact: Contact) -> Machine:
        """The machine with the same contact in every joint."""
        return replace(self, contacts=dict.fromkeys(self.pins, contact))


def constant(force: Point, torque: float = 0.0) -> Array:
    """Table of a load that does not change."""
    return np.tile([force[0], force[1], torque], (TABLE, 1))
