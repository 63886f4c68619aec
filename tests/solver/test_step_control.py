"""Rules of error-controlled steps: where contacts switch, and that few steps are tried in vain."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.integrators.control import after_switch, next_step, shorten, switch_part
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.simulation.simulate import simulate, simulate_batch

LAG = 2e-4
"""Damping over stiffness of the contact below, s."""


def contact(t: float) -> tuple[float, float, float]:
    """Switch function, penetration and its rate of a linear contact that began with 0.1 m/s, m and m/s."""
    decay, rate = 800.0, 5e3
    swing, lean = math.sin(rate * t), math.cos(rate * t)
    fading = 0.1 / rate * math.exp(-decay * t)
    p, r = fading * swing, fading * (rate * lean - decay * swing)
    return min(p, p + LAG * r), p, r


def test_a_damped_contact_is_left_where_its_force_ends() -> None:
    """Steps of two fifths of the contact: 0.3 % of a step off at most; along a straight line it would be 5 %."""
    left = brentq(lambda t: contact(t)[1] + LAG * contact(t)[2], 3e-4, 6e-4)
    step, off, straight = 2e-4, [], []
    for before in (0.1, 0.3, 0.5, 0.7, 0.9):
        (s0, p0, r0), (s1, p1, r1) = contact(left - before * step), contact(left + (1 - before) * step)
        off.append(abs(switch_part(True, s0, s1, p0, p1, r0, r1, step) - before))
        straight.append(abs(s0 / (s0 - s1) - before))
    assert max(off) < 0.004
    assert max(straight) > 0.04


def test_a_switch_is_located_on_the_cubic() -> None:
    """To 1e-9 of a step, wherever it lies: also where the first of Newton's steps would leave the step."""
    rng = np.random.default_rng(1)
    for _ in range(2000):
        p0, p1 = -rng.exponential(1e-6), rng.exponential(1e-6)
        r0, r1 = rng.normal(0, 1e-2, 2) * rng.choice([0.01, 1.0], 2)
        d0, d1 = 1e-4 * r0, 1e-4 * r1
        cubic = np.polynomial.Polynomial([p0, d0, 3 * (p1 - p0) - 2 * d0 - d1, 2 * (p0 - p1) + d0 + d1])
        part = switch_part(False, p0, p1, p0, p1, r0, r1, 1e-4)
        roots = cubic.roots()
        near = np.abs(roots - part).min()
        assert 0 < part <= 1
        assert near < 2e-9 or np.abs(cubic(part)) < 1e-12 * np.abs(cubic.coef).max()


def test_a_contact_that_came_apart_unnoticed_ends_at_once() -> None:
    assert switch_part(True, -1e-7, -1.2e-7, -7e-8, -9e-8, -1e-3, -1e-3, 1e-6) == 0.0
    assert switch_part(False, 1e-7, 1.2e-7, 1e-7, 1.2e-7, 1e-3, 1e-3, 1e-6) == 0.0


@pytest.mark.parametrize("part", [0.0, 0.3, 0.5, 0.9])
def test_a_shorter_step_is_shorter(part: float) -> None:
    """Whatever the speed: past the switch goes no further than half of what is left of the step."""
    for approach in (0.0, 1e-6, 1e-3, 1.0):
        shorter = shorten(1e-6, part, True, -1e-7, approach, 1e-8, 1e-14)
        assert 0 < shorter <= (0.5 + 0.5 * part) * 1e-6


def test_a_step_that_leaves_and_comes_in_anew_ends_outside() -> None:
    """A pin that crosses its clearance in one step: what its contact remembers must be forgotten on the way."""
    part = switch_part(False, -1e-6, 5e-6, 2e-6, 5e-6, -1.0, 1.0, 2e-4)
    assert 0 < part < 1
    d0, d1 = -2e-4, 2e-4
    a, b = 2 * 2e-6 - 2 * 5e-6 + d0 + d1, -3 * 2e-6 + 3 * 5e-6 - 2 * d0 - d1
    assert 2e-6 + part * (d0 + part * (b + part * a)) < 0
    # Pressed in again without leaving: the switch itself.
    assert switch_part(False, -1e-6, 1e-6, 2e-6, 3e-6, -1e-3, 1e-2, 1e-6) == 0.5


def trials(c: float, p0: float, speed: float, lag: float, step: float, precision: float) -> int:
    """Steps tried until a pin that flies freely out of one side of its socket is found outside, or at the other side.

    Exact: the pin is at x, moves with `speed` towards the other side, and penetrates by abs(x) - c.
    """
    place, count = c + p0, 0
    while True:
        count += 1
        end = place - speed * step
        p1, r1 = abs(end) - c, speed * math.copysign(1, -end)
        s0, s1 = min(p0, p0 - lag * speed), min(p1, p1 + lag * r1)
        part = switch_part(False, s0, s1, p0, p1, -speed, r1, step)
        if part > 1:
            return count
        step = shorten(step, part, False, s1, r1, precision, 1e-14)
        if step == 0:
            return count


@pytest.mark.parametrize(
    ("c", "p0", "speed", "lag", "step"),
    [(1e-6, 1.386e-5, 3.37, 6.6e-3, 1.8e-5), (3e-6, 3e-6, 3.0, 3e-4, 1e-5), (1e-7, 3e-6, 3.0, 3e-5, 1e-5)],
)
def test_a_small_clearance_crossed_at_speed_is_found(
    c: float, p0: float, speed: float, lag: float, step: float
) -> None:
    """3, 3 and 5 trials, measured; thousands where the straight line alone shortened the step."""
    assert trials(c, p0, speed, lag, step, 1e-8) <= 8


def test_a_contact_that_was_left_within_a_step_is_noticed() -> None:
    """Pushing at both ends, on one side and then on the other, 1.7 um of clearance in between."""
    part = switch_part(True, 7.6e-5, 2.8e-6, 7.6e-5, 2.8e-6, -0.285, 0.262, 3e-4)
    assert 0 < part < 1
    # Pressed in again without having left.
    assert switch_part(True, 7.6e-5, 7e-5, 7.6e-5, 7e-5, -0.285, 0.262, 3e-4) == 2.0


def test_hysteresis_lets_go_where_its_factor_is_spent() -> None:
    """p (1 + a p') with a constant deceleration: the first shortened step is 2 um/s2 near. Cubic and lag are exact."""
    a, p0, r0, bend = 0.5556, 4.768e-4, -1.721, -1155.4
    end = (-1 / a - r0) / bend
    step = 1.05 * end
    p1, r1 = p0 + r0 * step + bend * step**2 / 2, r0 + bend * step
    s0, s1 = p0 * (1 + a * r0), p1 * (1 + a * r1)
    assert s0 > 0 > s1
    assert switch_part(True, s0, s1, p0, p1, r0, r1, step) == pytest.approx(end / step, rel=1e-6)


def test_a_contact_begins_with_the_step_that_the_last_one_ended_with() -> None:
    flight, contact_step = 1e-3, 1e-4
    kept, longest = after_switch(contact_step, 2e-5, math.inf, flight, False)
    assert (kept, longest) == (contact_step, flight)
    kept, longest = after_switch(flight, 3e-4, kept, flight, True)
    assert next_step(3e-4, flight, 4.0, flight, longest, 0.0, 1.0) == contact_step
    # A release that nothing shortened leaves its own step, not none.
    assert after_switch(0.0, 2e-5, math.inf, flight, False)[0] == 2e-5


def test_few_steps_are_tried_in_vain() -> None:
    """New fits in all five joints: contacts that switch together, at creeping speeds.

    Measured: at most 1.2 trials a step. Where contacts switched one at a time, 4 of the 16 took more than 1.5, one
    more than 5.
    """
    machine = shipped_machine("quick-return")
    draws = np.random.default_rng(7)
    fits = np.exp(draws.uniform(math.log(3e-6), math.log(20e-6), size=(16, 5)))
    cases = [Case(Fault(dict(zip("ACEFO", row.tolist(), strict=True)))) for row in fits]
    settings = Settings(sample_rate=1e4, duration=0.5, accuracy="draft", motion=False)
    for case, run in zip(cases, simulate_batch(machine, cases, settings), strict=True):
        assert run.status is Status.OK
        limited = Settings(
            sample_rate=1e4, duration=0.5, accuracy="draft", motion=False, most_trials=round(1.3 * 0.5 / run.step)
        )
        assert simulate_batch(machine, [case], limited)[0].status is Status.OK


def test_too_many_trials_stall() -> None:
    """From rest into flights and impacts, 12 ms: what is simulated until then is kept."""
    limited = Settings(sample_rate=1e4, duration=0.012, most_trials=20)
    run = simulate(shipped_machine("slider-crank"), Case(Fault({"A": 1e-4})), limited)
    assert run.status is Status.STEP_TOO_SMALL
    assert 0 < len(run.t) < 121
    assert "too many were needed" in run.message
