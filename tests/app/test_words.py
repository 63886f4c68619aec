"""Verdicts as sentences."""

from __future__ import annotations

from typing import Any

import pytest

from app import words


def hypothesis(label: str, probability: float, **joints: float) -> dict[str, Any]:
    found = {joint: {"clearance_um": um, "interval_um": [0.9 * um, 1.1 * um]} for joint, um in joints.items()}
    return {"label": label, "joints": found, "probability": probability, "distance_db": 1.0}


def result(verdict: str, *hypotheses: dict[str, Any]) -> dict[str, Any]:
    return {"verdict": verdict, "hypotheses": list(hypotheses), "coverage": 0.95, "candidate_set": []}


def test_one_worn_joint() -> None:
    found = result("fault", hypothesis("F", 0.93, F=210), hypothesis("healthy", 0.07))
    assert words.sentence(found) == "Joint F is worn: radial clearance 210 µm (90 %: 189 to 231), probability 93 %."
    assert words.short(found) == "F worn"


def test_two_worn_joints() -> None:
    found = result("fault", hypothesis("A+C", 0.8, A=250, C=8))
    assert words.sentence(found) == (
        "Joints A and C are worn: radial clearance A 250 µm (90 %: 225 to 275); C 8.0 µm (90 %: 7.2 to 8.8), "
        "probability 80 %."
    )


def test_a_healthy_machine_counts_the_new_one_in() -> None:
    found = result("healthy", hypothesis("as-new", 0.5), hypothesis("healthy", 0.4), hypothesis("F", 0.1, F=20))
    assert words.sentence(found).endswith("probability 90 %.")


def test_why_a_model_is_not_believed() -> None:
    doubted = {"mode": {"asked": "auto", "used": "robust", "trusted_p_value": 0.004}}
    assert words.mode_sentence(doubted) == (
        "The machine is taken to differ from its model (robust): "
        "as simulated it does not explain the recording, p = 0.004."
    )
    asked = {"mode": {"asked": "robust", "used": "robust", "trusted_p_value": None}}
    assert words.mode_sentence(asked) == "The machine is taken to differ from its model (robust)."


def test_a_widened_set_promises_nothing() -> None:
    found = {**result("fault", hypothesis("F", 0.6, F=20)), "candidate_set": ["F"]}
    assert words.set_sentence(found) == "Candidates, which hold the true cause in 95 % of cases: F."
    assert words.set_sentence({**found, "widened": True}) == (
        "Candidates, from a set widened because the one for 95 % was empty: F."
    )


def test_nothing_known() -> None:
    found = result("unknown", hypothesis("F", 1.0, F=20))
    assert words.sentence(found) == (
        "No verdict: the recording fits none of the hypotheses of this catalogue; the closest is F."
    )
    assert "none of them explains the recording" in words.set_sentence(found)


@pytest.mark.parametrize(
    ("probability", "text"),
    [(1.0, "> 99 %"), (0.996, "> 99 %"), (0.99, "99 %"), (0.5, "50 %"), (0.004, "< 1 %"), (0.0, "< 1 %")],
)
def test_nothing_is_certain(probability: float, text: str) -> None:
    assert words.percent(probability) == text


@pytest.mark.parametrize(("value", "text"), [(2.0, "2"), (14.52, "14.5"), (1428.6, "1429"), (100.4, "100")])
def test_orders(value: float, text: str) -> None:
    assert words.order(value) == text
