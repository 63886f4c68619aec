"""What a held-out recording is of: a machine with worn joints, drawn from a seed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from jointplay.catalogue.evaluation.elsewhere import Disturbance, Flaw
from jointplay.catalogue.evaluation.response import Response
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.solver.machines.joints import Contact, TurningJoint
from jointplay.solver.machines.machine import Machine

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
