"""What sensors on a frame see, and the motion of a rigid one back from what they saw.

The point P at ``r`` from the centre of gravity accelerates with ``a + alpha x r - w^2 r``; both ``r`` and the sensor's
direction turn with the frame. Where modes displace it by ``u`` in axes of the frame, ``r`` is ``r + u``, and ``u'' + 2
w x u'`` is added. Gravity is not in the signal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from jointplay.solver.arrays import FloatArray
from jointplay.solver.errors import SettingsError

#: Ratio of the largest to the smallest singular value of the (length-scaled) transform up to which sensors count as
#: seeing all three motions. Beyond it sensor noise swamps one motion.
CONDITION_LIMIT = 1e3


def sensor_transform(points: npt.ArrayLike, directions: npt.ArrayLike, centre: npt.ArrayLike) -> FloatArray:
    """Matrix from the frame's motion to sensor signals, for small rotations of the frame.

    Parameters
    ----------
    points, directions : (s, 2) arrays
        Sensor points [m] and directions (normalised here) as drawn.
    centre : (2,) array
        Centre of gravity of the frame as drawn [m].

    Returns
    -------
    (s, 3) array
        ``signal = T @ [ax, ay, alpha]``; the same matrix serves displacements and velocities.

    Raises
    ------
    SettingsError
        For a direction of no length.
    """
    arm = np.atleast_2d(np.asarray(points, dtype=np.float64)) - np.asarray(centre, dtype=np.float64)
    unit = _unit(directions)
    return np.column_stack([unit, unit[:, 1] * arm[:, 0] - unit[:, 0] * arm[:, 1]])


def sensor_signals(
    displacement: npt.ArrayLike,
    velocity: npt.ArrayLike,
    acceleration: npt.ArrayLike,
    points: npt.ArrayLike,
    directions: npt.ArrayLike,
    centre: npt.ArrayLike,
    bending: tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None = None,
) -> FloatArray:
    """Acceleration along each sensor's direction, without the approximation of small rotations.

    Parameters
    ----------
    displacement, velocity, acceleration : (n, 3) arrays
        Of the frame's centre of gravity, [x, y, theta], from the drawn pose, global axes.
    points, directions : (s, 2) arrays
        As drawn; both turn with the frame.
    centre : (2,) array
        Centre of gravity as drawn [m].
    bending : tuple of arrays, optional
        Shapes (s, m, 2) of the frame's modes at the points, their coordinates (n, m), rates and accelerations. By how
        much they turn a sensor, some 1e-5 rad, is left out.

    Returns
    -------
    (n, s) array
        m/s2.
    """
    angle = np.asarray(displacement, dtype=np.float64)[:, 2, None]
    rate = np.asarray(velocity, dtype=np.float64)[:, 2, None]
    motion = np.asarray(acceleration, dtype=np.float64)
    arm = np.atleast_2d(np.asarray(points, dtype=np.float64)) - np.asarray(centre, dtype=np.float64)
    unit = _unit(directions)
    # Seen in the frame's own axes r and the direction stand still, and only the acceleration has to be turned.
    cosine, sine = np.cos(angle), np.sin(angle)
    along = motion[:, :1] * cosine + motion[:, 1:2] * sine
    across = motion[:, 1:2] * cosine - motion[:, :1] * sine
    x, y = arm[:, 0], arm[:, 1]
    if bending is not None:
        shapes, *moved = bending
        (ux, uy), (vx, vy), (bx, by) = ([part @ shapes[:, :, k].T for k in (0, 1)] for part in moved)
        x, y, along, across = x + ux, y + uy, along + bx - 2 * rate * vy, across + by + 2 * rate * vx
    ax = along - motion[:, 2:3] * y - rate**2 * x
    ay = across + motion[:, 2:3] * x - rate**2 * y
    return np.asarray(ax * unit[:, 0] + ay * unit[:, 1], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Least-squares motion of the frame from sensor signals.

    Parameters
    ----------
    transform : (s, m) array
        Of :func:`sensor_transform`; all its columns or those of the motions that are free.
    inverse : (m, s) array or None
        ``[ax, ay, alpha] = inverse @ signal``; None where the sensors do not see all of these motions.
    """

    transform: FloatArray
    inverse: FloatArray | None

    @property
    def observable(self) -> bool:
        """Whether all motions follow from the sensors."""
        return self.inverse is not None


def rigid_body(transform: npt.ArrayLike) -> RigidBody:
    """Least squares back from sensors to the frame's motion.

    Parameters
    ----------
    transform : (s, m) array
        Columns of motions that are blocked may be left out.

    Returns
    -------
    RigidBody
    """
    matrix = np.atleast_2d(np.asarray(transform, dtype=np.float64))
    # Angles are weighed against translations at the sensors' own distance, or the condition would depend on the unit.
    scale = np.abs(matrix).max(axis=0, initial=0.0)
    singular = np.linalg.svd(matrix / np.where(scale > 0, scale, 1.0), compute_uv=False)
    if len(matrix) < matrix.shape[1] or singular[-1] * CONDITION_LIMIT < singular[0]:
        return RigidBody(matrix, None)
    return RigidBody(matrix, np.asarray(np.linalg.pinv(matrix), dtype=np.float64))


def _unit(directions: npt.ArrayLike) -> FloatArray:
    values = np.atleast_2d(np.asarray(directions, dtype=np.float64))
    length = np.hypot(values[:, 0], values[:, 1])
    if not np.all(length > 0):
        raise SettingsError("sensor direction: must have a length")
    return np.asarray(values / length[:, None], dtype=np.float64)
