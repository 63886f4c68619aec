"""Coulomb friction of sliding joints, whose normal forces depend on the accelerations that the friction changes.

Along the line acts Ft = -k |Fn|, k = mu tanh(v / friction_velocity). The equations are linear in forces, so that with
the normal forces c that the machine would have without friction, and W_ij, what a unit force along line j adds to the
normal force of joint i,

    Fn + W diag(k) |Fn| = c.

Every choice of signs of Fn makes this linear; the one whose solution has these signs is the right one. Where none has,
or several with different forces, rigid bodies have no motion under this law: the joint jams (P. Painleve, Lecons sur le
frottement, 1895).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

import casadi as ca

from jointplay.solver.equations.dynamics import Solver
from jointplay.solver.equations.forces import Scene
from jointplay.solver.equations.numbers import Numbers
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine

#: Sliding joints with friction that a machine may have: the choices of signs double with each.
MOST = 6
#: A normal force may have the wrong sign by this part of the largest: rounding where it passes zero.
_ROUNDING = 1e-12
#: Solutions further apart than this part of the largest normal force are different ones.
_DIFFERENT = 1e-9
#: In place of a pivot of exactly zero, a solution of no consequence: its normal force is beyond any machine.
_TINY = 1e-30


def rubbing_joints(machine: Machine, number: Numbers) -> tuple[str, ...]:
    """Sliding joints with Coulomb friction, in the file or as a number that a case varies.

    Raises
    ------
    MachineError
        More than :data:`MOST`.
    """
    found = tuple(
        name
        for name, joint in machine.joints.items()
        if isinstance(joint, SlidingJoint) and (joint.friction or number.varies(f"joints.{name}.friction"))
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
    friction, friction_velocity : casadi.SX
        (k, 1) coefficients mu, and m/s.
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
    friction_velocity: ca.SX
    rate: ca.SX
    leverage: ca.SX
    mobility: ca.SX
    acceleration: ca.SX
    normal: ca.SX
    jam: ca.SX


def solve_with_friction(
    scene: Scene, joints: Sequence[str], solution: Solver, gamma: ca.SX
) -> tuple[ca.SX, ca.SX, Rubbing]:
    """Accelerations (n, 1) and reactions (m, 1) of a scene with rubbing sliding joints.

    Parameters
    ----------
    scene : Scene
        With all other forces written.
    joints : sequence of str
        Those that rub; each has its normal closure.
    solution : Solver
    gamma : casadi.SX
        (m, 1) right-hand side of the closures.
    """
    closures = [closure.name for closure in scene.kinematics.closures]
    rows = [closures.index(f"{name}.normal") for name in joints]
    number, lines, friction, velocity, rates = scene.number, [], [], [], []
    for name in joints:
        joint = scene.machine.joints[name]
        assert isinstance(joint, SlidingJoint)
        travel, rate = scene.slides[name]
        lines.append(scene.gradient(travel))
        friction.append(number(f"joints.{name}.friction", joint.friction))
        velocity.append(number(f"joints.{name}.friction_velocity", joint.friction_velocity))
        rates.append(rate)
    pull = ca.horzcat(*lines)
    without, at_rest = ca.horzcat(scene.total, pull), ca.horzcat(gamma, ca.SX(gamma.shape[0], len(joints)))
    accelerations, reactions = solution.solve(without, at_rest)
    grip = [mu * ca.tanh(v / v0) for mu, v, v0 in zip(friction, rates, velocity, strict=True)]
    response = reactions[rows, 1:]
    coupling = [[response[i, j] * k for j, k in enumerate(grip)] for i in range(len(joints))]
    normal, jam = _normal_forces([reactions[row, 0] for row in rows], coupling)
    along = ca.vertcat(*(-k * ca.fabs(force) for k, force in zip(grip, normal, strict=True)))
    acceleration, reaction = (part[:, 0] + ca.mtimes(part[:, 1:], along) for part in (accelerations, reactions))
    rubbing = Rubbing(
        tuple(joints), ca.vertcat(*friction), ca.vertcat(*velocity), ca.vertcat(*rates), ca.diag(response),
        ca.diag(ca.mtimes(pull.T, accelerations[:, 1:])), ca.mtimes(pull.T, acceleration), ca.vertcat(*normal), jam,
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
