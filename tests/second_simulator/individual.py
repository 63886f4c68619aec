"""One machine as it stands somewhere: what differs from its file, and how it turns while it is recorded."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from second_simulator.machine import Array, Contact, Machine
from second_simulator.sensors import Chain
from second_simulator.turning import Ripple, drawn_wander

#: Radial clearance [m] of a joint as new, and of one that is worn.
AS_NEW, WORN = (3e-6, 15e-6), (80e-6, 800e-6)
#: Share by which the drive's mean speed is off, and by which it wanders.
SPEED_ERROR, WANDER = 0.02, 0.0035

Shaking = Callable[["Individual", Array, np.random.Generator], Array]


@dataclass
class Individual:
    """A machine of its own numbers, what is the matter with it, and the loggers' chain of its sensors.

    ``causes`` are plain: name, target, size, unit. ``shaking`` gives forces and torques (n, 3) on the frame at times.
    ``course`` are times [s] of the recording and factors on the drive speed, linear between; then it ends with them.
    """

    filed: Machine
    machine: Machine
    clearances: dict[str, float]
    speed: float
    wander: Array
    chain: Chain
    worn: dict[str, float] = field(default_factory=dict)
    ripple: list[Ripple] = field(default_factory=list)
    causes: list[dict[str, Any]] = field(default_factory=list)
    disturbance: str = ""
    shaking: Shaking | None = None
    revolutions: float = 40.0
    longest: float = math.inf
    course: Sequence[tuple[float, float]] = ()
    notes: dict[str, Any] = field(default_factory=dict)

    def wear(self, worn: Mapping[str, float]) -> None:
        """Give joints a radial clearance [m] of wear."""
        self.worn.update(worn)
        self.clearances.update(worn)

    def blame(self, name: str, target: str = "", size: float = 0.0, unit: str = "") -> None:
        """Note a cause other than wear."""
        self.causes.append({"name": name, "target": target, "size": size, "unit": unit})


def log_uniform(draw: np.random.Generator, low: float, high: float) -> float:
    """A number between two, even on a logarithmic scale."""
    return float(math.exp(draw.uniform(math.log(low), math.log(high))))


def drawn_contact(draw: np.random.Generator, spread: float = 1.0) -> Contact:
    """Numbers of one of the two laws."""
    rubs = {"friction": draw.uniform(0.02, 0.12), "friction_velocity": log_uniform(draw, 5e-3, 12e-3)}
    if draw.random() < 0.5:
        stiffness, damping = 1e7 * math.exp(spread * draw.normal(0, 0.3)), 300 * math.exp(spread * draw.normal(0, 0.35))
        return Contact("linear", stiffness, damping, **rubs)
    return Contact(
        "hertz", log_uniform(draw, 1.4e9 / spread, 4e9 * spread), 0.0, restitution=draw.uniform(0.5, 0.85), **rubs
    )


def scattered_contacts(machine: Machine, contact: Contact, draw: np.random.Generator) -> Machine:
    """The same law in every joint, with numbers that differ a little from joint to joint."""
    contacts = {}
    for name in machine.pins:
        stiffness, friction = np.exp(draw.normal(0, 0.1, 2))
        contacts[name] = replace(contact, stiffness=contact.stiffness * stiffness, friction=contact.friction * friction)
    return replace(machine, contacts=contacts)


def erred(machine: Machine, draw: np.random.Generator) -> Machine:
    """The machine with numbers that a file has slightly wrong: frame 2 to 3 %, mounts 3 %, dampers 10 %, links 1 %."""
    bodies = {}
    for name, body in machine.bodies.items():
        mass, inertia = (0.02, 0.03) if name == machine.frame else (0.01, 0.01)
        bodies[name] = replace(
            body,
            mass=body.mass * math.exp(draw.normal(0, mass)),
            inertia=body.inertia * math.exp(draw.normal(0, inertia)),
        )
    mounts = []
    for mount in machine.mounts:
        stiff, damp = np.exp(draw.normal(0, 0.03)), np.exp(draw.normal(0, 0.1))
        stiffness = (mount.stiffness[0] * stiff, mount.stiffness[1] * stiff)
        mounts.append(replace(mount, stiffness=stiffness, damping=(mount.damping[0] * damp, mount.damping[1] * damp)))
    return replace(machine, bodies=bodies, mounts=tuple(mounts))


def drawn_individual(filed: Machine, draw: np.random.Generator) -> Individual:
    """A sound machine: play as new in every turning joint, and the errors that every recording has."""
    machine = scattered_contacts(erred(filed, draw), drawn_contact(draw), draw)
    assert filed.drive is not None
    return Individual(
        filed=filed,
        machine=machine,
        clearances={name: log_uniform(draw, *AS_NEW) for name in filed.pins},
        speed=filed.drive.speed * (1 + draw.uniform(-SPEED_ERROR, SPEED_ERROR)),
        wander=drawn_wander(draw, draw.uniform(0.001, WANDER)),
        chain=Chain.drawn(draw, [sensor.name for sensor in filed.sensors]),
    )


def recorded_anew(individual: Individual, draw: np.random.Generator) -> None:
    """Another recording of the same machine: speed and noise are drawn again, gains stay."""
    assert individual.filed.drive is not None
    individual.speed = individual.filed.drive.speed * (1 + draw.uniform(-SPEED_ERROR, SPEED_ERROR))
    individual.wander = drawn_wander(draw, draw.uniform(0.001, WANDER))
    chain = Chain.drawn(draw, list(individual.chain.gains))
    individual.chain = replace(chain, gains=individual.chain.gains)
