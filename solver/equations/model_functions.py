"""Functions of the equations of a model: numbers without any compilation, each made when first asked for, and kept."""

from __future__ import annotations

import math
from functools import cached_property

import casadi as ca

from jointplay.solver.equations.contact import ContactForce
from jointplay.solver.equations.dynamics import Solver
from jointplay.solver.equations.poses import Kinematics
from jointplay.solver.equations.rubbing import Rubbing
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
    solution: Solver
    phi: ca.SX
    phi_rate: ca.SX
    acceleration: ca.SX
    eccentricity: ca.SX
    contacts: tuple[ContactForce, ...]
    touching: ca.SX
    rubbing: Rubbing | None
    jam: ca.SX
    remembering: tuple[int, ...]
    memory: ca.SX

    def function(self, name: str, *outputs: ca.SX) -> ca.Function:
        """A CasADi function of (t, z, v, p): evaluated without any compilation, microseconds a call.

        Contacts count as beginning now: nothing is remembered.
        """
        dense = [ca.densify(self.unremembered(part)) for part in outputs]
        return ca.Function(name, [self.t, self.z, self.v, self.p], dense)

    def function_of_memory(self, name: str, *outputs: ca.SX) -> ca.Function:
        """A CasADi function of (t, z, v, p, memory)."""
        return ca.Function(name, [self.t, self.z, self.v, self.p, self.memory], list(outputs))

    def unremembered(self, expression: ca.SX) -> ca.SX:
        """The expression with nothing remembered."""
        if not self.remembering:
            return expression
        return ca.substitute(expression, self.memory, ca.SX.zeros(len(self.remembering)))

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
            rubbing.friction, rubbing.friction_velocity, rubbing.rate, rubbing.leverage, rubbing.mobility,
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
        force = ca.mtimes(self.kinematics.axes, self.unremembered(self.force)) + ca.mtimes(gradient.T, multipliers)
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
        poses = (kin.poses[name] for name in self.machine.links)
        pose = ca.vertcat(*(ca.vertcat(kin.terms.value(k.centre, ground=True).column, k.theta) for k in poses))
        return self.function("link_rates", ca.jacobian(pose, self.z), ca.jacobian(pose, self.t))


def with_contacts_decided(touching: ca.SX, switch: ca.SX, expressions: list[ca.SX]) -> list[ca.SX]:
    """The expressions with surfaces pushing where their switch function is positive."""
    if touching.shape[0] == 0:
        return expressions
    return list(ca.substitute(expressions, [touching], [ca.if_else(switch > 0, 1, 0)]))
