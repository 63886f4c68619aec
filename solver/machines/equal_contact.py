"""The contact of a joint under another law, so that machines differ in their law and as little else as may be."""

from __future__ import annotations

import math
from typing import Literal

from jointplay.solver.machines.joints import Contact, Joint
from jointplay.solver.machines.machine import Machine

#: Penetration at which a fitted law is as stiff as the one it stands for, m (docs/reference/plan.md).
EQUAL_PENETRATION = 40e-6
#: Hysteresis of a Hertzian contact that stands for a linear one, s/m.
USUAL_HYSTERESIS = 3.0
#: Damping ratio of a linear contact that stands for another one, at the lighter link's mass.
DAMPING_RATIO = 0.1


def equal_contact(machine: Machine, joint: Joint, law: Literal["linear", "hertz"]) -> Contact:
    """The contact of a joint under a law, as stiff at :data:`EQUAL_PENETRATION`, its friction kept."""
    own = joint.contact
    if own.law == law:
        return own
    friction = {**own.own_friction, "viscous": own.viscous}
    if law == "hertz":
        secant = own.stiffness * EQUAL_PENETRATION ** ((own.exponent or 1.0) - 1.5)
        return Contact(law="hertz", stiffness=secant, hysteresis=USUAL_HYSTERESIS, **friction)
    stiffness = own.stiffness * EQUAL_PENETRATION ** ((own.exponent or 1.0) - 1.0)
    mass = min(machine.links[link].mass or 1.0 for link in joint.links)
    return Contact(stiffness=stiffness, damping=2 * DAMPING_RATIO * math.sqrt(stiffness * mass), **friction)
