"""What stands for the sign of the sliding velocity v in Coulomb's law: a number y from -1 to 1.

``tanh`` is tanh(v / v0). ``threshold`` is nothing below a tenth of v0, full from v0 on and straight between (J. A. C.
Ambrosio, 2003). Both creep: where they hold, they hold by moving.

``bristle`` is at rest or slips. At rest the surfaces are held by bristles, y = x + T x', whose deflection x in parts of
the presliding d follows the sliding, x' = v / d; with |y| = 1 they slip, y stays as it is, and x with it, until v turns
round. So x is a state to integrate, and whether it slips (and which way) is held over a step, as contacts are: the
driver (:mod:`jointplay.solver.integrators.sticking`) ends steps where that changes. In the limit d -> 0 this is
Coulomb's law. It is Dahl's model with the sharpest bend (P. R. Dahl, 1968), and the damping T of Canudas de Wit,
Olsson, Astrom and Lischinsky (IEEE Trans. Autom. Control 40, 1995, 419) while it holds.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca

from jointplay.solver.equations.numbers import Number
from jointplay.solver.machines.friction import FrictionLaw

#: T, s: a bristle's damping, so that what comes to rest does not ring. Measured in ``docs/measured/solver.md``.
RETARDATION = 1e-5
#: Part of v0 below which the law ``threshold`` has no friction.
_THRESHOLD = 0.1


@dataclass
class Bristles:
    """Rubbing surfaces that can stick, in the order in which they were met.

    Attributes
    ----------
    contacts : list of int
        Contact (its place among them) of each; -1 for a guide without clearance, whose surfaces never part.
    deflections, slips : list of casadi.SX
        Symbols: x; and 1 or -1 where it slips (the sign of v), 0 at rest.
    pulls : list of casadi.SX
        T x' at rest, from the velocities alone.
    """

    contacts: list[int] = field(default_factory=list)
    deflections: list[ca.SX] = field(default_factory=list)
    slips: list[ca.SX] = field(default_factory=list)
    pulls: list[ca.SX] = field(default_factory=list)

    def add(self, contact: int, slip: ca.SX, presliding: Number) -> ca.SX:
        """Let another pair of surfaces stick; returns its y."""
        k = len(self.contacts)
        deflection, slips = ca.SX.sym(f"deflection{k}"), ca.SX.sym(f"slips{k}")
        pull = slip * (RETARDATION / presliding)
        self.contacts.append(contact)
        self.deflections.append(deflection)
        self.slips.append(slips)
        self.pulls.append(pull)
        # No more than 1 within a step that goes on a little too long, or that nobody looks for the end of.
        held = ca.fmax(-1, ca.fmin(1, deflection + pull))
        return ca.if_else(slips == 0, held, slips)

    @property
    def pull(self) -> ca.SX:
        """T x' of all, (k, 1)."""
        return ca.vertcat(*self.pulls) if self.pulls else ca.SX(0, 1)

    @property
    def memory(self) -> ca.SX:
        """Symbols of all deflections, then of all slips, (2 k, 1)."""
        return ca.vertcat(*self.deflections, *self.slips) if self.pulls else ca.SX(0, 1)


def sliding_sign(law: FrictionLaw, slip: ca.SX, number: Number, contact: int, bristles: Bristles) -> ca.SX:
    """Return y of one pair of surfaces.

    Parameters
    ----------
    law : str
    slip : casadi.SX
        m/s.
    number : symbol or float
        That of the law: v0, m/s, or the presliding, m.
    contact : int
        As in :attr:`Bristles.contacts`.
    bristles : Bristles
        Grows where the law sticks.
    """
    if law == "bristle":
        return bristles.add(contact, slip, number)
    if law == "tanh":
        return ca.tanh(slip / number)
    forth, back = ((v / number - _THRESHOLD) / (1 - _THRESHOLD) for v in (slip, -slip))
    return ca.fmax(0, ca.fmin(1, forth)) - ca.fmax(0, ca.fmin(1, back))
