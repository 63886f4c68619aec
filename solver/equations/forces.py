"""Forces as pairs of a displacement and the force that does work along it.

A spring acts along its length, a force at the vector to its point, a torque along an angle. The generalised forces
follow by virtual work, Q = (d displacement / dz)' force, so no moment arm is ever written down.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import assert_never

import casadi as ca

from jointplay.solver.equations.anchors import anchor_term
from jointplay.solver.equations.drive import Harmonics, interpolate, interpolate_periodic, known_effort
from jointplay.solver.equations.friction import Bristles
from jointplay.solver.equations.geometry import Complex, Kinematics, Pose, Vector, constant
from jointplay.solver.equations.numbers import Number, Numbers
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Damper, Mount, Spring, Support

#: Length (m) below which a spring has no direction; it pulls with its force along nothing.
SHORTEST = 1e-9


@dataclass
class Scene:
    """What force elements need to know, and the forces written so far.

    Attributes
    ----------
    machine, kinematics, number
        The machine, its kinematics and its numbers.
    t : casadi.SX
        Time.
    slides : dict of str to (casadi.SX, casadi.SX)
        Travel of every sliding joint since drawn (m) and its rate (m/s).
    total : casadi.SX
        (n, 1) generalised forces written so far, the origins' in the axes of the frame.
    bristles : Bristles
        Surfaces that can stick, so far.
    """

    machine: Machine
    kinematics: Kinematics
    number: Numbers
    t: ca.SX
    slides: dict[str, tuple[ca.SX, ca.SX]]
    total: ca.SX
    bristles: Bristles = field(default_factory=Bristles)

    def add(self, displacement: ca.SX, force: ca.SX) -> None:
        """A force along a scalar displacement."""
        self.total += self.gradient(displacement) * force

    def gradient(self, displacement: ca.SX) -> ca.SX:
        """(n, 1) generalised force of a unit force along a scalar displacement."""
        return ca.mtimes(ca.jacobian(displacement, self.kinematics.z), self.kinematics.axes).T

    def push(self, vector: Vector, force: Complex) -> None:
        """A force (axes of the frame) that does work where `vector` changes."""
        for index, partial in self.kinematics.terms.partials(vector).items():
            self.total[index] += partial.dot(force)

    def twist(self, pose: Pose, torque: ca.SX) -> None:
        """A torque on a link."""
        for index, share in pose.angle_partials.items():
            self.total[index] += share * torque

    def anchor(self, path: str, support: Support) -> Vector:
        """Where a support ends: a point of the ground, as it moves, or of the link that carries it."""
        at = support.at if isinstance(support, Mount) else support.anchor
        if support.to_link is not None:
            return self.kinematics.poses.at(support.to_link, at).point(at)
        if not support.motion:
            return constant(at)
        term = anchor_term(f"{path}.motion", support.motion, self.number, self.t, self.drive_angle)
        self.kinematics.terms.terms[path] = term
        return constant(at) + Vector({path: 1.0})

    def angle(self, joint: TurningJoint) -> tuple[ca.SX, ca.SX]:
        """Angle of links[0] relative to links[1] since drawn, and its rate."""
        first, second = (self.kinematics.poses.at(link, joint.at) for link in joint.links)
        return first.theta - second.theta, first.omega - second.omega

    def drive_angle(self) -> tuple[ca.SX, ca.SX]:
        """Angle of a drive that turns since drawn, and its rate: the machine file refuses what asks without one."""
        joint = self.machine.joints[self.machine.driven_joint]
        assert isinstance(joint, TurningJoint)
        return self.angle(joint)


def supports(scene: Scene) -> None:
    """Springs, dampers and mounts (the paper's groups IX and X), to the ground or to another link."""
    number, terms = scene.number, scene.kinematics.terms
    grounded: dict[str, list[tuple[str, Mount]]] = {}
    for i, support in enumerate(scene.machine.supports):
        path = f"supports.{i}"
        point = scene.kinematics.poses.at(support.link, support.at).point(support.at)
        if isinstance(support, Mount):
            bent = scene.machine.modes and support.link == scene.machine.frame
            if support.to_link is None and not support.motion and not bent:
                grounded.setdefault(support.link, []).append((path, support))
            else:
                _mount_alone(scene, path, support)
            continue
        vector = point - scene.anchor(path, support)
        line = terms.value(vector)
        length = ca.sqrt(ca.fmax(line.dot(line), SHORTEST**2))
        if isinstance(support, Spring):
            free = number(f"{path}.free_length", support.free_length or 0.0)
            tension = number(f"{path}.stiffness", support.stiffness) * (length - free)
        elif isinstance(support, Damper):
            tension = number(f"{path}.damping", support.damping) * line.dot(terms.rate(vector)) / length
        else:
            assert_never(support)
        pull = -tension / length
        scene.push(vector, Complex(pull * line.re, pull * line.im))

    for link, mounts in grounded.items():
        _mounts_to_ground(scene, link, mounts)


def _mount_alone(scene: Scene, path: str, mount: Mount) -> None:
    """A mount between two links, on a floor that moves, or of a frame whose modes displace each mount otherwise."""
    terms, number = scene.kinematics.terms, scene.number
    vector = scene.kinematics.poses.at(mount.link, mount.at).point(mount.at) - scene.anchor(path, mount)
    offset, rate = (part.column for part in (terms.value(vector, ground=True), terms.rate(vector, ground=True)))
    force = [
        -number(f"{path}.stiffness.{k}", mount.stiffness[k]) * offset[k]
        - number(f"{path}.damping.{k}", mount.damping[k]) * rate[k]
        for k in range(2)
    ]
    scene.push(vector, terms.to_frame(Complex(*force)))


def _mounts_to_ground(scene: Scene, link: str, mounts: list[tuple[str, Mount]]) -> None:
    """All mounts of one link at once, so that their number costs nothing.

    With X the displacement of the centre of gravity, a the arms as drawn and r = R a as turned, mount i pulls with
    K_i (X + r_i - a_i) + C_i (X' + omega z x r_i). Force and moment are sums over the mounts in which only c = cos
    theta and s = sin theta vary: the rest are constants.
    """
    pose, terms = scene.kinematics.poses[link], scene.kinematics.terms
    centre = pose.centre - constant(pose.cg)
    turn = terms.to_ground(terms.rotation[pose.turn])
    c, s = turn.re, turn.im
    offset, rate = (part.column for part in (terms.value(centre, ground=True), terms.rate(centre, ground=True)))
    # Products of c and s, at most second order: (c - 1, s) for displacements, (c, s) and their squares for moments.
    lean = (c - 1, s)
    squares = (c * c, c * s, s * s)
    force: list[Number] = [0.0, 0.0]
    moment: Number = 0.0
    twist: list[Number] = [0.0, 0.0, 0.0]
    drag: list[Number] = [0.0, 0.0, 0.0]
    for k, sign in ((0, -1), (1, 1)):
        # Along axis k the arm is r_k; the moment of a force along it has the arm across, (r_y, r_x)[k], and this sign.
        sums = _MountSums(scene, mounts, pose.cg, k)
        pull = (
            sums.stiffness * offset[k] + _linear(sums.stiffness_arm, k, lean)
            + sums.damping * rate[k] + pose.omega * sign * _linear(sums.damping_arm, 1 - k, (c, s))
        )  # fmt: skip
        force[k] = -pull
        moment -= sign * (
            offset[k] * _linear(sums.stiffness_arm, 1 - k, (c, s))
            + rate[k] * _linear(sums.damping_arm, 1 - k, (c, s))
            - _linear(sums.drawn_arm, 1 - k, (c, s))
        )
        twist = [total + sign * part for total, part in zip(twist, sums.twist(), strict=True)]
        drag = [total + part for total, part in zip(drag, sums.drag(k), strict=True)]
    moment -= sum(m * q for m, q in zip(twist, squares, strict=True))
    moment -= pose.omega * sum(m * q for m, q in zip(drag, squares, strict=True))
    scene.push(centre, terms.to_frame(Complex(*force)))
    scene.twist(pose, ca.SX(moment))


def _linear(arm: tuple[Number, Number], k: int, turn: tuple[Number, Number]) -> Number:
    """Component k of R a for a weighted arm a: c a_x - s a_y, or s a_x + c a_y."""
    c, s = turn
    return c * arm[0] - s * arm[1] if k == 0 else s * arm[0] + c * arm[1]


class _MountSums:
    """Sums over mounts of stiffness and damping along one axis, times powers of their arms."""

    def __init__(self, scene: Scene, mounts: list[tuple[str, Mount]], cg: tuple[float, float], k: int) -> None:
        def total(weights: list[Number], factors: list[float]) -> Number:
            return sum((w * f for w, f in zip(weights, factors, strict=True) if f), start=0.0)

        stiffness = [scene.number(f"{path}.stiffness.{k}", mount.stiffness[k]) for path, mount in mounts]
        damping = [scene.number(f"{path}.damping.{k}", mount.damping[k]) for path, mount in mounts]
        x, y = ([mount.at[axis] - cg[axis] for _, mount in mounts] for axis in (0, 1))
        ones, own = [1.0] * len(mounts), (x, y)[k]
        xx, xy, yy = ([a * b for a, b in zip(*pair, strict=True)] for pair in ((x, x), (x, y), (y, y)))
        self.stiffness, self.damping = total(stiffness, ones), total(damping, ones)
        self.stiffness_arm = (total(stiffness, x), total(stiffness, y))
        self.damping_arm = (total(damping, x), total(damping, y))
        own_x, own_y = ([a * b for a, b in zip(own, axis, strict=True)] for axis in (x, y))
        self.drawn_arm = (total(stiffness, own_x), total(stiffness, own_y))
        self._stiffness_squares = [total(stiffness, product) for product in (xx, xy, yy)]
        self._damping_squares = [total(damping, product) for product in (xx, xy, yy)]

    def twist(self) -> tuple[Number, Number, Number]:
        """Coefficients of c^2, c s, s^2 in sum K r_x r_y, whichever axis the stiffness is along."""
        xx, xy, yy = self._stiffness_squares
        return xy, xx - yy, -xy

    def drag(self, k: int) -> tuple[Number, Number, Number]:
        """Coefficients of c^2, c s, s^2 in sum C r^2, r the arm across axis k."""
        xx, xy, yy = self._damping_squares
        return (yy, 2 * xy, xx) if k == 0 else (xx, -2 * xy, yy)


def loads(scene: Scene) -> None:
    """External loads: constant, over time, over the drive angle; the point moves with its link, axes are global."""
    waves: Harmonics | None = None
    for i, load in enumerate(scene.machine.loads):
        path = f"loads.{i}"
        if load.over_time is not None:
            values = [interpolate(scene.t, [(row[0], row[k]) for row in load.over_time]) for k in (1, 2, 3)]
        elif load.over_angle is not None:
            values = [
                interpolate_periodic(scene.drive_angle()[0], [(row[0], row[k]) for row in load.over_angle])
                for k in (1, 2, 3)
            ]
            if scene.number.varies(f"{path}.over_angle"):
                # What is drawn of a load is its size; its course stays.
                factor = scene.number(f"{path}.over_angle", 1.0)
                values = [value * factor for value in values]
        else:
            names = (("force.0", load.force[0]), ("force.1", load.force[1]), ("torque", load.torque))
            values = [ca.SX(scene.number(f"{path}.{name}", value)) for name, value in names]
            if load.order is not None:
                waves = waves or Harmonics(scene.drive_angle()[0])
                sine, _ = waves.wave(load.order, load.phase)
                values = [value * sine for value in values]
        force = scene.kinematics.terms.to_frame(Complex(values[0], values[1]))
        pose = scene.kinematics.poses.at(load.link, load.at)
        scene.push(pose.point(load.at), force)
        scene.twist(pose, values[2])


def effort(scene: Scene) -> None:
    """A drive that is a known torque or force."""
    name = scene.machine.driven_joint
    if not name:
        return
    joint = scene.machine.joints[name]
    displacement, rate = scene.angle(joint) if isinstance(joint, TurningJoint) else scene.slides[name]
    known = known_effort(scene.machine, scene.number, rate)
    if known is not None:
        scene.add(displacement, known)


def viscous_joints(scene: Scene, open_joints: frozenset[str]) -> None:
    """Viscous resistance of ideal turning joints (the paper's CT) and of sliding joints (its Ct)."""
    for name, joint in scene.machine.joints.items():
        if not joint.viscous or name in open_joints:
            continue
        displacement, rate = scene.slides[name] if isinstance(joint, SlidingJoint) else scene.angle(joint)
        scene.add(displacement, -scene.number(f"joints.{name}.viscous", joint.viscous) * rate)
