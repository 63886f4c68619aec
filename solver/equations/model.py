"""Machine and set of clearance joints to symbolic equations of motion, and to functions of them.

A joint is its closure equation and a force element a force at a point; Jacobians, velocity terms and the generalised
forces are derived from them, so there is no second copy of an equation that could disagree with the first. The
functions give numbers without any compilation; each is made when first asked for, and kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca

from jointplay.solver.equations import drive, forces
from jointplay.solver.equations.contact import ContactForce, with_contacts_decided
from jointplay.solver.equations.decoupled import HeldSolver, OwnMotion, hold_frame, own_motion
from jointplay.solver.equations.dynamics import Solver, border_of, constrained_solver, inertia
from jointplay.solver.equations.friction import Bristles
from jointplay.solver.equations.geometry import Kinematics
from jointplay.solver.equations.kinematics import kinematics
from jointplay.solver.equations.numbers import Numbers, contact_paths
from jointplay.solver.equations.play import wear
from jointplay.solver.equations.redundancy import Repeats, without_repeats
from jointplay.solver.equations.rubbing import Rubbing, journals, rubbing_joints, solve_with_friction
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine


class ModelFunctions:
    """What :class:`~jointplay.solver.equations.model.Model` can be asked for in numbers; its attributes are described
    there.

    Making a function costs milliseconds, calling it microseconds, and cases by the thousand share a model.
    """

    machine: Machine
    t: ca.SX
    z: ca.SX
    v: ca.SX
    p: ca.SX
    kinematics: Kinematics
    mass: ca.SX
    force: ca.SX
    solution: Solver | HeldSolver
    phi: ca.SX
    phi_rate: ca.SX
    acceleration: ca.SX
    eccentricity: ca.SX
    contacts: tuple[ContactForce, ...]
    touching: ca.SX
    rubbing: Rubbing | None
    jam: ca.SX
    remembering: tuple[int, ...]
    bristles: Bristles
    memory: ca.SX

    def function(self, name: str, *outputs: ca.SX) -> ca.Function:
        """A CasADi function of (t, z, v, p): evaluated without any compilation, microseconds a call.

        Contacts count as beginning now: nothing is remembered.
        """
        dense = [ca.densify(self.forget(part)) for part in outputs]
        return ca.Function(name, [self.t, self.z, self.v, self.p], dense)

    def function_of_memory(self, name: str, *outputs: ca.SX) -> ca.Function:
        """A CasADi function of (t, z, v, p, memory)."""
        return ca.Function(name, [self.t, self.z, self.v, self.p, self.memory], list(outputs))

    def forget(self, expression: ca.SX) -> ca.SX:
        """The expression with nothing remembered."""
        if not self.memory.shape[0]:
            return expression
        return ca.substitute(expression, self.memory, ca.SX.zeros(*self.memory.shape))

    @cached_property
    def right_hand_side(self) -> ca.Function:
        """(t, z, v, p) -> z''; no numbers where sliding joints jam."""
        if self.rubbing is None:
            return self.function("right_hand_side", self.acceleration)
        return self.function("right_hand_side", self.acceleration + ca.if_else(self.jam, math.nan, 0))

    @cached_property
    def rubbing_state(self) -> ca.Function:
        """(t, z, v, p) -> numbers of rubbing joints as in :class:`~jointplay.solver.equations.rubbing.Rubbing`, but for
        `jam`.
        """
        rubbing = self.rubbing
        assert rubbing is not None
        switch = ca.vertcat(*(contact.switch for contact in self.contacts))
        columns = [
            rubbing.friction, rubbing.slow, rubbing.rate, rubbing.leverage, rubbing.mobility,
            rubbing.acceleration, rubbing.normal,
        ]  # fmt: skip
        return self.function("rubbing_state", *with_contacts_decided(self.touching, switch, columns))

    @cached_property
    def projection(self) -> ca.Function:
        """(t, z, v, p) -> corrections of z and v that restore the closures, least mass-weighted."""
        still = ca.SX.zeros(*self.z.shape)
        corrections = (self.solution.solve(still, -residual)[0] for residual in (self.phi, self.phi_rate))
        return self.function("projection", *(ca.mtimes(self.kinematics.axes, c) for c in corrections))

    @cached_property
    def constraint(self) -> ca.Function:
        """(t, z, v, p) -> closures and eccentricities stacked, their Jacobian, their time derivative at v = 0."""
        stacked = ca.vertcat(self.phi, self.eccentricity)
        return self.function("constraint", stacked, ca.jacobian(stacked, self.z), ca.jacobian(stacked, self.t))

    @cached_property
    def constraint_curvature(self) -> ca.Function:
        """(t, z, p, u) -> second derivatives by t and z of the sum of closures and eccentricities stacked, times u."""
        stacked, place = ca.vertcat(self.phi, self.eccentricity), ca.vertcat(self.t, self.z)
        weights = ca.SX.sym("u", stacked.shape[0])
        second = ca.densify(ca.hessian(ca.dot(weights, stacked), place)[0])
        return ca.Function("constraint_curvature", [self.t, self.z, self.p, weights], [second])

    @cached_property
    def constraint_bias(self) -> ca.Function:
        """(t, z, v, p) -> second time derivative of closures and eccentricities stacked, without accelerations."""
        bias = ca.vertcat(self.phi, self.eccentricity)
        for _ in range(2):
            bias = ca.jtimes(bias, self.z, self.v) + ca.jacobian(bias, self.t)
        return self.function("constraint_bias", bias)

    @cached_property
    def inertia(self) -> ca.Function:
        """(t, z, v, p) -> mass matrix and generalised forces of the coordinates themselves."""
        axes = self.kinematics.axes
        return self.function("inertia", ca.mtimes([axes, self.mass, axes.T]), ca.mtimes(axes, self.force))

    @cached_property
    def equilibrium(self) -> ca.Function:
        """(z and multipliers, t, v, p) -> residual of forces and closures, pins concentric, and its Jacobian."""
        stacked = ca.vertcat(self.phi, self.eccentricity)
        multipliers = ca.SX.sym("l", stacked.shape[0])
        gradient = ca.jacobian(stacked, self.z)
        force = ca.mtimes(self.kinematics.axes, self.forget(self.force)) + ca.mtimes(gradient.T, multipliers)
        unknowns = ca.vertcat(self.z, multipliers)
        equations = ca.vertcat(force, stacked)
        arguments = [unknowns, self.t, self.v, self.p]
        dense = [ca.densify(part) for part in (equations, ca.jacobian(equations, unknowns))]
        return ca.Function("equilibrium", arguments, dense)

    @cached_property
    def mass_matrix(self) -> ca.Function:
        """(t, z, v, p) -> mass matrix of the coordinates themselves."""
        axes = self.kinematics.axes
        return self.function("mass_matrix", ca.mtimes([axes, self.mass, axes.T]))

    @cached_property
    def linearised(self) -> ca.Function:
        """(t, z, v, p) -> Jacobians of z'' with respect to z and v, nothing remembered."""
        parts = (ca.jacobian(self.acceleration, x) for x in (self.z, self.v))
        return self.function("linearised", *parts)

    @cached_property
    def force_gradient(self) -> ca.Function:
        """(t, z, v, p) -> Jacobians of the generalised forces of the coordinates with respect to z and v."""
        force = ca.mtimes(self.kinematics.axes, self.force)
        return self.function("force_gradient", *(ca.jacobian(force, x) for x in (self.z, self.v)))

    @cached_property
    def link_rates(self) -> ca.Function:
        """(t, z, v, p) -> Jacobian (3N, n) of x, y, theta of every link in file order, and their rate at v = 0."""
        kin = self.kinematics
        pose = ca.vertcat(*map(kin.placed, self.machine.links))
        return self.function("link_rates", ca.jacobian(pose, self.z), ca.jacobian(pose, self.t))


#: Models that are kept, with what is made of each: a catalogue's pairs of joints under two contact laws, once more with
#: other numbers drawn, come by in turns; what was forgotten costs as much as a dozen cases, what is kept some 4 MB.
MODELS_KEPT = 256


@dataclass(frozen=True)
class Model(ModelFunctions):
    """Equations of one machine with one set of clearance joints.

    Attributes
    ----------
    machine : Machine
    clearance_joints : tuple of str
    parameters : tuple of str
        Paths of the lane parameters, in the order of `p`.
    nominal : dict of str to float
        Their values (and those of every folded number) in the machine file.
    t, z, v, p : casadi.SX
        Time (s), coordinates (n, 1), velocities (n, 1), lane parameters (k, 1).
    kinematics : Kinematics
    mass, force : casadi.SX
        M (n, n) and Q (n, 1) of M a = Q + G' lambda with z'' = T a, T the kinematics' axes; Q holds the velocity terms.
    solution : Solver
        Of the constrained system for any right-hand sides.
    phi, phi_rate : casadi.SX
        Closures (m, 1) and their rate.
    acceleration, reactions : casadi.SX
        z'' (n, 1) and lambda (m, 1).
    eccentricity : casadi.SX
        How far the clearance joints are off where they were drawn, stacked, (2k, 1), m; this and `push` as of
        :class:`~jointplay.solver.equations.play.WornJoint`.
    push : dict of str to casadi.SX
        (2, 1) force in each clearance joint.
    contacts : tuple of ContactForce
        One of a pin, four of a block in its guide; with whether the surfaces push as a symbol.
    touching, held_acceleration : casadi.SX
        These symbols, one a contact, and z'' as a function of them: smooth as long as they are held.
    rubbing : Rubbing or None
        Sliding joints with Coulomb friction, contacts held; ``None`` without any.
    jam : casadi.SX
        1 where they jam: accelerations and reactions have no meaning there; else 0.
    remembering : tuple of int
        Places of contacts whose law remembers, see :mod:`jointplay.solver.equations.contact`.
    bristles : Bristles
        Rubbing surfaces that can stick.
    memory : casadi.SX
        Symbols of what the state has beside motion: what contacts remember, m/s, 0 while the surfaces are apart; the
        bristles' deflections; their slips. All 0 is a state that nothing went before.
    repeats : Repeats
        Closures left out or kept that follow from others.
    """

    machine: Machine
    clearance_joints: tuple[str, ...]
    parameters: tuple[str, ...]
    nominal: dict[str, float]
    t: ca.SX
    z: ca.SX
    v: ca.SX
    p: ca.SX
    kinematics: Kinematics
    mass: ca.SX
    force: ca.SX
    solution: Solver | HeldSolver
    phi: ca.SX
    phi_rate: ca.SX
    acceleration: ca.SX
    reactions: ca.SX
    eccentricity: ca.SX
    push: dict[str, ca.SX]
    contacts: tuple[ContactForce, ...]
    touching: ca.SX
    held_acceleration: ca.SX
    rubbing: Rubbing | None
    jam: ca.SX
    remembering: tuple[int, ...]
    bristles: Bristles
    memory: ca.SX
    repeats: Repeats

    @cached_property
    def size(self) -> int:
        """Number of coordinates n."""
        return int(self.z.shape[0])

    @property
    def degrees_of_freedom(self) -> int:
        """Coordinates less closures: motions to integrate."""
        return self.size - len(self.kinematics.closures) + self.repeats.shared

    @property
    def lubricated(self) -> bool:
        """Whether there is a film of oil in one of the clearance joints."""
        return any(getattr(self.machine.joints[name], "film", None) for name in self.clearance_joints)

    @property
    def frame_indices(self) -> tuple[int | None, int | None, int | None]:
        """Where x, y, theta of the frame are among the coordinates; ``None`` for a motion it does not have."""
        return self.kinematics.indices_of(self.machine.frame)

    @property
    def frame_coordinates(self) -> list[int]:
        """Where all motions are that the frame has: of x, y, theta, then its modes."""
        return [*(i for i in self.frame_indices if i is not None), *self.kinematics.modes]

    @property
    def inner_indices(self) -> list[int]:
        """Where the other coordinates are."""
        frame = self.frame_coordinates
        return [i for i in range(self.size) if i not in frame]

    def vector(self, values: dict[str, float]) -> list[float]:
        """Lane parameters in kernel order: `values` where given, the machine file's numbers elsewhere."""
        return [values.get(path, self.nominal[path]) for path in self.parameters]


def build_model(
    machine: Machine, clearance_joints: Iterable[str] = (), varying: Iterable[str] = (), *, expanded: bool = False
) -> Model:
    """Write the equations of a machine.

    Parameters
    ----------
    machine : Machine
    clearance_joints : iterable of str
        Joints that have clearance in this model.
    varying : iterable of str
        Numbers of the machine file, by path, that become lane parameters besides the contact numbers of the clearance
        joints and the drive speed.
    expanded : bool
        See :func:`jointplay.solver.equations.kinematics.kinematics`; slower, and every reaction is there.

    Raises
    ------
    MachineError
        A joint that cannot have clearance, a path that no equation holds, or something the solver does not model.
    """
    wanted = tuple(clearance_joints)
    for name in wanted:
        if name not in machine.wearing_joints:
            rule = f"cannot have clearance; that can {', '.join(machine.wearing_joints)}"
            raise MachineError(machine.name, f"joints.{name}", None, rule)
    whole, machine = machine, hold_frame(machine) if machine.decoupled else machine
    open_joints = tuple(name for name in machine.wearing_joints if name in wanted)
    contacted = [path for name in open_joints for path in contact_paths(machine, name)]
    speed = ["drive.speed"] if isinstance(getattr(machine.drive, "speed", None), float) else []
    number = Numbers([*contacted, *speed, *varying])

    t = ca.SX.sym("t")
    motion = drive.prescribed_motion(machine, number, t)
    rubbing_names, turning = (find(machine, number, open_joints) for find in (rubbing_joints, journals))
    rubs, gravity = frozenset((*rubbing_names, *turning)), number("gravity", machine.gravity)

    def moving(machine: Machine, motion: drive.PrescribedMotion | None) -> Kinematics:
        return kinematics(machine, frozenset(open_joints), motion, gravity, rubbing=rubs, expanded=expanded)

    kin = moving(machine, motion)
    z, v = kin.z, kin.v
    kin, repeats = without_repeats(machine, kin, t, number, lambda: moving(machine, None), rubs)
    rubbing_names = tuple(name for name in rubbing_names if name not in repeats.joints)
    n = int(z.shape[0])

    def rate(expression: ca.SX) -> ca.SX:
        return ca.jtimes(expression, z, v) + ca.jacobian(expression, t)

    travel = {k: kin.slide(j)[0] for k, j in machine.joints.items() if isinstance(j, SlidingJoint)}
    slides = {name: (offset, rate(offset)) for name, offset in travel.items()}
    scene = forces.Scene(machine, kin, number, t, slides, ca.SX.zeros(n))
    mass = inertia(scene)
    forces.supports(scene)
    forces.loads(scene)
    forces.effort(scene)
    forces.viscous_joints(scene, frozenset(open_joints))
    play = wear(scene, open_joints)

    closed = bool(kin.closures)
    phi = ca.vertcat(*(c.phi for c in kin.closures)) if closed else ca.SX(0, 1)
    jacobian = ca.mtimes(ca.jacobian(phi, z), kin.axes) if closed else ca.SX(0, n)
    phi_rate = rate(phi) if closed else ca.SX(0, 1)
    gamma = -rate(phi_rate) if closed else ca.SX(0, 1)
    solution = constrained_solver(mass, jacobian, border_of(machine, kin), shared=repeats.shared > 0)
    rubbing, held_jam = None, ca.SX(0)
    if rubbing_names or turning:
        held, reactions, rubbing = solve_with_friction(scene, rubbing_names, turning, solution, gamma)
        held_jam = ca.SX(0) if rubbing is None else rubbing.jam
    else:
        held, reactions = solution.solve(scene.total, gamma)
    held = ca.mtimes(kin.axes, held)
    force, acceleration, reactions, jam, *pushes = with_contacts_decided(
        play.touching, play.switch,
        [scene.total, held, reactions, held_jam, *(joint.push for joint in play.joints.values())],
    )  # fmt: skip
    own = own_motion(whole, moving(whole, motion), kin, number, t, gravity) if whole.decoupled else None
    unused = number.unused()
    if unused:
        raise MachineError(machine.name, unused[0], None, "no equation of this machine holds such a number")
    model = Model(
        machine, open_joints, number.paths, number.nominal, t, z, v, number.vector, kin, mass, force,
        solution, phi, phi_rate, acceleration, reactions, play.eccentricity,
        dict(zip(play.joints, pushes, strict=True)), play.contacts, play.touching, held,
        rubbing, jam, play.remembering, scene.bristles, ca.vertcat(play.memory, scene.bristles.memory), repeats,
    )  # fmt: skip
    return model if own is None else _with_frame(model, whole, own)


def _with_frame(model: Model, machine: Machine, own: OwnMotion) -> Model:
    """A model of a machine on a frame at rest, with the motion of its frame among its coordinates."""

    def join(inner: ca.SX, frame: ca.SX) -> ca.SX:
        return ca.vertcat(inner, frame)[own.order, :]

    def blocks(inner: ca.SX, frame: ca.SX) -> ca.SX:
        return ca.diagcat(inner, frame)[own.order, own.order]

    kin, z, v = model.kinematics, join(model.z, own.z), join(model.v, own.v)
    names = (*kin.names, *own.names)
    kin = replace(
        kin, names=tuple(names[i] for i in own.order), z=z, v=v, apart={machine.frame: own.pose},
        axes=blocks(kin.axes, ca.SX.eye(len(own.names))),
    )  # fmt: skip
    return replace(
        model, machine=machine, z=z, v=v, kinematics=kin, mass=blocks(model.mass, own.mass),
        force=join(model.force, own.force(ca.SX.zeros(model.size))), solution=HeldSolver(model.solution, own.order),
        acceleration=join(model.acceleration, own.acceleration(model.acceleration)),
        held_acceleration=join(model.held_acceleration, own.acceleration(model.held_acceleration)),
    )  # fmt: skip
