"""Normal force of a contact: the paper's linear impact pair, or K d^n with hysteresis (d the penetration).

The laws that take a restitution remember v0, the velocity of approach when the contact began. That memory is a part of
the state: 0 while the surfaces are apart, and set when a step is accepted (see
:mod:`jointplay.solver.integrators.control`) that has brought them together; it stays until the penetration is gone,
also where the force vanishes before. Within the step that begins a contact the present velocity stands for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from jointplay.solver.equations.numbers import Number
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.restitution import HYSTERESIS, hysteresis_factor

#: Least velocity of approach (m/s) that counts as v0: hysteresis c/v0 would grow without bound where a contact begins
#: at a creep, and be stiff for nothing. Impacts slower than this lose less than the law says; measured in
#: ``docs/solver.md``.
SLOWEST_APPROACH = 1e-3
#: Penetration (m) in place of none, so that powers have derivatives; the force there is nothing.
_LEAST = 1e-30


@dataclass(frozen=True)
class NormalForce:
    """Force along the normal, N, and the switch of :class:`jointplay.solver.equations.contact.ContactForce`, m."""

    elastic: ca.SX
    switch: ca.SX


def remembers(machine: Machine, joint: str) -> bool:
    """Whether the contact of a turning joint remembers the velocity of approach."""
    found = machine.joints[joint]
    return isinstance(found, TurningJoint) and found.contact.law in HYSTERESIS


def linear(stiffness: Number, damping: Number, penetration: ca.SX, approach: ca.SX) -> NormalForce:
    """K d + C d'."""
    elastic = stiffness * penetration + damping * approach
    # Nothing touches at e <= c, and a pair of surfaces cannot pull.
    return NormalForce(elastic, ca.fmin(penetration, elastic / stiffness))


def hertzian(
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
