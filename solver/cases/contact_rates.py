"""How fast a contact is, estimated before anything has moved: what fixed steps and first steps are chosen by."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from jointplay.solver.equations.contact_laws import SLOWEST_APPROACH
from jointplay.solver.equations.numbers import contact_path
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.restitution import HYSTERESIS, hysteresis_factor

#: Velocity (m/s) at which surfaces are taken to meet at least. The frequency follows its fifth root (n = 1.5).
_LEAST_IMPACT = 1.0


@dataclass(frozen=True)
class ContactRates:
    """Frequency, rad/s, and damping rate, 1/s, of one contact."""

    frequency: float
    decay: float


@lru_cache(maxsize=64)
def extent_of(machine: Machine) -> float:
    """Largest distance between joints and centres of gravity as drawn, m; 1 where all are in one place."""
    points = [joint.at for joint in machine.joints.values()] + [link.cg for link in machine.links.values()]
    return max((math.dist(p, q) for p in points for q in points), default=0.0) or 1.0


def contact_rates(
    machine: Machine, mobility: Mapping[str, float], values: Mapping[str, float], speed: float
) -> dict[str, ContactRates]:
    """Estimates for every clearance joint.

    Parameters
    ----------
    machine : Machine
    mobility : mapping of str to float
        Of each clearance joint, 1/kg.
    values : mapping of str to float
        Contact numbers by path; what is missing is 0.
    speed : float
        Fastest prescribed motion, rad/s.

    Notes
    -----
    The linear law has sqrt(K w) and C w. With K d^n both follow the penetration, and that the velocity v of the impact:
    w K D^(n+1) = (n + 1)/2 v^2 at the deepest point D, where the frequency is sqrt(n w K D^(n-1)). A pin that
    crosses its clearance c from side to side under the acceleration a arrives at 2 sqrt(a c); a is gravity and
    the machine's extent times the square of the drive's speed, and v no less than 1 m/s.
    """
    acceleration = abs(values.get("gravity", machine.gravity)) + extent_of(machine) * speed * speed
    return {joint: _rates(machine, joint, w, values, acceleration) for joint, w in mobility.items()}


def deepest_point(stiffness: float, exponent: float, speed: float) -> float:
    """Penetration D of an impact at `speed`, m, with k D^(n+1) = (n + 1)/2 v^2; k is stiffness times mobility."""
    return float((0.5 * (exponent + 1) * speed**2 / stiffness) ** (1 / (exponent + 1)))


def _rates(machine: Machine, joint: str, w: float, values: Mapping[str, float], acceleration: float) -> ContactRates:
    found = machine.joints[joint]
    assert isinstance(found, TurningJoint)
    law, n = found.contact.law, found.contact.exponent

    def number(name: str) -> float:
        return values.get(contact_path(joint, name), 0.0)

    stiffness, drag = number("stiffness") * w, number("viscous") * w
    if not stiffness:  # neither body can move: nothing swings
        return ContactRates(0.0, 0.0)
    if n is None:
        return ContactRates(math.sqrt(stiffness), number("damping") * w + drag)
    impact = max(_LEAST_IMPACT, 2 * math.sqrt(acceleration * number("clearance")))
    depth = deepest_point(stiffness, n, impact)
    force = stiffness * depth**n  # times mobility: an acceleration
    if law in HYSTERESIS:
        # An impact loses at the rate c F / v; a contact that began at a creep and is pressed since, at c a / v0.
        decay = hysteresis_factor(law, number("restitution")) * max(force / impact, acceleration / SLOWEST_APPROACH)
    else:
        decay = number("hysteresis") * force
    return ContactRates(math.sqrt(n * stiffness * depth ** (n - 1)), decay + drag)
