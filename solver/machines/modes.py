"""Flexible modes of the frame, as they stand in a machine file: frequency, damping, and the shape at its points.

A mode is what a calculation or a modal test of the frame alone gives, hung freely, without links and supports. Such
modes move neither the centre of gravity of the frame nor, on average, its axes: the rigid motion feels them only
through what is fastened to the frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.arrays import AnyComplexArray, FloatArray
from jointplay.solver.machines import units
from jointplay.solver.machines.fields import Point, QuantityField, VectorField
from jointplay.solver.machines.parts import Part

#: Most modes of a frame.
MOST_MODES = 5
#: Points of a drawing that are nearer to each other than this are one, m.
SAME_POINT = 1e-6


class ShapePoint(Part):
    """A point of the frame, its displacement in a mode, and the rotation there [1/m: rad for a displacement of 1 m]."""

    at: Point
    displacement: Annotated[tuple[float, float], VectorField((QuantityField(units.RATIO),) * 2)]
    rotation: Annotated[float, QuantityField(units.SLOPE)] = 0.0


class FrameMode(Part):
    """A flexible mode of the frame alone.

    ``frequency`` [Hz], ``damping`` (ratio to critical) and ``shape``, in axes of the frame. ``mass`` [kg] is the modal
    mass at the scale of the shape; 1, the default, is that of a shape normalised by mass, in 1/sqrt(kg).
    """

    frequency: Annotated[float, QuantityField(units.FREQUENCY, above=0)]
    damping: Annotated[float, QuantityField(units.RATIO, at_least=0, at_most=1)]
    mass: Annotated[float, QuantityField(units.MASS, above=0)] = 1.0
    shape: tuple[ShapePoint, ...]

    @property
    def largest(self) -> float:
        """Largest displacement of the shape; 1 where it has none."""
        return max((math.hypot(*point.displacement) for point in self.shape), default=0.0) or 1.0

    def find(self, at: Sequence[float]) -> ShapePoint | None:
        """What the shape says of the point that was drawn at `at`."""
        return next((point for point in self.shape if math.dist(point.at, at) < SAME_POINT), None)

    def displacement_at(self, at: Sequence[float]) -> tuple[float, float]:
        """Displacement at a point of the frame that carries something."""
        return self._known(at).displacement

    def rotation_at(self, at: Sequence[float]) -> float:
        """Rotation at a point of the frame that carries something, 1/m."""
        return self._known(at).rotation

    def _known(self, at: Sequence[float]) -> ShapePoint:
        found = self.find(at)
        assert found is not None  # or the machine would have been refused
        return found


def shapes_at(modes: Sequence[FrameMode], points: Sequence[tuple[float, float]]) -> FloatArray:
    """Displacements of modes at points of the frame that carry something, (points, modes, 2)."""
    found = [[mode.displacement_at(at) for mode in modes] for at in points]
    return np.array(found, dtype=np.float64).reshape(len(points), len(modes), 2)


def swing(ratio: NDArray[np.floating], damping: NDArray[np.floating] | float) -> AnyComplexArray:
    """How far a mode swings against what moves it, for a unit motion of that: r^2 / (1 - r^2 + 2 i z r).

    Parameters
    ----------
    ratio : array of floats
        r, frequency over that of the mode; its precision is that of the result.
    damping : array, or float
        z, ratio to critical, broadcast against `ratio`.

    Notes
    -----
    Accelerance between two points of a frame that hangs freely, without its rigid motion, is minus this times the
    product of the shape at both over the modal mass. D. J. Ewins, Modal Testing, 2nd ed. (2000), chapter 2.
    """
    square = ratio * ratio
    return np.asarray(square / (1.0 - square + 2j * damping * ratio))
