"""Force of the oil between a pin and its socket: a short journal bearing with squeeze, wedge and cavitation.

In a bearing that is short against its diameter oil flows along the pin (G. B. DuBois and F. W. Ocvirk, NACA Report
1157, 1953). With the film thickness h = c - e.u at the place u of the circumference, Reynolds' equation is

    d/dz (h^3 / (12 mu) dp/dz) = -V.u,    V = e' - (w_pin + w_socket)/2 k x e:

squeeze and wedge are one, the velocity V of the pin's centre in axes that turn with the mean of both links. Pressure is
a parabola along the pin, positive on the half of the circumference that V points to; in the other half the oil
cavitates, which cannot pull (J. F. Booker, J. Basic Eng. 87, 1965, 537). With xi and eta the parts of e/c along V and
across it, D = 1 - (e/c)^2 and A = pi/2 + arctan(xi / sqrt D), all of it in closed form is

    F = -mu R L^3 / c^3 [X |V| e/c + A D^(-3/2) V - eta / (D (1 - eta^2)) k x V],    X = 3 (1 + xi A / sqrt D) / D^2.

Nothing is singular at e = 0, and F.V <= 0 everywhere. The shear stresses turn both links against each other with
2 pi mu R^3 L / (c sqrt D) times the difference of their speeds (N. P. Petrov), and each by -(e x F)/2, without which
the angular momentum of a free machine would drift: the film takes -F.V and what it shears from the motion, never less.

To the wall it goes in three steps, so that forces stay finite (P. Ravn, S. Shivaswamy, B. J. Alshaer and H. M.
Lankarani, J. Mech. Des. 122, 2000, 484, and P. Flores and others go over to dry contact in like manner):

* the film counts as no thinner than the roughness of the surfaces, between whose tips oil remains;
* a film that would bring the lighter link to rest within :data:`FASTEST` is held to that;
* the dry contact begins at e = c as it does without oil, and the film fades over a penetration of one roughness.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from jointplay.solver.equations.geometry import Complex
from jointplay.solver.equations.numbers import Number
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine

#: Rate, 1/s, at which a film may settle the velocity of the lighter link at most. What is faster costs digits and time
#: and changes nothing; softer ones let light links in tight fits touch. Measured in ``docs/measured/solver.md``.
FASTEST = 1e8
#: Thinnest film, in parts of the clearance: beyond, the difference of large numbers leaves no digits.
_THINNEST = 1e-3
#: Square of a velocity, m2/s2, that counts as none; its root has a derivative.
_TINY = 1e-60


def most_damping(machine: Machine, joint: TurningJoint) -> float:
    """Damping coefficient that the film of a joint is held to, N s/m."""
    masses = [mass for mass in (machine.links[link].mass for link in joint.links) if mass]
    return FASTEST * min(masses, default=1.0)


@dataclass(frozen=True)
class Film:
    """Oil around a pin: viscosity, Pa s, 0 where it runs dry; radius of the pin, length, clearance and roughness, m;
    largest damping coefficient, N s/m.
    """

    viscosity: Number
    radius: Number
    length: Number
    clearance: Number
    roughness: Number
    most: float

    @property
    def thinnest(self) -> ca.SX:
        """Thickness below which it counts as no thinner, m."""
        return ca.fmax(ca.fmin(self.roughness, self.clearance / 2), _THINNEST * self.clearance)

    @property
    def unit(self) -> Number:
        """mu R L^3 / c^3, N s/m."""
        return self.viscosity * self.radius * self.length**3 / self.clearance**3

    def damping(self, gap: ca.SX) -> ca.SX:
        """Largest coefficient, N s/m, of a film that is full all around, where 1 - (e/c)^2 is `gap`; unbounded."""
        return self.unit * math.pi * (3 - 2 * gap) / (gap * gap * ca.sqrt(gap))

    def force(self, e: Complex, size: ca.SX, e_rate: Complex, omegas: tuple[ca.SX, ca.SX]) -> tuple[Complex, ca.SX]:
        """Force on the pin, N, and torque on it against the other's rotation, N m.

        Parameters
        ----------
        e, e_rate : Complex
            Vector from socket to pin centre, m, and its rate, m/s.
        size : casadi.SX
            Length of `e`, greater than 0.
        omegas : pair of casadi.SX
            Of pin and socket, rad/s.
        """
        c, thinnest = self.clearance, self.thinnest
        held = ca.fmin(1, (c - thinnest) / size) / c
        lean = Complex(e.re * held, e.im * held)
        mean = (omegas[0] + omegas[1]) / 2
        v = Complex(e_rate.re + mean * e.im, e_rate.im - mean * e.re)
        speed = ca.sqrt(ca.fmax(v.dot(v), _TINY))
        xi, eta = lean.dot(v) / speed, v.cross(lean) / speed
        gap = 1 - lean.dot(lean)
        root = ca.sqrt(gap)
        angle = math.pi / 2 + ca.atan(xi / root)
        ahead, toward, across = 3 * speed * (1 + xi * angle / root) / gap**2, angle / (gap * root), eta / gap
        across /= gap + xi * xi  # 1 - eta^2
        fading = ca.fmax(0, ca.fmin(1, 1 - (size - c) / thinnest))
        # Held by a quotient that has a derivative where there is no oil, too.
        scale = -fading * self.unit / ca.fmax(1, self.damping(gap) / self.most)
        force = Complex(
            scale * (ahead * lean.re + toward * v.re + across * v.im),
            scale * (ahead * lean.im + toward * v.im - across * v.re),
        )
        shear = fading * 2 * math.pi * self.viscosity * self.radius**3 * self.length / (c * root)
        return force, -shear * (omegas[0] - omegas[1])
