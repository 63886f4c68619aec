"""The play of joints over time: how beliefs of it move, and when it reaches a limit."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from lives import BOUNDS

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.following import play
from jointplay.catalogue.following.play import (
    AXIS,
    LIKELY_RATES,
    RATES,
    STEP,
    YEAR,
    bounds_of,
    let_pass,
    quantiles,
    reach,
)
from jointplay.solver.machines.machine import parse_machine, shipped_machine


def test_fits_beyond_what_is_followed_are_refused() -> None:
    machine = shipped_machine("slider-crank")
    assert bounds_of(machine, ["B"])["B"].fit == (3e-6, 20e-6)
    with pytest.raises(DiagnosisError, match="joint Q: must be one of those of the machine, O, A, B"):
        bounds_of(machine, ["Q"])
    wide = parse_machine({**json.loads(machine.canonical_json()), "joints": {
        name: {**joint, "fit": ["8 mm", "9 mm"], "limit": "50 mm"} if name == "B" else joint
        for name, joint in json.loads(machine.canonical_json())["joints"].items()}})  # fmt: skip
    with pytest.raises(DiagnosisError, match=r"joint B: fit 8000 to 9000 um: must be from 1 um to 2\.4 mm"):
        bounds_of(wide, ["B"])


def test_time_moves_a_clearance_by_its_rate_and_never_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(play, "JUMPS", 0.0)
    belief = np.zeros((1, len(RATES), len(AXIS)))
    start, rate = np.searchsorted(AXIS, math.log(50e-6)), 12
    belief[0, rate, start] = 1.0
    seconds = 40e-6 / RATES[rate]
    later = let_pass(belief, seconds)
    stayed = later[0, rate] / later[0, rate].sum()
    # The mean between two points of the grid, in ln: off by less than the square of a step.
    expected = math.exp(AXIS[start]) + 40e-6
    assert float(stayed @ np.exp(AXIS)) == pytest.approx(expected, rel=STEP**2)
    assert later.sum() == pytest.approx(1.0)
    assert later[0, :, :start].sum() == 0.0
    assert np.array_equal(let_pass(belief, 0.0), belief)


@pytest.mark.parametrize("years", [0.3, 1.0, 3.0])
def test_time_adds_up(years: float) -> None:
    """What is believed after some time hardly depends on how often somebody looked.

    Steps of a month, or of what is left of one, differ by 0.003 at the most, those of a day to nine by 0.012.
    """
    bounds = BOUNDS["B"]
    belief = np.where(bounds.worn & (AXIS < math.log(100e-6)), LIKELY_RATES[:, None], 0.0)
    belief, mended = belief / belief.sum(), bounds.as_new()
    whole = let_pass(belief, years * YEAR, mended)
    apart = let_pass(let_pass(belief, 0.37 * years * YEAR, mended), 0.63 * years * YEAR, mended)
    often = belief
    for _ in range(120):
        often = let_pass(often, years * YEAR / 120, mended)
    for other, error in ((apart, 0.004), (often, 0.015)):
        np.testing.assert_allclose(other.sum(axis=0).cumsum(), whole.sum(axis=0).cumsum(), atol=error)


def test_joints_jump_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    """By half of ln(clearance) in the mean; nothing leaves the grid."""
    monkeypatch.setattr(play, "LIKELY_RATES", np.eye(len(RATES))[0])  # at rest, before and after
    belief = np.zeros((2, len(RATES), len(AXIS)))
    places = np.searchsorted(AXIS, np.log([50e-6, 5e-3]))
    belief[range(2), 0, places] = 1.0
    later = let_pass(belief, 0.5 / play.JUMPS)
    assert later.sum(axis=(1, 2)) == pytest.approx([1.0, 1.0])
    jumped = 1.0 - math.exp(-0.5)
    assert later[0, 0] @ (AXIS - AXIS[places[0]]) == pytest.approx(0.5 * play.JUMP, rel=0.1)
    assert later[0, 0, places[0]] == pytest.approx(1.0 - jumped, abs=0.05)
    assert later[0, 0, : places[0]].sum() == 0.0
    assert later[1, 0, -1] > 0.25
    long = let_pass(belief, 8.0 / play.JUMPS)
    for _ in range(15):
        later = let_pass(later, 0.5 / play.JUMPS)
    np.testing.assert_allclose(long.cumsum(axis=-1), later.cumsum(axis=-1), atol=0.02)


def test_when_a_limit_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the joint's rate, as far as it keeps that, and beside what all recordings have wrong alike."""
    belief = np.zeros((2, len(RATES), len(AXIS)))
    place = np.searchsorted(AXIS, math.log(50e-6))
    belief[:, 10, place], belief[:, 0, place] = 0.6, 0.4
    limits = np.array([200e-6, 40e-6])
    shares = np.array([0.05, 0.5, 0.95])
    seconds = (200e-6 - math.exp(AXIS[place])) / RATES[10]
    over, changing = reach(belief, limits, 1e-3, shares)
    assert over.tolist() == pytest.approx([0.0, 1.0], abs=1e-9)
    assert changing[1].tolist() == [0.0, 0.0, 0.0]
    assert changing[0, 0] < changing[0, 1] < changing[0, 2] < math.inf
    monkeypatch.setattr(play, "CHANGES", 0.0)
    monkeypatch.setattr(play, "JUMPS", 0.0)
    _, steady = reach(belief, limits, 1e-3, shares)
    assert steady[0, :2].tolist() == pytest.approx([seconds, seconds], rel=0.25)  # as far as moments are apart
    assert math.isinf(steady[0, 2])
    nearly, doubted = reach(belief, limits, 0.5, shares)
    assert nearly[0] == pytest.approx(0.5 * math.erfc(math.log(200e-6 / math.exp(AXIS[place])) / 0.5 / math.sqrt(2.0)))
    assert doubted[0, 0] < 0.7 * steady[0, 0]


def test_quantiles_are_blurred_by_what_all_recordings_have_wrong() -> None:
    marginal = np.zeros(len(AXIS))
    marginal[120] = 1.0
    low, middle, high = quantiles(marginal, np.array([0.05, 0.5, 0.95]), 0.2)
    assert middle == pytest.approx(math.exp(AXIS[120]), rel=1e-9)
    assert math.log(high / low) == pytest.approx(2 * 1.645 * 0.2, abs=2 * STEP**2 / 0.2)
