"""Force between pin and socket of a turning joint with clearance (the paper's impact pair, groups V and VIII)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca

from jointplay.solver.equations.contact_laws import NormalForce
from jointplay.solver.equations.numbers import Number
from jointplay.solver.equations.vectors import Complex

#: Squared eccentricity (m2) below which the contact normal has no meaning; there is no force there anyway (e <= c).
TINY = 1e-60


@dataclass(frozen=True)
class ContactNumbers:
    """Numbers of one clearance joint, constants or symbols; SI units."""

    clearance: Number
    friction: Number
    viscous: Number
    friction_velocity: Number
    pin_radius: Number


#: (penetration, approach) -> normal force: a law of :mod:`jointplay.solver.equations.contact_laws` with its numbers.
NormalLaw: TypeAlias = Callable[[ca.SX, ca.SX], NormalForce]


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
    touching: ca.SX,
) -> ContactForce:  # fmt: skip
    """A contact law along the normal, never attractive; regularised Coulomb and viscous friction across it.

    Parameters
    ----------
    e, e_rate : Complex
        Vector from socket centre to pin centre, m, and its rate, m/s, in the same axes.
    pin_omega, socket_omega : symbol
        Angular velocities of the two links, rad/s.
    numbers : ContactNumbers
    law : callable
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
    rubbing = numbers.friction * pushing * ca.tanh(slip / numbers.friction_velocity)
    rubbing += ca.if_else(touching > 0, numbers.viscous * slip, 0)
    on_pin = normal * Complex(-pushing, -rubbing)
    moment_on_socket = rubbing * arm_socket
    return ContactForce(
        on_pin, -rubbing * numbers.pin_radius, moment_on_socket, penetration, approach, normal_force.switch
    )
