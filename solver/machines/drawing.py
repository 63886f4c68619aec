"""A machine as one drawing, for every paper and screen: marks and labels in pixels, and their form as SVG.

The SVG follows the page's colours and can be read aloud.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape
from itertools import pairwise

from jointplay.solver.errors import MachineError
from jointplay.solver.machines import marks as signs
from jointplay.solver.machines.fields import nearest
from jointplay.solver.machines.labels import Label, Pixel, distance_to_box, place_labels
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.marks import LOOKS, RED, Group, Mark
from jointplay.solver.machines.shapes import MachineShapes, SupportMark, machine_shapes

#: Room for the machine, pixels: small, so that letters are legible where a screen is 360 pixels wide.
WIDEST, HIGHEST = 340.0, 260.0
#: Around everything that is drawn.
MARGIN = 6.0
#: A label farther from what it names than this has a line to it.
NEAR = 17.0
#: Size of letters, weight, slant and opacity by kind of label.
LETTERS = {
    "joint": (14.0, "bold", False, 1.0),
    "sensor": (11.5, "normal", False, 1.0),
    "link": (12.0, "normal", True, 0.75),
    "gap": (13.0, "bold", False, 1.0),
}


@dataclass(frozen=True)
class PlacedLabel:
    """A text: its kind (of :data:`LETTERS`), the name of its part, what is written, and the middle of that."""

    kind: str
    name: str
    text: str
    middle: Pixel
    half: Pixel


@dataclass(frozen=True)
class Picture:
    """A drawing in pixels, y down, from back to front.

    Attributes
    ----------
    box : (left, top, width, height)
        Everything is inside.
    groups, labels : tuples
    title, description : str
        What is read out.
    """

    box: tuple[float, float, float, float]
    groups: tuple[Group, ...]
    labels: tuple[PlacedLabel, ...]
    title: str
    description: str


class Sheet:
    """From metres, y up, to pixels, y down.

    Parameters
    ----------
    shapes : MachineShapes
        What has to fit.
    """

    def __init__(self, shapes: MachineShapes) -> None:
        self._left, bottom, right, self._top = shapes.bounds
        wide, high = right - self._left, self._top - bottom
        scales = [room / size for room, size in ((WIDEST, wide), (HIGHEST, high)) if size > 0]
        #: Pixels a metre.
        self.scale = min(scales, default=1.0)

    def __call__(self, point: Pixel) -> Pixel:
        """Return the pixel of a point."""
        return (point[0] - self._left) * self.scale, (self._top - point[1]) * self.scale


def draw_machine(
    machine: Machine,
    joint_colours: Mapping[str, str] | None = None,
    title: str | None = None,
    open_joint: str | None = None,
) -> Picture:
    """Draw a machine in its drawn pose.

    Parameters
    ----------
    machine : Machine
    joint_colours : mapping of joint name to CSS colour, optional
        Fills these joints, for instance by how likely they are worn.
    title : str, optional
        Read out and shown by the browser; "Drawing of NAME" unless given.
    open_joint : str, optional
        Of a machine that cannot be assembled: it is drawn where this joint stays open widest ("" for whichever), as
        near to closed as it comes, with the gap in red.

    Raises
    ------
    MachineError
        When `joint_colours` names a joint that the machine does not have.
    """
    colours = dict(joint_colours or {})
    for name in sorted(set(colours) - set(machine.joints)):
        rule = f"is not a joint of this machine{nearest(name, machine.joints)}"
        raise MachineError(machine.name, f"joints.{name}", None, rule)
    shapes = machine_shapes(machine, open_joint)
    sheet = Sheet(shapes)
    groups = list(_groups(sheet, shapes, colours))
    labels, leaders = _labels(sheet, shapes, groups)
    if leaders:
        groups.append(Group("leader", "", "", tuple(leaders)))
    said = description(machine)
    if shapes.gap:
        stays = f"joint {shapes.gap.name} stays {signs.gap_length(shapes.gap)} open"
        drive = shapes.gap.drive
        turned = machine.joints[machine.driven_joint].kind == "turning" if machine.driven_joint else False
        where = f"{math.degrees(drive):.0f} deg" if turned else f"{drive * 1e3:.3g} mm"
        said += f" It cannot be assembled: at {where} of the drive, where it is open widest, {stays}."
    return Picture(_around(groups, labels), tuple(groups), labels, title or f"Drawing of {machine.name}", said)


def machine_svg(
    machine: Machine,
    joint_colours: Mapping[str, str] | None = None,
    title: str | None = None,
    open_joint: str | None = None,
) -> str:
    """Return :func:`draw_machine` as SVG.

    Returns
    -------
    str
        One ``<svg>`` element without script, style sheet or outside reference; it is drawn in ``currentColor``. Classes
        to style or move: ``link``, ``link-NAME``, ``joint``, ``joint-NAME``, ``guide``, ``guide-NAME``, ``support``,
        ``sensor``, ``load``, ``drive``, ``gap``, ``label-joint``, ``label-joint-NAME`` (a space in a name is a ``-``
        there).

    Raises
    ------
    MachineError
        When `joint_colours` names a joint that the machine does not have.
    """
    picture = draw_machine(machine, joint_colours, title, open_joint)
    return svg_of(picture, f"drawing-{machine.content_key[:12]}")


def svg_of(picture: Picture, name: str) -> str:
    """Write a drawing as one ``<svg>`` element; `name` makes its identifiers."""
    left, top, width, height = picture.box
    parts = [_group(group) for group in picture.groups] + [_text(label) for label in picture.labels]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="machine-drawing" role="img" viewBox="{left:.0f} {top:.0f} '
        f'{width:.0f} {height:.0f}" aria-labelledby="{name}-title {name}-desc" fill="none" stroke="currentColor" '
        f'stroke-linecap="round" stroke-linejoin="round" font-family="system-ui, sans-serif" font-size="13">\n'
        f'<title id="{name}-title">{escape(picture.title)}</title>\n'
        f'<desc id="{name}-desc">{escape(picture.description)}</desc>\n' + "\n".join(parts) + "\n</svg>\n"
    )


def _group(group: Group) -> str:
    told = f"<title>{escape(group.title)}</title>" if group.title else ""
    return f'<g class="{svg_class(group.kind, group.name)}">{told}{"".join(map(_mark, group.marks))}</g>'


def _mark(mark: Mark) -> str:
    look = LOOKS[mark.look]
    drawn = f'stroke-width="{look.width:g}"' + (f' stroke-opacity="{look.opacity:g}"' if look.opacity < 1 else "")
    if look.dash:
        drawn += f' stroke-dasharray="{" ".join(f"{each:g}" for each in look.dash)}"'
    if look.fill is None and mark.colour:
        drawn += f' stroke="{escape(mark.colour)}"'
    elif mark.colour or look.fill == 0:
        drawn += f' fill="{escape(mark.colour) or "none"}"'
    elif look.fill:
        drawn += ' fill="currentColor"' + (f' fill-opacity="{look.fill:g}"' if look.fill < 1 else "")
    if mark.radius:
        (x, y) = mark.points[0]
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{mark.radius:g}" {drawn}/>'
    corners = [f"{x:.1f} {y:.1f}" for x, y in mark.points]
    path = "M" + " L".join(corners if len(corners) > 1 else corners * 2) + (" Z" if mark.closed else "")
    return f'<path d="{path}" {drawn}/>'


def _text(label: PlacedLabel) -> str:
    size, weight, slanted, opacity = LETTERS[label.kind]
    look = f'fill="{RED if label.kind == "gap" else "currentColor"}" font-size="{size:g}"'
    look += f' font-weight="{weight}"' if weight != "normal" else ""
    look += ' font-style="italic"' if slanted else ""
    look += f' fill-opacity="{opacity:g}"' if opacity < 1 else ""
    x, y = label.middle
    return (
        f'<text class="{svg_class(f"label-{label.kind}", label.name)}" x="{x:.1f}" y="{y + 0.36 * size:.1f}" '
        f'text-anchor="middle" stroke="none" {look}>{escape(label.text)}</text>'
    )


def svg_class(kind: str, name: str) -> str:
    """Return the classes of an element: its kind, and its kind with its name."""
    return f"{kind} {kind}-{escape(name.replace(' ', '-'))}" if name else kind


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


def _groups(sheet: Sheet, shapes: MachineShapes, colours: Mapping[str, str]) -> Iterator[Group]:
    """Everything but the labels, from back to front."""
    for link in shapes.links:
        yield signs.link_group(link, [tuple(map(sheet, outline)) for outline in link.outlines], sheet(link.cg))
    for guide in shapes.guides:
        yield signs.guide_group(guide, sheet(guide.start), sheet(guide.end))
    for support in shapes.supports:
        start, end = _ends(sheet, support)
        yield signs.support_group(support, start, end)
        if support.motion is not None:
            yield signs.motion_group(support.motion, end)
    for sensor in shapes.sensors:
        yield signs.arrow_group(sensor, "sensor", sheet(sensor.at))
    # Pins on top of the blocks they sit in, coloured ones on others in the same place: what is worn must be seen.
    for joint in sorted(shapes.joints, key=lambda joint: (joint.kind == "turning", joint.name in colours)):
        yield signs.joint_group(joint, sheet(joint.at), colours.get(joint.name, ""))
    for kind, arrows in (("load", shapes.loads), ("drive", shapes.drives)):
        for arrow in arrows:
            yield signs.arrow_group(arrow, kind, sheet(arrow.at))
    blocks = {joint.at for joint in shapes.joints if joint.kind == "sliding"}
    for joint in shapes.joints:
        if joint.sense:
            yield signs.drive_group(joint, sheet(joint.at), joint.at in blocks)
    if shapes.gap:
        first, second = shapes.gap.ends
        yield signs.gap_group(shapes.gap, (sheet(first), sheet(second)))


def _ends(sheet: Sheet, support: SupportMark) -> tuple[Pixel, Pixel]:
    start = sheet(support.start)
    if support.end is not None:
        return start, sheet(support.end)
    return start, (start[0], start[1] + (-signs.SUPPORT_LENGTH if support.upward else signs.SUPPORT_LENGTH))


def _labels(sheet: Sheet, shapes: MachineShapes, groups: list[Group]) -> tuple[tuple[PlacedLabel, ...], list[Mark]]:
    """Labels, and lines to what they name where that is farther away."""
    wanted: list[tuple[str, str, Label]] = []
    if shapes.gap:
        (x, y), (x1, y1) = map(sheet, shapes.gap.ends)
        text = f"{shapes.gap.name}: {signs.gap_length(shapes.gap)} open"
        wanted.append(("gap", shapes.gap.name, Label(text, ((x + x1) / 2, (y + y1) / 2), LETTERS["gap"][0], 4.0)))
    for joint in shapes.joints:
        clear = signs.JOINT_RADIUS if joint.kind == "turning" else signs.BLOCK[1]
        wanted.append(("joint", joint.name, Label(joint.name, sheet(joint.at), LETTERS["joint"][0], clear)))
    for sensor in shapes.sensors:
        tip = signs.along(sheet(sensor.at), sensor.direction, signs.SENSOR_LENGTH)
        wanted.append(("sensor", sensor.name, Label(sensor.name, tip, LETTERS["sensor"][0], -4.0)))
    for link in shapes.links:
        longest = max(link.outlines, key=lambda outline: len(outline))
        points = [sheet(point) for point in longest]
        middle = (sum(x for x, _ in points) / len(points), sum(y for _, y in points) / len(points))
        wanted.append(("link", link.name, Label(link.name, middle, LETTERS["link"][0])))
    segments = list(_segments(groups))
    box = _around(groups, ())
    corners = (box[0], box[1], box[0] + box[2], box[1] + box[3])
    spots = place_labels([label for _, _, label in wanted], segments, corners)
    placed, leaders = [], []
    for (kind, name, label), spot in zip(wanted, spots, strict=True):
        placed.append(PlacedLabel(kind, name, label.text, spot, label.half))
        if distance_to_box(label.at, spot, label.half) > NEAR + label.clear:
            leaders.append(_leader(label, spot))
    return tuple(placed), leaders


def _leader(label: Label, spot: Pixel) -> Mark:
    """A line from what is named towards the text, to its edge."""
    dx, dy = spot[0] - label.at[0], spot[1] - label.at[1]
    part = max((abs(d) - half) / abs(d) for d, half in zip((dx, dy), label.half, strict=True) if d)
    start = max(label.clear, 0.0) / (dx * dx + dy * dy) ** 0.5
    ends = [(label.at[0] + each * dx, label.at[1] + each * dy) for each in (start, max(part, start))]
    return signs.line("leader", *ends)


def _segments(groups: list[Group]) -> Iterator[tuple[Pixel, Pixel, float]]:
    """Lines of all marks with their widths; those of the frame's outline may be crossed."""
    for group in groups:
        for mark in group.marks:
            if mark.look != "cg":
                width = 2 * mark.radius or LOOKS[mark.look].width
                points = [*mark.points, mark.points[0]] if mark.closed or len(mark.points) == 1 else mark.points
                yield from ((a, b, width) for a, b in pairwise(points))


def _around(groups: list[Group], labels: tuple[PlacedLabel, ...]) -> tuple[float, float, float, float]:
    """The box around everything, with a margin."""
    points: list[tuple[float, ...]] = []
    for group in groups:
        for mark in group.marks:
            r = mark.radius + LOOKS[mark.look].width / 2
            points += [(x + sign * r, y + sign * r) for x, y in mark.points for sign in (-1, 1)]
    for label in labels:
        points += [tuple(label.middle[k] + sign * label.half[k] for k in (0, 1)) for sign in (-1, 1)]
    xs, ys = zip(*points, strict=True)
    left, top = min(xs) - MARGIN, min(ys) - MARGIN
    return left, top, max(xs) + MARGIN - left, max(ys) + MARGIN - top
