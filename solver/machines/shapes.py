"""Outlines of a machine in one pose: what is to be drawn where, in metres, without a word about how."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

from jointplay.solver.machines.course import Course, course_of, sense_of_drive
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Damper, Load, Mount, PositionDrive, Spring, Support

Point: TypeAlias = tuple[float, float]


@dataclass(frozen=True)
class LinkShape:
    """One link: a point, a line or a convex polygon around its joints, supports and loads; or bars along its slot.

    Attributes
    ----------
    name : str
    outlines : tuple of tuples of points
        In order; one of one point for a link with everything in one place, polygons of three and more. A link in which
        a block slides has a bar along the slot, and one from there to each place off it.
    cg : point
    is_frame : bool
        The frame's outline also goes around the sensors.
    """

    name: str
    outlines: tuple[tuple[Point, ...], ...]
    cg: Point
    is_frame: bool

    @property
    def points(self) -> tuple[Point, ...]:
        """All of its outlines."""
        return tuple(point for outline in self.outlines for point in outline)


@dataclass(frozen=True)
class GuideShape:
    """The line of a sliding joint, as far as its block goes: rails on the frame, a slot in a link that moves."""

    name: str
    on_frame: bool
    start: Point
    end: Point


@dataclass(frozen=True)
class Gap:
    """A joint that stays open: where it is on its two links, how far these are apart, m, and where the drive is."""

    name: str
    ends: tuple[Point, Point]
    size: float
    drive: float  # rad, or m


@dataclass(frozen=True)
class JointMark:
    """One joint: a circle, or for a sliding joint a rectangle along ``direction``."""

    name: str
    kind: Literal["turning", "sliding"]
    at: Point
    direction: Point
    links: tuple[str, str]
    grounded: bool  # on a frame that does not move at all
    sense: int  # of the drive, seen from the frame: 1 is counter-clockwise, or along the direction; 0 is not driven


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
    guides: tuple[GuideShape, ...]
    supports: tuple[SupportMark, ...]
    joints: tuple[JointMark, ...]
    sensors: tuple[Arrow, ...]
    loads: tuple[Arrow, ...]
    drives: tuple[Arrow, ...]
    gap: Gap | None

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least and greatest x and y, m: (x0, y0, x1, y1)."""
        points = [point for link in self.links for point in (*link.points, link.cg)]
        points += [point for guide in self.guides for point in (guide.start, guide.end)]
        points += [point for support in self.supports for point in (support.start, support.end or support.start)]
        points += [joint.at for joint in self.joints] + [
            arrow.at for arrow in (*self.sensors, *self.loads, *self.drives)
        ]
        xs, ys = zip(*points, strict=True)
        return min(xs), min(ys), max(xs), max(ys)


def machine_shapes(machine: Machine, open_joint: str | None = None) -> MachineShapes:
    """Lay out a machine as it is drawn in its file.

    Parameters
    ----------
    machine : Machine
    open_joint : str, optional
        Of a machine that cannot be assembled: it is laid out where this joint stays open widest ("" for whichever), as
        near to closed as it comes.

    Returns
    -------
    MachineShapes
        The frame comes first among the links.
    """
    course = course_of(machine, open_joint or "")
    widest, position = course.widest if open_joint is not None else ("", 0)
    layout = _Layout(machine, course, position)
    links = sorted(machine.links, key=lambda name: name != machine.frame)
    return MachineShapes(
        name=machine.name,
        links=tuple(layout.link(name) for name in links),
        guides=tuple(layout.guide(name) for name in machine.sliding_joints),
        supports=tuple(layout.support(support) for support in machine.supports),
        joints=tuple(layout.joint(name) for name in machine.joints),
        sensors=tuple(Arrow(sensor.name, sensor.at, sensor.direction) for sensor in machine.sensors),
        loads=tuple(
            Arrow(load.link, layout.place(load.link, load.at), direction)
            for load in machine.loads
            if (direction := _pull(load))
        ),
        drives=tuple(layout.driven()),
        gap=layout.gap(widest) if widest else None,
    )


class _Layout:
    """A machine at one position of its course."""

    def __init__(self, machine: Machine, course: Course, position: int) -> None:
        self.machine, self.course, self.position = machine, course, position

    def place(self, link: str, point: Point) -> Point:
        """Where a point of a link is, that is given as drawn."""
        cg = self.machine.links[link].cg
        x, y, _ = self.course.links[link][self.position]
        dx, dy = self.turn(link, (point[0] - cg[0], point[1] - cg[1]))
        return float(x) + dx, float(y) + dy

    def turn(self, link: str, direction: Point) -> Point:
        """A direction of a link that is given as drawn."""
        if not (angle := float(self.course.links[link][self.position][2])):
            return direction
        c, s = math.cos(angle), math.sin(angle)
        return c * direction[0] - s * direction[1], s * direction[0] + c * direction[1]

    def link(self, name: str) -> LinkShape:
        machine = self.machine
        is_frame = name == machine.frame
        slots = [] if is_frame else [slot for slot in machine.sliding_joints if machine.joints[slot].links[1] == name]
        points = [joint.at for of, joint in machine.joints.items() if name in joint.links and of not in slots]
        points += [load.at for load in machine.loads if load.link == name]
        for support in machine.supports:
            if support.link == name:
                points.append(support.at)
            elif support.to_link == name:
                points.append(support.at if isinstance(support, Mount) else support.anchor)
        if is_frame:
            points += [sensor.at for sensor in machine.sensors]
        cg = machine.links[name].cg
        outlines: tuple[tuple[Point, ...], ...]
        if slots:
            outlines = tuple(self.bars(slots, points))
        elif len(set(points)) > 1:
            outlines = (convex_outline(points),)
        else:
            outlines = (tuple(dict.fromkeys([*points, cg])),)
        moved = tuple(tuple(self.place(name, point) for point in outline) for outline in outlines)
        return LinkShape(name, moved, self.place(name, cg), is_frame)

    def bars(self, slots: list[str], points: list[Point]) -> Iterator[tuple[Point, ...]]:
        """Bars of a link along its slots, and from the first of them to what is beside it, as drawn."""
        first, *others = (self.slot(name) for name in slots)
        for start, end in others:
            yield start, end
            points = [*points, ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)]
        (x, y), (x1, y1) = first
        long = math.dist(*first) or 1.0
        dx, dy = (x1 - x) / long, (y1 - y) / long
        feet = {point: (point[0] - x) * dx + (point[1] - y) * dy for point in points}
        low, high = min([0.0, *feet.values()]), max([long, *feet.values()])
        yield (x + low * dx, y + low * dy), (x + high * dx, y + high * dy)
        for point, foot in feet.items():
            base = (x + foot * dx, y + foot * dy)
            if math.dist(base, point) > 1e-3 * self.course.size:
                yield base, point

    def slot(self, name: str) -> tuple[Point, Point]:
        """Ends of the line of a sliding joint, as drawn: as far as its block goes, and a little more."""
        joint = self.machine.joints[name]
        assert isinstance(joint, SlidingJoint)
        low, high = self.course.reach(name)
        more = max((joint.length or 0.0) / 2, 0.06 * self.course.size)
        (x, y), (dx, dy) = joint.at, joint.direction
        return (x + (low - more) * dx, y + (low - more) * dy), (x + (high + more) * dx, y + (high + more) * dy)

    def guide(self, name: str) -> GuideShape:
        carrier = self.machine.joints[name].links[1]
        start, end = (self.place(carrier, point) for point in self.slot(name))
        return GuideShape(name, carrier == self.machine.frame, start, end)

    def joint(self, name: str) -> JointMark:
        joint, frame = self.machine.joints[name], self.machine.frame
        first, second = joint.links
        direction = self.turn(second, joint.direction) if isinstance(joint, SlidingJoint) else (1.0, 0.0)
        grounded = frame in joint.links and self.machine.links[frame].fixed
        sense = sense_of_drive(self.machine) if self.machine.driven_joint == name else 0
        if first == frame:  # the frame is not what is seen to go
            sense = -sense
        return JointMark(name, joint.kind, self.place(first, joint.at), direction, joint.links, grounded, sense)

    def support(self, support: Support) -> SupportMark:
        on_ground, motion = support.to_link is None, _largest(_shifts(support))
        start = self.place(support.link, support.at)
        if isinstance(support, Mount):
            upward = support.at[1] > self.machine.links[support.link].cg[1]
            spring, damper = any(support.stiffness), any(support.damping)
            return SupportMark(support.link, start, None, upward, spring, damper, on_ground, motion)
        is_spring, is_damper = isinstance(support, Spring), isinstance(support, Damper)
        end = support.anchor if support.to_link is None else self.place(support.to_link, support.anchor)
        return SupportMark(support.link, start, end, False, is_spring, is_damper, on_ground, motion)

    def driven(self) -> Iterator[Arrow]:
        drive = self.machine.drive
        if isinstance(drive, PositionDrive):
            yield Arrow(drive.link, self.place(drive.link, self.machine.links[drive.link].cg), drive.direction)

    def gap(self, name: str) -> Gap:
        joint = self.machine.joints[name]
        first, second = (self.place(link, joint.at) for link in joint.links)
        if not isinstance(joint, TurningJoint):  # to the foot on its line
            dx, dy = self.turn(joint.links[1], joint.direction)
            along = (first[0] - second[0]) * dx + (first[1] - second[1]) * dy
            second = (second[0] + along * dx, second[1] + along * dy)
        size, drive = (float(of[self.position]) for of in (self.course.gaps[name], self.course.drive))
        return Gap(name, (first, second), size, drive)


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
