"""The state of wear of an asset: what is known of it, gathered from the database, and followed in a worker."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

from sqlalchemy import select

from jointplay.app.errors import NothingToFollowError
from jointplay.app.storage.assets import Assets, diagnoses_of
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.storage.store import Store

if TYPE_CHECKING:
    from jointplay.catalogue.following.state import WearState

MOST_VISITS = 2000
"""Recordings of an asset that are followed: the newest so many."""

MOST_LESSONS = 1000
"""Findings of machines of one kind that teach: the newest so many."""

NO_EVIDENCE: dict[str, Any] = {"orders": [], "bands": [], "rival": None}
"""Levels are most of an answer, and nothing here asks for them."""


@dataclass(frozen=True)
class Life:
    """What is known of an asset.

    Parameters
    ----------
    machine : Mapping
        The machine's file.
    visits : sequence of (datetime, str, Mapping)
        When a recording was made, what it is called, and its answer as JSON.
    findings : sequence of (datetime, str, Mapping)
        When something was found, its id, and its joints.
    lessons : sequence of (Mapping, Mapping)
        Answers to recordings of machines of this kind, and what was found at their joints then.
    """

    machine: Mapping[str, Any]
    visits: Sequence[tuple[datetime, str, Mapping[str, Any]]]
    findings: Sequence[tuple[datetime, str, Mapping[str, Any]]]
    lessons: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]


def gather(store: Store, asset: str) -> Life:
    """Return what is known of an asset.

    Of several answers to the same recordings the newest counts; of recordings that have an answer together, that one.

    Raises
    ------
    UnknownAssetError
        When there is none of this id.
    NothingToFollowError
        When none of its recordings was diagnosed.
    """
    assets = Assets(store.database)
    row = assets.asset(asset)
    diagnoses = store.diagnoses(None, MOST_VISITS, among=diagnoses_of(asset))
    newest = list({each.measurements: each for each in reversed(diagnoses)}.values())
    if not newest:
        raise NothingToFollowError(f"asset {asset}: none of its recordings was diagnosed yet", field="asset")
    together = {key for each in newest if len(each.measurements) > 1 for key in each.measurements}
    counted = [each for each in newest if len(each.measurements) > 1 or each.measurement not in together]
    used = {key for each in counted for key in each.measurements}
    known = store.measurements(None, len(used), select(MeasurementRow.id).where(MeasurementRow.id.in_(used)))
    made = {each.id: each.measured_at for each in known}
    fleet = assets.findings_of_machine(row.machine, MOST_LESSONS)
    ids = select(DiagnosisRow.id).where(DiagnosisRow.id.in_({found.diagnosis for found in fleet}))
    answered = store.diagnoses(None, len(fleet), among=ids)
    results = {each.id: _without_evidence(each) for each in answered}
    return Life(
        machine=diagnoses[0].machine,
        visits=[
            (max(made[key] for key in each.measurements), " ".join(each.measurements), _without_evidence(each))
            for each in counted
        ],
        findings=[(found.at, found.id, found.joints) for found in fleet if found.asset == asset],
        lessons=[(results[found.diagnosis], found.joints) for found in reversed(fleet)],
    )


def _without_evidence(row: DiagnosisRow) -> dict[str, Any]:
    return row.result | {"evidence": NO_EVIDENCE}


def follow_life(life: Life) -> WearState:
    """Return the state of wear of an asset; in a worker."""
    from jointplay.catalogue.diagnosing.answer import Diagnosis
    from jointplay.catalogue.following.follow import follow
    from jointplay.catalogue.following.play import bounds_of
    from jointplay.catalogue.following.teaching import Lesson, learn_from
    from jointplay.catalogue.following.visits import Inspection, Visit
    from jointplay.solver.machines.machine import parse_machine

    visits = [Visit(at, key, Diagnosis.model_validate(result)) for at, key, result in life.visits]
    joints = dict.fromkeys(joint for visit in visits for joint in visit.answer.joints)
    bounds = bounds_of(parse_machine(life.machine), joints)
    inspections = [
        Inspection(
            at,
            {joint: 1e-6 * found["clearance_um"] for joint, found in joints.items() if joint in bounds},
            frozenset(joint for joint, found in joints.items() if found.get("repaired") and joint in bounds),
            key,
        )
        for at, key, joints in life.findings
    ]
    lessons = [
        Lesson(Diagnosis.model_validate(result), joint, clearance, worn=clearance >= bounds[joint].worn_from)
        for result, joints in life.lessons
        for joint, clearance in ((joint, 1e-6 * found["clearance_um"]) for joint, found in joints.items())
        if joint in bounds
    ]
    return follow(visits, inspections, bounds=bounds, correction=learn_from(lessons)).state
