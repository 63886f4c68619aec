"""Solving for accelerations and reactions: the same numbers whatever is eliminated last, at a cost linear in links."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from benchmarks.scaling import chain
from jointplay.solver.equations.dynamics import BorderedSolver, ConstrainedSolver, constrained_solver
from jointplay.solver.equations.model import Model, build_model


def test_border_and_no_border_solve_the_same_system() -> None:
    random = np.random.default_rng(5)
    root, jacobian = random.normal(size=(9, 9)), random.normal(size=(4, 9))
    mass = root @ root.T + 9 * np.eye(9)
    force, gamma = random.normal(size=(9, 3)), random.normal(size=(4, 3))
    expected = np.linalg.solve(np.block([[mass, -jacobian.T], [jacobian, np.zeros((4, 4))]]), np.vstack([force, gamma]))
    solvers = (
        ConstrainedSolver.of(ca.SX(mass), ca.SX(jacobian)),
        BorderedSolver.of(ca.SX(mass), ca.SX(jacobian), [0, 1, 2]),
        BorderedSolver.of(ca.SX(mass), ca.SX(jacobian), [7, 3]),
    )
    for solver in solvers:
        found = np.vstack([np.array(ca.DM(part)) for part in solver.solve(ca.SX(force), ca.SX(gamma))])
        assert np.allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_border_without_closures() -> None:
    solver = constrained_solver(ca.SX(np.diag([1.0, 2.0, 4.0])), ca.SX(0, 3), [0])
    accelerations, reactions = solver.solve(ca.SX([1.0, 1.0, 1.0]), ca.SX(0, 1))
    assert np.array(ca.DM(accelerations)).ravel() == pytest.approx([1.0, 0.5, 0.25])
    assert reactions.shape == (0, 1)


def operations(model: Model) -> int:
    right = ca.Function("right", [model.t, model.z, model.v, model.p], ca.cse([model.acceleration]))
    return int(right.n_instructions())


def test_operations_grow_linearly_with_links() -> None:
    """41 and 81 moving links on a floating frame: twice the work; eliminating the frame first takes six times."""
    models = [build_model(chain(loops)) for loops in (20, 40)]
    assert all(isinstance(model.solution, BorderedSolver) for model in models)
    assert operations(models[1]) < 2.2 * operations(models[0])


def test_a_border_that_does_not_pay_is_not_taken() -> None:
    assert isinstance(build_model(chain(1)).solution, ConstrainedSolver | BorderedSolver)
    plain = constrained_solver(ca.SX(np.eye(3)), ca.SX(np.ones((1, 3))), [])
    assert isinstance(plain, ConstrainedSolver)
