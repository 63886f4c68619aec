"""A link whose position in space is prescribed: what the frame may do beside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.equations.redundancy import independent_rows
from jointplay.solver.machines.parts import PositionDrive


def cannot_follow(model: Model, rows: FloatArray) -> bool:
    """Whether a driven link could follow its drive only if the frame went with it.

    Parameters
    ----------
    model : Model
    rows : (m, n) array
        Jacobian of the closures, of which the drive's is the last, and of concentric pins.
    """
    if model.machine.driven_link in ("", model.machine.frame):
        return False
    inner = rows[:, model.inner_indices]
    drive = len(model.kinematics.closures) - 1
    return len(rows) - 1 not in independent_rows(np.vstack([np.delete(inner, drive, axis=0), inner[drive]]))


def still_frame(model: Model) -> list[FloatArray]:
    """Rows (n,) over the velocities: motions that a frame does not have at the start, unless they were given.

    One that is driven stands across its drive.
    """
    machine, drive, unit = model.machine, model.machine.drive, np.eye(model.size)
    modes = [unit[i] for i in model.kinematics.modes]
    if machine.frame in machine.initial.velocities:
        return modes
    if not isinstance(drive, PositionDrive) or drive.link != machine.frame:
        return [unit[i] for i in model.frame_coordinates]
    x, y, theta = model.frame_indices
    turning = [] if theta is None else [unit[theta]]
    across = [] if x is None or y is None else [drive.direction[0] * unit[y] - drive.direction[1] * unit[x]]
    return [*across, *turning, *modes]


def beside_drive(
    model: Model, p: Sequence[float], rigid: FloatArray, motions: list[str]
) -> tuple[FloatArray, list[str]]:
    """Motions of the frame that a driven link leaves: links go round it; a frame that is driven moves across.

    Parameters
    ----------
    model : Model
        With its drive standing.
    p : sequence of float
        Lane parameters.
    rigid : (n, k) array
        Motions of the machine as one body, and of its modes.
    motions : list of str
        Their names.

    Returns
    -------
    (n, l) array, list of str
    """
    zero, inner = np.zeros(model.size), model.inner_indices
    rows = evaluate(model.constraint, 0.0, zero, zero, p)[1]
    if model.machine.driven_link != model.machine.frame:
        rigid = rigid.copy()
        rigid[inner] -= np.linalg.lstsq(rows[:, inner], rows @ rigid, rcond=1e-9)[0]
        return rigid, motions
    moved = rows[len(model.kinematics.closures) - 1] @ rigid
    most = int(np.abs(moved).argmax())
    others = [k for k in range(len(motions)) if k != most]
    return (rigid - np.outer(rigid[:, most], moved / moved[most]))[:, others], [motions[k] for k in others]
