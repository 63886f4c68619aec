"""A scene is simulated, and what comes out is judged: a number that holds against the oracle, or a named failure."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from fuzz.machines import Scene
from numpy.typing import NDArray
from oracle.closures import blocked_motions
from oracle.dense import JammedError, _System
from oracle.state import State
from scipy.integrate import solve_ivp

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.equations.anchors import row_times
from jointplay.solver.equations.links import LinkMotion
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.restitution import HYSTERESIS
from jointplay.solver.simulation.simulate import simulate

Array = NDArray[np.float64]

#: Samples in which solver and oracle are compared.
SAMPLES = 10
#: Scaled error of a step: of the run that is judged, and of the one that says how far it has converged.
FINE, COARSE = 1e-9, 1e-7
#: Part of the velocities' scale: a thousand steps of `FINE`. What differs by less is taken for right at once, what
#: differs by more must do so by less than this beside what the run has not converged to.
FLOOR = 1e-6
#: Evaluations after which the oracle's integration gives up: a stiff contact, or masses that leave it few digits.
MOST_EVALUATIONS = 800


class FaultyError(AssertionError):
    """A result that is neither right nor named."""


class _TiredError(Exception):
    pass


@dataclass(frozen=True)
class Verdict:
    """How a scene ended: a status, or `refused`; whether the oracle confirmed it; and the message."""

    ending: str
    confirmed: bool
    message: str


def judge(scene: Scene, *, evaluations: int = MOST_EVALUATIONS) -> Verdict:
    """Simulate a scene and compare with the oracle's equations, integrated on their own.

    Where the two differ by more than :data:`FLOOR`, both have to say how far they have converged.

    Raises
    ------
    FaultyError
        Something that is no number, a failure without a name, or a motion that is not the oracle's.
    """
    try:
        fine = _run(scene, FINE)
    except (MachineError, SettingsError) as error:
        return Verdict("refused", False, str(error))
    if fine.status is not Status.OK:
        if not fine.message:
            raise FaultyError(f"{fine.status} without a message")
        return Verdict(fine.status.value, False, fine.message)
    assert fine.links is not None
    if any(scene.machine.joints[joint].contact.law in HYSTERESIS for joint in scene.fault.joints):
        return Verdict("ok", False, fine.message)  # the oracle's accelerations know a state, not what was before
    try:
        error = _difference(scene.machine, fine.links.velocity, _integrated(scene, fine.links, 1e-8, evaluations))
        if error > FLOOR:
            rough = _run(scene, COARSE)
            if rough.links is None or rough.status is not Status.OK:
                return Verdict(f"ok, but {rough.status} at {COARSE:g}", False, rough.message)
            converged = _difference(scene.machine, fine.links.velocity, rough.links.velocity)
            right = _integrated(scene, fine.links, 1e-11, 4 * evaluations)
            error = _difference(scene.machine, fine.links.velocity, right)
            if error > converged + FLOOR:
                raise FaultyError(
                    f"velocities are {error:.3g} from the oracle's; they had converged to {converged:.3g}"
                )
    except _TiredError:
        return Verdict("ok", False, fine.message)
    return Verdict("ok", True, fine.message)


def _run(scene: Scene, rtol: float) -> History:
    settings = Settings(duration=scene.duration, sample_rate=SAMPLES / scene.duration, rtol=rtol, links=True)
    history = simulate(scene.machine, Case(scene.fault), settings)
    _finite(history)
    return history


def _finite(history: History) -> None:
    arrays = [history.displacement, history.velocity, history.acceleration, history.band_limited_acceleration]
    if history.links is not None:
        arrays += [history.links.displacement, history.links.velocity, history.links.acceleration]
        arrays += list(history.links.reactions.values())
    if not all(np.isfinite(array).all() for array in arrays):
        raise FaultyError(f"{history.status} with something that is no number")


def _difference(machine: Machine, one: Array, other: Array) -> float:
    """Largest difference of the links' velocities, as part of their scales: the largest, or what gravity gives."""
    points = [joint.at for joint in machine.joints.values()] + [link.cg for link in machine.links.values()]
    extent = max((math.dist(p, q) for p in points for q in points), default=0.0) or 1.0
    rate = max(math.sqrt(abs(machine.gravity) / extent), 1.0)
    parts = []
    for columns, size in ((slice(0, 2), extent), (slice(2, 3), 1.0)):
        first, second = one[..., columns], other[..., columns]
        parts.append(np.abs(first - second).max() / max(np.abs(second).max(), size * rate))
    return float(max(parts))


def _integrated(scene: Scene, motion: LinkMotion, rtol: float, most: int) -> Array:
    """Velocities (samples, N, 3) by the oracle's accelerations, from the first sample on."""
    machine = scene.machine
    t = np.linspace(0.0, scene.duration, len(motion.velocity))
    drawn = np.array([(*link.cg, 0.0) for link in machine.links.values()])
    start = np.concatenate([(motion.displacement[0] + drawn).ravel(), motion.velocity[0].ravel()])
    blocked = [3 * i + k for i, k in blocked_motions(machine)]
    signs: list[tuple[float, ...]] = []
    count = 0

    def rate(t: float, y: Array) -> Array:
        nonlocal count
        count += 1
        if count > most or not np.isfinite(y).all():
            raise _TiredError
        positions, velocities = (part.reshape(-1, 3) for part in np.split(y, 2))
        system = _System(State(machine, positions, velocities), scene.fault, t, {})
        try:
            accelerations = _signed(system, signs).ravel()
        except JammedError:  # a trial too far; a shorter step follows
            return np.full(len(y), math.nan)
        accelerations[blocked] = 0.0
        return np.concatenate([y[len(y) // 2 :], accelerations])

    rows = [row for row in row_times(machine) if 0 < row <= t[-1]]
    found = np.array([start] * len(t))
    for begin, end in itertools.pairwise(sorted({0.0, *rows, t[-1]})):
        stop = end * (1 - 1e-13) if end in rows else end  # what follows the row of a table is not to be seen before
        inside = (t > begin) & (t <= end)
        times = np.unique([*np.minimum(t[inside], stop), stop])
        try:
            part = solve_ivp(rate, (begin, stop), start, "DOP853", times, rtol=rtol, atol=0.1 * rtol)
        except np.linalg.LinAlgError as error:
            raise _TiredError from error
        if part.status != 0:
            raise FaultyError(f"the oracle's integration ends at {part.t[-1]:.3g} s: {part.message}")
        found[inside], start = part.y.T[: np.count_nonzero(inside)], part.y[:, -1]
    return np.asarray(found[:, len(start) // 2 :].reshape(len(t), -1, 3))


def _signed(system: _System, last: list[tuple[float, ...]]) -> Array:
    """Accelerations with the first consistent signs of the normal forces, those that were right last tried first."""
    for signs in [*last, *itertools.product((1.0, -1.0), repeat=len(system.rubbing))]:
        solution = system.solve(signs)
        normal = np.array([solution.reactions[name][0] for name in system.rubbing])
        if (normal * signs >= 0).all():
            last[:] = [signs]
            return solution.accelerations
    raise JammedError("no signs of the normal forces are consistent with the motion")
