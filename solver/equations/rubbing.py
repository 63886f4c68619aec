"""Coulomb friction of sliding joints, whose normal forces depend on the accelerations that the friction changes.

Along the line acts Ft = -k |Fn|, k = mu y, y standing for the sign of the velocity
(:mod:`jointplay.solver.equations.friction`). The equations are linear in forces, so that with
the normal forces c that the machine would have without friction, and W_ij, what a unit force along line j adds to the
normal force of joint i,

    Fn + W diag(k) |Fn| = c.

Every choice of signs of Fn makes this linear; the one whose solution has these signs is the right one. Where none has,
or several with different forces, rigid bodies have no motion under this law: the joint jams (P. Painleve, Lecons sur le
frottement, 1895).

A turning joint without clearance rubs as a journal: a torque M = -mu r y |F| against its rotation, r the radius of the
pin and F its reaction, which changes with M by parts of r over the length of a link. So fixed-point steps find it; each
takes an error down by mu r over that length.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

import casadi as ca

from jointplay.solver.equations.dynamics import Solver
from jointplay.solver.equations.forces import Scene
from jointplay.solver.equations.friction import RETARDATION, sliding_sign
from jointplay.solver.equations.numbers import Number, Numbers
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.friction import FRICTION_NUMBERS, DryFriction
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine

#: Sliding joints with friction that a machine may have: the choices of signs double with each.
MOST = 6
#: A normal force may have the wrong sign by this part of the largest: rounding where it passes zero.
_ROUNDING = 1e-12
#: Solutions further apart than this part of the largest normal force are different ones.
_DIFFERENT = 1e-9
#: Steps to the torques of journals: a friction of 1 on a pin of 8 mm in links of 0.2 m converges by 0.03 a step.
_FIXED_POINT_STEPS = 8
#: Square of a reaction that counts as none, N2: its root has a derivative.
_LEAST = 1e-24
#: In place of a pivot of exactly zero, a solution of no consequence: its normal force is beyond any machine.
_TINY = 1e-30


def journals(machine: Machine, number: Numbers, open_joints: Collection[str]) -> tuple[str, ...]:
    """Turning joints without clearance that rub as journals, in the file or by a number that a case varies."""
    return tuple(
        name
        for name, joint in machine.joints.items()
        if isinstance(joint, TurningJoint)
        and name not in open_joints
        and (joint.journal_friction or number.varies(f"joints.{name}.journal_friction"))
    )


def rubbing_joints(machine: Machine, number: Numbers, open_joints: Collection[str]) -> tuple[str, ...]:
    """Sliding joints without clearance, with Coulomb friction in the file or as a number that a case varies.

    Raises
    ------
    MachineError
        More than :data:`MOST`.
    """
    found = tuple(
        name
        for name, joint in machine.joints.items()
        if isinstance(joint, SlidingJoint)
        and name not in open_joints
        and (joint.friction or number.varies(f"joints.{name}.friction"))
    )
    if len(found) > MOST:
        path, rule = f"joints.{found[MOST]}.friction", f"at most {MOST} sliding joints of a machine may have friction"
        raise MachineError(machine.name, path, None, f"{rule}; use `viscous` in the others")
    return found


@dataclass(frozen=True)
class Rubbing:
    """Sliding joints with friction.

    Attributes
    ----------
    joints : tuple of str
    friction, slow : casadi.SX
        (k, 1) coefficients mu; velocities at which their friction is about full, m/s.
    rate : casadi.SX
        (k, 1) sliding velocities, m/s.
    leverage : casadi.SX
        (k, 1) diagonal of W: what a unit force along the line adds to the joint's own normal force.
    mobility : casadi.SX
        (k, 1) acceleration along the line by a unit force along it, 1/kg.
    acceleration : casadi.SX
        (k, 1) rate of the sliding velocities, m/s2, but for terms of the velocities alone.
    normal : casadi.SX
        (k, 1) normal forces, N. This and `acceleration` have no meaning where `jam` is 1.
    jam : casadi.SX
        1 where no normal forces, or several, fulfil the friction law; else 0.
    """

    joints: tuple[str, ...]
    friction: ca.SX
    slow: ca.SX
    rate: ca.SX
    leverage: ca.SX
    mobility: ca.SX
    acceleration: ca.SX
    normal: ca.SX
    jam: ca.SX


@dataclass(frozen=True)
class _Pairs:
    """Surfaces that rub, one a column: what a unit of friction does, mu y (times r), and rows of the reactions."""

    lines: list[ca.SX]
    grip: list[ca.SX]
    rows: list[list[int]]
    friction: list[Number]
    slow: list[Number]
    rates: list[ca.SX]

    def add(
        self, scene: Scene, path: str, law: DryFriction, coefficient: Number, motion: tuple[ca.SX, ca.SX],
        radius: Number, rows: list[int],
    ) -> None:  # fmt: skip
        """Another pair: its law, displacement and rate (radians where it turns), and arm."""
        (key,) = FRICTION_NUMBERS[law.friction_law]
        scale = scene.number(f"{path}.{key}", getattr(law, key))
        displacement, rate = motion
        sign = sliding_sign(law.friction_law, rate * radius, scale, -1, scene.bristles)
        self.lines.append(scene.gradient(displacement))
        self.grip.append(coefficient * radius * sign)
        self.rows.append(rows)
        self.friction.append(coefficient)
        self.slow.append(scale / RETARDATION if law.friction_law == "bristle" else scale)
        self.rates.append(rate)


def solve_with_friction(
    scene: Scene, joints: Sequence[str], turning: Sequence[str], solution: Solver, gamma: ca.SX
) -> tuple[ca.SX, ca.SX, Rubbing | None]:
    """Accelerations (n, 1) and reactions (m, 1) of a scene with rubbing joints.

    Parameters
    ----------
    scene : Scene
        With all other forces written.
    joints, turning : sequence of str
        Sliding joints that rub, and journals; each has its closures.
    solution : Solver
    gamma : casadi.SX
        (m, 1) right-hand side of the closures.
    """
    closures = [closure.name for closure in scene.kinematics.closures]
    guides, pins = _Pairs([], [], [], [], [], []), _Pairs([], [], [], [], [], [])
    for name in joints:
        guide = scene.machine.joints[name]
        assert isinstance(guide, SlidingJoint)
        path, rows = f"joints.{name}", [closures.index(f"{name}.normal")]
        guides.add(scene, path, guide, scene.number(f"{path}.friction", guide.friction), scene.slides[name], 1.0, rows)
    for name in turning:
        joint = scene.machine.joints[name]
        assert isinstance(joint, TurningJoint)
        path, rows = f"joints.{name}", [closures.index(f"{name}.{axis}") for axis in "xy"]
        coefficient = scene.number(f"{path}.journal_friction", joint.journal_friction)
        radius = scene.number(f"{path}.pin_radius", joint.pin_radius)
        pins.add(scene, f"{path}.contact", joint.contact, coefficient, scene.angle(joint), radius, rows)
    count = len(joints)
    pull = ca.horzcat(*guides.lines, *pins.lines)
    without, at_rest = ca.horzcat(scene.total, pull), ca.horzcat(gamma, ca.SX(gamma.shape[0], pull.shape[1]))
    accelerations, reactions = solution.solve(without, at_rest)
    rows = [row for (row,) in guides.rows]
    response = reactions[rows, 1 : 1 + count]
    coupling = [[response[i, j] * k for j, k in enumerate(guides.grip)] for i in range(count)]
    torques: list[ca.SX] = [ca.SX(0)] * len(turning)
    for _ in range(_FIXED_POINT_STEPS if turning else 1):
        smooth = reactions[:, 0] + ca.mtimes(reactions[:, 1 + count :], ca.vertcat(*torques)) if turning else reactions
        normal, jam = _normal_forces([smooth[row, 0] for row in rows], coupling) if joints else ([], ca.SX(0))
        along = [-k * ca.fabs(force) for k, force in zip(guides.grip, normal, strict=True)]
        given = ca.vertcat(*along, *torques)
        reaction = reactions[:, 0] + ca.mtimes(reactions[:, 1:], given)
        sizes = [ca.sqrt(ca.fmax(reaction[x] ** 2 + reaction[y] ** 2, _LEAST)) for x, y in pins.rows]
        torques = [-k * size for k, size in zip(pins.grip, sizes, strict=True)]
    acceleration = accelerations[:, 0] + ca.mtimes(accelerations[:, 1:], given)
    if not joints:
        return acceleration, reaction, None
    pull, mobility = pull[:, :count], accelerations[:, 1 : 1 + count]
    rubbing = Rubbing(
        tuple(joints), ca.vertcat(*guides.friction), ca.vertcat(*guides.slow), ca.vertcat(*guides.rates),
        ca.diag(response), ca.diag(ca.mtimes(pull.T, mobility)), ca.mtimes(pull.T, acceleration),
        ca.vertcat(*normal), jam,
    )  # fmt: skip
    return acceleration, reaction, rubbing


def _normal_forces(smooth: list[ca.SX], coupling: list[list[ca.SX]]) -> tuple[list[ca.SX], ca.SX]:
    """The solution x of x + B |x| = c, and 1 where it is not exactly one, else 0."""
    scale = ca.SX(0)
    for force in smooth:
        scale = ca.fmax(scale, ca.fabs(force))
    found: list[tuple[ca.SX, list[ca.SX]]] = []
    for signs, forces in _by_signs(smooth, coupling):
        right = [sign * force >= -_ROUNDING * scale for sign, force in zip(signs, forces, strict=True)]
        found.append((reduce(ca.logic_and, right), forces))
    count = sum((ca.if_else(fits, 1, 0) for fits, _ in found), start=ca.SX(0))
    share = 1 / ca.fmax(count, 1)
    # Two choices of signs may both fit one solution that has a zero in it.
    mean = [share * sum(ca.if_else(fits, forces[i], 0) for fits, forces in found) for i in range(len(smooth))]
    spread = ca.SX(0)
    for fits, forces in found:
        for force, middle in zip(forces, mean, strict=True):
            spread = ca.fmax(spread, ca.if_else(fits, ca.fabs(force - middle), 0))
    unique = ca.logic_and(count > 0, spread <= _DIFFERENT * scale)
    return mean, ca.if_else(unique, 0, 1)


def _by_signs(smooth: list[ca.SX], coupling: list[list[ca.SX]]) -> Iterator[tuple[tuple[int, ...], list[ca.SX]]]:
    """Solutions x of (1 + B diag(s)) x = c for all signs s, by an elimination whose first steps they share."""
    if not smooth:
        yield (), []
        return
    for sign in (1, -1):
        pivot = 1 + sign * coupling[0][0]
        inverse = 1 / ca.if_else(pivot == 0, _TINY, pivot)
        factors = [sign * row[0] * inverse for row in coupling[1:]]
        rest = [force - f * smooth[0] for force, f in zip(smooth[1:], factors, strict=True)]
        inner = [
            [b - f * first for b, first in zip(row[1:], coupling[0][1:], strict=True)]
            for row, f in zip(coupling[1:], factors, strict=True)
        ]
        for signs, forces in _by_signs(rest, inner):
            first = smooth[0]
            for other, force, b in zip(signs, forces, coupling[0][1:], strict=True):
                first -= b * other * force
            yield (sign, *signs), [first * inverse, *forces]
