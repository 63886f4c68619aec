"""Where a run starts: as drawn or in static equilibrium, with velocities that fulfil constraints and drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.cases.assembly import CLOSED, NEWTON_STEPS, close, inner_coordinates
from jointplay.solver.equations.evaluation import evaluate
from jointplay.solver.equations.model import Model
from jointplay.solver.errors import AssemblyError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Start:
    """Where a run starts or ended: coordinates, velocities, (n,) each, the time, s, and what contacts remember, (m,).

    Without the last, a contact at the start begins there.
    """

    z: Array
    v: Array
    t: float = 0.0
    memory: Array = field(default_factory=lambda: np.zeros(0))


def start_pose(model: Model, p: Sequence[float]) -> Array:
    """Coordinates at t = 0: as drawn, or in static equilibrium with the drive standing and pins concentric.

    Parameters
    ----------
    model : Model
        For an equilibrium, of the machine with its drive standing.
    p : sequence of float

    Raises
    ------
    AssemblyError
        Nothing holds some motion, or no equilibrium is near the drawn pose.
    """
    z = np.zeros(model.size)
    if model.machine.initial.pose == "drawn" or model.size == 0:
        return z
    newton = model.equilibrium
    x = np.zeros(newton.size1_in(0))
    rest = np.zeros(model.size)
    for _ in range(NEWTON_STEPS):
        residual, jacobian = evaluate(newton, x, 0.0, rest, p)
        scale = np.maximum(np.abs(jacobian).max(axis=1), 1e-300)
        step, _, rank, _ = np.linalg.lstsq(jacobian / scale[:, None], residual[:, 0] / scale, rcond=1e-13)
        if rank < x.size:
            rule = "no static equilibrium: some motion is held by nothing; use `pose: drawn`"
            raise AssemblyError(model.machine.name, "initial.pose", "equilibrium", rule)
        x -= step
        if np.abs(step[: model.size]).max() < 1e-13:
            return np.asarray(x[: model.size])
    rule = "no static equilibrium near the drawn pose; use `pose: drawn`"
    raise AssemblyError(model.machine.name, "initial.pose", "equilibrium", rule)


def start_velocity(model: Model, p: Sequence[float], z: Array) -> Array:
    """Velocities of the ideal machine: constraints and drive fulfilled, what was given kept, the frame at rest.

    What is left open is the least mass-weighted motion.

    Raises
    ------
    AssemblyError
        Given velocities contradict each other, the joints or the drive.
    """
    rest = np.zeros(model.size)
    rows, right = [], []
    given = model.machine.initial.velocities
    names = list(model.machine.links)
    if given:
        link_jacobian, link_drift = evaluate(model.link_rates, 0.0, z, rest, p)
    for name, velocity in given.items():
        first = 3 * names.index(name)
        for k, value in enumerate((*(velocity.velocity or (None, None)), velocity.omega)):
            if value is not None:
                rows.append(link_jacobian[first + k])
                right.append(value - link_drift[first + k, 0])
    if model.machine.frame not in given:
        for index in model.frame_indices:
            if index is not None:
                rows.append(np.eye(model.size)[index])
                right.append(0.0)
    field = "initial" if given else "drive"
    return least_velocity(model, 0.0, p, z, np.array(rows).reshape(len(rows), model.size), np.array(right), field)


def least_velocity(
    model: Model, t: float, p: Sequence[float], z: Array, rows: Array, right: Array, field: str = "drive"
) -> Array:
    """The least mass-weighted velocities that fulfil closures, concentric pins and drive, and `rows` v = `right`.

    Parameters
    ----------
    model : Model
    t : float
        s.
    p : sequence of float
    z : (n,) array
        Coordinates that fulfil the closures.
    rows, right : (k, n) and (k,) arrays
    field : str
        Path in the machine file of what is to blame where these demands contradict each other.

    Returns
    -------
    (n,) array

    Raises
    ------
    AssemblyError
        They contradict each other.
    """
    rest = np.zeros(model.size)
    _, jacobian, drift = evaluate(model.constraint, t, z, rest, p)
    matrix, target = np.vstack([jacobian, rows]), np.concatenate([-drift[:, 0], right])
    if model.size == 0 or target.size == 0:
        return rest
    (mass,) = evaluate(model.mass_matrix, t, z, rest, p)
    root = np.linalg.cholesky(mass)
    # Least v'Mv: in w = L'v it is the least norm.
    weighted = np.linalg.solve(root, matrix.T).T
    v = np.linalg.solve(root.T, np.linalg.lstsq(weighted, target, rcond=1e-11)[0])
    left = float(np.abs(matrix @ v - target).max())
    if left > 1e-8 * max(1.0, float(np.abs(target).max())):
        rule = f"velocities contradict the joints and the drive by {left:.3g} (m/s or rad/s)"
        raise AssemblyError(model.machine.name, field, None, rule)
    return np.asarray(v)


def start_with_frame(
    model: Model, p: Sequence[float], t: float, pose: Array, displacement: Array, velocity: Array
) -> Start:
    """The machine at a time of its drive with its frame moving as given, everything else following.

    Pins are concentric, and velocities the least mass-weighted that fulfil closures and drive.

    Parameters
    ----------
    model : Model
    p : sequence of float
        Lane parameters.
    t : float
        Time of the drive, s.
    pose : (n,) array
        Coordinates near the wanted ones.
    displacement, velocity : (k,) arrays
        Of the coordinates that the frame has (m, m, rad), in the order x, y, theta.

    Raises
    ------
    AssemblyError
        The machine does not close there.
    """
    held = [index for index in model.frame_indices if index is not None]
    z = pose.copy()
    z[held] = displacement
    z, gap, name = close(model, t, z, p, inner_coordinates(model))
    if gap >= CLOSED:
        rule = f"does not close at the start by {gap * 1e3:.3g} mm"
        raise AssemblyError(model.machine.name, f"joints.{name.partition('.')[0]}", None, rule)
    return Start(z, least_velocity(model, t, p, z, np.eye(model.size)[held], velocity), t)
