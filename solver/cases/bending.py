"""How the frame's modes moved in a run, and what of it sensors take for a motion of a rigid frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.modes import shapes_at
from jointplay.solver.spectra.sensor import sensor_transform


@dataclass(frozen=True, eq=False)
class Bending:
    """Motion of the frame's modes, (n, m) each.

    Coordinates, rates and accelerations at the samples of a :class:`~jointplay.solver.cases.history.History`. A point
    of the frame is displaced by these coordinates times its displacements in the shapes.
    """

    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    band_limited_acceleration: FloatArray

    def __getitem__(self, rows: slice) -> Bending:
        """Of some samples."""
        parts = (self.displacement, self.velocity, self.acceleration, self.band_limited_acceleration)
        return Bending(*(part[rows] for part in parts))

    def motion(self, rows: slice, *, instantaneous: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Coordinates, rates and accelerations of some samples; instantaneous or band-limited accelerations."""
        acceleration = self.acceleration if instantaneous else self.band_limited_acceleration
        return self.displacement[rows], self.velocity[rows], acceleration[rows]


def seen_as_rigid(machine: Machine) -> FloatArray:
    """Motion [x, y, theta] of a rigid frame by which its sensors explain what they see, (3, s): least squares."""
    points, directions = ([getattr(sensor, name) for sensor in machine.sensors] for name in ("at", "direction"))
    frame = machine.links[machine.frame]
    free = [column for column, motion in enumerate(("x", "y", "theta")) if motion not in frame.locked]
    seen = np.zeros((3, len(points)))
    seen[free] = np.linalg.pinv(sensor_transform(points, directions, frame.cg)[:, free])
    return seen


def taken_for_rigid(machine: Machine) -> FloatArray:
    """Motion [x, y, theta] of a rigid frame by which its sensors explain a unit of each mode, (3, m): least squares."""
    points, directions = ([getattr(sensor, name) for sensor in machine.sensors] for name in ("at", "direction"))
    along = np.einsum("smk,sk->sm", shapes_at(machine.modes, points), np.asarray(directions))
    return np.asarray(seen_as_rigid(machine) @ along)
