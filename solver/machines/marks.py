"""What a drawing is made of: strokes and discs in pixels (y down) with named looks; and the signs made of them.

A renderer needs to know no more than this to put a drawing on paper or screen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from jointplay.solver.machines.labels import Pixel
from jointplay.solver.machines.shapes import Arrow, Gap, GuideShape, JointMark, LinkShape, SupportMark

JOINT_RADIUS = 6.0
SUPPORT_LENGTH = 34.0
#: Half the length and height of a block.
BLOCK = (13.0, 8.5)
SENSOR_LENGTH, LOAD_LENGTH = 22.0, 34.0
RED = "#c9252d"


@dataclass(frozen=True)
class Look:
    """Width and opacity of a line, its dashes; opacity of what it encloses (``None``: it encloses nothing)."""

    width: float = 1.5
    opacity: float = 1.0
    dash: tuple[float, ...] = ()
    fill: float | None = None


LOOKS = {
    "thin": Look(),
    "strong": Look(2.5),
    "pin": Look(2.0, fill=0.0),
    "solid": Look(1.0, fill=1.0),
    "frame": Look(1.0, 0.4, (6.0, 5.0), 0.05),
    "bar": Look(10.0, 0.3, fill=0.15),
    "cg": Look(1.0, 0.6),
    "guide": Look(1.5, 0.75),
    "slot": Look(1.2, 0.7, fill=0.0),
    "ground": Look(1.0, 0.7),
    "leader": Look(0.7, 0.6),
    "gap": Look(3.0),
}


@dataclass(frozen=True)
class Mark:
    """A stroke through points; a disc around the only one if there is a radius.

    ``colour`` fills what has a look that encloses something, and is that of the line of others; empty is the ink.
    """

    look: str
    points: tuple[Pixel, ...]
    closed: bool = False
    radius: float = 0.0
    colour: str = ""


@dataclass(frozen=True)
class Group:
    """Marks that belong to one part: a kind, its name ("" for none), and what is said of it."""

    kind: str
    name: str
    title: str
    marks: tuple[Mark, ...]


def along(at: Pixel, direction: Pixel, forward: float, left: float = 0.0) -> Pixel:
    """Go from a pixel along a direction that is given with y up."""
    dx, dy = direction[0], -direction[1]
    return at[0] + dx * forward + dy * left, at[1] + dy * forward - dx * left


def line(look: str, *points: Pixel, closed: bool = False, colour: str = "") -> Mark:
    """A stroke."""
    return Mark(look, points, closed, colour=colour)


def box(look: str, at: Pixel, direction: Pixel, half: Pixel, colour: str = "") -> Mark:
    """A rectangle around a point."""
    corners = [along(at, direction, f * half[0], s * half[1]) for f, s in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return line(look, *corners, closed=True, colour=colour)


def arrow(look: str, start: Pixel, end: Pixel) -> tuple[Mark, ...]:
    """A shaft and its head."""
    return line(look, start, end), head(look, end, _direction(start, end))


def head(look: str, tip: Pixel, direction: Pixel) -> Mark:
    """The head of an arrow, its direction given with y up."""
    return line(look, along(tip, direction, -7, 4), tip, along(tip, direction, -7, -4))


def _direction(start: Pixel, end: Pixel) -> Pixel:
    """Direction of length 1, with y up."""
    long = math.dist(start, end) or 1.0
    return (end[0] - start[0]) / long, (start[1] - end[1]) / long


def link_group(link: LinkShape, outlines: Iterable[tuple[Pixel, ...]], cg: Pixel) -> Group:
    """A link: its outlines, and a cross at its centre of gravity."""
    look = "frame" if link.is_frame else "bar"
    bars = [line(look, *points, closed=len(points) > 2) for points in outlines]
    cross = [line("cg", (cg[0] - 3, cg[1]), (cg[0] + 3, cg[1])), line("cg", (cg[0], cg[1] - 3), (cg[0], cg[1] + 3))]
    return Group("link", link.name, f"link {link.name}", (*bars, *cross))


def guide_group(guide: GuideShape, start: Pixel, end: Pixel) -> Group:
    """Rails with the wall behind them, or a slot with round ends."""
    direction = _direction(start, end)
    if guide.on_frame:
        start, end = along(start, direction, -BLOCK[0]), along(end, direction, BLOCK[0])
        long, marks = math.dist(start, end), []
        for side in (-1.0, 1.0):
            rail = side * (BLOCK[1] + 3)
            marks.append(line("guide", along(start, direction, 0, rail), along(start, direction, long, rail)))
            for k in range(max(1, round(long / 9))):
                foot = along(start, direction, 4 + 9 * k, rail)
                marks.append(line("ground", foot, along(foot, direction, -4, side * 5)))
        return Group("guide", guide.name, f"guide of {guide.name}", tuple(marks))
    r = 3.0
    turns = [math.pi / 2 + k * math.pi / 6 for k in range(7)]
    ends = [along(start, direction, r * math.cos(a), r * math.sin(a)) for a in turns]
    ends += [along(end, direction, -r * math.cos(a), -r * math.sin(a)) for a in turns]
    return Group("guide", guide.name, f"slot of {guide.name}", (line("slot", *ends, closed=True),))


def joint_group(joint: JointMark, at: Pixel, colour: str) -> Group:
    """A pin or a block, what it stands on, and the sense in which it is driven."""
    marks = [Mark("pin", (at,), radius=JOINT_RADIUS, colour=colour)]
    if joint.kind == "sliding":
        marks = [box("pin", at, joint.direction, BLOCK, colour)]
    if joint.grounded:
        marks += ground((at[0], at[1] + JOINT_RADIUS), 1)
    what = f"{joint.kind} joint {joint.name}: {joint.links[0]} on {joint.links[1]}"
    return Group("joint", joint.name, what + (", driven" if joint.sense else ""), tuple(marks))


def drive_group(joint: JointMark, at: Pixel, in_block: bool) -> Group:
    """The sense in which a joint is driven: an arc around a pin (and the block it sits in), an arrow beside a block."""
    if joint.kind == "sliding":
        start, end = along(at, joint.direction, -14, 17), along(at, joint.direction, 14, 17)
        marks = arrow("thin", *((start, end) if joint.sense > 0 else (end, start)))
        return Group("drive", joint.name, f"drive of {joint.name}", marks)
    r, steps = 20.0 if in_block else 15.0, 14
    # Three quarters of a turn from the lower right; y is down, so that counter-clockwise is the falling angle.
    angles = [math.radians(40 - 260 * k / steps) for k in range(steps + 1)]
    if joint.sense < 0:
        angles = [math.pi - angle for angle in angles]
    arc = [(at[0] + r * math.cos(a), at[1] + r * math.sin(a)) for a in angles]
    turns = "counter-clockwise" if joint.sense > 0 else "clockwise"
    direction = _direction(arc[-2], arc[-1])
    tilt = 0.2 * joint.sense  # the head of an arrow on an arc looks outwards otherwise
    inward = (direction[0] - tilt * direction[1], direction[1] + tilt * direction[0])
    return Group(
        "drive", joint.name, f"drive of {joint.name}, {turns}", (line("thin", *arc), head("thin", arc[-1], inward))
    )


def arrow_group(shape: Arrow, kind: str, at: Pixel) -> Group:
    """A sensor, a load or a driven link; a load's arrow ends at its point, others leave it."""
    says = {"sensor": "sensor", "load": "load on", "drive": "drive of"}
    far = SENSOR_LENGTH if kind == "sensor" else LOAD_LENGTH
    tip = along(at, shape.direction, far)
    ends = (along(at, shape.direction, -far), at) if kind == "load" else (at, tip)
    marks = arrow("strong" if kind == "load" else "thin", *ends)
    if kind == "sensor":
        marks = (box("solid", at, (1.0, 0.0), (2.5, 2.5)), *marks)
    return Group(kind, shape.name, f"{says[kind]} {shape.name}", marks)


def support_group(support: SupportMark, start: Pixel, end: Pixel) -> Group:
    """A spring, a dashpot or both, with the ground, and an arrow with two heads where that moves."""
    aside = 6.5 if support.spring and support.damper else 0.0
    marks = [_spring(start, end, -aside)] if support.spring else []
    marks += _dashpot(start, end, aside) if support.damper else []
    marks += ground(end, math.copysign(1.0, end[1] - start[1])) if support.on_ground else []
    what = " and ".join(name for name, there in (("spring", support.spring), ("damper", support.damper)) if there)
    where = f"on {support.link}, to {'the ground' if support.on_ground else 'another link'}"
    return Group("support", support.link, f"{what or 'support'} {where}", tuple(marks))


def motion_group(direction: Pixel, at: Pixel) -> Group:
    """An arrow with two heads, where the ground moves."""
    start, tip = along(at, direction, -14), along(at, direction, 14)
    back = (-direction[0], -direction[1])
    return Group("motion", "", "moving ground", (*arrow("thin", start, tip), head("thin", start, back)))


def gap_group(gap: Gap, ends: tuple[Pixel, Pixel]) -> Group:
    """What stays open, in red: a line with a ring at either end."""
    rings = [Mark("gap", (end,), radius=JOINT_RADIUS + 3, colour=RED) for end in ends]
    what = f"joint {gap.name} stays open by {gap_length(gap)}"
    return Group("gap", gap.name, what, (line("gap", *ends, colour=RED), *rings))


def gap_length(gap: Gap) -> str:
    """The length of a gap, for people."""
    return f"{gap.size * 1e3:.3g} mm" if gap.size >= 1e-4 else f"{gap.size * 1e6:.3g} µm"


def _between(start: Pixel, end: Pixel, steps: Iterable[tuple[float, float]]) -> list[Pixel]:
    """Return points given as (part of the way, pixels to the side)."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy) or 1.0
    return [
        (start[0] + dx * part - dy / length * side, start[1] + dy * part + dx / length * side) for part, side in steps
    ]


def _spring(start: Pixel, end: Pixel, aside: float) -> Mark:
    count = 2 * max(round(0.6 * math.dist(start, end) / 14), 3) + 1  # a coil of about 14 pixels
    turns = [(0.2 + 0.6 * (index + 0.5) / count, aside + (4.5 if index % 2 else -4.5)) for index in range(count)]
    return line("thin", *_between(start, end, [(0, aside), (0.2, aside), *turns, (0.8, aside), (1, aside)]))


def _dashpot(start: Pixel, end: Pixel, aside: float) -> list[Mark]:
    pieces = [
        [(0, aside), (0.5, aside)],
        [(0.5, aside - 3.5), (0.5, aside + 3.5)],
        [(0.35, aside - 4.5), (0.7, aside - 4.5), (0.7, aside + 4.5), (0.35, aside + 4.5)],
        [(0.7, aside), (1, aside)],
    ]
    return [line("thin", *_between(start, end, piece)) for piece in pieces]


def ground(at: Pixel, sign: float) -> list[Mark]:
    """A piece of ground below a point, or above it (-1)."""
    x, y = at
    strokes = [line("ground", (x + step, y), (x + step - 5, y + 5 * sign)) for step in range(-11, 15, 6)]
    return [line("ground", (x - 14, y), (x + 14, y)), *strokes]
