"""Both modes heard together, with weights worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointplay.catalogue.matching.matcher import ClearanceEstimate, HypothesisMatch, MatchResult, rank
from jointplay.catalogue.matching.refit import AS_FILED_BEFORE, blend, weight_as_filed

NOTHING = np.zeros(1)


def result(p_value: float, mode: str, **hypotheses: float) -> MatchResult:
    """An answer whose hypotheses all fit alike; clearances say which mode they are of."""
    size = 100e-6 if mode == "trusted" else 200e-6
    matches = []
    for name, probability in hypotheses.items():
        label = name.replace("_", "+")
        joints = () if label == "healthy" else tuple(label.split("+"))
        clearances = tuple(ClearanceEstimate(joint, size, size / 2, size * 2) for joint in joints)
        matches.append(HypothesisMatch(label, joints, probability, clearances, 1.0, p_value, NOTHING, NOTHING))
    found = replace(rank(matches), mode=mode, notes=("of both", f"of the {mode} mode"))
    return replace(found, network=f"network of {mode}")


@pytest.mark.parametrize(
    ("p_value", "weight"),
    [
        # Odds of nine to one beforehand, times -e p ln p: 0.407162, 0.0187773 and 3.75544e-5.
        (1.0, 0.9),
        (0.5, 0.9),
        (0.05, 3.664458 / 4.664458),
        (1e-3, 0.1689957 / 1.1689957),
        (1e-6, 3.379895e-4 / 1.0003379895),
    ],
)
def test_weights_by_hand(p_value: float, weight: float) -> None:
    assert weight_as_filed(p_value) == pytest.approx(weight, rel=1e-5)


def test_the_weight_falls_with_the_p_value_and_has_no_step() -> None:
    p_values = np.geomspace(1e-12, 1.0, 2000)
    weights = np.array([weight_as_filed(float(each)) for each in p_values])
    assert (np.diff(weights) >= 0.0).all()
    assert np.diff(weights).max() < 0.01
    assert weights[0] < 1e-9
    assert weights[-1] == pytest.approx(AS_FILED_BEFORE)


@pytest.mark.parametrize("p_value", [0.5, 0.05, 1e-3, 1e-6])
def test_probabilities_are_weighed_and_add_to_1(p_value: float) -> None:
    trusted = result(p_value, "trusted", healthy=0.1, A=0.7, B=0.15, A_B=0.05)
    robust = result(0.6, "robust", B=0.5, healthy=0.3, A=0.15, A_B=0.05)
    found = blend(trusted, robust)
    weight = weight_as_filed(p_value)
    assert sum(match.probability for match in found.hypotheses) == pytest.approx(1.0)
    for label in ("healthy", "A", "B", "A+B"):
        own = weight * trusted.probability(label) + (1.0 - weight) * robust.probability(label)
        assert found.probability(label) == pytest.approx(own)
    falling = [match.probability for match in found.hypotheses]
    assert falling == sorted(falling, reverse=True)


@pytest.mark.parametrize(("p_value", "mode"), [(0.5, "trusted"), (0.05, "trusted"), (1e-3, "robust"), (1e-6, "robust")])
def test_the_likelier_mode_leads(p_value: float, mode: str) -> None:
    found = blend(result(p_value, "trusted", healthy=0.1, A=0.9), result(0.6, "robust", healthy=0.2, A=0.8))
    assert found.mode == mode
    assert found.network == f"network of {mode}"
    # What it rests on is told of both.
    assert found.trusted_p_value == p_value
    assert found.notes == ("of both", "of the trusted mode", "of the robust mode")


def test_sets_and_limits_are_those_of_the_leading_mode() -> None:
    class Marked(str):
        pass

    for p_value, leading in ((0.5, "trusted"), (1e-6, "robust")):
        modes = {
            mode: replace(
                result(p_value if mode == "trusted" else 0.6, mode, healthy=0.1, A=0.9),
                sightings=Marked(mode),  # type: ignore[arg-type]
            )
            for mode in ("trusted", "robust")
        }
        assert blend(modes["trusted"], modes["robust"]).sightings == leading


def test_clearances_are_those_of_the_mode_that_says_more_for_a_hypothesis() -> None:
    trusted = result(1e-3, "trusted", healthy=0.01, A=0.98, B=0.01)
    robust = result(0.6, "robust", healthy=0.5, A=0.05, B=0.45)
    clearances = {match.label: match.clearances for match in blend(trusted, robust).hypotheses}
    # 0.1446 of 0.98 is more than the rest of 0.05.
    assert clearances["A"][0].median == 100e-6
    assert clearances["B"][0].median == 200e-6


def test_a_recording_is_explained_as_well_as_the_better_mode_explains_it() -> None:
    trusted, robust = result(1e-3, "trusted", healthy=0.1, A=0.9), result(0.6, "robust", healthy=0.2, A=0.8)
    assert {match.p_value for match in blend(trusted, robust).hypotheses} == {0.6}
    assert {match.p_value for match in blend(result(0.9, "trusted", healthy=0.1, A=0.9), robust).hypotheses} == {0.9}
