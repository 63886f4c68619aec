"""Force between pin and socket of a turning joint with clearance (the paper's impact pair, groups V and VIII).

The normal force is the paper's linear pair, or K d^n with hysteresis (d the penetration). The laws that take a
restitution remember v0, the velocity of approach when the contact began. That memory is a part of the state: 0 while
the surfaces are apart, and set when a step is accepted (see :mod:`jointplay.solver.integrators.control`) that has
brought them together; it stays until the penetration is gone, also where the force vanishes before. Within the step
that begins a contact the present velocity stands for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca

from jointplay.solver.equations.geometry import Complex
from jointplay.solver.equations.numbers import Number
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.restitution import HYSTERESIS, hysteresis_factor

#: Least velocity of approach (m/s) that counts as v0: hysteresis c/v0 would grow without bound where a contact begins
#: at a creep, and be stiff for nothing. Impacts slower than this lose less than the law says; measured in
#: ``docs/measured/solver.md``.
SLOWEST_APPROACH = 1e-3
#: Penetration (m) in place of none, so that powers have derivatives; the force there is nothing.
_LEAST = 1e-30


@dataclass(frozen=True)
class NormalForce:
    """Force along the normal, N, and the switch of :class:`ContactForce`, m."""

    elastic: ca.SX
    switch: ca.SX


def remembers(machine: Machine, joint: str) -> bool:
    """Whether the contact of a turning joint remembers the velocity of approach."""
    found = machine.joints[joint]
    return isinstance(found, TurningJoint) and found.contact.law in HYSTERESIS


def linear_force(stiffness: Number, damping: Number, penetration: ca.SX, approach: ca.SX) -> NormalForce:
    """K d + C d'."""
    elastic = stiffness * penetration + damping * approach
    # Nothing touches at e <= c, and a pair of surfaces cannot pull.
    return NormalForce(elastic, ca.fmin(penetration, elastic / stiffness))


def hertzian_force(
    stiffness: Number, exponent: float, hysteresis: Number, penetration: ca.SX, approach: ca.SX
) -> NormalForce:
    """K d^n (1 + a d'), a >= 0 in s/m."""
    loss = 1 + hysteresis * approach
    elastic = stiffness * power(ca.fmax(penetration, _LEAST), exponent) * loss
    return NormalForce(elastic, ca.fmin(penetration, penetration * loss))


def impact_hysteresis(law: str, restitution: Number, approach: ca.SX, memory: ca.SX) -> ca.SX:
    """a = c/v0 of a law that takes a restitution, s/m."""
    began = ca.if_else(memory > 0, memory, ca.fmax(ca.fabs(approach), SLOWEST_APPROACH))
    return hysteresis_factor(law, restitution) / began


def power(x: ca.SX, exponent: float) -> ca.SX:
    """x^n, x > 0: products and a root where n is a multiple of a half, as it mostly is."""
    whole = int(exponent)
    if exponent not in (whole, whole + 0.5):
        return ca.exp(exponent * ca.log(x))
    result = ca.sqrt(x) if exponent > whole else ca.SX(1)
    for _ in range(whole):
        result = result * x
    return result


#: Squared eccentricity (m2) below which the contact normal has no meaning; there is no force there anyway (e <= c).
TINY = 1e-60


@dataclass(frozen=True)
class ContactNumbers:
    """Numbers of one clearance joint, constants or symbols; SI units."""

    clearance: Number
    friction: Number
    viscous: Number
    pin_radius: Number


#: (penetration, approach) -> normal force: one of the laws above with its numbers.
NormalLaw: TypeAlias = Callable[[ca.SX, ca.SX], NormalForce]
#: Sliding velocity -> what stands for its sign in Coulomb's law.
SlidingSign: TypeAlias = Callable[[ca.SX], ca.SX]


@dataclass(frozen=True)
class ContactForce:
    """Force on the pin and the moments about both centres.

    Attributes
    ----------
    on_pin : Complex
        Force on the pin's link, N, in the axes of `e`; its opposite acts on the socket's link.
    moment_on_pin, moment_on_socket : casadi.SX
        Moments about the pin centre and about the socket centre, N m.
    penetration, approach : casadi.SX
        e - c, m, and its rate, m/s.
    switch : casadi.SX
        m; the surfaces push exactly where it is positive: penetration, or what the force makes of it if that is less.
    """

    on_pin: Complex
    moment_on_pin: ca.SX
    moment_on_socket: ca.SX
    penetration: ca.SX
    approach: ca.SX
    switch: ca.SX


def impact_pair(
    e: Complex, e_rate: Complex, pin_omega: Number, socket_omega: Number, numbers: ContactNumbers, law: NormalLaw,
    sign: SlidingSign, touching: ca.SX,
) -> ContactForce:  # fmt: skip
    """A contact law along the normal, never attractive; Coulomb and viscous friction across it.

    Parameters
    ----------
    e, e_rate : Complex
        Vector from socket centre to pin centre, m, and its rate, m/s, in the same axes.
    pin_omega, socket_omega : symbol
        Angular velocities of the two links, rad/s.
    numbers : ContactNumbers
    law, sign : callable
    touching : casadi.SX
        1 where the surfaces push, 0 where they do not: a symbol, replaced by ``switch > 0`` or held over a step.

    Notes
    -----
    Contact only at e > c, strictly. Both forces act at one point, the pin's surface at pin centre + r_pin n, so that
    the angular momentum of a free machine is kept; its arm about the socket centre is (e + r_pin) n.
    """
    eccentricity = ca.sqrt(ca.fmax(e.dot(e), TINY))
    normal = Complex(e.re / eccentricity, e.im / eccentricity)
    penetration = eccentricity - numbers.clearance
    approach = normal.dot(e_rate)
    normal_force = law(penetration, approach)
    # Selecting the normal force to zero takes friction and moments with it.
    pushing = ca.if_else(touching > 0, normal_force.elastic, 0)
    arm_socket = eccentricity + numbers.pin_radius
    # Velocity of the pin's body relative to the socket's at the common contact point, along the tangent (-n_y, n_x).
    slip = normal.cross(e_rate) + pin_omega * numbers.pin_radius - socket_omega * arm_socket
    rubbing = numbers.friction * pushing * sign(slip)
    rubbing += ca.if_else(touching > 0, numbers.viscous * slip, 0)
    on_pin = normal * Complex(-pushing, -rubbing)
    moment_on_socket = rubbing * arm_socket
    return ContactForce(
        on_pin, -rubbing * numbers.pin_radius, moment_on_socket, penetration, approach, normal_force.switch
    )
