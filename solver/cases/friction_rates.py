"""How fast friction settles a sliding velocity: what a fixed step must resolve besides the contacts.

Below the friction velocity v0 the law is a damper of mu F / v0 that acts on the mobility w of the surfaces: a rate of
mu F w / v0. F is not known before the run; it is estimated from the ideal machine in motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.cases.assembly import inner_coordinates
from jointplay.solver.cases.contact_rates import deepest_point
from jointplay.solver.equations.evaluation import evaluate
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import contact_path
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine

Array = NDArray[np.float64]

_NUMBERS = ("clearance", "stiffness", "friction", "friction_velocity")


def without_sliding_friction(machine: Machine) -> Machine:
    """The machine as it moves where no guide rubs."""
    rubbing = {name: j for name, j in machine.joints.items() if isinstance(j, SlidingJoint) and j.friction}
    smooth = {name: joint.model_copy(update={"friction": 0.0}) for name, joint in rubbing.items()}
    return machine.model_copy(update={"joints": {**machine.joints, **smooth}}) if rubbing else machine


def friction_rate(
    model: Model, poses: Sequence[tuple[float, Array]], p: Sequence[float], values: Mapping[str, float],
    mobility: Mapping[str, float],
) -> float:  # fmt: skip
    """Largest rate of the friction of all joints, 1/s.

    Parameters
    ----------
    model : Model
        At its top speed.
    poses : sequence of (float, (n,) array)
        Times and coordinates.
    p : sequence of float
        Lane parameters.
    values : mapping of str to float
        Numbers of the machine by path; of a contact, what is missing is 0.
    mobility : mapping of str to float
        Of the clearance joints, 1/kg.

    Notes
    -----
    A pin is pressed by the force F that its joint would carry were it ideal, and hits with the speed that F gives it
    across the play 2 c: at its peak by F + sqrt(K / w) sqrt(4 c F w), with d^n by F + K D^n, D the depth. A guide
    is pressed by its normal force in the ideal machine and by what the impacts of all clearance joints add.
    """
    count = len(model.kinematics.closures)
    reactions = np.abs([_ideal_reactions(model, t, z, p) for t, z in poses])
    rates, impacts = [0.0], 0.0
    for i, joint in enumerate(model.clearance_joints):
        number = {name: values.get(contact_path(joint, name), 0.0) for name in _NUMBERS}
        pressed = float(np.hypot(*reactions[:, count + 2 * i : count + 2 * i + 2].T).max())
        found = model.machine.joints[joint]
        exponent = found.contact.exponent or 1.0 if isinstance(found, TurningJoint) else 1.0
        speed = math.sqrt(4 * number["clearance"] * pressed * mobility[joint])
        depth = deepest_point(number["stiffness"] * mobility[joint], exponent, speed)
        impact = number["stiffness"] * depth**exponent
        impacts += impact
        if number["friction"]:
            rates.append(number["friction"] * (pressed + impact) * mobility[joint] / number["friction_velocity"])
    if model.rubbing is not None:
        names = [closure.name for closure in model.kinematics.closures]
        rows = [names.index(f"{joint}.normal") for joint in model.rubbing.joints]
        rest = np.zeros(model.size)
        for (t, z), normal in zip(poses, reactions[:, rows], strict=True):
            state = (part[:, 0] for part in evaluate(model.rubbing_state, t, z, rest, p))
            friction, slow, _, _, swing, *_ = state
            rates.append(float(np.max(friction * np.abs(swing) * (normal + impacts) / slow)))
    return max(rates)


def _ideal_reactions(model: Model, t: float, z: Array, p: Sequence[float]) -> Array:
    """Multipliers of closures and eccentricities, pins kept concentric; without friction, from a frame at rest."""
    v = np.zeros(model.size)
    _, jacobian, drift = evaluate(model.constraint, t, z, v, p)
    free = inner_coordinates(model)
    if free and drift.size:
        v[free] = np.linalg.lstsq(jacobian[:, free], -drift[:, 0], rcond=1e-9)[0]
    mass, force = evaluate(model.inertia, t, z, v, p)
    (bias,) = evaluate(model.constraint_bias, t, z, v, p)
    spread = np.linalg.solve(mass, np.column_stack([jacobian.T, force]))
    missing = jacobian @ spread[:, -1] + bias[:, 0]
    return np.asarray(-np.linalg.pinv(jacobian @ spread[:, :-1], rcond=1e-12) @ missing)
