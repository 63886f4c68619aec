"""Mass matrix and forces by virtual work; accelerations and reactions from them.

The 3N + 2J equations of the paper, reduced to the rows a scene has: M z'' = Q + G' lambda with G z'' = gamma, solved by
the Schur complement on the reactions, S = G M^-1 G', both by sparse LDL.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from jointplay.solver.equations.forces import Scene
from jointplay.solver.equations.geometry import GROUND, ONE, Complex, Kinematics, Terms
from jointplay.solver.machines.machine import Machine

#: Part of its diagonal that is added to the Schur complement of closures of which some follow from others, and how
#: often what that takes from the reactions is given back: the rest is its power of one more.
_GRIP = 1e-8
_RETURNS = 2


@dataclass(frozen=True)
class Factors:
    """Sparse LDL factors of a symmetric positive definite matrix, symbolic."""

    diagonal: ca.SX
    lower_transposed: ca.SX
    order: list[int]

    def solve(self, right: ca.SX) -> ca.SX:
        """Solution of A x = right, columns independent."""
        if right.shape[1] == 0:
            return right
        return ca.ldl_solve(right, self.diagonal, self.lower_transposed, self.order)


def factorise(matrix: ca.SX) -> Factors:
    """LDL with a fill-reducing order, of the upper half: what cancels in one half may not be seen in the other."""
    return Factors(*ca.ldl(ca.triu2symm(ca.triu(ca.sparsify(matrix)))))


@dataclass(frozen=True)
class ConstrainedSolver:
    """M x = Q + G' l, G x = gamma for any right-hand sides.

    Attributes
    ----------
    mass : Factors
        Of M, (n, n).
    jacobian : casadi.SX
        G, (m, n).
    spread : casadi.SX
        M^-1 G', (n, m).
    schur : Factors or None
        Of G M^-1 G'; ``None`` when nothing is left to close.
    grip : casadi.SX or None
        Diagonal that :data:`_GRIP` adds to it where closures follow from others, (m, 1).
    """

    mass: Factors
    jacobian: ca.SX
    spread: ca.SX
    schur: Factors | None
    grip: ca.SX | None = None

    @property
    def size(self) -> int:
        """Number of accelerations n."""
        return int(self.jacobian.shape[1])

    @classmethod
    def of(cls, mass: ca.SX, jacobian: ca.SX, *, shared: bool = False) -> ConstrainedSolver:
        """Factorise once; `jacobian` may have no rows. `shared`: some of them follow from others."""
        factors = factorise(mass)
        if jacobian.shape[0] == 0:
            return cls(factors, jacobian, ca.SX(mass.shape[0], 0), None)
        spread = factors.solve(jacobian.T)
        schur = ca.mtimes(jacobian, spread)
        if not shared:
            return cls(factors, jacobian, spread, factorise(schur))
        grip = _GRIP * ca.diag(schur)
        return cls(factors, jacobian, spread, factorise(schur + ca.diag(grip)), grip)

    def solve(self, force: ca.SX, gamma: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Accelerations (n, k) and reactions (m, k) for forces (n, k) and right sides of the closures (m, k)."""
        free = self.mass.solve(force)
        if self.schur is None:
            return free, ca.SX(0, force.shape[1])
        missing = gamma - ca.mtimes(self.jacobian, free)
        reactions = self.schur.solve(missing)
        if self.grip is not None:
            # What the grip takes away comes back; without the reactions that do nothing, which it makes small.
            for _ in range(_RETURNS):
                reactions = self.schur.solve(missing + self.grip * reactions)
        return free + ca.mtimes(self.spread, reactions), reactions


@dataclass(frozen=True)
class BorderedSolver:
    """The same, with some coordinates eliminated last.

    All links hang on the frame, so that eliminating its motions first ties every closure to every other: the cost grows
    with the cube of their number. Eliminated last, they are a border of three rows round a system that stays sparse.
    The closures must keep their rank when the border stands still.

    Attributes
    ----------
    inner : ConstrainedSolver
        Of the other coordinates, u.
    inside, border : list of int
        Indices of u and of the border's coordinates b.
    coupling, jacobian : casadi.SX
        M_ub (n - k, k) and G_b (m, k).
    response, reactions : casadi.SX
        Accelerations of u (n - k, k) and reactions (m, k) that a unit acceleration of b calls for, with opposite sign.
    core : Factors
        Of the border's own system once u is eliminated, (k, k).
    """

    inner: ConstrainedSolver
    inside: list[int]
    border: list[int]
    coupling: ca.SX
    jacobian: ca.SX
    response: ca.SX
    reactions: ca.SX
    core: Factors

    @property
    def size(self) -> int:
        """Number of accelerations n."""
        return len(self.inside) + len(self.border)

    @classmethod
    def of(cls, mass: ca.SX, jacobian: ca.SX, border: list[int], *, shared: bool = False) -> BorderedSolver:
        """Factorise once, the coordinates `border` last."""
        inside = [i for i in range(mass.shape[0]) if i not in border]
        inner = ConstrainedSolver.of(mass[inside, inside], jacobian[:, inside], shared=shared)
        coupling, own = mass[inside, border], jacobian[:, border]
        response, reactions = inner.solve(coupling, own)
        core = mass[border, border] - ca.mtimes(coupling.T, response) + ca.mtimes(own.T, reactions)
        return cls(inner, inside, border, coupling, own, response, reactions, factorise(core))

    def solve(self, force: ca.SX, gamma: ca.SX) -> tuple[ca.SX, ca.SX]:
        """As :meth:`ConstrainedSolver.solve`."""
        inner, reactions = self.inner.solve(force[self.inside, :], gamma)
        left = force[self.border, :] - ca.mtimes(self.coupling.T, inner) + ca.mtimes(self.jacobian.T, reactions)
        outer = self.core.solve(left)
        found = ca.SX(*force.shape)
        found[self.border, :] = outer
        found[self.inside, :] = inner - ca.mtimes(self.response, outer)
        return found, reactions - ca.mtimes(self.reactions, outer)


Solver = ConstrainedSolver | BorderedSolver


def border_of(machine: Machine, kin: Kinematics) -> list[int]:
    """Coordinates of the frame, where closures keep their rank without them.

    They do where the whole machine can move as one body: what the frame's motion opens, the other links' can open, too.
    A link that is tied to the ground, or driven in space, takes that away. What modes open is as little as those of a
    rigid frame need.
    """
    if machine.driven_link:
        return []
    if any(link.fixed or link.locked for name, link in machine.links.items() if name != machine.frame):
        return []
    return [*(i for i in kin.indices_of(machine.frame) if i is not None), *kin.modes]


def constrained_solver(mass: ca.SX, jacobian: ca.SX, frame: list[int], *, shared: bool = False) -> Solver:
    """The solver that needs fewer operations for a right-hand side: with the motions of the frame last, or not.

    Parameters
    ----------
    mass, jacobian : casadi.SX
        M (n, n) and G (m, n).
    frame : list of int
        Coordinates of the frame that may come last; see :class:`BorderedSolver`.
    shared : bool
        Some closures follow from others: their reactions are the least squares, weighted with S_ii, of those that do.
    """
    plain = ConstrainedSolver.of(mass, jacobian, shared=shared)
    if not frame or len(frame) == mass.shape[0]:
        return plain
    bordered = BorderedSolver.of(mass, jacobian, frame, shared=shared)
    force, gamma = ca.SX.sym("force", mass.shape[0]), ca.SX.sym("gamma", jacobian.shape[0])
    plain_cost, bordered_cost = (ca.n_nodes(ca.vertcat(*found.solve(force, gamma))) for found in (plain, bordered))
    return bordered if bordered_cost < plain_cost else plain


def inertia(scene: Scene) -> ca.SX:
    """M (n, n), and the inertial forces and gravity added to the scene's forces.

    The inertia of all links is one constant matrix over the terms: with r_i = sum_p a_ip B_p, the kinetic energy is
    half the sum over p, q of Re(conj(B_p') B_q' sum_i m_i conj(a_ip) a_iq). The second derivative of B_p is a sum over
    the coordinates' accelerations and a bias; gravity is in the origins' bias, as an upward acceleration.
    """
    kin, number = scene.kinematics, scene.number
    terms = kin.terms
    n = int(kin.z.shape[0])
    mass_matrix = ca.SX(n, n)
    coupling: dict[tuple[str, str], Complex] = {}
    for name, link in scene.machine.links.items():
        pose = kin.poses[name]
        # Only a fixed link may leave them out: the frame has no coordinates then, another link is held by closures.
        mass = 1.0 if link.mass is None else number(f"links.{name}.mass", link.mass)
        moment = 1.0 if link.inertia is None else number(f"links.{name}.inertia", link.inertia)
        for i, share in pose.angle_partials.items():
            for j, also in pose.angle_partials.items():
                mass_matrix[i, j] += share * also * moment
            # A unit vector's bias is -omega^2 + i times the angle's prescribed acceleration.
            scene.total[i] -= share * moment * terms.terms[pose.turn].bias.im
        moving = {key: a for key, a in pose.centre.terms.items() if key != GROUND}
        for p, a in moving.items():
            for q, b in moving.items():
                weight = a.conjugate() * b
                entry = Complex(mass * weight.real, mass * weight.imag)
                coupling[p, q] = coupling[p, q] + entry if (p, q) in coupling else entry
    _modes(scene, mass_matrix)
    turned = _Turned(terms)
    for (p, q), inertial in coupling.items():
        first, second = terms.terms[p], terms.terms[q]
        push = turned(first.moving_turn, q, None, second.bias) * inertial
        for i, partial in first.partials.items():
            scene.total[i] -= partial.dot(push)
        if (q, p) in coupling and q < p:
            continue  # the pair's other half adds the same products with i and j exchanged
        for j, other in second.partials.items():
            moved = turned(first.moving_turn, q, j, other) * inertial
            for i, partial in first.partials.items():
                product = partial.dot(moved)
                mass_matrix[i, j] += product
                if p != q:
                    mass_matrix[j, i] += product
    return ca.sparsify(mass_matrix)


def _modes(scene: Scene, mass_matrix: ca.SX) -> None:
    """Modal masses, springs and dampers of the frame's modes: m q'' + 2 z m w q' + m w^2 q.

    The modes of a free body are orthogonal to its rigid motions, whose inertia stays as it is. What their small
    displacements u change in it, by 2 u / r and less, r the radius of gyration, is left out.
    """
    kin, number = scene.kinematics, scene.number
    for i, mode in enumerate(scene.machine.modes):
        index, path = kin.names.index(f"mode({i})"), f"modes.{i}"
        mass, ratio = number(f"{path}.mass", mode.mass), number(f"{path}.damping", mode.damping)
        w = 2 * math.pi * number(f"{path}.frequency", mode.frequency)
        mass_matrix[index, index] += mass
        scene.total[index] -= mass * w * (w * kin.z[index] + 2 * ratio * kin.v[index])


class _Turned:
    """Vectors of a term in the axes of another turn, each computed once."""

    def __init__(self, terms: Terms) -> None:
        self.terms = terms
        self.rotations: dict[tuple[str, str], Complex] = {}
        self.known: dict[tuple[str, str, int | None], Complex] = {}

    def rotation(self, here: str, there: str) -> Complex:
        """exp(i angle) from `here` to `there`; the one back is its conjugate."""
        if here == there:
            return ONE
        if (here, there) not in self.rotations:
            forth = self.terms.rotation[here].conjugate * self.terms.rotation[there]
            self.rotations[here, there], self.rotations[there, here] = forth, forth.conjugate
        return self.rotations[here, there]

    def __call__(self, here: str, term: str, which: int | None, vector: Complex) -> Complex:
        """`vector`, the partial `which` of `term` (or its bias), in the axes of `here`."""
        key = (here, term, which)
        if key not in self.known:
            self.known[key] = self.rotation(here, self.terms.terms[term].moving_turn) * vector
        return self.known[key]
