"""Drawings of machines: SVG for the page and for files; the same marks as PNG or PDF for files."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointplay.solver.machines.drawing import LETTERS, Picture, draw_machine, machine_svg, svg_of
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.marks import LOOKS, RED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ENDINGS = (".svg", ".png", ".pdf")
RULE = "must end in .svg, .png or .pdf"
WEAR = (232, 106, 20)
INK = "#16202b"
FAINTEST = 0.005
#: Points an inch, and dots of a PNG: it is some 1200 wide.
POINTS, DOTS = 72, 220


def machine_picture(machine: Machine, probabilities: Mapping[str, float]) -> str:
    """Return the drawing of a machine as SVG, each joint the deeper in colour the more probable its wear.

    Parameters
    ----------
    machine : Machine
    probabilities : Mapping
        Joint to probability, 0 to 1.
    """
    colours = {
        joint: "rgb({} {} {} / {:.3f})".format(*WEAR, min(probability, 1.0))
        for joint, probability in probabilities.items()
        if probability >= FAINTEST
    }
    return machine_svg(machine, colours, f"{machine.name}, joints coloured by the probability of wear")


@lru_cache(maxsize=4)
def response_picture(machine: Machine, phase: bool) -> str:
    """Return what the frame of a machine answers to forces as SVG: a task for workers."""
    from jointplay.app.figures.responses import response_svg  # loads the simulation, too

    return response_svg(machine, phase)


def check_ending(path: Path) -> None:
    """Refuse a drawing's file name before any work is done.

    Raises
    ------
    OutputError
        For another ending than .svg, .png or .pdf, or a folder that does not exist.
    """
    from jointplay.app.figures.outputs import check_output  # loads the simulation, which the web page does without

    check_output(path, ENDINGS, RULE)


def save_drawing(machine: Machine, worn: tuple[str, ...], path: Path, open_joint: str | None = None) -> None:
    """Write the drawing of a machine in its drawn pose; joints with clearance are filled.

    Parameters
    ----------
    machine : Machine
    worn : tuple of str
        Joints with clearance.
    path : Path
        Its ending says which format.
    open_joint : str, optional
        As for :func:`jointplay.solver.machines.drawing.draw_machine`.
    """
    check_ending(path)
    picture = draw_machine(machine, dict.fromkeys(worn, "#{:02x}{:02x}{:02x}".format(*WEAR)), open_joint=open_joint)
    if path.suffix.lower() == ".svg":
        text = svg_of(picture, f"drawing-{machine.content_key[:12]}")
        path.write_text('<?xml version="1.0" encoding="UTF-8"?>\n' + text, encoding="utf-8")
    else:
        paint(picture).savefig(path, dpi=DOTS)


def paint(picture: Picture) -> Figure:
    """Put a drawing on paper, a pixel of it for a point."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    left, top, width, height = picture.box
    figure = Figure(figsize=(width / POINTS, height / POINTS))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(left, left + width), ylim=(top + height, top))
    axes.set_axis_off()
    for order, mark in enumerate(mark for group in picture.groups for mark in group.marks):
        look = LOOKS[mark.look]
        face = (mark.colour or (INK, look.fill)) if look.fill or (mark.colour and look.fill is not None) else "none"
        style: dict[str, Any] = {
            "edgecolor": (mark.colour if look.fill is None and mark.colour else INK, look.opacity),
            "facecolor": face,
            "linewidth": look.width,
            "linestyle": (0, tuple(each / look.width for each in look.dash)) if look.dash else "solid",
            "capstyle": "round",
            "joinstyle": "round",
            "zorder": order,
            "clip_on": False,
        }
        if mark.radius:
            axes.add_patch(Circle(mark.points[0], mark.radius, **style))
        else:
            points = mark.points if len(mark.points) > 1 else mark.points * 2
            axes.add_patch(Polygon(points, closed=mark.closed, fill=face != "none", **style))
    for label in picture.labels:
        size, weight, slanted, opacity = LETTERS[label.kind]
        axes.text(
            *label.middle, label.text, size=size, weight=weight, style="italic" if slanted else "normal",
            color=(RED if label.kind == "gap" else INK, opacity), ha="center", va="center", zorder=len(axes.patches),
            parse_math=False,
        )  # fmt: skip
    return figure
