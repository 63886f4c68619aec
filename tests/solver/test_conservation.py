"""What a free machine keeps: energy without losses, momentum always, and the parabola of a thrown body."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate

Array = np.ndarray


def free_slider_crank(**contact: float) -> Machine:
    """Nothing drives or holds it, no gravity; the crank stands at one radian and turns at 20 rad/s."""
    tree: dict[str, Any] = shipped_machine("slider-crank").model_dump(mode="json", exclude_none=True)
    x, y = 0.05 * math.cos(1.0), 0.05 * math.sin(1.0)
    end = x + math.sqrt(0.15**2 - y**2)
    tree["joints"]["A"]["at"] = [x, 0.05 + y]
    tree["joints"]["B"]["at"] = tree["joints"]["G1"]["at"] = [end, 0.05]
    for joint in "OAB":
        tree["joints"][joint]["contact"].update(contact)
    del tree["drive"], tree["supports"]
    return parse_machine({**tree, "gravity": 0, "initial": {"velocities": {"crank": {"omega": 20}}}})


def kept(machine: Machine, history: History) -> tuple[Array, Array, Array]:
    """Kinetic energy (n,), momentum (n, 2) and angular momentum (n,) about the origin."""
    motion = history.links
    assert motion is not None
    links = [machine.links[name] for name in motion.links]
    mass = np.array([link.mass for link in links], dtype=float)
    inertia = np.array([link.inertia for link in links], dtype=float)
    place = motion.displacement[..., :2] + np.array([link.cg for link in links])
    speed, omega = motion.velocity[..., :2], motion.velocity[..., 2]
    energy = (mass * (speed**2).sum(axis=2) + inertia * omega**2).sum(axis=1) / 2
    turning = place[..., 0] * speed[..., 1] - place[..., 1] * speed[..., 0]
    return energy, (mass[:, None] * speed).sum(axis=1), (mass * turning + inertia * omega).sum(axis=1)


def test_energy_is_kept_without_losses() -> None:
    """Without damping and friction impacts only borrow energy: after 0.3 s with dozens of them it is all there."""
    machine = free_slider_crank(damping=0.0, friction=0.0)
    case = Case(Fault({"A": 2e-4}))
    history = simulate(machine, case, Settings(duration=0.3, accuracy="reference", links=True))
    energy = kept(machine, history)[0]
    assert history.status is Status.OK
    # While the surfaces touch, some is in their elasticity; none may come from nowhere.
    assert energy.max() < energy[0] * (1 + 1e-6)
    assert np.median(energy[-200:]) == pytest.approx(energy[0], rel=1e-3)


def test_losses_only_lose() -> None:
    machine = free_slider_crank(damping=300.0, friction=0.1)
    case = Case(Fault({"A": 2e-4, "B": 1e-4}))
    energy = kept(machine, simulate(machine, case, Settings(duration=0.3, links=True)))[0]
    assert energy.max() < energy[0] * (1 + 1e-5)
    assert energy[-1] < 0.999 * energy[0]


def test_momentum_is_kept_through_impacts_and_friction() -> None:
    """Action and reaction meet at one contact point, so friction with a pin radius makes no angular momentum."""
    machine = free_slider_crank(friction=0.3)
    case = Case(Fault({"A": 2e-4, "B": 1e-4}))
    _, momentum, turning = kept(machine, simulate(machine, case, Settings(duration=0.3, links=True)))
    assert np.abs(momentum - momentum[0]).max() < 1e-9
    assert turning == pytest.approx(turning[0], rel=1e-9)


def test_a_thrown_body() -> None:
    """One free link, no joint: the parabola, and a constant rotation."""
    machine = parse_machine({
        "name": "stone", "links": {"stone": {"mass": 2, "inertia": 0.1, "cg": [0, 0]}},
        "initial": {"velocities": {"stone": {"velocity": [1, 2], "omega": 3}}},
    })  # fmt: skip
    history = simulate(machine, Case(), Settings(duration=0.3, sample_rate=1000))
    t = history.t
    exact = np.column_stack([t, 2 * t - 9.81 * t**2 / 2, 3 * t])
    assert history.displacement == pytest.approx(exact, abs=1e-12)
