"""Orders of convergence, measured; closures over ten thousand revolutions."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from laws import Array, impacts, run, states, tree_of

from jointplay.solver.equations.links import LinkMotion
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine


def test_gill_is_of_fourth_order() -> None:
    """Slope of the error over four halvings of the step, on a machine whose motion is smooth."""
    machine = shipped_machine("quick-return")
    exact, _ = run(machine, {}, duration=0.2, sample_rate=100, step=2e-5)
    steps, errors = [], []
    for step in (2e-3, 1e-3, 5e-4, 2.5e-4):
        history, _ = run(machine, {}, duration=0.2, sample_rate=100, step=step)
        steps.append(history.step)
        errors.append(np.abs(history.displacement - exact.displacement).max())
    slopes = np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert slopes == pytest.approx([4.0] * 3, abs=0.06)


def test_error_control_is_of_fifth_order() -> None:
    """Slope of the error over the mean step: 5; over the tolerance: 1. Smooth motion."""
    machine = shipped_machine("quick-return")
    exact, _ = run(machine, {}, duration=0.2, sample_rate=100, step=1e-5)
    steps, errors = [], []
    tolerances = (1e-8, 1e-9, 1e-10, 1e-11)
    for rtol in tolerances:
        history, _ = run(machine, {}, duration=0.2, sample_rate=100, rtol=rtol)
        steps.append(history.step)
        errors.append(np.abs(history.displacement - exact.displacement).max())
    assert np.diff(np.log(errors)) / np.diff(np.log(steps)) == pytest.approx([5.0] * 3, abs=0.15)
    assert np.diff(np.log(errors)) / np.diff(np.log(tolerances)) == pytest.approx([1.0] * 3, abs=0.06)


def test_impacts_converge() -> None:
    """Sixty milliseconds of damped impacts (the force jumps at first touch): error in proportion to the tolerance."""
    machine = shipped_machine("slider-crank")
    settings = {"duration": 0.06, "sample_rate": 5000}
    exact, motion = run(machine, {"B": 2e-4}, rtol=1e-12, **settings)
    assert impacts(motion, "B") > 5
    errors = []
    for rtol in (1e-8, 1e-9, 1e-10, 1e-11):
        history, _ = run(machine, {"B": 2e-4}, rtol=rtol, **settings)
        errors.append(np.abs(history.velocity - exact.velocity).max())
    assert all(fine < 0.3 * coarse for coarse, fine in itertools.pairwise(errors))
    assert errors[-1] < 1e-6


def test_fixed_steps_converge_to_the_same_motion() -> None:
    """Forces of undamped impacts are continuous: Gill's steps come to the same result, second order or so."""
    machine = parse_machine(tree_of("slider-crank", damping=0.0, friction=0.0))
    settings = {"duration": 0.03, "sample_rate": 5000}
    exact, motion = run(machine, {"B": 2e-4}, rtol=1e-12, **settings)
    assert impacts(motion, "B") >= 3
    errors = []
    for step in (8e-6, 1e-6, 1.25e-7):
        history, _ = run(machine, {"B": 2e-4}, step=step, **settings)
        errors.append(np.abs(history.displacement - exact.displacement).max())
    assert errors[2] < 1e-10
    assert errors[2] < errors[0] / 64


#: Of the drive; the machine turns at 60 rad/s.
REVOLUTIONS = 10_000


def gaps(machine: Machine, motion: LinkMotion) -> Array:
    """(samples, 2): most that any joint lacks of its closure, m, and of its rate, m/s."""
    found = []
    for state in states(machine, motion):
        place, rate = [0.0], [0.0]
        for joint in machine.joints.values():
            i, j = (state.index(link) for link in joint.links)
            if isinstance(joint, SlidingJoint):
                slide = state.slide(joint)
                place.append(abs(float(slide.normal @ slide.gap)))
                rate.append(abs(slide.normal_rate))
            else:
                place += list(np.abs(state.point(i, joint.at) - state.point(j, joint.at)))
                rate += list(np.abs(state.velocity(i, joint.at) - state.velocity(j, joint.at)))
        found.append((max(place), max(rate)))
    return np.array(found)


@pytest.mark.parametrize(
    # Fixed steps restore the closures at every sample; with error control they are what its steps leave between two
    # corrections (64 steps), here at the loose end, 1e-6. Rates are up to 10 m/s.
    ("settings", "place", "rate"),
    [({"step": 2 * math.pi / 60 / 360}, 5e-13, 2e-8), ({"rtol": 1e-6}, 1e-9, 5e-8)],
    ids=["gill", "adaptive"],
)
@pytest.mark.parametrize("name", ["four-bar", "quick-return"])
def test_closures_do_not_drift(name: str, settings: dict[str, float], place: float, rate: float) -> None:
    """10 000 revolutions: gaps no larger at the end than at the start, and every revolution like the first."""
    tree = tree_of(name)
    tree["links"]["frame"] = {"fixed": True}
    tree |= {"supports": [], "sensors": []}
    tree["drive"]["speed"] = 60.0
    machine = parse_machine(tree)
    period = 2 * math.pi / 60
    history, motion = run(machine, {}, duration=REVOLUTIONS * period, sample_rate=7 / period, **settings)
    assert len(history.t) == REVOLUTIONS * 7 + 1
    chosen = LinkMotion(
        motion.links, *(part[::509] for part in (motion.displacement, motion.velocity, motion.acceleration)), {}
    )
    lack = gaps(machine, chosen)
    # An angle of 63 000 rad is itself rounded to 1e-11 of a radian, on links of 0.3 m.
    rounding = np.array([1, 60]) * 2.0**-52 * 2 * math.pi * REVOLUTIONS * 0.3
    assert lack[:, 0].max() < place + rounding[0]
    assert lack[:, 1].max() < rate
    third = len(lack) // 3
    assert (lack[-third:].max(axis=0) < 1.5 * lack[:third].max(axis=0) + rounding).all()
    # One prescribed freedom: after whole revolutions every link is where it was.
    assert np.abs(motion.displacement[-1] - motion.displacement[0])[:, :2].max() < 10 * place
