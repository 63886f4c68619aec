"""Outlines of a machine in its drawn pose: what is to be drawn where, in metres, without a word about how."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Damper, Load, Mount, PositionDrive, Spring, Support

Point: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class LinkShape:
    """One link: a point, a line or a convex polygon around its joints, supports and loads.

    Attributes
    ----------
    name : str
    outline : tuple of points
        In order; one point for a link with everything in one place.
    cg : point
    is_frame : bool
        The frame's outline also goes around the sensors.
    """

    name: str
    outline: tuple[Point, ...]
    cg: Point
    is_frame: bool

    @property
    def closed(self) -> bool:
        """Whether the outline is a polygon."""
        return len(self.outline) > 2


@dataclass(frozen=True)
class JointMark:
    """One joint: a circle, or for a sliding joint a rectangle along ``direction``."""

    name: str
    kind: Literal["turning", "sliding"]
    at: Point
    direction: Point
    links: tuple[str, str]
    grounded: bool  # on a frame that does not move at all
    driven: bool


@dataclass(frozen=True)
class SupportMark:
    """One support.

    Attributes
    ----------
    link : str
    start : point
        On the link.
    end : point or None
        Where it is anchored; None for a mount, which has no length of its own.
    upward : bool
        A mount is above the link's centre of gravity, so that there is room over it rather than below.
    spring, damper, on_ground : bool
        What is in it, and whether its other end stands on the ground.
    motion : point or None
        Direction, of length 1, in which that end moves most; None where it stands still.
    """

    link: str
    start: Point
    end: Point | None
    upward: bool
    spring: bool
    damper: bool
    on_ground: bool
    motion: Point | None


@dataclass(frozen=True)
class Arrow:
    """A sensor, a load or a driven link: a point and a direction of length 1."""

    name: str
    at: Point
    direction: Point


@dataclass(frozen=True)
class MachineShapes:
    """Everything to be drawn, in the order from back to front."""

    name: str
    links: tuple[LinkShape, ...]
    supports: tuple[SupportMark, ...]
    joints: tuple[JointMark, ...]
    sensors: tuple[Arrow, ...]
    loads: tuple[Arrow, ...]
    drives: tuple[Arrow, ...]

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least and greatest x and y, m: (x0, y0, x1, y1)."""
        points = [point for link in self.links for point in (*link.outline, link.cg)]
        points += [point for support in self.supports for point in (support.start, support.end or support.start)]
        points += [joint.at for joint in self.joints] + [
            arrow.at for arrow in (*self.sensors, *self.loads, *self.drives)
        ]
        xs, ys = zip(*points, strict=True)
        return min(xs), min(ys), max(xs), max(ys)


def machine_shapes(machine: Machine) -> MachineShapes:
    """Lay out a machine as it is drawn in its file.

    Parameters
    ----------
    machine : Machine

    Returns
    -------
    MachineShapes
        The frame comes first among the links.
    """
    frame = machine.frame
    links = sorted(machine.links, key=lambda name: name != frame)
    return MachineShapes(
        name=machine.name,
        links=tuple(_link_shape(machine, name) for name in links),
        supports=tuple(_support_mark(machine, support) for support in machine.supports),
        joints=tuple(_joint_mark(machine, name) for name in machine.joints),
        sensors=tuple(Arrow(sensor.name, sensor.at, sensor.direction) for sensor in machine.sensors),
        loads=tuple(Arrow(load.link, load.at, direction) for load in machine.loads if (direction := _pull(load))),
        drives=tuple(_driven_arrow(machine)),
    )


def _link_shape(machine: Machine, name: str) -> LinkShape:
    points = [joint.at for joint in machine.joints.values() if name in joint.links]
    is_frame = name == machine.frame
    points += [load.at for load in machine.loads if load.link == name]
    for support in machine.supports:
        if support.link == name:
            points.append(support.at)
        elif support.to_link == name:
            points.append(support.at if isinstance(support, Mount) else support.anchor)
    if is_frame:
        points += [sensor.at for sensor in machine.sensors]
    cg = machine.links[name].cg
    outline = convex_outline(points) if len(set(points)) > 1 else tuple(dict.fromkeys([*points, cg]))
    return LinkShape(name, outline, cg, is_frame)


def convex_outline(points: Iterable[Point]) -> tuple[Point, ...]:
    """Return the convex hull of points, counter-clockwise; two points if they lie on one line, one if they coincide.

    Notes
    -----
    Andrew's monotone chain (Information Processing Letters 9, 1979).
    """
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return tuple(ordered)
    size = math.dist(ordered[0], ordered[-1])
    halves = []
    for run in (ordered, ordered[::-1]):
        half: list[Point] = []
        for point in run:
            # Corners flatter than a thousandth of the size are taken for straight: a rocker stays a bar.
            while len(half) > 1 and _turn(half[-2], half[-1], point) <= 1e-3 * size**2:
                half.pop()
            half.append(point)
        halves.append(half[:-1])
    return tuple(halves[0] + halves[1])


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _joint_mark(machine: Machine, name: str) -> JointMark:
    joint = machine.joints[name]
    direction = joint.direction if isinstance(joint, SlidingJoint) else (1.0, 0.0)
    grounded = machine.frame in joint.links and machine.links[machine.frame].fixed
    driven = machine.driven_joint == name
    return JointMark(name, joint.kind, joint.at, direction, joint.links, grounded, driven)


def _support_mark(machine: Machine, support: Support) -> SupportMark:
    on_ground, motion = support.to_link is None, _largest(_shifts(support))
    if isinstance(support, Mount):
        upward = support.at[1] > machine.links[support.link].cg[1]
        spring, damper = any(support.stiffness), any(support.damping)
        return SupportMark(support.link, support.at, None, upward, spring, damper, on_ground, motion)
    is_spring, is_damper = isinstance(support, Spring), isinstance(support, Damper)
    return SupportMark(support.link, support.at, support.anchor, False, is_spring, is_damper, on_ground, motion)


def _driven_arrow(machine: Machine) -> Iterator[Arrow]:
    if isinstance(machine.drive, PositionDrive):
        link = machine.drive.link
        yield Arrow(link, machine.links[link].cg, machine.drive.direction)


def _pull(load: Load) -> Point | None:
    rows = load.over_time or load.over_angle
    return _largest([(row[1], row[2]) for row in rows] if rows else [load.force])


def _shifts(support: Support) -> list[Point]:
    """Displacements of the ground at a support."""
    sines = [part.displacement for part in support.motion]
    return sines + [(row[1], row[2]) for part in support.motion for row in part.over_time or ()]


def _largest(vectors: list[Point]) -> Point | None:
    """Direction of the largest vector; ``None`` where all are nothing."""
    x, y = max(vectors, key=lambda vector: math.hypot(*vector), default=(0.0, 0.0))
    size = math.hypot(x, y)
    return (x / size, y / size) if size > 0 else None
