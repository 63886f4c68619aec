"""Work and precision: the recommended setting keeps what it promises, chaos is told from order."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, load_machine
from jointplay.solver.simulation import workbench
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.simulation.tradeoff import TradeOff, measure
from jointplay.solver.simulation.workbench import TradeOffPoint
from jointplay.solver.spectra.harmonics import harmonic_error

DATA = Path(__file__).parents[1] / "data" / "reference"
FAULT = Fault({"B": 2e-4})
P1 = Case(FAULT)
#: Without friction and with a tenth of the damping the impacts never settle.
P1X = Case(FAULT, {"contact.friction": 0.0, "contact.damping": 30.0})
RUNGS = [*(Settings(rtol=rtol) for rtol in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)), Settings(method="gill")]


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine(DATA / "p1.yaml")


def measured(machine: Machine, case: Case, **options: Any) -> TradeOff:
    found = measure(machine, case, **options)
    assert isinstance(found, TradeOff)
    return found


@pytest.fixture(scope="module")
def periodic(machine: Machine) -> TradeOff:
    return measured(machine, P1, rungs=RUNGS)


@pytest.fixture(scope="module")
def chaotic(machine: Machine) -> TradeOff:
    return measured(machine, P1X, rungs=[Settings(rtol=1e-6), Settings(rtol=1e-8)])


def test_a_perturbation_of_p1_dies_out(periodic: TradeOff) -> None:
    assert not periodic.chaotic
    assert periodic.motion == "y"
    assert periodic.compared == 200
    assert periodic.growth < 1e-2  # measured 2.4e-5
    assert periodic.difference_db < 1e-6  # measured 1.3e-9
    assert periodic.reference_error_db < 1e-5  # measured 5e-7


@pytest.mark.parametrize(("lost", "tried"), [(math.inf, 4), (0.0, 1)])
def test_references_that_stall_are_given_up(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, lost: float, tried: int
) -> None:
    monkeypatch.setattr(workbench, "_PATIENCE", 0)
    monkeypatch.setattr(workbench, "_LEAST_PATIENCE", 1000)  # of some 1e5 that these runs take
    monkeypatch.setattr(workbench, "_NO_REFERENCE", lost)
    told: list[tuple[int, int]] = []
    found = measure(machine, P1, lambda done, total: told.append((done, total)), rungs=RUNGS)
    assert isinstance(found, History)
    assert found.status is Status.STEP_TOO_SMALL
    assert told == [(done, len(RUNGS) + 4) for done in range(tried + 1)]


def test_errors_fall_with_the_tolerance(periodic: TradeOff) -> None:
    adaptive = [point for point in periodic.points if point.settings.integrator == "adaptive"]
    errors = [point.error_db for point in adaptive]
    assert all(fine < coarse / 3 for coarse, fine in itertools.pairwise(errors))  # measured 7 to 23
    assert all(fine.step < coarse.step for coarse, fine in itertools.pairwise(adaptive))
    assert all(point.worst_db >= point.error_db and point.seconds > 0 for point in periodic.points)
    assert [point.accuracy for point in periodic.points] == ["", "draft", "standard", "", "", "standard"]


@pytest.mark.parametrize("wanted", [0.5, 0.05, 0.01])
def test_the_recommended_setting_meets_what_was_asked(machine: Machine, periodic: TradeOff, wanted: float) -> None:
    """Against results of an independent code, from which our tightest tolerance is 0.004 dB away."""
    best = periodic.recommend(wanted).point
    assert best is not None
    history = simulate(machine, P1, dataclasses.replace(best.settings, duration=2.0))
    steady = history.t >= 0.5
    reference = np.load(DATA / "p1.npz")["acc_y"][steady]
    assert harmonic_error(history.acceleration[steady, 1], reference, history.sample_rate, 10.0) < wanted + 0.004


def test_nothing_is_claimed_below_the_reference(periodic: TradeOff) -> None:
    advice = periodic.recommend(periodic.reference_error_db / 2)
    assert advice.point is None
    assert "reference" in advice.reason
    advice = periodic.recommend(2 * periodic.reference_error_db)
    assert advice.point is None
    assert "none of the settings" in advice.reason


def point(settings: Settings, seconds: float, error: float, status: Status = Status.OK) -> TradeOffPoint:
    return TradeOffPoint(settings, 1e-5, status, seconds, error, error, 0.0)


def test_luck_is_not_recommended_and_equal_cost_goes_to_the_better(periodic: TradeOff) -> None:
    rungs = [Settings(rtol=10.0**-k) for k in range(3, 8)]
    errors = [0.05, 0.3, 0.08, 0.04, 0.001]
    costs = [1.0, 2.0, 3.0, 3.1, 4.0]
    lucky = dataclasses.replace(
        periodic, points=tuple(point(*values) for values in zip(rungs, costs, errors, strict=True))
    )
    best = lucky.recommend(0.1).point
    assert best is not None
    assert best.settings.rtol == 1e-6
    broken = (*lucky.points, point(Settings(rtol=1e-8), 5.0, math.nan, Status.STEP_TOO_SMALL))
    assert dataclasses.replace(periodic, points=broken).recommend(0.1).point is None


def test_chaos_is_recognised_and_its_spread_bounds_what_pays(chaotic: TradeOff) -> None:
    assert chaotic.chaotic
    assert chaotic.growth > 1e3  # measured 3e4: from 1e-11 m to the size of the motion
    assert chaotic.difference_db > 2.0  # measured 6 dB a harmonic
    assert 0.5 < chaotic.spread_db < 3.0  # measured 1.4 dB a one-order band
    for found in chaotic.points:
        assert found.error_db < chaotic.spread_db
        assert not chaotic.pays(found)
    advice = chaotic.recommend(0.1)
    assert advice.point is not None
    assert "scatter" in advice.reason


def test_without_y_another_motion_is_compared(machine: Machine) -> None:
    frame = machine.links["frame"].model_copy(update={"locked": ("y",)})
    locked = machine.model_copy(update={"links": {**machine.links, "frame": frame}})
    assert measured(locked, P1, rungs=[]).motion == "x"


@pytest.mark.parametrize(
    ("change", "case", "text"),
    [
        ({"speed": ((0.0, 10.0), (1.0, 60.0))}, Case(), "turn at a constant speed"),
        ({}, Case(parameters={"drive.speed": 0.0}), "turn at a constant speed"),
        (None, Case(), "turn at a constant speed"),
    ],
)
def test_no_constant_speed_no_harmonics(
    machine: Machine, change: dict[str, object] | None, case: Case, text: str
) -> None:
    assert machine.drive is not None
    drive = None if change is None else machine.drive.model_copy(update=change)
    with pytest.raises(SettingsError, match=text):
        measure(machine.model_copy(update={"drive": drive}), case)


def test_a_fixed_frame_does_not_vibrate(machine: Machine) -> None:
    frame = machine.links["frame"].model_copy(update={"fixed": True})
    fixed = machine.model_copy(update={"links": {**machine.links, "frame": frame}, "supports": ()})
    with pytest.raises(SettingsError, match="frame is fixed"):
        measure(fixed)
