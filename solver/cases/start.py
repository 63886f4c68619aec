"""Where a run starts: as drawn or in static equilibrium, with velocities that fulfil constraints and drive.

Closures are met by Newton's method, followed over the positions of the drive, or refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.change_points import AHEAD, ChangePoint, cannot_assemble, find_change_point, place_of
from jointplay.solver.cases.driven_link import cannot_follow, still_frame
from jointplay.solver.cases.rates import extent_of
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.equations.redundancy import independent_rows
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.parts import RotationDrive, TravelDrive

#: Closures count as closed below this (m, rad): some thousand times rounding at the size of a machine.
CLOSED = 1e-11
#: Newton's method gives up after so many steps.
NEWTON_STEPS = 30
_WALK_STEPS = 120
#: Least singular value of the closures, as a part of the largest, at which the machine counts as near a change point.
_SINGULAR = 0.03
#: It is looked for where that has fallen to this part within a step: it falls to nothing within six. Machines that
#: ship keep 0.97.
_FALLING = 0.85


def close(
    model: Model, t: float, z: FloatArray, p: Sequence[float], free: Sequence[int]
) -> tuple[FloatArray, float, str]:
    """Newton on closures and concentric pins, moving the `free` coordinates as little as possible.

    Returns the coordinates, the largest remaining gap and the name of the closure that has it.
    """
    return meet(model, t, z, p, free)[:3]


def meet(
    model: Model, t: float, z: FloatArray, p: Sequence[float], free: Sequence[int]
) -> tuple[FloatArray, float, str, FloatArray]:
    """As :func:`close`, with the Jacobian (m, k) of closures and eccentricities by the free coordinates there."""
    z = z.copy()
    names = [c.name for c in model.kinematics.closures] + [j for j in model.clearance_joints for _ in range(2)]
    zero = np.zeros(model.size)
    gap, rows = np.zeros(0), np.zeros((0, len(free)))
    for _ in range(NEWTON_STEPS):
        residual, jacobian, _ = evaluate(model.constraint, t, z, zero, p)
        gap, rows = residual[:, 0], jacobian[:, free]
        if gap.size == 0 or np.abs(gap).max() < CLOSED:
            break
        step = np.linalg.lstsq(rows, gap, rcond=1e-12)[0]
        # A full step from a dead centre may leave for infinity; half a radian or half a metre is far enough.
        z[free] -= step * min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-300))
    if gap.size == 0:
        return z, 0.0, "", rows
    worst = int(np.abs(gap).argmax())
    return z, float(abs(gap[worst])), names[worst], rows


def drive_period(model: Model, speed: float) -> float:
    """Time in which the drive goes through all its positions, s; 0 where it has none to go through.

    A frame that is driven takes its machine along, as it is.
    """
    drive = model.machine.drive
    if model.machine.driven_link == model.machine.frame:
        return 0.0
    if isinstance(drive, RotationDrive):
        return 2 * math.pi / abs(speed) if speed else 0.0
    if isinstance(drive, TravelDrive) and drive.harmonics:
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
    return walk_round(model, p, speed, steps)[0]


def walk_round(
    model: Model, p: Sequence[float], speed: float, steps: int = _WALK_STEPS
) -> tuple[list[tuple[float, FloatArray]], list[ChangePoint]]:
    """As :func:`walk`, with the change points on the way."""
    period = drive_period(model, speed)
    return follow(model, p, [period * k / steps for k in range(steps)] if period else [0.0], period)


def follow(
    model: Model, p: Sequence[float], times: Sequence[float], end: float
) -> tuple[list[tuple[float, FloatArray]], list[ChangePoint]]:
    """Assembled poses of the ideal machine at given times of its drive, each from the one before, and change points.

    Close to a change point the one before is as near to another branch: there it goes on as it came. As :func:`walk`;
    evenly spaced are the times, and from the last one the drive goes on to `end`.
    """
    free = model.inner_indices
    done: list[tuple[float, FloatArray]] = []
    passed: list[ChangePoint] = []
    z, rows = np.zeros(model.size), np.zeros((0, len(free)))
    previous, held, singular = 0.0, _SINGULAR * extent_of(model.machine) / _FALLING, False
    redundant = find_repeat(model, p)
    if redundant and model.machine.driven_link:
        raise redundant
    step = times[1] - times[0] if len(times) > 1 else 0.0
    ahead = sorted(times, reverse=True)
    while ahead:
        t = ahead.pop()
        guess = z
        if passed and not passed[-1].distance and previous <= passed[-1].t < t:
            guess = passed[-1].guess(t)
        elif len(done) > 1 and singular:
            before, past = done[-2]
            guess = z + (z - past) * (t - previous) / (previous - before)
        closed, gap, name, rows = meet(model, t, guess, p, free)
        if gap >= CLOSED:
            raise cannot_assemble(model, p, *last_pose(model, p, z, previous, t, free), gap, name)
        done.append((t, closed))
        z, previous, earlier = closed, t, held
        held, singular = _hold(model, rows)
        known = bool(passed) and t <= passed[-1].t + 0.5 * step
        if step and not redundant and not known and held < _FALLING * earlier:
            point = find_change_point(model, p, t, z, step)
            if point is None or point.t >= end:
                continue
            if not point.closes:
                last = last_pose(model, p, z, t, point.t, free)
                raise cannot_assemble(model, p, *last, point.distance, point.closure)
            passed.append(point)
            ahead = sorted({*ahead, *(at for at in point.times(AHEAD * step) if t < at < times[-1])}, reverse=True)
    if redundant:
        raise redundant
    wanted = set(times)
    return [pose for pose in done if pose[0] in wanted], passed


def _hold(model: Model, rows: FloatArray) -> tuple[float, bool]:
    """How much the closures hold the motion that they hold least; whether that is little in proportion to others."""
    sizes = np.linalg.svd(rows, compute_uv=False)[: min(rows.shape[1], len(rows) - model.repeats.shared)]
    return (float(sizes[-1]), bool(sizes[-1] < _SINGULAR * sizes[0])) if len(sizes) else (math.inf, False)


def find_repeat(model: Model, p: Sequence[float]) -> AssemblyError | None:
    """Refusal of the first closure that, as drawn, only repeats what those before it hold, and not at all positions.

    At positions further on it would hold something else, or the drive could not leave the drawn one. Of a link that is
    driven in space the frame must not have to follow.
    """
    closures = model.kinematics.closures
    rows = evaluate(model.constraint, 0.0, np.zeros(model.size), np.zeros(model.size), p)[1]
    if cannot_follow(model, rows):
        rule = "cannot be driven so from the drawn pose: a dead centre, or a direction in which it is held"
        return AssemblyError(model.machine.name, "drive.link", model.machine.driven_link, rule)
    rows = np.delete(rows[: len(closures)], model.kinematics.modes, axis=1)
    kept = independent_rows(rows)
    if len(kept) == len(rows) - model.repeats.shared:
        return None
    name = next(closure.name for place, closure in enumerate(closures) if place not in kept)
    rule = (
        "cannot be driven from the drawn pose, a dead centre: draw another one"
        if name.endswith(".drive")
        else "holds as drawn only what other joints hold already: leave one of them out, or draw another pose "
        "if this is a change point"
    )
    return AssemblyError(model.machine.name, place_of(model.machine, name), None, rule)


def last_pose(
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
        held = len(independent_rows(jacobian[model.size :, : model.size]))
        if rank < model.size + held:
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
    for row in still_frame(model):
        rows.append(row)
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
    w, _, rank, _ = np.linalg.lstsq(weighted, target, rcond=1e-11)
    if rank < model.size:
        given = np.linalg.solve(root, _given_momentum(model, t, p, z))
        w -= given - np.linalg.lstsq(weighted, weighted @ given, rcond=1e-11)[0]
    v = np.linalg.solve(root.T, w)
    left = float(np.abs(matrix @ v - target).max())
    if left > 1e-8 * max(1.0, float(np.abs(target).max())):
        rule = f"velocities contradict the joints and the drive by {left:.3g} (m/s or rad/s)"
        raise AssemblyError(model.machine.name, field, None, rule)
    return np.asarray(v)


def _given_momentum(model: Model, t: float, p: Sequence[float], z: FloatArray) -> FloatArray:
    """Momenta of the coordinates, (n,), by the prescribed motion alone: what couples it to the motions left open."""
    jacobian, drift = evaluate(model.link_rates, t, z, np.zeros(model.size), p)
    numbers = model.nominal | dict(zip(model.parameters, p, strict=True))
    # Only a fixed link may leave them out, and that one stands.
    mass, moment = (
        [numbers.get(f"links.{link}.{name}", 0.0) for link in model.machine.links] for name in ("mass", "inertia")
    )
    return np.asarray(jacobian.T @ (np.column_stack([mass, mass, moment]).ravel() * drift[:, 0]))


def start_with_frame(
    model: Model, p: Sequence[float], t: float, pose: FloatArray, displacement: FloatArray, velocity: FloatArray,
    rows: FloatArray | None = None, right: Sequence[float] = (),
) -> Start:  # fmt: skip
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
        Of :attr:`~jointplay.solver.equations.model.Model.frame_coordinates` (m, m, rad, m by the scale of a shape).
    rows, right : (k, n) array and (k,) sequence, optional
        What else velocities fulfil, see :func:`least_velocity`.

    Raises
    ------
    AssemblyError
        The machine does not close there.
    """
    held = model.frame_coordinates
    z = pose.copy()
    z[held] = displacement
    z, gap, name = close(model, t, z, p, model.inner_indices)
    if gap >= CLOSED:
        rule = f"does not close at the start by {gap * 1e3:.3g} mm"
        raise AssemblyError(model.machine.name, place_of(model.machine, name), None, rule)
    all_rows = np.vstack([np.eye(model.size)[held], *([] if rows is None else [rows])])
    return Start(z, least_velocity(model, t, p, z, all_rows, np.array([*velocity, *right])), t)
