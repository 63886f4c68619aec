"""Step size and transient from the scene: contact frequencies, suspension, drive."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import casadi as ca
import numpy as np
from scipy import linalg

from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.cases.driven_link import beside_drive
from jointplay.solver.cases.rates import ContactRates
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.errors import AssemblyError

Accuracy = Literal["draft", "standard", "reference"]


@dataclass(frozen=True)
class StepRule:
    """How finely each frequency of a scene is resolved.

    Attributes
    ----------
    contact : float
        Largest product of step and contact frequency, rad.
    decay : float
        Largest product of step and contact damping rate; Runge-Kutta-Gill is stable to 2.78.
    smooth : float
        Largest product of step and the fastest eigenvalue of everything but contacts.
    rubbing : float
        Largest product of step and the rate at which friction settles a sliding velocity. Its force is bounded: one
        that is not resolved chatters, but does not grow.
    per_revolution : float
        Least steps in a revolution of the drive.
    """

    contact: float
    decay: float
    smooth: float
    rubbing: float
    per_revolution: float


#: Chosen from measured harmonic errors, see ``docs/measured/solver.md``.
STEP_RULES: dict[Accuracy, StepRule] = {
    "draft": StepRule(0.8, 1.2, 0.5, 2.0, 360),
    "standard": StepRule(0.16, 0.4, 0.2, 1.0, 1440),
    "reference": StepRule(0.008, 0.02, 0.02, 0.1, 7200),
}

#: What an error-controlled step keeps to as well: an estimate cannot see what it steps over, and near the limit of
#: stability it lets noise of the size of its tolerance grow.
BETWEEN_IMPACTS = StepRule(math.inf, math.inf, 0.5, math.inf, 120)

#: Largest product of step and the rate of a film of oil: stable. Nothing that is slower feels how it settles.
FILM = 1.2
#: Thickness of a film in parts of the clearance that runs under error control are estimated by; they find their steps.
USUAL_FILM = 0.1

#: The start-up transient of the suspension is dropped until it has decayed to this part of itself (-40 dB).
RESIDUE = 0.01
#: Revolutions dropped at least: the impacts take a few to settle.
SETTLING_REVOLUTIONS = 2
#: Part of the transient as drawn that is still dropped, in whole revolutions: what the wear itself adds to the motion
#: of the frame decays as slowly as the suspension. Chosen from measured spectra, ``docs/measured/solver.md``.
SETTLED_PART = 0.25
#: Least part of its motion at a fast drive that a frame is taken to answer a slow one with.
LEAST_RESPONSE = 1e-3
#: A suspension that decays slower than this part of its frequency counts as undamped.
UNDAMPED = 1e-4


def contact_mobility(model: Model, poses: Sequence[tuple[float, FloatArray]], p: Sequence[float]) -> dict[str, float]:
    """Largest mobility (1/kg, one over the effective mass) of each clearance joint over the given poses.

    Parameters
    ----------
    model : Model
    poses : sequence of (float, (n,) array)
        Times and coordinates, see :func:`jointplay.solver.cases.start.walk`.
    p : sequence of float
        Lane parameters.
    """
    if not model.clearance_joints or not poses:
        return dict.fromkeys(model.clearance_joints, 0.0)
    closures = len(model.kinematics.closures)
    # All poses in one call each: a call costs more than what it computes.
    count = len(poses)
    t, z = np.array([t for t, _ in poses]), np.array([z for _, z in poses])
    state = (t, z, np.zeros_like(z), np.tile(p, (count, 1)))
    mass = _stack(evaluate(_for_all(model.mass_matrix, count), *state)[0], count)
    jacobian = _stack(evaluate(_for_all(model.constraint, count), *state)[1], count)
    mobility = np.linalg.inv(mass)
    if closures:
        loops = jacobian[:, :closures]
        spread = mobility @ loops.swapaxes(1, 2)
        mobility = mobility - spread @ np.linalg.pinv(loops @ spread) @ spread.swapaxes(1, 2)
    largest = {}
    for i, joint in enumerate(model.clearance_joints):
        rows = jacobian[:, closures + 2 * i : closures + 2 * i + 2]
        found = np.linalg.eigvalsh(rows @ mobility @ rows.swapaxes(1, 2))[:, -1].max()
        largest[joint] = max(0.0, float(found))  # less is rounding, where neither body can move
    return largest


@lru_cache(maxsize=512)
def _for_all(function: ca.Function, count: int) -> ca.Function:
    """The function for so many arguments side by side."""
    return function.map(count)


def _stack(side_by_side: FloatArray, count: int) -> FloatArray:
    """Matrices that stand side by side as an array (count, rows, columns)."""
    return side_by_side.reshape(len(side_by_side), count, -1).swapaxes(0, 1)


def smooth_eigenvalues(model: Model, p: Sequence[float]) -> FloatArray:
    """Eigenvalues (1/s, complex) of small motions about the drawn pose.

    Parameters
    ----------
    model : Model
        Without clearances and sliding friction, its drive standing: what is left are the motions of the suspension,
        and of links that nothing drives.
    p : sequence of float
        Lane parameters.

    Raises
    ------
    AssemblyError
        Motions that the closures tie to each other elsewhere are free of each other in the drawn pose.
    """
    if model.size == 0:
        return np.zeros(0)
    zero = np.zeros(model.size)
    stiffness, damping = evaluate(model.linearised, 0.0, zero, zero, p)
    # Only motions that keep the closures exist; the rest of coordinate space would add modes of rounding.
    closures = evaluate(model.constraint, 0.0, zero, zero, p)[1]
    tangent = linalg.null_space(closures) if len(closures) else np.eye(model.size)
    reduced = [tangent.T @ part @ tangent for part in (stiffness, damping)]
    n = tangent.shape[1]
    system = np.block([[np.zeros((n, n)), np.eye(n)], reduced])
    if not np.isfinite(system).all():
        rule = "links lie in one line in the drawn pose, from which nothing can be computed: draw it at another angle"
        raise AssemblyError(model.machine.name, "drive", None, rule)
    return np.asarray(np.linalg.eigvals(system))


def largest_step(
    rule: StepRule, contacts: Iterable[ContactRates], eigenvalues: FloatArray, speed: float, rubbing: float = 0.0
) -> float:
    """Longest step that a rule allows a case, s; infinite where nothing moves.

    Parameters
    ----------
    rule : StepRule
    contacts : iterable of ContactRates
        Of each clearance joint.
    eigenvalues : array
        Of the smooth motion, 1/s.
    speed : float
        Fastest prescribed motion, rad/s.
    rubbing : float
        Largest rate of friction, 1/s, see :mod:`jointplay.solver.cases.rates`.
    """
    limits = [math.inf]
    for rates in contacts:
        limits.append(rule.contact / rates.frequency if rates.frequency else math.inf)
        limits.append(rule.decay / rates.decay if rates.decay else math.inf)
        limits.append(FILM / rates.film if rates.film else math.inf)
    fastest = float(np.abs(eigenvalues).max(initial=0.0))
    limits.append(rule.smooth / fastest if fastest else math.inf)
    limits.append(rule.rubbing / rubbing if rubbing else math.inf)
    limits.append(2 * math.pi / abs(speed) / rule.per_revolution if speed else math.inf)
    return min(limits)


@dataclass(frozen=True, eq=False)
class Suspension:
    """The whole machine on its supports, its links where they were drawn; arrays (k, k) over the motions of the frame.

    Attributes
    ----------
    motions : tuple of str
        Which of x, y, theta are free, then the frame's modes.
    mass : array
        kg, kg m, kg m2.
    gradients : pair of arrays
        Of the generalised forces with respect to displacements and velocities.
    """

    motions: tuple[str, ...]
    mass: FloatArray
    gradients: tuple[FloatArray, FloatArray]

    def apparent_mass(self, frequency: FloatArray) -> ComplexArray:
        """Forces for a unit of each acceleration, (f, k, k), at frequencies > 0, Hz."""
        s = 2j * np.pi * frequency[:, None, None]
        return np.asarray(self.mass - self.gradients[1] / s - self.gradients[0] / s**2)


def suspension_of(model: Model, p: Sequence[float]) -> Suspension:
    """Mass, stiffness and damping of the machine on its supports.

    Parameters
    ----------
    model : Model
        Without clearances and with its drive standing.
    p : sequence of float
        Lane parameters.

    Notes
    -----
    Links that nothing drives have slow motions of their own, which are no transient; held rigid, they have none.
    """
    names, frame = model.kinematics.names, model.machine.frame
    cg = model.machine.links[frame].cg
    rigid = np.zeros((model.size, 3))
    for row, name in enumerate(names):
        kind, link = name[:-1].split("(")
        if model.kinematics.apart and link != frame:
            continue  # what a decoupled frame weighs has the links in it
        if kind == "theta":
            rigid[row, 2] = 1.0
        elif kind in ("x", "y"):
            place = model.machine.links[link].cg
            rigid[row, "xy".index(kind)] = 1.0
            rigid[row, 2] = cg[1] - place[1] if kind == "x" else place[0] - cg[0]
    free = [k for k, i in enumerate(model.frame_indices) if i is not None]
    rigid = rigid[:, free]
    zero = np.zeros(model.size)
    modes = model.kinematics.modes
    if modes:
        # Links follow the points of the frame that carry them, as the closures have it.
        bent, inner = np.eye(model.size)[:, modes], model.inner_indices
        rows = evaluate(model.constraint, 0.0, zero, zero, p)[1]
        bent[inner] = -np.linalg.lstsq(rows[:, inner], rows[:, modes], rcond=1e-9)[0]
        rigid = np.hstack([rigid, bent])
    motions = [*(("x", "y", "theta")[k] for k in free), *(names[i] for i in modes)]
    if model.machine.driven_link:
        rigid, motions = beside_drive(model, p, rigid, motions)
    mass = rigid.T @ evaluate(model.mass_matrix, 0.0, zero, zero, p)[0] @ rigid
    stiffness, damping = (rigid.T @ part @ rigid for part in evaluate(model.force_gradient, 0.0, zero, zero, p))
    return Suspension(tuple(motions), mass, (stiffness, damping))


def suspension_modes(suspension: Suspension) -> list[complex]:
    """Motions of a suspension that swing: one of each conjugate pair, 1/s."""
    n = len(suspension.motions)
    if not n:
        return []
    parts = [np.linalg.solve(suspension.mass, part) for part in suspension.gradients]
    system = np.block([[np.zeros((n, n)), np.eye(n)], parts])
    return [complex(s) for s in np.linalg.eigvals(system) if s.imag > 1e-6 * max(1.0, abs(s))]


def response(modes: Sequence[complex], speed: float) -> float:
    """How far the frame moves against what it would at a drive that is faster than its suspension.

    Inertia forces grow with the square of the speed, and below its modes the suspension answers them with its
    stiffness: (speed / lowest mode)^2, no less than :data:`LEAST_RESPONSE`. Errors of steps are held to this part of
    the sizes that they are compared with, or the spectra of slow machines would drown in them.

    Parameters
    ----------
    modes : sequence of complex
        Suspension modes, 1/s.
    speed : float
        Drive speed, rad/s; 0 where nothing repeats.
    """
    lowest = min((float(abs(s)) for s in modes if abs(s) > 0), default=0.0)
    if not speed or not lowest:
        return 1.0
    return max(LEAST_RESPONSE, min(1.0, (speed / lowest) ** 2))


def transient_time(modes: Sequence[complex], speed: float, passed_over: float = math.inf) -> tuple[float, str]:
    """Time to drop from the start of a run, s, and a remark where the rule does not hold.

    Parameters
    ----------
    modes : sequence of complex
        Suspension modes, 1/s.
    speed : float
        Drive speed, rad/s.
    passed_over : float
        Hz; what rings above is passed over by implicit steps, which damp it.

    Returns
    -------
    (float, str)
        The slowest mode's decay to :data:`RESIDUE`, no less than :data:`SETTLING_REVOLUTIONS`, in whole revolutions of
        the drive. Undamped modes never decay: they are left out, and the remark says so.
    """
    undamped = [s for s in modes if -s.real < UNDAMPED * abs(s)]
    rates = [-s.real for s in modes if s not in undamped]
    decay = math.log(1 / RESIDUE) / min(rates) if rates else 0.0
    rings = [abs(s) / (2 * math.pi) for s in undamped]
    remark = "; ".join(
        f"undamped suspension mode at {', '.join(f'{each:.3g}' for each in some)} Hz: {what}"
        for some, what in (
            ([each for each in rings if each <= passed_over], "its start-up transient stays in the spectra"),
            ([each for each in rings if each > passed_over], "implicit steps do not follow how it rings, and damp it"),
        )
        if some
    )
    if not speed:
        return decay, remark
    revolution = 2 * math.pi / abs(speed)
    return revolution * max(SETTLING_REVOLUTIONS, math.ceil(decay / revolution - 1e-9)), remark
