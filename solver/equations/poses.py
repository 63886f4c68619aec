"""What kinematics gives: poses of links as functions of coordinates, and the closures that are left."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from jointplay.solver.equations.vectors import Terms, Vector
from jointplay.solver.machines.joints import SlidingJoint


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
    angle_index : int or None
        Coordinate that the angle follows; ``None`` for a link that cannot turn.
    cg : tuple of float
        Where the centre of gravity was drawn, m.
    """

    centre: Vector
    turn: str
    theta: ca.SX
    omega: ca.SX
    angle_index: int | None
    cg: tuple[float, float]

    def fixed(self, vector: tuple[float, float]) -> Vector:
        """A vector drawn on the link, as it has turned."""
        return Vector({self.turn: complex(*vector)})

    def arm(self, point: tuple[float, float]) -> Vector:
        """From the centre of gravity to a point of the link, given where it was drawn."""
        return self.fixed((point[0] - self.cg[0], point[1] - self.cg[1]))

    def point(self, point: tuple[float, float]) -> Vector:
        """A point of the link, given where it was drawn."""
        return self.centre + self.arm(point)


@dataclass(frozen=True)
class Closure:
    """One scalar closure equation phi = 0: what it is, and its expression (m or rad)."""

    name: str
    phi: ca.SX


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
    poses : dict of str to Pose
    closures : tuple of Closure
    eliminated : tuple of str
        Joints solved by the choice of coordinates: they need no equation.
    """

    names: tuple[str, ...]
    z: ca.SX
    v: ca.SX
    terms: Terms
    axes: ca.SX
    poses: dict[str, Pose]
    closures: tuple[Closure, ...]
    eliminated: tuple[str, ...]

    def indices_of(self, link: str) -> tuple[int | None, int | None, int | None]:
        """Where x, y, theta of a link are among the coordinates; ``None`` for a motion that is none of them."""
        wanted = [f"{motion}({link})" for motion in ("x", "y", "theta")]
        x, y, theta = (self.names.index(name) if name in self.names else None for name in wanted)
        return x, y, theta

    def slide(self, joint: SlidingJoint) -> tuple[ca.SX, ca.SX]:
        """Sliding (along) and normal distance (across the line fixed in links[1]) of links[0] since drawn, m."""
        return slide(joint, self.poses, self.terms)


def slide(joint: SlidingJoint, poses: dict[str, Pose], terms: Terms) -> tuple[ca.SX, ca.SX]:
    """As :meth:`Kinematics.slide`."""
    slider, guide = (poses[name] for name in joint.links)
    gap = terms.value(slider.point(joint.at) - guide.point(joint.at))
    along = terms.value(guide.fixed(joint.direction))
    return along.dot(gap), along.cross(gap)
