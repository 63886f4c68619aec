"""Drawings of machines: SVG for the page and for files, PNG for files."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointplay.solver.machines.drawing import machine_svg
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.shapes import SupportMark, machine_shapes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ENDINGS = (".svg", ".png")
WEAR = (232, 106, 20)
FAINTEST = 0.005
MOUNT_LENGTH = 0.06


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
        For another ending than .svg or .png, or a folder that does not exist.
    """
    from jointplay.app.figures.outputs import check_output  # loads the simulation, which the web page does without

    check_output(path, ENDINGS, "must end in .svg or .png")


def save_drawing(machine: Machine, worn: tuple[str, ...], path: Path) -> None:
    """Write the drawing of a machine in its drawn pose; joints with clearance are filled.

    Parameters
    ----------
    machine : Machine
    worn : tuple of str
        Joints with clearance.
    path : Path
        Its ending says which format.
    """
    from jointplay.app.figures.outputs import check_output

    ending = check_output(path, ENDINGS, "must end in .svg or .png")
    if ending == ".png":
        save_png(machine, worn, path)
        return
    picture = machine_svg(machine, dict.fromkeys(worn, "#{:02x}{:02x}{:02x}".format(*WEAR)))
    path.write_text('<?xml version="1.0" encoding="UTF-8"?>\n' + picture, encoding="utf-8")


def save_png(machine: Machine, worn: tuple[str, ...], path: Path) -> None:
    """Draw the outlines of a machine with points and lines."""
    from matplotlib.figure import Figure

    shapes = machine_shapes(machine)
    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(machine.name)
    left, bottom, right, top = shapes.bounds
    size = max(right - left, top - bottom)
    for link in shapes.links:
        outline = [*link.outline, link.outline[0]] if link.closed else list(link.outline)
        xs, ys = zip(*outline, strict=True)
        axes.plot(xs, ys, color="0.55", linewidth=2 if link.is_frame else 6, linestyle="--" if link.is_frame else "-")
        axes.plot(*link.cg, marker="+", color="0.4")
        axes.annotate(link.name, link.cg, textcoords="offset points", xytext=(6, -12), style="italic", color="0.35")
    for support in shapes.supports:
        draw_support(axes, support, MOUNT_LENGTH * size)
    names: dict[tuple[float, float], list[str]] = {}
    # A guide is drawn first and larger, so that a pin in the same place stays visible.
    for joint in sorted(shapes.joints, key=lambda mark: mark.kind != "sliding"):
        look: dict[str, Any] = (
            {"marker": "s", "markersize": 18} if joint.kind == "sliding" else {"marker": "o", "markersize": 10}
        )
        fill = tuple(part / 255 for part in WEAR) if joint.name in worn else "white"
        axes.plot(*joint.at, color="black", markerfacecolor=fill, linestyle="none", **look)
        names.setdefault(joint.at, []).append(joint.name)
    for at, there in names.items():
        axes.annotate(", ".join(sorted(there)), at, textcoords="offset points", xytext=(11, 9), weight="bold")
    for sensor in shapes.sensors:
        tip = (sensor.at[0] + 0.08 * size * sensor.direction[0], sensor.at[1] + 0.08 * size * sensor.direction[1])
        axes.annotate("", tip, sensor.at, arrowprops={"arrowstyle": "->"})
        axes.annotate(sensor.name, tip, fontsize="small")
    for drive in shapes.drives:
        tip = (drive.at[0] + 0.1 * size * drive.direction[0], drive.at[1] + 0.1 * size * drive.direction[1])
        axes.annotate("", tip, drive.at, arrowprops={"arrowstyle": "->", "linewidth": 1.5})
    figure.savefig(path, dpi=150)


def draw_support(axes: Axes, support: SupportMark, length: float) -> None:
    """Draw a support as a dotted line to its anchor, with a bar where that is the ground."""
    end = support.end or (support.start[0], support.start[1] + (length if support.upward else -length))
    axes.plot(*zip(support.start, end, strict=True), color="0.3", linewidth=1.5, linestyle=":")
    if support.on_ground:
        axes.plot([end[0] - length / 2, end[0] + length / 2], [end[1]] * 2, color="0.3", linewidth=1.5)
    if support.motion is not None:
        x, y = (0.5 * length * part for part in support.motion)
        ends = ((end[0] + x, end[1] + y), (end[0] - x, end[1] - y))
        axes.annotate("", *ends, arrowprops={"arrowstyle": "<->", "linewidth": 1.5})
