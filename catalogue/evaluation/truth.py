"""What a held-out recording is of: a machine with worn joints, drawn from a seed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from jointplay.catalogue.evaluation.response import Response
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.plans.keys import seed_from
from jointplay.catalogue.plans.parameters import nominal_drive_speed
from jointplay.solver.machines.joints import Contact, TurningJoint
from jointplay.solver.machines.machine import Machine

if TYPE_CHECKING:
    from jointplay.catalogue.evaluation.elsewhere import Disturbance
    from jointplay.catalogue.evaluation.protocols import Protocol
    from jointplay.catalogue.evaluation.spoiling import Flaw

RESTITUTION = (0.5, 0.85)
"""Drawn restitutions, uniform."""


@dataclass(frozen=True)
class Truth:
    """What one held-out recording is of.

    Parameters
    ----------
    hypothesis : Hypothesis
        The true one.
    machine : Machine
        As it really is, which may differ from the catalogue's.
    clearances : mapping of str to float
        Radial clearance by joint, m.
    parameters : mapping of str to float
        Numbers that differ from `machine`, by path, SI.
    seconds : float
        Length of the recording.
    response : Response
        Of the structure between frame and sensors.
    gains : tuple of float
        Of the sensors, 1 for a true one.
    seed : int
        Of the noise.
    causes : tuple of str
        What differs beside play, in the words of answers; empty where no answer has a name for it.
    disturbance : Disturbance, optional
        What shakes the frame besides.
    flaw : Flaw, optional
        What is wrong with sensors or the recorder.
    """

    hypothesis: Hypothesis
    machine: Machine
    clearances: Mapping[str, float]
    parameters: Mapping[str, float]
    seconds: float
    response: Response = field(default_factory=Response)
    gains: tuple[float, ...] = ()
    seed: int = 0
    causes: tuple[str, ...] = ()
    disturbance: Disturbance | None = None
    flaw: Flaw | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with clearance: all turning joints."""
        return tuple(self.clearances)


def draw_truth(machine: Machine, hypothesis: Hypothesis, protocol: Protocol, seed: int, number: int) -> Truth:
    """Draw a machine of a hypothesis under the conditions of a protocol, without the protocol's differences.

    What is drawn follows from seed, hypothesis and number alone where protocols ask for the same ranges: so the
    recordings of two protocols differ only in what the protocols differ in.
    """
    draws = np.random.default_rng(seed_from("truth", seed, hypothesis.label, number))
    joints = tuple(sorted(machine.turning_joints))
    ranges = {joint: protocol.clearance if joint in hypothesis.joints else protocol.fits for joint in joints}
    clearances = {
        joint: float(math.exp(draws.uniform(math.log(low), math.log(high)))) for joint, (low, high) in ranges.items()
    }
    speed = nominal_drive_speed(machine) * (1.0 + float(draws.uniform(-protocol.speed, protocol.speed)))
    friction = {f"joints.{joint}.contact.friction": float(draws.uniform(*protocol.friction)) for joint in joints}
    parameters = {"drive.speed": speed, **friction, **drawn_contacts(machine, joints, protocol.scatter, draws)}
    return Truth(
        hypothesis=hypothesis,
        machine=machine,
        clearances=clearances,
        parameters=parameters,
        seconds=protocol.least_revolutions * 2.0 * math.pi / abs(speed),
        gains=(1.0,) * len(machine.sensors),
        seed=seed_from("noise", seed, hypothesis.label, number),
    )


def drawn_contacts(
    machine: Machine, joints: Sequence[str], scatter: float, draws: np.random.Generator
) -> dict[str, float]:
    """Draw the numbers of the contact law in every joint, by path: log-normal factors, uniform restitutions."""
    found: dict[str, float] = {}
    for joint in joints:
        contact = contact_of(machine, joint)
        for name in ("stiffness", "damping", "hysteresis", "restitution"):
            own = getattr(contact, name)
            deviate, uniform = float(draws.normal()), float(draws.uniform(*RESTITUTION))
            if own and contact.has(name):
                path = f"joints.{joint}.contact.{name}"
                found[path] = uniform if name == "restitution" else own * math.exp(scatter * deviate)
    return found


def contact_of(machine: Machine, joint: str) -> Contact:
    """Return the contact of a turning joint."""
    found = machine.joints[joint]
    assert isinstance(found, TurningJoint)
    return found.contact
