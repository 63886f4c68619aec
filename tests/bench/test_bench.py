"""What the benchmarks conclude from what they measure, and the model that was derived by hand for them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import slider_crank
from benchmarks.comparison import Point, cost_at
from benchmarks.problem import from_equations
from benchmarks.scenes import p1
from benchmarks.throughput import busy_part
from jointplay.solver.equations.model import build_model


def test_cost_at_equal_error_lies_between_two_settings() -> None:
    points = [Point(1e-4, 1.0, 1.0), Point(1e-5, 2.0, 0.2), Point(1e-6, 4.0, 0.05), Point(1e-7, 9.0, 0.001)]
    assert cost_at(points, 0.1) == pytest.approx(2.0 * 2**0.5)
    assert cost_at(points[:2], 0.1) is None
    assert cost_at(points[2:], 0.1) == 4.0


def test_lanes_are_idle_only_behind_the_last_cases() -> None:
    assert busy_part([1.0] * 16) == 1.0
    assert busy_part([1.0] * 9) == pytest.approx(9 / 16)


def test_slider_crank_by_hand() -> None:
    """The peer integrates the same machine: accelerations at random states, in contact and out of it."""
    scene = p1()
    problem, names = from_equations(scene), build_model(scene.machine, scene.fault.joints).kinematics.names
    order = [("x(frame)", "y(frame)", "theta(frame)", "slide(G)", "theta(rod)").index(name) for name in names]
    columns = np.array([*order, *(5 + k for k in order)])
    drawn = np.zeros(slider_crank.SIZE)
    drawn[3] = slider_crank.CRANK + slider_crank.ROD  # the product's slide is counted from the drawing
    rng = np.random.default_rng(3)
    pushing = 0
    for _ in range(20):
        t, y = rng.uniform(0, 1), rng.normal(size=slider_crank.SIZE)
        y[:3] *= 1e-3
        # Rod and slider close the linkage at this crank angle, up to a millimetre.
        crank = slider_crank.OMEGA * t
        rod = np.arcsin(-slider_crank.CRANK * np.sin(crank) / slider_crank.ROD)
        y[3] = slider_crank.CRANK * np.cos(crank) + slider_crank.ROD * np.cos(rod) + rng.uniform(-3e-4, 3e-4)
        y[4] = y[2] + rod
        by_hand, product = np.empty(slider_crank.SIZE), np.empty(problem.size)
        _, _, switch = slider_crank.derivative(t, y, slider_crank.BY_STATE, by_hand)
        problem.derivative(t, (y - drawn)[columns], product)
        pushing += switch > 0
        # Rounding of the penetration, 1e-17 m of 0.2 m, times stiffness over mass is far below this.
        assert product == pytest.approx(by_hand[columns], rel=1e-9, abs=1e-6)
    assert 0 < pushing < 20
