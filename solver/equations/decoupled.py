"""A frame that does not act back: the machine on a frame at rest, and the frame's motion by what that does to it.

What a machine on a frame at rest exerts on it is what its links' momentum changes by, less weight and other external
forces: with linear momentum P and angular momentum L about the frame's centre of gravity, w = W - (P', L'). Contacts,
reactions and the drive's effort are internal and need not be known. By it the frame with all links on it, as drawn,
moves on its supports, linearised where it stands: M q'' + C q' + K q = w. What is left out, the links' answer to the
frame's motion, is of the order of their mass over the frame's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from jointplay.solver.equations import forces
from jointplay.solver.equations.dynamics import Solver, factorise
from jointplay.solver.equations.geometry import GROUND, ZERO, Complex, Kinematics
from jointplay.solver.equations.numbers import Number, Numbers
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine

MOTIONS = ("x", "y", "theta")
#: To the equilibrium of the machine on its supports: suspensions are nearly linear.
_NEWTON_STEPS = 3


def hold_frame(machine: Machine) -> Machine:
    """The machine with its frame at rest.

    Raises
    ------
    MachineError
        A frame that nothing is gained for, or whose motion is not that of a rigid body on its supports.
    """
    name, frame = machine.frame, machine.links[machine.frame]
    held = [link for link, each in machine.links.items() if link != name and (each.fixed or each.locked)]
    rule = ""
    if frame.fixed or len(set(frame.locked)) == len(MOTIONS):
        rule = f"{name} does not move"
    elif machine.modes:
        rule = f"{name} has modes, which move its joints"
    elif held:
        rule = f"{held[0]}, fixed or locked, holds the frame by way of the mechanism"
    elif machine.driven_link:
        rule = f"{machine.driven_link} is driven in space, by a force from outside that the frame would feel"
    if rule:
        raise MachineError(machine.name, "decoupled", None, f"cannot be: {rule}")
    links = {**machine.links, name: frame.model_copy(update={"fixed": True})}
    return machine.model_copy(update={"links": links, "decoupled": False, "response": None})


@dataclass(frozen=True)
class HeldSolver:
    """Of the machine on a frame at rest; corrections of closures leave the frame alone.

    Attributes
    ----------
    inner : Solver
        Of the coordinates without the frame's.
    order : list of int
        Of all: first counted without the frame's, which then follow.
    """

    inner: Solver | HeldSolver
    order: list[int]

    @property
    def size(self) -> int:
        """Number of accelerations n."""
        return len(self.order)

    def solve(self, force: ca.SX, gamma: ca.SX) -> tuple[ca.SX, ca.SX]:
        """As :meth:`jointplay.solver.equations.dynamics.ConstrainedSolver.solve`."""
        count = self.inner.size
        inside = [self.order.index(i) for i in range(count)]
        found, reactions = self.inner.solve(force[inside, :], gamma)
        return ca.vertcat(found, ca.SX(len(self.order) - count, force.shape[1]))[self.order, :], reactions


@dataclass(frozen=True)
class OwnMotion:
    """Motion of a decoupled frame.

    Attributes
    ----------
    names : tuple of str
        Its free coordinates, ``x(frame)`` ...
    z, v : casadi.SX
        (k, 1) these and their rates.
    pose : casadi.SX
        (3, 1) x, y, theta.
    mass : casadi.SX
        (k, k) M, of the machine as drawn.
    force : callable
        Accelerations (n, 1) of the other coordinates -> w - C v - K z, (k, 1).
    order : list of int
        Where the coordinates of the machine that moves as a whole are among the other coordinates and these.
    """

    names: tuple[str, ...]
    z: ca.SX
    v: ca.SX
    pose: ca.SX
    mass: ca.SX
    force: Callable[[ca.SX], ca.SX]
    order: list[int]

    def acceleration(self, inner: ca.SX) -> ca.SX:
        """Accelerations (k, 1) by those of the machine on a frame at rest."""
        return factorise(self.mass).solve(self.force(inner))


def own_motion(
    machine: Machine, whole: Kinematics, held: Kinematics, number: Numbers, t: ca.SX, gravity: Number
) -> OwnMotion:
    """Motion of the frame of a machine that is simulated with its frame at rest.

    Parameters
    ----------
    machine : Machine
        With its frame moving.
    whole, held : Kinematics
        Of it, and of the machine with its frame at rest.
    number : Numbers
    t : casadi.SX
    gravity : symbol or float
        m/s2.
    """
    frame = machine.links[machine.frame]
    free = [k for k, motion in enumerate(MOTIONS) if motion not in frame.locked]
    names = tuple(f"{MOTIONS[k]}({machine.frame})" for k in free)
    z, v = (ca.vertcat(*(ca.SX.sym(f"{name}{mark}") for name in names)) for mark in ("", "'"))
    choice = ca.DM.eye(3)[:, free]
    offset = ca.mtimes(choice, z)
    rigid, moments = _rigid_mass(machine, number)
    mass = ca.mtimes([choice.T, rigid, choice])
    hold = _hold(machine, whole, number, t, [gravity * part for part in (rigid[0, 0], *moments)], choice)
    external = ca.mtimes(choice.T, _external(machine, whole, held, number, t)) + hold.constant

    def force(inner: ca.SX) -> ca.SX:
        rate = ca.mtimes(choice.T, _momentum_rate(machine, held, number, inner))
        return external - rate - ca.mtimes(hold.damping, v) - ca.mtimes(hold.stiffness, z)

    pose = ca.DM([*frame.cg, 0.0]) + offset
    joined = (*held.names, *names)
    return OwnMotion(names, z, v, pose, mass, force, [joined.index(name) for name in whole.names])


def _arm(machine: Machine, link: str) -> tuple[float, float]:
    """From the frame's centre of gravity to that of a link, as drawn."""
    cg, centre = machine.links[link].cg, machine.links[machine.frame].cg
    return cg[0] - centre[0], cg[1] - centre[1]


def _rigid_mass(machine: Machine, number: Numbers) -> tuple[ca.SX, tuple[Number, Number]]:
    """Mass matrix (3, 3) of the machine as drawn and rigid, for x, y, theta of its frame; its first moments, kg m."""
    total: Number = 0.0
    moments: list[Number] = [0.0, 0.0]
    inertia: Number = 0.0
    for name, link in machine.links.items():
        arm = _arm(machine, name)
        mass = number(f"links.{name}.mass", link.mass or 0.0)
        total += mass
        moments = [moment + mass * a for moment, a in zip(moments, arm, strict=True)]
        inertia += number(f"links.{name}.inertia", link.inertia or 0.0) + mass * (arm[0] ** 2 + arm[1] ** 2)
    x, y = moments
    rows = [[total, 0.0, -y], [0.0, total, x], [-y, x, inertia]]
    return ca.vertcat(*(ca.horzcat(*row) for row in rows)), (x, y)


def _rigid_displacement(machine: Machine, kin: Kinematics, q: ca.SX) -> ca.SX:
    """Coordinates (n, 1) of the machine as drawn and rigid when its frame is at x, y, theta."""
    turn = Complex(ca.cos(q[2]) - 1, ca.sin(q[2]))
    rows = []
    for name in kin.names:
        motion, link = name[:-1].split("(")
        if motion in ("x", "y"):
            moved = turn * complex(*_arm(machine, link))
            rows.append(q[0] + moved.re if motion == "x" else q[1] + moved.im)
        else:
            rows.append(q[2] if motion == "theta" else ca.SX(0.0))
    return ca.vertcat(*rows)


def _scene(machine: Machine, kin: Kinematics, number: Numbers, t: ca.SX) -> forces.Scene:
    slides = {}
    for name, joint in machine.joints.items():
        if isinstance(joint, SlidingJoint):
            travel = kin.slide(joint)[0]
            slides[name] = travel, ca.jtimes(travel, kin.z, kin.v) + ca.jacobian(travel, t)
    return forces.Scene(machine, kin, number, t, slides, ca.SX.zeros(kin.z.shape[0]))


@dataclass(frozen=True)
class _Hold:
    """Wrench of supports and weights on the rigid machine: that at the drawn pose, plus constant - C v - K z."""

    stiffness: ca.SX
    damping: ca.SX
    constant: ca.SX


def _hold(machine: Machine, whole: Kinematics, number: Numbers, t: ca.SX, weight: list[Number], choice: ca.DM) -> _Hold:
    """What holds the machine, rigid as drawn, linearised where it stands in equilibrium.

    The weight that its springs carry is not small beside what moves it, however heavy the frame is: linearised as
    drawn, a frame that stands on its springs 0.25 mm lower would swing at a frequency 0.02 % off. Where nothing holds
    some motion there is no equilibrium, and it is linearised as drawn.

    Parameters
    ----------
    machine, whole, number, t
        As :func:`own_motion`.
    weight : list of symbols or floats
        Weight, N, and its moments g sum m x, g sum m y about the frame's centre of gravity, N m.
    choice : (3, k) matrix
        The free motions among x, y, theta.
    """
    scene = _scene(machine, whole, number, t)
    forces.supports(scene)
    q, rate = ca.SX.sym("q", choice.shape[1]), ca.SX.sym("q'", choice.shape[1])
    moved = ca.mtimes(choice, q)
    displaced = _rigid_displacement(machine, whole, moved)
    rigid = ca.jacobian(displaced, q)
    pull = ca.mtimes(whole.axes, scene.total)
    drawn = [ca.SX(0.0), *(ca.densify(part) for part in (displaced, ca.mtimes(rigid, rate)))]
    (pull,) = ca.substitute([pull], [t, whole.z, whole.v], drawn)
    tipped = ca.cos(moved[2]) * weight[1] - ca.sin(moved[2]) * weight[2]
    wrench = ca.mtimes(rigid.T, pull) + ca.mtimes(choice.T, ca.vertcat(0, -weight[0], -tipped))
    stiffness = -ca.jacobian(wrench, q)

    def at(place: ca.SX, *expressions: ca.SX) -> list[ca.SX]:
        still = [ca.densify(place), ca.SX.zeros(*rate.shape)]
        return [ca.densify(part) for part in ca.substitute(list(expressions), [q, rate], still)]

    place = ca.SX.zeros(*q.shape)
    nominal = ca.substitute(at(place, stiffness), [number.vector], [ca.DM([number.nominal[k] for k in number.paths])])
    if np.linalg.matrix_rank(np.array(ca.evalf(nominal[0])), 1e-9) == choice.shape[1]:
        for _ in range(_NEWTON_STEPS):
            here, slope = at(place, wrench, stiffness)
            place += ca.solve(slope, here)
    here, slope, drag = at(place, wrench, stiffness, -ca.jacobian(wrench, rate))
    (at_first,) = at(ca.SX.zeros(*q.shape), wrench)
    return _Hold(slope, drag, here + ca.mtimes(slope, place) - at_first)


def _external(machine: Machine, whole: Kinematics, held: Kinematics, number: Numbers, t: ca.SX) -> ca.SX:
    """Wrench (3, 1) of supports and loads on the machine about the centre of gravity of its frame, which is at rest."""
    scene = _scene(machine, whole, number, t)
    forces.supports(scene)
    forces.loads(scene)
    now = dict(zip(whole.names, ca.vertsplit(whole.z), strict=True))
    rows = []
    for name in whole.names:
        motion, link = name[:-1].split("(")
        if motion == "x":
            rows.append([1.0, 0.0, -_arm(machine, link)[1] - now.get(f"y({link})", 0.0)])
        elif motion == "y":
            rows.append([0.0, 1.0, _arm(machine, link)[0] + now.get(f"x({link})", 0.0)])
        else:
            rows.append([0.0, 0.0, 1.0 if motion == "theta" else 0.0])
    rigid = ca.vertcat(*(ca.horzcat(*row) for row in rows))
    wrench = ca.mtimes(rigid.T, ca.mtimes(whole.axes, scene.total))
    places = [held.names.index(name) if name in held.names else None for name in whole.names]
    at, rate = (ca.vertcat(*(part[i] if i is not None else 0.0 for i in places)) for part in (held.z, held.v))
    (found,) = ca.substitute([wrench], [whole.z, whole.v], [ca.densify(at), ca.densify(rate)])
    return found


def _momentum_rate(machine: Machine, held: Kinematics, number: Numbers, acceleration: ca.SX) -> ca.SX:
    """Rate (3, 1) of the links' momentum about the centre of gravity of a frame at rest, less their weight.

    As in :func:`jointplay.solver.equations.dynamics.inertia`, the links' masses are constants between the moving terms.
    """
    terms = held.terms
    centre = machine.links[machine.frame].cg
    linear: dict[str, Complex] = {}
    angular: dict[str, dict[str, Complex]] = {}
    spin: Number = 0.0
    for name, link in machine.links.items():
        pose = held.poses[name]
        mass = number(f"links.{name}.mass", link.mass or 0.0)
        turning = sum((share * acceleration[i] for i, share in pose.angle_partials.items()), start=ca.SX(0.0))
        moment = number(f"links.{name}.inertia", link.inertia or 0.0)
        spin += moment * (turning + terms.terms[pose.turn].bias.im)
        arms = {**pose.centre.terms}
        arms[GROUND] = arms.get(GROUND, 0.0) - complex(*centre)
        for q, b in pose.centre.terms.items():
            if q == GROUND:
                continue
            linear[q] = linear.get(q, ZERO) + Complex(mass * b.real, mass * b.imag)
            for p, a in arms.items():
                weight = a.conjugate() * b
                row = angular.setdefault(q, {})
                row[p] = row.get(p, ZERO) + Complex(mass * weight.real, mass * weight.imag)
    push = ZERO
    for q, moved in linear.items():
        term = terms.terms[q]
        second = sum((partial * Complex(acceleration[i], 0.0) for i, partial in term.partials.items()), start=term.bias)
        second = second * terms.rotation[term.moving_turn]
        push = push + second * moved
        lever = ZERO
        for p, inertial in angular[q].items():
            place = terms.terms[p]
            lever = lever + (place.size * terms.rotation[place.turn]).conjugate * inertial
        spin += (lever * second).im
    return ca.vertcat(push.re, push.im, spin)
