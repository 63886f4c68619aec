"""Force between two surfaces of a joint with clearance (the paper's impact pair, groups V and VIII).

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

from jointplay.solver.equations.numbers import Number
from jointplay.solver.machines.restitution import hysteresis_factor

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


#: (penetration, approach) -> normal force: one of the laws above with its numbers.
NormalLaw: TypeAlias = Callable[[ca.SX, ca.SX], NormalForce]
#: Sliding velocity -> what stands for its sign in Coulomb's law.
SlidingSign: TypeAlias = Callable[[ca.SX], ca.SX]


@dataclass(frozen=True)
class ContactForce:
    """What two surfaces do to each other.

    Attributes
    ----------
    pushing, rubbing : casadi.SX
        Normal force, never negative, and the friction against the slip, N; 0 where they do not touch.
    penetration, approach : casadi.SX
        m, and its rate, m/s.
    switch : casadi.SX
        m; the surfaces push exactly where it is positive: penetration, or what the force makes of it if that is less.
    """

    pushing: ca.SX
    rubbing: ca.SX
    penetration: ca.SX
    approach: ca.SX
    switch: ca.SX


@dataclass(frozen=True)
class Surfaces:
    """Two surfaces that may touch: a law along the normal, never attractive; Coulomb and viscous friction across it.

    Attributes
    ----------
    law, sign : callable
    friction, viscous : symbol or float
        Coefficient; N s/m.
    touching : casadi.SX
        1 where they push, 0 where they do not: a symbol, replaced by ``switch > 0`` or held over a step.
    """

    law: NormalLaw
    sign: SlidingSign
    friction: Number
    viscous: Number
    touching: ca.SX

    def force(self, penetration: ca.SX, approach: ca.SX, slip: ca.SX) -> ContactForce:
        """Forces at a penetration, m, that grows at the rate `approach`, of surfaces that slip, m/s."""
        normal_force = self.law(penetration, approach)
        # Selecting the normal force to zero takes friction and moments with it.
        pushing = ca.if_else(self.touching > 0, normal_force.elastic, 0)
        rubbing = self.friction * pushing * self.sign(slip)
        rubbing += ca.if_else(self.touching > 0, self.viscous * slip, 0)
        return ContactForce(pushing, rubbing, penetration, approach, normal_force.switch)


def with_contacts_decided(touching: ca.SX, switch: ca.SX, expressions: list[ca.SX]) -> list[ca.SX]:
    """The expressions with surfaces pushing where their switch function is positive."""
    if touching.shape[0] == 0:
        return expressions
    return list(ca.substitute(expressions, [touching], [ca.if_else(switch > 0, 1, 0)]))
