"""How fast contacts and friction are, estimated before anything has moved: what fixed and first steps are chosen by.

Below the friction velocity v0 the law of friction is a damper of mu F / v0 that acts on the mobility w of the surfaces:
a rate of mu F w / v0. F is not known before the run; it is estimated from the ideal machine in motion.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.equations.contact import SLOWEST_APPROACH
from jointplay.solver.equations.film import Film, most_damping
from jointplay.solver.equations.friction import RETARDATION
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import contact_path, evaluate
from jointplay.solver.machines.joints import Joint, SlidingJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import MotionDrive, RotationDrive, TravelDrive
from jointplay.solver.machines.restitution import HYSTERESIS, hysteresis_factor

#: Velocity (m/s) at which surfaces are taken to meet at least. The frequency follows its fifth root (n = 1.5).
_LEAST_IMPACT = 1.0


@dataclass(frozen=True)
class ContactRates:
    """Frequency, rad/s, and damping rates, 1/s, of one contact and of the oil around its pin."""

    frequency: float
    decay: float
    film: float = 0.0


@lru_cache(maxsize=64)
def extent_of(machine: Machine) -> float:
    """Largest distance between joints and centres of gravity as drawn, m; 1 where all are in one place."""
    points = [joint.at for joint in machine.joints.values()] + [link.cg for link in machine.links.values()]
    return max((math.dist(p, q) for p in points for q in points), default=0.0) or 1.0


def contact_rates(
    machine: Machine,
    mobility: Mapping[str, float],
    values: Mapping[str, float],
    speed: float,
    thinnest: float = 0.0,
) -> dict[str, ContactRates]:
    """Estimates for every clearance joint.

    Parameters
    ----------
    machine : Machine
    mobility : mapping of str to float
        Of each clearance joint, 1/kg.
    values : mapping of str to float
        Contact numbers by path; what is missing is 0.
    speed : float
        Fastest prescribed motion, rad/s.
    thinnest : float
        Thickness of a film that is to be followed, in parts of the clearance: thinner ones are faster.

    Notes
    -----
    The linear law has sqrt(K w) and C w. With K d^n both follow the penetration, and that the velocity v of the impact:
    w K D^(n+1) = (n + 1)/2 v^2 at the deepest point D, where the frequency is sqrt(n w K D^(n-1)). A pin that
    crosses its clearance c from side to side under the acceleration a arrives at 2 sqrt(a c); a is gravity and
    the machine's extent times the square of the drive's speed, and v no less than 1 m/s.
    """
    acceleration = abs(values.get("gravity", machine.gravity)) + extent_of(machine) * speed * speed
    rates = {joint: _rates(machine, joint, w, values, acceleration) for joint, w in mobility.items()}
    return {
        joint: replace(rates[joint], film=_film_rate(machine, joint, w, values, thinnest))
        for joint, w in mobility.items()
    }


def deepest_point(stiffness: float, exponent: float, speed: float) -> float:
    """Penetration D of an impact at `speed`, m, with k D^(n+1) = (n + 1)/2 v^2; k is stiffness times mobility."""
    return float((0.5 * (exponent + 1) * speed**2 / stiffness) ** (1 / (exponent + 1)))


def _rates(machine: Machine, joint: str, w: float, values: Mapping[str, float], acceleration: float) -> ContactRates:
    contact = machine.joints[joint].contact
    law, n = contact.law, contact.exponent

    def number(name: str) -> float:
        return values.get(contact_path(joint, name), 0.0)

    stiffness, drag = number("stiffness") * w, number("viscous") * w
    if not stiffness:  # neither body can move: nothing swings
        return ContactRates(0.0, 0.0)
    if n is None:
        return ContactRates(math.sqrt(stiffness), number("damping") * w + drag)
    impact = max(_LEAST_IMPACT, 2 * math.sqrt(acceleration * number("clearance")))
    depth = deepest_point(stiffness, n, impact)
    force = stiffness * depth**n  # times mobility: an acceleration
    if law in HYSTERESIS:
        # An impact loses at the rate c F / v; a contact that began at a creep and is pressed since, at c a / v0.
        decay = hysteresis_factor(law, number("restitution")) * max(force / impact, acceleration / SLOWEST_APPROACH)
    else:
        decay = number("hysteresis") * force
    return ContactRates(math.sqrt(n * stiffness * depth ** (n - 1)), decay + drag)


def _film_rate(machine: Machine, name: str, w: float, values: Mapping[str, float], thinnest: float) -> float:
    """That of the thinnest film to be followed, which is the fastest, 1/s."""
    joint = machine.joints[name]
    if isinstance(joint, SlidingJoint) or joint.film is None:
        return 0.0
    radius, clearance, viscosity = (values[contact_path(name, key)] for key in ("pin_radius", "clearance", "viscosity"))
    film = Film(viscosity, radius, joint.film.length, clearance, joint.film.roughness, most_damping(machine, joint))
    thinnest = max(thinnest, float(film.thinnest / clearance))
    return w * min(film.most, float(film.damping(ca.SX(thinnest * (2 - thinnest)))))


_NUMBERS = ("clearance", "stiffness", "friction", "friction_velocity", "presliding")


def without_dry_friction(machine: Machine) -> Machine:
    """The machine as it moves where no guide and no journal rubs."""
    smooth: dict[str, Joint] = {}
    for name, joint in machine.joints.items():
        number = "friction" if isinstance(joint, SlidingJoint) else "journal_friction"
        if getattr(joint, number):
            smooth[name] = joint.model_copy(update={number: 0.0})
    return machine.model_copy(update={"joints": {**machine.joints, **smooth}}) if smooth else machine


def friction_rate(
    model: Model, poses: Sequence[tuple[float, FloatArray]], p: Sequence[float], values: Mapping[str, float],
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
    across the play 2 c: at its peak by F + sqrt(K / w) sqrt(4 c F w), with d^n by F + K D^n, D the depth. So do the
    ends of a block in a worn guide, whose mobility across it stands for that along it. A guide without clearance
    is pressed by its normal force in the ideal machine and by what the impacts of all clearance joints add.
    """
    count = len(model.kinematics.closures)
    reactions = np.abs([_ideal_reactions(model, t, z, p) for t, z in poses])
    rates, impacts = [0.0], 0.0
    for i, joint in enumerate(model.clearance_joints):
        if not mobility[joint]:  # neither body can move
            continue
        number = {name: values.get(contact_path(joint, name), 0.0) for name in _NUMBERS}
        pressed = float(np.hypot(*reactions[:, count + 2 * i : count + 2 * i + 2].T).max())
        exponent = model.machine.joints[joint].contact.exponent or 1.0
        speed = math.sqrt(4 * number["clearance"] * pressed * mobility[joint])
        depth = deepest_point(number["stiffness"] * mobility[joint], exponent, speed)
        impact = number["stiffness"] * depth**exponent
        impacts += impact
        if number["friction"]:
            scale = number["presliding"] / RETARDATION or number["friction_velocity"]
            settling = number["friction"] * (pressed + impact) * mobility[joint] / scale
            rates.append(_held_rate(settling) if number["presliding"] else settling)
    if model.rubbing is not None:
        names = [closure.name for closure in model.kinematics.closures]
        rows = [names.index(f"{joint}.normal") for joint in model.rubbing.joints]
        rest = np.zeros(model.size)
        for (t, z), normal in zip(poses, reactions[:, rows], strict=True):
            state = (part[:, 0] for part in evaluate(model.rubbing_state, t, z, rest, p))
            friction, slow, _, _, swing, *_ = state
            each = friction * np.abs(swing) * (normal + impacts) / slow
            for name, rate in zip(model.rubbing.joints, each.tolist(), strict=True):
                guide = model.machine.joints[name]
                sticks = isinstance(guide, SlidingJoint) and guide.friction_law == "bristle"
                rates.append(_held_rate(rate) if sticks else rate)
    return max(rates)


def _held_rate(settling: float) -> float:
    """Rate of surfaces that bristles hold: a damper's that settle at a rate, or the frequency of what swings, 1/s."""
    return max(settling, math.sqrt(settling / RETARDATION))


def _ideal_reactions(model: Model, t: float, z: FloatArray, p: Sequence[float]) -> FloatArray:
    """Multipliers of closures and eccentricities, pins kept concentric; without friction, from a frame at rest."""
    v = np.zeros(model.size)
    _, jacobian, drift = evaluate(model.constraint, t, z, v, p)
    free = model.inner_indices
    if free and drift.size:
        v[free] = np.linalg.lstsq(jacobian[:, free], -drift[:, 0], rcond=1e-9)[0]
    mass, force = evaluate(model.inertia, t, z, v, p)
    (bias,) = evaluate(model.constraint_bias, t, z, v, p)
    spread = np.linalg.solve(mass, np.column_stack([jacobian.T, force]))
    missing = jacobian @ spread[:, -1] + bias[:, 0]
    return np.asarray(-np.linalg.pinv(jacobian @ spread[:, :-1], rcond=1e-12) @ missing)


def error_scales(machine: Machine, model: Model) -> list[float]:
    """Sizes of the coordinates: the machine's extent, a radian, what displaces a mode's largest point by the extent."""
    extent = extent_of(machine)
    sizes = {f"mode({i})": extent / mode.largest for i, mode in enumerate(machine.modes)}
    return [1.0 if name.startswith("theta(") else sizes.get(name, extent) for name in model.kinematics.names]


#: A coordinate that carries less than this part of the inertia of the heaviest is light: its velocity counts by the
#: momentum that it has, which is all that the others feel of it, but for so much at least.
_LIGHT, _LEAST_WEIGHT = 1e-3, 1e-4


def velocity_scales(model: Model, scales: Sequence[float]) -> list[float]:
    """Sizes that implicit steps compare errors of velocities with: those of the coordinates, more where one is light.

    A link of next to no mass in the play of its pin, which is pressed on it, swings there without end and ever faster
    the lighter it is. Where it is, it has to be followed; how it swings has not.
    """
    rest = np.zeros(model.size)
    (mass,) = evaluate(model.mass_matrix, 0.0, rest, rest, model.vector({}))
    inertia = np.diag(mass) * np.square(scales)
    inner = model.inner_indices
    heaviest = max(inertia[inner], default=0.0)
    weights = np.ones(model.size)
    weights[inner] = np.clip(inertia[inner] / (_LIGHT * heaviest), _LEAST_WEIGHT, 1.0)
    return [float(size) for size in scales / weights]


def pace_of(machine: Machine, values: Mapping[str, float]) -> float:
    """Time in which the machine moves by its own size, s: by its drive, or by falling; a second at most."""
    extent = extent_of(machine)
    drive, rate = machine.drive, 0.0
    if isinstance(drive, MotionDrive):
        speeds = [speed for _, speed in drive.speed] if isinstance(drive.speed, tuple) else [drive.speed]
        fastest = abs(values.get("drive.speed", max(speeds, key=abs)))
        rate = fastest / (1.0 if isinstance(drive, RotationDrive) else extent)
        if isinstance(drive, TravelDrive):
            rate = max(rate, *(2 * math.pi * h.frequency for h in drive.harmonics), 0.0)
    return 1.0 / max(rate, math.sqrt(abs(values.get("gravity", machine.gravity)) / extent), 1.0)
