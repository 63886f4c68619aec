"""Which drives come round, and how often."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from test_simulate import crank_at

from solver.drive import repeating_frequency
from solver.ensemble import Ensemble, simulate_ensemble
from solver.errors import SettingsError
from solver.fault import FaultState
from solver.history import Case, Settings, Status
from solver.machine import Machine, parse_machine, shipped_machine
from solver.tradeoff import measure


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
        slide(4.0), Case(FaultState({"B": 1e-4})), Ensemble(2, kind, 1.0), Settings(sample_rate=5000.0)
    )  # fmt: skip
    assert found.status is Status.OK
    assert found.converged and found.from_healthy
    assert found.drive_speed == pytest.approx(8 * math.pi)
