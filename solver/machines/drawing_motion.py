"""How a machine's drawing moves: SVG transforms of its elements, one a position of the drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.course import course_of
from jointplay.solver.machines.drawing import MARGIN, Sheet, draw_machine, svg_class
from jointplay.solver.machines.labels import Pixel
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.marks import BLOCK
from jointplay.solver.machines.shapes import machine_shapes


@dataclass(frozen=True)
class MovingDrawing:
    """What moves in the drawing of :func:`jointplay.solver.machines.drawing.machine_svg`.

    Attributes
    ----------
    view_box : str
        Of the ``<svg>``, so that nothing leaves it.
    transforms : mapping of str to tuple of str
        By the class of an element (``link-rod``): its ``transform`` at each position. What is not there stands still.
    """

    view_box: str
    transforms: Mapping[str, tuple[str, ...]]


def moving_drawing(machine: Machine) -> MovingDrawing:
    """Return how the drawing of a machine goes through one period of its drive."""
    motion = course_of(machine).links
    shapes = machine_shapes(machine)
    sheet = Sheet(shapes)
    transforms: dict[str, tuple[str, ...]] = {}
    corners = []
    for link in shapes.links:
        poses = motion[link.name]
        transforms[_own_class("link", link.name)] = _transforms(sheet, link.cg, poses)
        corners += [_points(poses, link.cg, point) for point in (*link.points, link.cg)]
    for joint in shapes.joints:
        carrier, other = joint.links
        shifts = _shifts(sheet, machine.links[carrier].cg, joint.at, motion[carrier])
        transforms[_own_class("joint", joint.name)] = shifts
        if joint.kind == "sliding":  # the first link is the block, the line belongs to the second
            transforms[_own_class("joint", joint.name)] = _transforms(sheet, machine.links[carrier].cg, motion[carrier])
            transforms[_own_class("guide", joint.name)] = _transforms(sheet, machine.links[other].cg, motion[other])
        if joint.sense:
            transforms[_own_class("drive", joint.name)] = shifts
        transforms[_own_class("label-joint", joint.name)] = shifts
    for load in shapes.loads:
        cg = machine.links[load.name].cg
        transforms[_own_class("load", load.name)] = _shifts(sheet, cg, load.at, motion[load.name])
    moving = {name: steps for name, steps in transforms.items() if len(set(steps)) > 1}
    return MovingDrawing(_view_box(sheet, draw_machine(machine).box, np.concatenate(corners)), moving)


def _own_class(kind: str, name: str) -> str:
    return svg_class(kind, name).split(" ", 1)[1]


def _points(poses: FloatArray, cg: tuple[float, float], point: tuple[float, float]) -> FloatArray:
    """Where a point of a link is, (n, 2), m."""
    turned = np.exp(1j * poses[:, 2]) * complex(point[0] - cg[0], point[1] - cg[1])
    return np.column_stack([poses[:, 0] + turned.real, poses[:, 1] + turned.imag])


def _transforms(sheet: Sheet, cg: tuple[float, float], poses: FloatArray) -> tuple[str, ...]:
    at = sheet(cg)
    return tuple(
        f"translate({_number((x - cg[0]) * sheet.scale)} {_number((cg[1] - y) * sheet.scale)}) "
        f"rotate({_number(-math.degrees(angle), 2)} {at[0]:.1f} {at[1]:.1f})"
        for x, y, angle in poses
    )


def _shifts(sheet: Sheet, cg: Pixel, at: Pixel, poses: FloatArray) -> tuple[str, ...]:
    """Pins, names and forces stay upright: they are moved with a point of a link and not turned."""
    return tuple(
        f"translate({_number((x - at[0]) * sheet.scale)} {_number((at[1] - y) * sheet.scale)})"
        for x, y in _points(poses, cg, at)
    )


def _number(value: float, digits: int = 1) -> str:
    """A number without the sign of a zero: what stands still has the same transform throughout."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _view_box(sheet: Sheet, box: tuple[float, float, float, float], points: FloatArray) -> str:
    """The drawing's own view, wider where a link goes beyond it."""
    left, top = sheet((points[:, 0].min(), points[:, 1].max()))
    right, bottom = sheet((points[:, 0].max(), points[:, 1].min()))
    room = BLOCK[0] + MARGIN
    x0, y0 = min(box[0], left - room), min(box[1], top - room)
    x1, y1 = max(box[0] + box[2], right + room), max(box[1] + box[3], bottom + room)
    return f"{x0:.0f} {y0:.0f} {x1 - x0:.0f} {y1 - y0:.0f}"
