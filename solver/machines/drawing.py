"""A machine as an SVG drawing that follows the page's colours and can be read aloud.

Labels stand near what they name, away from everything else.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TypeAlias

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fields import nearest
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.shapes import Arrow, JointMark, LinkShape, MachineShapes, SupportMark, machine_shapes

Pixel: TypeAlias = tuple[float, float]
Segment: TypeAlias = tuple[Pixel, Pixel]

CHARACTER = 8.0
"""Mean width of a character of 13 pixels, with a little air."""

HEIGHT = 14.0


def place_labels(
    labels: Sequence[tuple[str, Pixel]],
    segments: Sequence[Segment],
    blocked: Sequence[tuple[Pixel, float]],
    sheet: Pixel,
) -> list[Pixel]:
    """Choose a place for each label, one after the other.

    Parameters
    ----------
    labels : sequence of (text, pixel)
        What to write, and the point that it names.
    segments : sequence of pairs of pixels
        Lines that a label should not cross.
    blocked : sequence of (pixel, radius)
        Marks that a label should not cover.
    sheet : (width, height)
        Labels stay inside.

    Returns
    -------
    list of pixels
        Middle of each text's base line.
    """
    taken: list[tuple[Pixel, float]] = []
    places = []
    for text, at in labels:
        half = max(len(text), 2) * CHARACTER / 2
        candidates = [
            (at[0] + math.cos(angle) * (reach + half), at[1] + math.sin(angle) * (reach + HEIGHT / 2))
            for reach in (8.0, 14.0, 24.0)
            for angle in (step * math.pi / 6 for step in range(12))
        ]
        best = min(candidates, key=lambda middle: _cost(middle, half, at, segments, blocked, taken, sheet))
        taken.append((best, half))
        places.append((best[0], best[1] + HEIGHT / 3))
    return places


def _cost(
    middle: Pixel,
    half: float,
    at: Pixel,
    segments: Sequence[Segment],
    blocked: Sequence[tuple[Pixel, float]],
    taken: Sequence[tuple[Pixel, float]],
    sheet: Pixel,
) -> float:
    """Sum what speaks against a place: overlaps count most, then crossing a line, then being far away."""
    x, y = middle
    cost = 0.02 * math.dist(middle, at)
    outside = max(half - x, x + half - sheet[0], HEIGHT / 2 - y, y + HEIGHT / 2 - sheet[1], 0.0)
    cost += 10 * outside
    for (other_x, other_y), other_half in taken:
        over_x, over_y = half + other_half - abs(x - other_x), HEIGHT - abs(y - other_y)
        if over_x > 0 and over_y > 0:
            cost += 20 + min(over_x, over_y)
    for (mark_x, mark_y), radius in blocked:
        gap = math.hypot(max(abs(x - mark_x) - half, 0.0), max(abs(y - mark_y) - HEIGHT / 2, 0.0))
        cost += max(radius - gap, 0.0)
    for a, b in segments:
        gap = min(_distance((x + part * half, y), a, b) for part in (-1.0, -0.5, 0.0, 0.5, 1.0))
        cost += 0.5 * max(HEIGHT - gap, 0.0)
    return cost


def _distance(point: Pixel, a: Pixel, b: Pixel) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    part = 0.0 if length == 0 else ((point[0] - a[0]) * dx + (point[1] - a[1]) * dy) / length
    part = min(max(part, 0.0), 1.0)
    return math.dist(point, (a[0] + part * dx, a[1] + part * dy))


WIDEST = 640.0
HIGHEST = 420.0
MARGIN = 56.0
JOINT_RADIUS = 7.0
SUPPORT_LENGTH = 40.0


def machine_svg(machine: Machine, joint_colours: Mapping[str, str] | None = None, title: str | None = None) -> str:
    """Draw a machine in its drawn pose.

    Parameters
    ----------
    machine : Machine
    joint_colours : mapping of joint name to CSS colour, optional
        Fills these joints, for instance by how likely they are worn.
    title : str, optional
        Read out and shown by the browser; "Drawing of NAME" unless given.

    Returns
    -------
    str
        One ``<svg>`` element without script, style sheet or outside reference; it is drawn in ``currentColor``. Classes
        to style or move: ``link``, ``link-NAME``, ``joint``, ``joint-NAME``, ``guide``, ``guide-NAME``, ``support``,
        ``sensor``, ``load``, ``drive``, ``label-joint``, ``label-joint-NAME`` (a space in a name is a ``-`` there).

    Raises
    ------
    MachineError
        When `joint_colours` names a joint that the machine does not have.
    """
    colours = dict(joint_colours or {})
    for name in sorted(set(colours) - set(machine.joints)):
        rule = f"is not a joint of this machine{nearest(name, machine.joints)}"
        raise MachineError(machine.name, f"joints.{name}", None, rule)
    shapes = machine_shapes(machine)
    sheet = Sheet(shapes)
    parts = [
        *(_link(sheet, link) for link in shapes.links),
        *(_guide(sheet, joint) for joint in shapes.joints if joint.kind == "sliding"),
        *(_support(sheet, support) for support in shapes.supports),
        *(_arrow(sheet, sensor, "sensor") for sensor in shapes.sensors),
        *(_arrow(sheet, load, "load") for load in shapes.loads),
        *(_arrow(sheet, drive, "drive") for drive in shapes.drives),
        # Pins on top of the blocks they sit in: a worn one must be seen.
        *(_joint(sheet, joint, colours.get(joint.name)) for joint in sorted(shapes.joints, key=_on_top)),
        *_labels(sheet, shapes),
    ]
    name = f"drawing-{machine.content_key[:12]}"
    heading = escape(title or f"Drawing of {machine.name}")
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="machine-drawing" role="img" viewBox="0 0 {sheet.width:.0f} '
        f'{sheet.height:.0f}" aria-labelledby="{name}-title {name}-desc" fill="none" stroke="currentColor" '
        f'stroke-linecap="round" stroke-linejoin="round" font-family="system-ui, sans-serif" font-size="13">\n'
        f'<title id="{name}-title">{heading}</title>\n<desc id="{name}-desc">{escape(description(machine))}</desc>\n'
        + "\n".join(part for part in parts if part)
        + "\n</svg>\n"
    )


def description(machine: Machine) -> str:
    """Say in words what the drawing shows: links, joints, drive, supports, sensors."""
    joints = [f"{name} ({joint.kind}, {joint.links[0]} on {joint.links[1]})" for name, joint in machine.joints.items()]
    sentences = [f"Links: {', '.join(machine.links)}; the frame is {machine.frame}."]
    if joints:
        sentences.append(f"Joints: {', '.join(joints)}.")
    if machine.drive is not None:
        sentences.append(f"Driven at {machine.driven_joint or f'the centre of gravity of {machine.driven_link}'}.")
    if machine.supports:
        sentences.append(f"Supports: {', '.join(f'{support.kind} on {support.link}' for support in machine.supports)}.")
    if machine.sensors:
        sentences.append(f"Sensors: {', '.join(sensor.name for sensor in machine.sensors)}.")
    return " ".join(sentences)


class Sheet:
    """From metres, y up, to pixels, y down.

    Parameters
    ----------
    shapes : MachineShapes
        What has to fit.

    Attributes
    ----------
    scale : float
        Pixels a metre.
    width, height : float
        Pixels.
    """

    def __init__(self, shapes: MachineShapes) -> None:
        self._left, bottom, right, self._top = shapes.bounds
        wide, high = right - self._left, self._top - bottom
        scales = [room / size for room, size in ((WIDEST, wide), (HIGHEST, high)) if size > 0]
        self.scale = min(scales, default=1.0)
        self.width = wide * self.scale + 2 * MARGIN
        self.height = high * self.scale + 2 * MARGIN

    def __call__(self, point: tuple[float, float]) -> Pixel:
        """Return the pixel of a point."""
        x, y = point
        return (x - self._left) * self.scale + MARGIN, (self._top - y) * self.scale + MARGIN


def _path(points: Iterable[Pixel], closed: bool = False) -> str:
    corners = [f"{x:.1f} {y:.1f}" for x, y in points]
    return "M" + " L".join(corners if len(corners) > 1 else corners * 2) + (" Z" if closed else "")


def svg_class(kind: str, name: str) -> str:
    """Return the classes of an element: its kind, and its kind with its name."""
    return f"{kind} {kind}-{escape(name.replace(' ', '-'))}"


def _along(at: Pixel, direction: Pixel, forward: float, left: float = 0.0) -> Pixel:
    """Go from a pixel along a direction that is given with y up."""
    dx, dy = direction[0], -direction[1]
    return at[0] + dx * forward + dy * left, at[1] + dy * forward - dx * left


def _link(sheet: Sheet, link: LinkShape) -> str:
    points = [sheet(point) for point in link.outline]
    cg = sheet(link.cg)
    look = (
        'fill="currentColor" fill-opacity="0.05" stroke-opacity="0.35" stroke-dasharray="6 5"'
        if link.is_frame
        else 'fill="currentColor" fill-opacity="0.16" stroke-opacity="0.32" stroke-width="11"'
    )
    return (
        f'<g class="{svg_class("link", link.name)}"><title>link {escape(link.name)}</title>'
        f'<path d="{_path(points, link.closed)}" {look}/>'
        f'<path class="cg" d="M{cg[0] - 3:.1f} {cg[1]:.1f} h6 m-3 -3 v6" stroke-opacity="0.6"/></g>'
    )


def _guide(sheet: Sheet, joint: JointMark) -> str:
    at = sheet(joint.at)
    ends = _path([_along(at, joint.direction, -46), _along(at, joint.direction, 46)])
    return f'<path class="{svg_class("guide", joint.name)}" d="{ends}" stroke-opacity="0.7" stroke-dasharray="2 5"/>'


def _on_top(joint: JointMark) -> bool:
    return joint.kind == "turning"


def _joint(sheet: Sheet, joint: JointMark, colour: str | None) -> str:
    at = sheet(joint.at)
    fill = escape(colour) if colour else "none"
    what = f"{joint.kind} joint {joint.name}: {joint.links[0]} on {joint.links[1]}" + (
        ", driven" if joint.driven else ""
    )
    marks = [f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{JOINT_RADIUS}" fill="{fill}" stroke-width="2"/>']
    if joint.kind == "sliding":
        corners = [_along(at, joint.direction, f, s) for f, s in ((-17, -11), (17, -11), (17, 11), (-17, 11))]
        marks = [f'<path d="{_path(corners, closed=True)}" fill="{fill}" stroke-width="2"/>']
    if joint.grounded:
        marks.append(_ground((at[0], at[1] + JOINT_RADIUS), 1))
    if joint.driven:
        marks.append(_drive_arrow(at, joint))
    return f'<g class="{svg_class("joint", joint.name)}"><title>{escape(what)}</title>{"".join(marks)}</g>'


def _drive_arrow(at: Pixel, joint: JointMark) -> str:
    if joint.kind == "sliding":
        start, end = _along(at, joint.direction, -14, 18), _along(at, joint.direction, 14, 18)
        shaft = _path([start, end])
        direction = joint.direction
    else:
        r = 16.0  # an arc from the lower right over the top: counter-clockwise is positive
        start, end = (at[0] + r * 0.94, at[1] + r * 0.34), (at[0] - r, at[1])
        shaft = f"M{start[0]:.1f} {start[1]:.1f} A{r} {r} 0 0 0 {end[0]:.1f} {end[1]:.1f}"
        direction = (-0.2, -0.98)
    return f'<path class="drive" d="{shaft} {_head(end, direction)}" stroke-width="1.5"/>'


def _head(tip: Pixel, direction: Pixel) -> str:
    return _path([_along(tip, direction, -7, 4), tip, _along(tip, direction, -7, -4)])


def _arrow(sheet: Sheet, arrow: Arrow, kind: str) -> str:
    at = sheet(arrow.at)
    # A load's arrow ends at its point; that of a sensor or a drive leaves it.
    reach = 22 if kind == "sensor" else 34
    start, tip = (_along(at, arrow.direction, -34), at) if kind == "load" else (at, _along(at, arrow.direction, reach))
    foot = f'<rect x="{at[0] - 3:.1f}" y="{at[1] - 3:.1f}" width="6" height="6" fill="currentColor"/>'
    width = 2.5 if kind == "load" else 1.5
    says = {"sensor": "sensor", "load": "load on", "drive": "drive of"}
    what = f"{says[kind]} {arrow.name}"
    return (
        f'<g class="{svg_class(kind, arrow.name)}"><title>{escape(what)}</title>{foot if kind == "sensor" else ""}'
        f'<path d="{_path([start, tip])} {_head(tip, arrow.direction)}" stroke-width="{width}"/></g>'
    )


def _support(sheet: Sheet, support: SupportMark) -> str:
    start, end = _ends(sheet, support)
    aside = 7.0 if support.spring and support.damper else 0.0
    marks = [_spring(start, end, -aside)] if support.spring else []
    marks += [_dashpot(start, end, aside)] if support.damper else []
    ground = _ground(end, math.copysign(1.0, end[1] - start[1])) if support.on_ground else ""
    what = " and ".join(name for name, there in (("spring", support.spring), ("damper", support.damper)) if there)
    where = f"on {escape(support.link)}, to {'the ground' if support.on_ground else 'another link'}"
    return (
        f'<g class="{svg_class("support", support.link)}"><title>{what or "support"} {where}</title>'
        f'<path d="{" ".join(marks)}" stroke-width="1.5"/>{ground}{_to_and_fro(end, support.motion)}</g>'
    )


def _to_and_fro(at: Pixel, direction: Pixel | None) -> str:
    """An arrow with two heads, where the ground moves."""
    if direction is None:
        return ""
    x, y = direction
    start, tip = _along(at, direction, -14), _along(at, direction, 14)
    heads = f"{_head(tip, direction)} {_head(start, (-x, -y))}"
    return f'<path class="motion" d="{_path([start, tip])} {heads}" stroke-width="1.5"/>'


def _ends(sheet: Sheet, support: SupportMark) -> tuple[Pixel, Pixel]:
    start = sheet(support.start)
    if support.end is not None:
        return start, sheet(support.end)
    return start, (start[0], start[1] + (-SUPPORT_LENGTH if support.upward else SUPPORT_LENGTH))


def _between(start: Pixel, end: Pixel, steps: Iterable[tuple[float, float]]) -> list[Pixel]:
    """Return points given as (part of the way, pixels to the side)."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    length = math.hypot(dx, dy) or 1.0
    return [
        (start[0] + dx * part - dy / length * side, start[1] + dy * part + dx / length * side) for part, side in steps
    ]


def _spring(start: Pixel, end: Pixel, aside: float) -> str:
    count = 2 * max(round(0.6 * math.dist(start, end) / 16), 3) + 1  # a coil of about 16 pixels
    turns = [(0.2 + 0.6 * (index + 0.5) / count, aside + (5.0 if index % 2 else -5.0)) for index in range(count)]
    return _path(_between(start, end, [(0, aside), (0.2, aside), *turns, (0.8, aside), (1, aside)]))


def _dashpot(start: Pixel, end: Pixel, aside: float) -> str:
    rod = _path(_between(start, end, [(0, aside), (0.5, aside)]))
    piston = _path(_between(start, end, [(0.5, aside - 4), (0.5, aside + 4)]))
    pot = _path(_between(start, end, [(0.35, aside - 5), (0.7, aside - 5), (0.7, aside + 5), (0.35, aside + 5)]))
    return f"{rod} {piston} {pot} {_path(_between(start, end, [(0.7, aside), (1, aside)]))}"


def _ground(at: Pixel, sign: float) -> str:
    x, y = at
    strokes = " ".join(f"M{x + step:.1f} {y:.1f} l-5 {5 * sign:.0f}" for step in range(-12, 17, 7))
    return f'<path class="ground" d="M{x - 16:.1f} {y:.1f} h32 {strokes}" stroke-opacity="0.7"/>'


def _labels(sheet: Sheet, shapes: MachineShapes) -> list[str]:
    segments = []
    for link in shapes.links:
        points = [sheet(point) for point in link.outline]
        segments += list(zip(points, points[1:] + points[:1], strict=True))
    blocked = [(sheet(mark.at), 14.0 if mark.kind == "turning" else 20.0) for mark in shapes.joints]
    blocked += [(_along(sheet(sensor.at), sensor.direction, 11), 13.0) for sensor in shapes.sensors]
    for start, end in (_ends(sheet, support) for support in shapes.supports):
        blocked.append(((start[0] / 2 + end[0] / 2, start[1] / 2 + end[1] / 2), math.dist(start, end) / 2))
    wanted = [("joint", joint.name, sheet(joint.at)) for joint in shapes.joints]
    wanted += [("sensor", sensor.name, _along(sheet(sensor.at), sensor.direction, 26)) for sensor in shapes.sensors]
    for link in shapes.links:
        points = [sheet(point) for point in link.outline]
        middle = (sum(x for x, _ in points) / len(points), sum(y for _, y in points) / len(points))
        wanted.append(("link", link.name, middle))
    spots = place_labels([(text, at) for _, text, at in wanted], segments, blocked, (sheet.width, sheet.height))
    looks = {
        "joint": 'font-weight="700"',
        "sensor": 'font-size="11"',
        "link": 'font-style="italic" fill-opacity="0.75"',
    }
    return [
        f'<text class="{svg_class(f"label-{kind}", text)}" x="{x:.1f}" y="{y:.1f}" text-anchor="middle" '
        f'fill="currentColor" stroke="none" {looks[kind]}>{escape(text)}</text>'
        for (kind, text, _), (x, y) in zip(wanted, spots, strict=True)
    ]
