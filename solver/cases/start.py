"""Where a run starts: as drawn or in static equilibrium, with velocities that fulfil constraints and drive.

Closures are met by Newton's method, followed over the positions of the drive, or refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.parts import RotationDrive, TranslationDrive

#: Closures count as closed below this (m, rad): some thousand times rounding at the size of a machine.
CLOSED = 1e-11
#: A closure of which less than this part is not in those before it repeats them.
_INDEPENDENT = 1e-9
#: Newton's method gives up after so many steps.
NEWTON_STEPS = 30
_WALK_STEPS = 120


def close(
    model: Model, t: float, z: FloatArray, p: Sequence[float], free: Sequence[int]
) -> tuple[FloatArray, float, str]:
    """Newton on closures and concentric pins, moving the `free` coordinates as little as possible.

    Returns the coordinates, the largest remaining gap and the name of the closure that has it.
    """
    z = z.copy()
    names = [c.name for c in model.kinematics.closures] + [j for j in model.clearance_joints for _ in range(2)]
    zero = np.zeros(model.size)
    gap = np.zeros(0)
    for _ in range(NEWTON_STEPS):
        residual, jacobian, _ = evaluate(model.constraint, t, z, zero, p)
        gap = residual[:, 0]
        if gap.size == 0 or np.abs(gap).max() < CLOSED:
            break
        step = np.linalg.lstsq(jacobian[:, free], gap, rcond=1e-12)[0]
        # A full step from a dead centre may leave for infinity; half a radian or half a metre is far enough.
        z[free] -= step * min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-300))
    if gap.size == 0:
        return z, 0.0, ""
    worst = int(np.abs(gap).argmax())
    return z, float(abs(gap[worst])), names[worst]


def inner_coordinates(model: Model) -> list[int]:
    """Coordinates other than the frame's."""
    return [i for i in range(model.size) if i not in model.frame_indices]


def drive_period(model: Model, speed: float) -> float:
    """Time in which the drive goes through all its positions, s; 0 where it has none to go through."""
    drive = model.machine.drive
    if isinstance(drive, RotationDrive):
        return 2 * math.pi / abs(speed) if speed else 0.0
    if isinstance(drive, TranslationDrive) and drive.harmonics:
        return 1.0 / min(h.frequency for h in drive.harmonics if h.frequency > 0)
    return 0.0


def walk(model: Model, p: Sequence[float], speed: float, steps: int = _WALK_STEPS) -> list[tuple[float, FloatArray]]:
    """Assembled poses of the ideal machine over one period of the drive, the frame where it was drawn.

    Parameters
    ----------
    model : Model
    p : sequence of float
        Lane parameters.
    speed : float
        Drive speed, rad/s.
    steps : int
        Poses to compute.

    Returns
    -------
    list of (float, (n,) array)
        Times and coordinates.

    Raises
    ------
    AssemblyError
        The machine cannot be assembled at some drive angle, or a joint is redundant; the message names it.
    """
    period = drive_period(model, speed)
    return follow(model, p, [period * k / steps for k in range(steps)] if period else [0.0])


def follow(model: Model, p: Sequence[float], times: Sequence[float]) -> list[tuple[float, FloatArray]]:
    """Assembled poses of the ideal machine at given times of its drive, each from the one before; as :func:`walk`."""
    check_closures(model, p)
    free = inner_coordinates(model)
    poses: list[tuple[float, FloatArray]] = []
    z = np.zeros(model.size)
    previous = 0.0
    for t in times:
        closed, gap, name = close(model, t, z, p, free)
        if gap >= CLOSED:
            raise _cannot_assemble(model, p, *_last_pose(model, p, z, previous, t, free), gap, name)
        poses.append((t, closed))
        z, previous = closed, t
    return poses


def check_closures(model: Model, p: Sequence[float]) -> None:
    """Refuse a joint that only repeats what others hold: its reaction would have no value.

    Raises
    ------
    AssemblyError
        Names the first closure, as drawn, that follows from those before it.
    """
    closures = model.kinematics.closures
    rows = evaluate(model.constraint, 0.0, np.zeros(model.size), np.zeros(model.size), p)[1][: len(closures)]
    scale = float(np.abs(rows).max(initial=0.0))
    basis: list[FloatArray] = []
    for closure, row in zip(closures, rows, strict=True):
        size = float(np.linalg.norm(row))
        left = row.copy()
        for _ in range(2):  # once more, or rounding would stay in
            for other in basis:
                left -= (other @ left) * other
        if size <= _INDEPENDENT * scale or np.linalg.norm(left) <= _INDEPENDENT * size:
            rule = (
                "cannot be driven from the drawn pose, a dead centre: draw another one"
                if closure.name.endswith(".drive")
                else "holds as drawn only what other joints hold already: leave one of them out, or draw another pose "
                "if this is a change point"
            )
            raise AssemblyError(model.machine.name, _place(closure.name), None, rule)
        basis.append(left / np.linalg.norm(left))


def _last_pose(
    model: Model, p: Sequence[float], z: FloatArray, good: float, bad: float, free: Sequence[int]
) -> tuple[float, FloatArray]:
    """Time and coordinates of the last pose that closes, between one that does and one that does not."""
    for _ in range(12):
        middle = 0.5 * (good + bad)
        closed, gap, _ = close(model, middle, z, p, free)
        if gap < CLOSED:
            good, z = middle, closed
        else:
            bad = middle
    return good, z


def _place(closure: str) -> str:
    """Path in the machine file of what a closure stands for."""
    owner, _, kind = closure.partition(".")
    return f"links.{owner}.locked" if kind.startswith("locked") else f"joints.{owner}"


def _cannot_assemble(model: Model, p: Sequence[float], t: float, z: FloatArray, gap: float, name: str) -> AssemblyError:
    """Refusal after the last pose `z` that closes, at time `t`; `gap` is what stays open at the next of the walk."""
    machine, kin = model.machine, model.kinematics
    where = "as drawn"
    if isinstance(machine.drive, RotationDrive | TranslationDrive):
        joint = machine.joints[machine.drive.joint]
        if isinstance(joint, TurningJoint):
            first, second = (kin.poses[link].theta for link in joint.links)
            position, factor, text = first - second, 180 / math.pi, "a drive angle of {:.1f} deg"
        else:
            position, factor, text = kin.slide(joint)[0], 1e3, "a drive travel of {:.3g} mm"
        now = float(model.function("position", position)(t, z, np.zeros(model.size), p))
        where = "at " + text.format(factor * now)
    owner, _, kind = name.partition(".")
    what = f"link {owner}, locked," if kind.startswith("locked") else f"joint {owner}"
    rule = f"cannot be assembled {where}: a little further {what} stays {gap * 1e3:.3g} mm open"
    return AssemblyError(machine.name, _place(name), None, rule)


@dataclass(frozen=True, eq=False)
class Start:
    """Where a run starts or ended: coordinates, velocities, (n,) each, the time, s, and what contacts remember, (m,).

    Without the last, a contact at the start begins there.
    """

    z: FloatArray
    v: FloatArray
    t: float = 0.0
    memory: FloatArray = field(default_factory=lambda: np.zeros(0))


def start_pose(model: Model, p: Sequence[float]) -> FloatArray:
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


def start_velocity(model: Model, p: Sequence[float], z: FloatArray) -> FloatArray:
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
    model: Model, t: float, p: Sequence[float], z: FloatArray, rows: FloatArray, right: FloatArray, field: str = "drive"
) -> FloatArray:
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
    model: Model, p: Sequence[float], t: float, pose: FloatArray, displacement: FloatArray, velocity: FloatArray
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
