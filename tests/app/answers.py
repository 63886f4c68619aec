"""A whole answer, of which a test says what it is about."""

from __future__ import annotations

from typing import Any

from jointplay.catalogue.diagnosing.answer import Diagnosis

ANSWER: dict[str, Any] = {
    "id": "0" * 32,
    "machine": "slider-crank",
    "catalogue": "slider-crank",
    "drive_speed_rpm": 600.0,
    "effort": "fast",
    "effort_spent": {"simulations": 0, "generations": 0, "note": ""},
    "mode": {"asked": "auto", "used": "trusted", "trusted_p_value": 0.5},
    "prior": {"worn": 0.75, "another": 0.6, "joints": {}, "numbers": [1.0]},
    "verdict": "unknown",
    "joints": {},
    "hypotheses": [],
    "causes": [],
    "sensors": [],
    "joint_probabilities": {},
    "candidate_set": [],
    "coverage": 0.95,
    "widened": False,
    "goodness_of_fit": {"p_value": 0.5},
    "evidence": {"orders": [], "bands": []},
    "baseline": None,
    "past": None,
    "suggestions": [],
    "warnings": [],
    "provenance": {
        "measurement": "a.csv",
        "measurement_sha256": "m" * 64,
        "catalogue_sha256": "c" * 64,
        "machine_sha256": "d" * 64,
        "solver_version": "1",
        "catalogue_solver_version": "1",
        "matcher": {"name": "gaussian", "version": "2"},
        "recipe": [],
    },
    "hash": "h",
}


def diagnosis(**members: Any) -> Diagnosis:
    """An answer with some of its members."""
    return Diagnosis.model_validate({**ANSWER, **members})


def changed(answer: Diagnosis, **members: Any) -> Diagnosis:
    """The same answer with other members."""
    return Diagnosis.model_validate({**answer.model_dump(mode="json"), **members})


def hypothesis(label: str, probability: float, **joints: float) -> dict[str, Any]:
    """One hypothesis, with clearances [µm] of its joints."""
    found = {joint: {"clearance_um": um, "interval_um": [0.9 * um, 1.1 * um]} for joint, um in joints.items()}
    return {"label": label, "joints": found, "probability": probability, "distance_db": 1.0}


def joint(condition: str, um: float, p_worn: float, **more: Any) -> dict[str, Any]:
    """What is said of one joint."""
    found = {"p_over_limit": 0.0, "limit_um": 200.0, "bound": "none", "detectable_from_um": 35.0, **more}
    return {
        "condition": condition,
        "p_worn": p_worn,
        "clearance_um": um,
        "interval_um": [0.9 * um, 1.1 * um],
        **found,
    }
