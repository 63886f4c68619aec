"""Planar vectors as complex numbers, positions as linear combinations of a few moving terms, and poses made of both.

Every point of a planar mechanism is a sum of origins, of unit vectors turning with a link, and of those times a sliding
distance, with constant coefficients. Written so, the constants of a chain of links merge into one number per term, and
the inertia of all links into one constant matrix over the terms: the work of a right-hand side depends on the number of
distinct motions, not on the number of masses.

Everything is expressed in axes that turn with the frame: what happens inside the machine then does not depend on how
the frame stands, and only gravity, supports and loads have to be turned.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca

from jointplay.solver.equations.numbers import Number
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint

#: Coefficients smaller than this (m) are rounding left over where two constants cancel.
NOTHING = 1e-14

#: Turns: the axes fixed in space, and those of the frame. Others are named after their link.
GROUND, FRAME = "ground", "frame"


@dataclass(frozen=True)
class Complex:
    """A planar vector or rotation as a complex number of symbols."""

    re: Number
    im: Number

    def __add__(self, other: Complex) -> Complex:
        return Complex(self.re + other.re, self.im + other.im)

    def __mul__(self, other: Complex | complex) -> Complex:
        b = other if isinstance(other, Complex) else Complex(other.real, other.imag)
        return Complex(self.re * b.re - self.im * b.im, self.re * b.im + self.im * b.re)

    def __neg__(self) -> Complex:
        return Complex(-self.re, -self.im)

    @property
    def conjugate(self) -> Complex:
        """Mirror image; of a rotation, the rotation back."""
        return Complex(self.re, -self.im)

    @property
    def column(self) -> ca.SX:
        """As a (2, 1) column."""
        return ca.vertcat(self.re, self.im)

    def dot(self, other: Complex) -> ca.SX:
        """Scalar product."""
        return ca.SX(self.re * other.re + self.im * other.im)

    def cross(self, other: Complex) -> ca.SX:
        """Vector product, positive counter-clockwise from self to other."""
        return ca.SX(self.re * other.im - self.im * other.re)


ZERO = Complex(0.0, 0.0)
ONE = Complex(1.0, 0.0)
I = Complex(0.0, 1.0)  # noqa: E741 - the imaginary unit


@dataclass(frozen=True)
class Vector:
    """Sum of complex coefficient times term: a rotation and a scale of each.

    Attributes
    ----------
    terms : dict of str to complex
        Coefficient of each term (m; 1 for an origin).
    """

    terms: dict[str, complex]

    def __add__(self, other: Vector) -> Vector:
        merged = dict(self.terms)
        for key, coefficient in other.terms.items():
            merged[key] = merged.get(key, 0.0) + coefficient
        return Vector({key: c for key, c in merged.items() if abs(c) > NOTHING})

    def __neg__(self) -> Vector:
        return Vector({key: -c for key, c in self.terms.items()})

    def __sub__(self, other: Vector) -> Vector:
        return self + (-other)


def constant(point: tuple[float, float]) -> Vector:
    """A point fixed in space."""
    return Vector({GROUND: complex(*point)})


@dataclass(frozen=True)
class Term:
    """A moving vector ``size`` in the axes of ``turn``.

    Attributes
    ----------
    turn : str
        Axes that `size` and `rate` are given in.
    size : Complex
        The vector.
    rate : Complex
        Its time derivative.
    moving_turn : str
        Axes that the next two are given in.
    partials : dict of int to Complex
        What each coordinate's acceleration adds to the second time derivative. The two coordinates of an origin count
        in the axes of the frame.
    bias : Complex
        Second time derivative without accelerations of the coordinates; an origin's holds gravity as an upward one.
    """

    turn: str
    size: Complex
    rate: Complex
    moving_turn: str
    partials: dict[int, Complex]
    bias: Complex


@dataclass
class Terms:
    """The terms of a machine and the rotations between their axes.

    Attributes
    ----------
    terms : dict of str to Term
    rotation : dict of str to Complex
        exp(i angle) of each turn relative to the frame.
    frame_rotation : Complex
        exp(i theta) of the frame itself.
    """

    frame_rotation: Complex = ONE
    terms: dict[str, Term] = field(default_factory=dict)
    rotation: dict[str, Complex] = field(default_factory=dict)

    def _sum(self, vector: Vector, which: str, *, ground: bool) -> Complex:
        """In the axes of the frame or the ground; terms with the same turn are added before they are turned."""
        sums: dict[str, Complex] = {}
        for key, coefficient in vector.terms.items():
            term = self.terms[key]
            part = (term.size if which == "size" else term.rate) * coefficient
            sums[term.turn] = sums[term.turn] + part if term.turn in sums else part
        at_rest = sums.pop(GROUND, ZERO)
        inside = ZERO
        for turn, part in sums.items():
            inside = inside + part * self.rotation[turn]
        return at_rest + self.to_ground(inside) if ground else self.to_frame(at_rest) + inside

    def value(self, vector: Vector, *, ground: bool = False) -> Complex:
        """The vector in the axes of the frame, or in those fixed in space, m."""
        return self._sum(vector, "size", ground=ground)

    def rate(self, vector: Vector, *, ground: bool = False) -> Complex:
        """Its absolute time derivative in the axes of the frame, or in those fixed in space, m/s."""
        return self._sum(vector, "rate", ground=ground)

    def to_ground(self, vector: Complex) -> Complex:
        """From the axes of the frame to those fixed in space."""
        return vector * self.frame_rotation

    def to_frame(self, vector: Complex) -> Complex:
        """From the axes fixed in space to those of the frame."""
        return vector * self.frame_rotation.conjugate

    def partials(self, vector: Vector) -> dict[int, Complex]:
        """How the acceleration of each coordinate moves the vector, in the axes of the frame."""
        sums: dict[tuple[int, str], Complex] = {}
        for key, coefficient in vector.terms.items():
            term = self.terms[key]
            for index, partial in term.partials.items():
                place, part = (index, term.moving_turn), partial * coefficient
                sums[place] = sums[place] + part if place in sums else part
        total: dict[int, Complex] = {}
        for (index, turn), part in sums.items():
            turned = part * self.rotation[turn]
            total[index] = total[index] + turned if index in total else turned
        return total


@dataclass(frozen=True)
class Pose:
    """Pose of one link.

    Attributes
    ----------
    centre : Vector
        Centre of gravity.
    turn : str
        Term that is the unit vector turning with the link.
    theta, omega : casadi.SX
        Angle since the drawn pose (rad) and its rate (rad/s).
    angle_partials : dict of int to float
        How the angle follows coordinates; empty for a link that cannot turn.
    cg : tuple of float
        Where the centre of gravity was drawn, m.
    """

    centre: Vector
    turn: str
    theta: ca.SX
    omega: ca.SX
    angle_partials: dict[int, float]
    cg: tuple[float, float]

    def rotate(self, vector: tuple[float, float]) -> Vector:
        """A vector drawn on the link, as it has turned."""
        return Vector({self.turn: complex(*vector)})

    def arm(self, point: tuple[float, float]) -> Vector:
        """From the centre of gravity to a point of the link, given where it was drawn."""
        return self.rotate((point[0] - self.cg[0], point[1] - self.cg[1]))

    def point(self, point: tuple[float, float]) -> Vector:
        """A point of the link, given where it was drawn."""
        return self.centre + self.arm(point)


class Poses(dict[str, Pose]):
    """Pose of every link, by its name.

    Attributes
    ----------
    bent : dict of (str, point) to Pose
        Of a frame with modes: that of the surroundings of each point that carries something, by where it was drawn.
    """

    def __init__(self) -> None:
        super().__init__()
        self.bent: dict[tuple[str, tuple[float, float]], Pose] = {}

    def at(self, link: str, drawn: tuple[float, float]) -> Pose:
        """What a joint, a support, a load feels of a link at a point: the link, or the frame as it is bent there."""
        return self.bent.get((link, drawn)) or self[link]


@dataclass(frozen=True)
class Closure:
    """One scalar closure equation phi = 0: what it is, and its expression (m or rad)."""

    name: str
    phi: ca.SX


def travel(link: str, direction: tuple[float, float], poses: Poses, terms: Terms) -> ca.SX:
    """How far the centre of gravity of a link has moved along a direction fixed in space since drawn, m."""
    cg = poses[link].cg
    offset = terms.value(poses.at(link, cg).point(cg) - constant(cg), ground=True)
    return Complex(*direction).dot(offset)


@dataclass(frozen=True)
class Kinematics:
    """Coordinates, poses and closures of a machine with a set of clearance joints.

    Attributes
    ----------
    names : tuple of str
        What each coordinate is, ``theta(rod)``, ``slide(G)``, ``x(frame)``.
    z, v : casadi.SX
        (n, 1) coordinates, all zero in the drawn pose, and their rates.
    terms : Terms
    axes : casadi.SX
        (n, n) rotation T of accelerations: z'' = T a, where a has the origins' accelerations in the axes of the frame.
    poses : Poses
    closures : tuple of Closure
    eliminated : tuple of str
        Joints solved by the choice of coordinates: they need no equation.
    apart : dict of str to casadi.SX
        x, y, theta (3, 1) of a frame that moves without acting back; `poses` have it at rest.
    """

    names: tuple[str, ...]
    z: ca.SX
    v: ca.SX
    terms: Terms
    axes: ca.SX
    poses: Poses
    closures: tuple[Closure, ...]
    eliminated: tuple[str, ...]
    apart: dict[str, ca.SX] = field(default_factory=dict)

    def placed(self, link: str) -> ca.SX:
        """x, y (global axes) and theta of a link, (3, 1)."""
        if link in self.apart:
            return self.apart[link]
        pose = self.poses[link]
        return ca.vertcat(self.terms.value(pose.centre, ground=True).column, pose.theta)

    def indices_of(self, link: str) -> tuple[int | None, int | None, int | None]:
        """Where x, y, theta of a link are among the coordinates; ``None`` for a motion that is none of them."""
        wanted = [f"{motion}({link})" for motion in ("x", "y", "theta")]
        x, y, theta = (self.names.index(name) if name in self.names else None for name in wanted)
        return x, y, theta

    @property
    def modes(self) -> list[int]:
        """Where the modes of the frame are among the coordinates."""
        return [i for i, name in enumerate(self.names) if name.startswith("mode(")]

    def slide(self, joint: SlidingJoint) -> tuple[ca.SX, ca.SX]:
        """Sliding (along) and normal distance (across the line fixed in links[1]) of links[0] since drawn, m."""
        return slide(joint, self.poses, self.terms)

    def position(self, joint: SlidingJoint | TurningJoint) -> ca.SX:
        """How far links[0] of a joint has turned (rad) or slid (m) on links[1] since drawn."""
        if isinstance(joint, SlidingJoint):
            return self.slide(joint)[0]
        first, second = (self.poses.at(link, joint.at).theta for link in joint.links)
        return first - second


def slide(joint: SlidingJoint, poses: Poses, terms: Terms) -> tuple[ca.SX, ca.SX]:
    """As :meth:`Kinematics.slide`."""
    slider, guide = (poses.at(name, joint.at) for name in joint.links)
    gap = terms.value(slider.point(joint.at) - guide.point(joint.at))
    along = terms.value(guide.rotate(joint.direction))
    return along.dot(gap), along.cross(gap)
