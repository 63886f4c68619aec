"""How prescribed drives move at the points of their tables; which drives come round, and how often."""

from __future__ import annotations

import json
import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
from laws import run
from test_simulate import crank_at

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.equations.drive import prescribed_motion, repeating_frequency
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.ensemble import Ensemble, simulate_ensemble
from jointplay.solver.simulation.tradeoff import measure


def slide(*frequencies: float, **more: Any) -> Machine:
    listed = [{"frequency": frequency, "amplitude": -0.005, "phase": 0} for frequency in frequencies]
    return parse_machine(crank_at(1.0, drive={"kind": "translation", "joint": "G", "harmonics": listed, **more}))


def test_a_rotation_comes_round_with_its_speed() -> None:
    assert repeating_frequency(shipped_machine("slider-crank"), -4 * math.pi) == pytest.approx(2.0)


def test_a_slide_comes_round_with_its_lowest_frequency() -> None:
    assert repeating_frequency(slide(4.0, 12.0), 8 * math.pi) == pytest.approx(4.0)
    for machine in (slide(4.0, 5.0), slide(4.0, speed=0.01)):
        with pytest.raises(SettingsError, match="must repeat with the lowest of its frequencies"):
            repeating_frequency(machine, 8 * math.pi)


def rippled(order: float) -> Machine:
    tree = json.loads(shipped_machine("slider-crank").canonical_json())
    tree["drive"]["ripple"] = [
        {"order": 2, "amplitude": 0.01, "phase": 0},
        {"order": order, "amplitude": 0.2, "phase": 0},
    ]
    return parse_machine(tree)


def test_a_rippled_rotation_comes_round_if_its_orders_are_whole() -> None:
    assert repeating_frequency(rippled(3.0), 4 * math.pi) == pytest.approx(2.0)
    refusal = r"drive\.ripple\.1\.order: 0\.37: must be a whole number"
    with pytest.raises(SettingsError, match=refusal):
        repeating_frequency(rippled(0.37), 4 * math.pi)
    with pytest.raises(SettingsError, match=refusal):
        simulate_ensemble(rippled(0.37))
    with pytest.raises(SettingsError, match=refusal):
        measure(rippled(0.37))


def test_what_changes_in_time_does_not_come_round() -> None:
    machine = shipped_machine("slider-crank")
    tree = json.loads(machine.canonical_json())
    tree["loads"] = [{"link": "slider", "at": [0.2, 0.05], "over_time": [[0, 0, 0, 0], [1, -5, 0, 0]]}]
    with pytest.raises(SettingsError, match=r"loads\.0\.over_time: must not change in time"):
        repeating_frequency(parse_machine(tree), 1.0)
    with pytest.raises(SettingsError, match="drive: none: must turn at a constant speed"):
        repeating_frequency(machine.model_copy(update={"drive": None}), 0.0)


@pytest.mark.parametrize("kind", ["perturbation", "phase"])
def test_an_ensemble_of_a_driven_slide(kind: Any) -> None:
    found = simulate_ensemble(
        slide(4.0), Case(Fault({"B": 1e-4})), Ensemble(2, kind, 1.0), Settings(sample_rate=5000.0)
    )  # fmt: skip
    assert found.status is Status.OK
    assert found.converged and found.from_healthy
    assert found.drive_speed == pytest.approx(8 * math.pi)


#: Speed over time, and the slope that follows each of its points.
RAMPS, SLOPES = [[0.0, 1.0], [0.02, 3.0], [0.05, -3.0], [0.08, 0.0]], [100.0, -200.0, 100.0, 0.0]


@pytest.mark.parametrize("kind", ["rotation", "translation"])
def test_acceleration_at_a_point_of_a_table_is_what_follows(kind: str) -> None:
    """Exactly there, and with any number of points before: steps begin at the first, and samples lie on all."""
    joint = "O" if kind == "rotation" else "G"
    machine = parse_machine(crank_at(1.0, drive={"kind": kind, "joint": joint, "speed": RAMPS}))
    t = ca.SX.sym("t")
    motion = prescribed_motion(machine, lambda path, value: value, t)
    assert motion is not None
    at = np.array([time for time, _ in RAMPS])[None, :]
    rate, acceleration = (part.full()[0] for part in ca.Function("motion", [t], [motion.rate, motion.acceleration])(at))
    assert rate == pytest.approx([speed for _, speed in RAMPS], abs=1e-13)
    assert acceleration == pytest.approx(SLOPES, abs=1e-13)


def test_effort_of_a_run_up_from_its_first_sample() -> None:
    """Inertia times the slope, which begins at once; halfway along too."""
    tree = {
        "name": "m", "gravity": 0.0,
        "links": {"wall": {"fixed": True}, "body": {"mass": 2.0, "inertia": 0.3, "cg": [0, 0]}},
        "joints": {"O": {"kind": "turning", "links": ["body", "wall"], "at": [0, 0]}},
        "drive": {"kind": "rotation", "joint": "O", "speed": RAMPS},
    }  # fmt: skip
    _, motion = run(parse_machine(tree), {}, duration=0.08, sample_rate=100.0)
    assert motion.acceleration[[0, 1], 1, 2] == pytest.approx([100.0, 100.0])
    assert motion.reactions["drive_effort"][[0, 1, 3]] == pytest.approx([30.0, 30.0, -60.0])
