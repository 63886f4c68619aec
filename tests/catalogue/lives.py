"""Answers to recordings of a made-up machine with three joints, as a catalogue of all its sets would give them."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from jointplay.catalogue.diagnosing.answer import Cause, Diagnosis, GoodnessOfFit, JointClearance, RankedHypothesis
from jointplay.catalogue.diagnosing.answer_of_baseline import BaselineShown
from jointplay.catalogue.following.follow import follow
from jointplay.catalogue.following.play import JointBounds
from jointplay.catalogue.following.state import WearState
from jointplay.catalogue.following.visits import Inspection, Visit
from jointplay.catalogue.matching.prior import Prior

JOINTS = ("A", "B", "O")
BOUNDS = {joint: JointBounds(fit=(3e-6, 20e-6), worn_from=25e-6, limit=200e-6) for joint in JOINTS}
NONE = dict.fromkeys(JOINTS, -6.0)
AS_NEW = dict.fromkeys(JOINTS, 26e-6)
SETS = [names for count in (0, 1, 2, 3) for names in itertools.combinations(JOINTS, count)]
BEGIN = datetime(2025, 3, 1, 9, 30, tzinfo=UTC)
_SOME = Diagnosis.model_validate(
    json.loads((Path(__file__).parents[1] / "data" / "service" / "answer-1.json").read_text())
)
PAST = BaselineShown(
    measurement="new",
    measurement_sha256=64 * "0",
    used=True,
    p_before=0.5,
    p_after=0.5,
    numbers={},
    gains={},
    heard=True,
)


def answer(
    evidence: Mapping[str, float],
    clearances: Mapping[str, float],
    *,
    width: float = 0.15,
    verdict: str = "worn",
    causes: tuple[Cause, ...] = (),
    heard: bool = False,
) -> Diagnosis:
    """Return an answer with so much evidence (ln) for wear in each joint, and clearances [m] where they are worn.

    The machine's own past was heard, or not.
    """
    prior = Prior()
    weights = np.array([prior.weight(names, 3, 3) * math.exp(sum(evidence[name] for name in names)) for names in SETS])
    ranked = []
    for names, share in zip(SETS, (weights / weights.sum()).tolist(), strict=True):
        sizes = {name: 1e6 * clearances[name] for name in names}
        joints = {
            name: JointClearance(clearance_um=um, interval_um=(um * math.exp(-width), um * math.exp(width)))
            for name, um in sizes.items()
        }
        label = "+".join(names) or "healthy"
        ranked.append(RankedHypothesis(label=label, joints=joints, probability=min(1.0, share), distance_db=1.0))
    ranked.sort(key=lambda each: -each.probability)
    update = {
        "hypotheses": tuple(ranked),
        "verdict": verdict,
        "causes": causes,
        "goodness_of_fit": GoodnessOfFit(p_value=0.5),
        "baseline": PAST if heard else None,
    }
    return _SOME.model_copy(update=update)


def course_of_wear(clearances: list[Mapping[str, float]], seed: int, days: float = 30.0) -> list[Visit]:
    """Return one visit for each set of clearances [m], so many days apart, with answers that scatter."""
    draw = np.random.default_rng(seed)
    visits = []
    for number, true in enumerate(clearances):
        evidence = {name: 6.0 * math.tanh(math.log(true[name] / 35e-6)) + draw.normal() for name in JOINTS}
        found = {name: max(true[name], 26e-6) * math.exp(draw.normal(0.0, 0.09)) for name in JOINTS}
        visits.append(Visit(BEGIN + timedelta(days=days * number), f"{number:064d}", answer(evidence, found)))
    return visits


def followed(visits: list[Visit], inspections: list[Inspection] | None = None) -> WearState:
    return follow(visits, inspections or [], bounds=BOUNDS)


def wears(count: int, begins: int = 8, um_a_visit: float = 15.0) -> list[dict[str, float]]:
    """Clearances [m] of B that grows evenly from a visit on."""
    return [{"A": 8e-6, "B": 1e-6 * (10 + um_a_visit * max(0, number - begins)), "O": 12e-6} for number in range(count)]
