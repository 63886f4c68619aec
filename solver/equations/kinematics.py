"""Coordinates of a machine and the pose of every link as a function of them.

Each link's orientation is an absolute angle; links that a sliding joint or a prescribed rotation ties together share
one. Positions follow from the frame outwards along a spanning tree of the ideal joints, turning joints first because
they cost no coordinate. What the tree leaves over closes a loop: one closure equation per sliding joint, two per
turning joint. A joint with clearance is in neither; its pin floats, or its block between the walls.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca

from jointplay.solver.equations.drive import PrescribedMotion
from jointplay.solver.equations.geometry import (
    FRAME,
    GROUND,
    ONE,
    ZERO,
    Closure,
    Complex,
    I,
    Kinematics,
    Pose,
    Poses,
    Term,
    Terms,
    Vector,
    constant,
    slide,
    travel,
)
from jointplay.solver.equations.numbers import Number
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import PositionDrive

#: Joints from the frame after which a link gets coordinates of its own: the mass matrix stays sparse in long chains.
MAX_DEPTH = 6


@dataclass(frozen=True)
class _Angle:
    """Angle shared by a set of links: base coordinate plus k times the drive plus parts of the frame's modes."""

    turn: str
    theta: ca.SX
    omega: ca.SX
    partials: dict[int, float]


#: How an angle differs from that of a set's first link: times the drive, and by each mode of the frame, 1/m.
_Turned = tuple[int, tuple[float, ...]]


class Tree:
    """Coordinates, angles and poses while they are being chosen, link by link; parameters as of ``kinematics``."""

    def __init__(
        self,
        machine: Machine,
        open_joints: frozenset[str],
        rubbing: frozenset[str],
        motion: PrescribedMotion | None,
        gravity: Number,
        expanded: bool,
    ) -> None:
        self.machine = machine
        self.open = open_joints
        self.rubbing = rubbing
        self.motion = motion
        self.gravity = gravity
        self.expanded = expanded
        self.names: list[str] = []
        self.z: list[ca.SX] = []
        self.v: list[ca.SX] = []
        self.terms = Terms()
        self.origin_pairs: list[tuple[int, int]] = []
        self.poses = Poses()
        self.eliminated: list[str] = []
        self.angles: dict[str, _Angle] = {}
        self.bent_angles: dict[tuple[float, float], _Angle] = {}
        self.modes = [self.coordinate(f"mode({i})") for i in range(len(machine.modes))]

    def coordinate(self, name: str) -> int:
        """Add a coordinate; returns its index."""
        self.names.append(name)
        self.z.append(ca.SX.sym(name))
        self.v.append(ca.SX.sym(f"{name}'"))
        return len(self.names) - 1

    def drives(self, joint: str, *, rotation: bool) -> PrescribedMotion | None:
        """The prescribed motion, where it is this joint's and of this kind."""
        motion = self.motion
        return motion if motion is not None and motion.joint == joint and motion.rotation == rotation else None

    def frame_moves(self, motion: str) -> bool:
        """Whether the frame is free in ``x``, ``y`` or ``theta``."""
        frame = self.machine.links[self.machine.frame]
        return not frame.fixed and motion not in frame.locked

    def assign_angles(self) -> None:
        """One angle for each set of links whose orientations are tied together."""
        ties: list[tuple[str, str, str, int]] = []  # theta(first) = theta(second) + k * drive
        for name, joint in self.machine.joints.items():
            first, second = joint.links
            if isinstance(joint, SlidingJoint):
                if name not in self.open:
                    ties.append((name, first, second, 0))
            elif self.drives(name, rotation=True):
                ties.append((name, first, second, 1))
        if self.expanded:
            ties.clear()
        turns: dict[str, _Turned] = {}
        for root in (self.machine.frame, *self.machine.links):
            if root in turns:
                continue
            turns[root] = 0, (0.0,) * len(self.modes)
            members = [root]
            for here in members:  # grows while it is walked
                for name, first, second, k in ties:
                    if here not in (first, second):
                        continue
                    far, step = (first, k) if here == second else (second, -k)
                    times, bend = turns[here]
                    if here == self.machine.frame:
                        bend = self.bend(self.machine.joints[name].at)
                    elif far == self.machine.frame:
                        there = self.bend(self.machine.joints[name].at)
                        bend = tuple(own - other for own, other in zip(bend, there, strict=True))
                    if far not in turns:
                        turns[far] = times + step, bend
                        members.append(far)
                    elif turns[far] != (times + step, bend):
                        rule = f"the angle between {first!r} and {second!r} is fixed by sliding joints already"
                        if turns[far][0] == times + step:
                            rule = "modes turn the frame otherwise here than at its other joints of the same links"
                        raise AssemblyError(self.machine.name, f"joints.{name}", None, rule)
            self.share_angle(root, {link: turns[link] for link in members})

    def bend(self, at: tuple[float, float]) -> tuple[float, ...]:
        """Rotation of the frame at a point by each of its modes, 1/m."""
        return tuple(mode.rotation_at(at) for mode in self.machine.modes)

    def angle(self, link: str, at: tuple[float, float]) -> _Angle:
        """Angle of a link at a point of it."""
        return self.bent_angles[at] if self.modes and link == self.machine.frame else self.angles[link]

    def share_angle(self, root: str, members: dict[str, _Turned]) -> None:
        """Give links the angle of `root` plus a multiple of the drive, and their unit vectors."""
        frame = root == self.machine.frame
        index = None if frame and not self.frame_moves("theta") else self.coordinate(f"theta({root})")
        base, rate = (self.z[index], self.v[index]) if index is not None else (ca.SX(0.0), ca.SX(0.0))
        if frame:
            self.frame_theta = base
            self.terms.frame_rotation = Complex(ca.cos(base), ca.sin(base))
            self.terms.rotation[GROUND] = self.terms.frame_rotation.conjugate
            self.terms.terms[GROUND] = Term(GROUND, ONE, ZERO, GROUND, {}, ZERO)
        for link, turned in members.items():
            self.angles[link] = self.turned(root, index, base, rate, turned)
        if frame and self.modes:
            for _, at in self.machine.frame_points:
                self.bent_angles[at] = self.turned(root, index, base, rate, (0, self.bend(at)))

    def turned(self, root: str, index: int | None, base: ca.SX, rate: ca.SX, by: _Turned) -> _Angle:
        """The angle `base`, of coordinate `index`, plus a multiple of the drive and parts of modes; its unit vector."""
        frame = root == self.machine.frame
        k, bend = by
        shares = {i: share for i, share in zip(self.modes, bend, strict=True) if share}
        turn = FRAME if frame and not k and not shares else f"turn({root},{k}{''.join(f',{x!r}' for x in bend)})"
        driven = [ca.SX(0.0)] * 3
        if k and self.motion is not None:
            driven = [k * part for part in (self.motion.value, self.motion.rate, self.motion.acceleration)]
        for i, share in shares.items():
            driven = [driven[0] + share * self.z[i], driven[1] + share * self.v[i], driven[2]]
        omega = rate + driven[1]
        partials = {} if index is None else {index: 1.0}
        partials |= shares
        if turn not in self.terms.terms:
            relative = driven[0] if frame else base + driven[0] - self.frame_theta
            self.terms.rotation[turn] = ONE if turn == FRAME else Complex(ca.cos(relative), ca.sin(relative))
            moving = {i: I if share == 1.0 else Complex(0.0, share) for i, share in partials.items()}
            bias = Complex(-omega * omega, driven[2])
            self.terms.terms[turn] = Term(turn, ONE, Complex(0.0, omega), turn, moving, bias)
        return _Angle(turn, base + driven[0], omega, partials)

    def place(self, link: str, centre: Vector) -> None:
        """Place a link by its centre of gravity."""
        angle = self.angles[link]
        cg = self.machine.links[link].cg
        self.poses[link] = Pose(centre, angle.turn, angle.theta, angle.omega, angle.partials, cg)

    def place_at(self, link: str, drawn: tuple[float, float], now: Vector) -> None:
        """Place a link so that its point `drawn` is at `now`."""
        cg = self.machine.links[link].cg
        self.place(link, now - Vector({self.angles[link].turn: complex(drawn[0] - cg[0], drawn[1] - cg[1])}))

    def place_root(self, link: str) -> None:
        """Place a link that no ideal joint holds: its centre of gravity gets coordinates of its own."""
        frame = link == self.machine.frame
        indices = [self.coordinate(f"{axis}({link})") if not frame or self.frame_moves(axis) else None for axis in "xy"]
        place = [self.z[i] if i is not None else 0.0 for i in indices]
        rate = [self.v[i] if i is not None else 0.0 for i in indices]
        upward = Complex(0.0, self.gravity)
        x, y = indices
        if x is not None and y is not None:
            # Both free: their accelerations are solved for in the axes of the frame.
            self.origin_pairs.append((x, y))
            moving, partials, bias = FRAME, {x: ONE, y: I}, self.terms.to_frame(upward)
        else:
            moving, bias = GROUND, upward
            partials = {i: unit for i, unit in ((x, ONE), (y, I)) if i is not None}
        key = f"origin({link})"
        self.terms.terms[key] = Term(GROUND, Complex(*place), Complex(*rate), moving, partials, bias)
        self.place(link, constant(self.machine.links[link].cg) + Vector({key: 1.0}))
        if frame and self.modes:
            self.bend_frame()

    def bend_frame(self) -> None:
        """Poses of the surroundings of the frame's points: displaced and turned by its modes.

        A mode is a displacement in the axes of the frame, as the travel of a slide is: r = R (a + sum phi_i q_i) (A. A.
        Shabana, Dynamics of Multibody Systems, chapter 5).
        """
        frame = self.machine.frame
        for i, index in enumerate(self.modes):
            self.terms.terms[f"mode({i})"] = self.moving_along(self.angles[frame], index)
        for _, at in self.machine.frame_points:
            shape = {f"mode({i})": complex(*mode.displacement_at(at)) for i, mode in enumerate(self.machine.modes)}
            angle = self.bent_angles[at]
            there = self.poses[frame].point(at) + Vector(shape)
            self.poses.bent[frame, at] = Pose(there, angle.turn, angle.theta, angle.omega, angle.partials, at)

    def grow(self, root: str) -> None:
        """Place every link that ideal joints reach from `root`, turning joints before sliding ones."""
        depth = {root: 0}
        queue = [] if self.expanded else [root]
        while queue:
            here = queue.pop(0)
            for name, joint in self.machine.joints.items():
                if not isinstance(joint, TurningJoint) or name in self.open | self.rubbing or here not in joint.links:
                    continue
                far = joint.links[1] if here == joint.links[0] else joint.links[0]
                if far in self.poses or depth[here] >= MAX_DEPTH:
                    continue
                self.place_at(far, joint.at, self.poses.at(here, joint.at).point(joint.at))
                self.eliminated.append(name)
                depth[far] = depth[here] + 1
                queue.append(far)
            if not queue:
                queue.extend(self.grow_slide(depth))

    def grow_slide(self, depth: dict[str, int]) -> list[str]:
        """Place one more link through a sliding joint, if any reaches out of what is placed."""
        for name, joint in self.machine.joints.items():
            if not isinstance(joint, SlidingJoint) or name in self.open | self.rubbing:
                continue  # friction needs the normal force, hence the closure equation
            near = [link for link in joint.links if link in depth and depth[link] < MAX_DEPTH]
            far = [link for link in joint.links if link not in self.poses]
            if not near or not far:
                continue
            self.add_slide(name, joint)
            along = complex(*joint.direction) * (1 if far[0] == joint.links[0] else -1)
            point = self.poses.at(near[0], joint.at).point(joint.at)
            self.place_at(far[0], joint.at, point + Vector({f"slide({name})": along}))
            self.eliminated.append(name)
            depth[far[0]] = depth[near[0]] + 1
            return far
        return []

    def add_slide(self, name: str, joint: SlidingJoint) -> None:
        """The term of a sliding distance, free or prescribed, in the axes of the guide."""
        motion, angle = self.drives(name, rotation=False), self.angle(joint.links[1], joint.at)
        along = motion if motion is not None else self.coordinate(f"slide({name})")
        self.terms.terms[f"slide({name})"] = self.moving_along(angle, along)

    def moving_along(self, angle: _Angle, along: PrescribedMotion | int) -> Term:
        """The term of a distance, prescribed or a coordinate, in axes that turn."""
        turning = self.terms.terms[angle.turn]
        partials: dict[int, Complex] = {}
        if isinstance(along, int):
            s, rate, drift = self.z[along], self.v[along], ca.SX(0.0)
            partials[along] = ONE
        else:
            s, rate, drift = along.value, along.rate, along.acceleration
        for index, share in angle.partials.items():
            partials[index] = Complex(0.0, share * s)
        bias = Complex(drift + s * turning.bias.re, 2 * rate * angle.omega + s * turning.bias.im)
        return Term(angle.turn, Complex(s, 0.0), Complex(rate, s * angle.omega), angle.turn, partials, bias)

    def axes(self) -> ca.SX:
        """Rotation of accelerations, see :class:`~jointplay.solver.equations.geometry.Kinematics`."""
        turned = ca.SX.eye(len(self.z))
        rotation = self.terms.frame_rotation
        for x, y in self.origin_pairs:
            turned[x, x] = turned[y, y] = rotation.re
            turned[x, y], turned[y, x] = -rotation.im, rotation.im
        return turned


def _closures(tree: Tree) -> Iterator[Closure]:
    """Closure equations of ideal joints that the tree did not use, of locked links, of a driven slide or link."""
    for name, joint in tree.machine.joints.items():
        if name in tree.eliminated:
            continue
        if isinstance(joint, TurningJoint):
            if name in tree.open:
                continue
            first, second = (tree.poses.at(link, joint.at).point(joint.at) for link in joint.links)
            gap = tree.terms.value(first - second).column
            yield Closure(f"{name}.x", gap[0])
            yield Closure(f"{name}.y", gap[1])
        else:
            along, across = slide(joint, tree.poses, tree.terms)
            if name not in tree.open:
                yield Closure(f"{name}.normal", across)
            driven = tree.drives(name, rotation=False)
            if driven:
                yield Closure(f"{name}.drive", along - driven.value)
    if tree.expanded:
        yield from _angle_closures(tree)
    for name, link in tree.machine.links.items():
        if name == tree.machine.frame:
            continue
        offset = tree.terms.value(tree.poses[name].centre - constant(link.cg), ground=True).column
        motions = {"x": offset[0], "y": offset[1], "theta": tree.poses[name].theta}
        for motion in motions if link.fixed else link.locked:
            yield Closure(f"{name}.locked.{motion}", motions[motion])
    drive = tree.machine.drive
    if isinstance(drive, PositionDrive) and tree.motion is not None:
        moved = travel(drive.link, drive.direction, tree.poses, tree.terms)
        yield Closure(f"{drive.link}.drive", moved - tree.motion.value)


def _angle_closures(tree: Tree) -> Iterator[Closure]:
    """Closure equations of the angles that links share, and of the drive, where they were not built in."""
    for name, joint in tree.machine.joints.items():
        first, second = (tree.angle(link, joint.at).theta for link in joint.links)
        driven = tree.drives(name, rotation=True)
        if isinstance(joint, SlidingJoint):
            if name not in tree.open:
                yield Closure(f"{name}.couple", first - second)
        elif driven:
            yield Closure(f"{name}.drive", first - second - driven.value)


def kinematics(
    machine: Machine,
    open_joints: frozenset[str],
    motion: PrescribedMotion | None,
    gravity: Number,
    *,
    rubbing: frozenset[str] = frozenset(),
    expanded: bool = False,
) -> Kinematics:
    """Choose coordinates and write every pose and the remaining closures.

    Parameters
    ----------
    machine : Machine
    open_joints : frozenset of str
        Joints with clearance.
    motion : PrescribedMotion or None
        Motion of the drive joint, a function of the time symbol.
    gravity : symbol or float
        m/s2 along -y.
    rubbing : frozenset of str
        Joints with Coulomb friction: they keep their closures, whose multipliers are the force that presses them.
    expanded : bool
        Coordinates of its own for every link and a closure for every joint and the drive: nothing is eliminated, and
        every reaction is a multiplier.

    Raises
    ------
    AssemblyError
        The drive contradicts a sliding joint.
    """
    tree = Tree(machine, open_joints, rubbing, motion, gravity, expanded)
    tree.assign_angles()
    for link in (machine.frame, *machine.links):
        if link not in tree.poses:
            tree.place_root(link)
            tree.grow(link)
    return Kinematics(
        tuple(tree.names), ca.vertcat(*tree.z), ca.vertcat(*tree.v), tree.terms, tree.axes(),
        tree.poses, tuple(_closures(tree)), tuple(tree.eliminated),
    )  # fmt: skip
