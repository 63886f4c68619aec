"""The state of wear of an asset: what is known of it, gathered from the database, and followed in a worker."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any

from sqlalchemy import select

from jointplay.app.errors import NothingToFollowError
from jointplay.app.storage.assets import Assets, diagnoses_of, measurements_of
from jointplay.app.storage.rows import DiagnosisRow
from jointplay.app.storage.store import Store

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.answer import Diagnosis
    from jointplay.catalogue.following.state import WearState

MOST_VISITS, MOST_RECORDINGS = 2000, 20_000
"""Diagnoses of an asset that are followed, the newest so many, and recordings that they may be of."""

MOST_LESSONS = 1000
"""Findings of an asset, and those of machines of its kind, which teach: the newest so many."""

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
    limits_um : Mapping
        Its own limits by joint, in place of the machine's.
    """

    machine: Mapping[str, Any]
    visits: Sequence[tuple[datetime, str, Mapping[str, Any]]]
    findings: Sequence[tuple[datetime, str, Mapping[str, Any]]]
    lessons: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]
    limits_um: Mapping[str, float]


def gather(store: Store, asset: str) -> Life:
    """Return what is known of an asset.

    Every recording counts once, by its bytes: in the newest answer that several have together, or else in its own; in a
    common answer without a verdict, as where recordings contradict each other, only if it has none of its own.

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
    if not diagnoses:
        raise NothingToFollowError(f"asset {asset}: none of its recordings was diagnosed yet", field="asset")
    # Whoever diagnoses a recording for an asset notes it as one of the asset's.
    known = {each.id: each for each in store.measurements(None, MOST_RECORDINGS, measurements_of(asset), gone=True)}
    # The same bytes by several names were made once: when somebody says, or else when they were first received.
    made: dict[str, tuple[bool, datetime]] = {}
    for row_of in known.values():
        moment = (row_of.measured_at_source == "received", row_of.measured_at)
        made[row_of.sha256] = min(made.get(row_of.sha256, moment), moment)
    heard: set[str] = set()
    counted: list[tuple[datetime, str, DiagnosisRow]] = []
    for each in sorted(diagnoses, key=_turn):  # the newest of each kind first
        recordings = [known[key] for key in each.measurements if key in known]
        bytes_of = sorted({recording.sha256 for recording in recordings})
        if recordings and heard.isdisjoint(bytes_of):
            heard.update(bytes_of)
            counted.append((max(made[key][1] for key in bytes_of), " ".join(bytes_of), each))
    own = assets.findings(None, MOST_LESSONS, only={"asset": asset})
    fleet = assets.findings_of_machine(row.machine, MOST_LESSONS)
    ids = select(DiagnosisRow.id).where(DiagnosisRow.id.in_({found.diagnosis for found in fleet}))
    answered = store.diagnoses(None, len(fleet), among=ids)
    results = {each.id: _without_evidence(each) for each in answered}
    return Life(
        machine=diagnoses[0].machine,
        visits=[(at, key, _without_evidence(each)) for at, key, each in counted],
        findings=[(found.at, found.id, found.joints) for found in own],
        lessons=[(results[found.diagnosis], found.joints) for found in reversed(fleet)],
        limits_um=row.limits_um,
    )


def _turn(row: DiagnosisRow) -> int:
    """When an answer counts: common ones first, those without a verdict last."""
    if len(row.measurements) == 1:
        return 1
    return 2 if row.result["verdict"] == "unknown" else 0


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
    bounds = {
        name: replace(found, limit=1e-6 * life.limits_um[name]) if name in life.limits_um else found
        for name, found in bounds_of(parse_machine(life.machine), joints).items()
    }
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
        Lesson(answer, joint, clearance, worn=clearance >= bounds[joint].worn_from)
        for answer, joints in _readable(life.lessons)
        for joint, clearance in ((joint, 1e-6 * found["clearance_um"]) for joint, found in joints.items())
        if joint in bounds
    ]
    return follow(visits, inspections, bounds=bounds, correction=learn_from(lessons))


def _readable(
    lessons: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]],
) -> Iterator[tuple[Diagnosis, Mapping[str, Any]]]:
    """Answers of other assets, and what was found; one that this version cannot read teaches nothing."""
    from pydantic import ValidationError

    from jointplay.catalogue.diagnosing.answer import Diagnosis

    for result, joints in lessons:
        with suppress(ValidationError):
            yield Diagnosis.model_validate(result), joints
