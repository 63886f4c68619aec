"""Every joint by itself, from hypotheses: mixtures that can be written down."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from jointplay.catalogue.diagnosing.joint_states import joint_posteriors
from jointplay.catalogue.matching.matcher import NORMAL_90, ClearanceEstimate, HypothesisMatch, MatchResult

NOTHING = np.zeros(1)
UM = 1e-6
GRID = 0.02  # of ln(clearance), in what these posteriors are kept


def even(joint: str, low: float, high: float) -> ClearanceEstimate:
    """Log-uniform between two clearances."""
    ends = np.log([low, high])
    inside = np.exp(ends[0] + np.array([0.5, 0.05, 0.95]) * (ends[1] - ends[0]))
    return ClearanceEstimate(joint, *inside.tolist(), course=(ends, np.array([0.0, 1.0])))


def match(label: str, probability: float, *clearances: ClearanceEstimate) -> HypothesisMatch:
    joints = () if label == "healthy" else tuple(label.split("+"))
    return HypothesisMatch(label, joints, probability, clearances, 1.0, 0.5, NOTHING, NOTHING)


def part(clearance: float, low: float, high: float) -> float:
    """Probability below a clearance, log-uniform."""
    return float(np.clip(np.log(clearance / low) / np.log(high / low), 0.0, 1.0))


FITS = {"A": UM * np.geomspace(4.0, 16.0, 401), "B": UM * np.geomspace(3.0, 20.0, 401), "C": np.array([5 * UM])}


@pytest.fixture
def mixed() -> MatchResult:
    """A worn in two hypotheses, of 50 to 200 um and of 100 to 400 um."""
    return MatchResult(
        (
            match("A", 0.5, even("A", 50 * UM, 200 * UM)),
            match("healthy", 0.3),
            match("A+B", 0.2, even("A", 100 * UM, 400 * UM), even("B", 60 * UM, 600 * UM)),
        )
    )


def test_a_joint_is_a_mixture_of_its_fit_and_its_wear(mixed: MatchResult) -> None:
    found = joint_posteriors(mixed, FITS)
    a, b = found["A"], found["B"]
    assert (a.p_worn, b.p_worn) == pytest.approx((0.7, 0.2))
    for clearance in (UM * np.array([8.0, 30.0, 70.0, 150.0, 300.0, 900.0])).tolist():
        below = (
            0.3 * part(clearance, 4 * UM, 16 * UM)
            + 0.5 * part(clearance, 50 * UM, 200 * UM)
            + 0.2 * part(clearance, 100 * UM, 400 * UM)
        )
        assert a.above(clearance) == pytest.approx(1.0 - below, abs=0.01)
        below = 0.8 * part(clearance, 3 * UM, 20 * UM) + 0.2 * part(clearance, 60 * UM, 600 * UM)
        assert b.above(clearance) == pytest.approx(1.0 - below, abs=0.01)


def test_quantiles_by_hand(mixed: MatchResult) -> None:
    a = joint_posteriors(mixed, FITS)["A"]
    # 0.15 is the middle of the fit's 0.3; 0.4 is a fifth of the way through the 0.5 of 50 to 200 um, below 100 um.
    assert a.quantile(0.15) == pytest.approx(8 * UM, rel=GRID)
    assert a.quantile(0.4) == pytest.approx(50 * UM * 4**0.2, rel=GRID)
    # Above 200 um there is half of the 0.2 left: 0.95 is a quarter of the way down from 400 um.
    assert a.quantile(0.95) == pytest.approx(400 * UM / 4**0.25, rel=GRID)
    for share in (0.05, 0.2, 0.5, 0.9):
        assert a.above(a.quantile(share)) == pytest.approx(1.0 - share, abs=1e-9)


def test_a_joint_that_is_never_worn_has_the_play_of_its_fit(mixed: MatchResult) -> None:
    found = joint_posteriors(mixed, {"D": FITS["B"]})["D"]
    assert found.p_worn == 0.0
    for share in (0.05, 0.5, 0.95):
        assert found.quantile(share) == pytest.approx(np.quantile(FITS["B"], share), rel=GRID)
    assert found.above(25 * UM) == 0.0
    assert found.above(2 * UM) == 1.0
    # One known play is a point.
    single = joint_posteriors(mixed, {"C": FITS["C"]})["C"]
    assert [single.quantile(share) for share in (0.05, 0.5, 0.95)] == pytest.approx([5 * UM] * 3, rel=1e-4)


def test_a_joint_that_is_surely_worn_has_nothing_of_its_fit() -> None:
    result = MatchResult((match("A", 1.0, even("A", 50 * UM, 200 * UM)), match("healthy", 0.0)))
    found = joint_posteriors(result, FITS)["A"]
    assert found.p_worn == 1.0
    assert found.above(49 * UM) == pytest.approx(1.0, abs=1e-9)
    assert found.quantile(0.5) == pytest.approx(100 * UM, rel=GRID)


def test_intervals_without_a_course_are_log_normal_halves() -> None:
    estimate = ClearanceEstimate("A", 100 * UM, 50 * UM, 300 * UM)
    result = MatchResult((match("A", 1.0, estimate),))
    found = joint_posteriors(result, FITS)["A"]
    assert found.quantile(0.05) == pytest.approx(50 * UM, rel=GRID)
    assert found.quantile(0.5) == pytest.approx(100 * UM, rel=GRID)
    assert found.quantile(0.95) == pytest.approx(300 * UM, rel=GRID)
    upper = norm.cdf(NORMAL_90 * np.log(2.0) / np.log(3.0))
    assert found.above(200 * UM) == pytest.approx(1.0 - upper, abs=0.005)


def test_hypotheses_without_clearances_take_those_of_the_others() -> None:
    estimate = even("A", 50 * UM, 200 * UM)
    known = joint_posteriors(MatchResult((match("A", 0.8, estimate), match("healthy", 0.2))), FITS)["A"]
    shared = joint_posteriors(MatchResult((match("A", 0.5, estimate), match("A+B", 0.3), match("healthy", 0.2))), FITS)[
        "A"
    ]
    assert shared.p_worn == pytest.approx(0.8)
    assert np.allclose(shared.below, known.below)
    # Where none has any, nothing but the fit is known of how large they are.
    none = joint_posteriors(MatchResult((match("A", 0.8), match("healthy", 0.2))), FITS)["A"]
    assert none.p_worn == pytest.approx(0.8)
    assert none.quantile(0.5) == pytest.approx(8 * UM, rel=GRID)


def test_probabilities_rise_from_nothing_to_all(mixed: MatchResult) -> None:
    for found in joint_posteriors(mixed, FITS).values():
        assert (np.diff(found.log_clearance) > 0.0).all()
        assert (np.diff(found.below) >= 0.0).all()
        assert found.below[0] == 0.0
        assert found.below[-1] == pytest.approx(1.0)
