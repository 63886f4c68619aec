"""The state of wear of an asset: what is known of it, gathered from the database, and followed in a worker."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from sqlalchemy import select

from jointplay.app.errors import NothingToFollowError
from jointplay.app.storage.asset_rows import FindingRow
from jointplay.app.storage.assets import Assets, asked, diagnoses_of, measurements_of
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.repairs import is_between, repairs_of
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.storage.standings import MOST_VISITS, made_once, turn_of
from jointplay.app.storage.store import Store

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.answer import Diagnosis
    from jointplay.catalogue.following.state import WearState

MOST_RECORDINGS = 20_000
"""Recordings that the diagnoses of an asset which are followed may be of."""

MOST_LESSONS = 1000
"""Findings of an asset, and those of machines of its kind, which teach: the newest so many."""

SOON, BEFORE = timedelta(days=31), timedelta(days=1)
"""How long after a recording something was found, or before it, that teaches what its answer is worth.

Chosen, not fitted: a joint that wears gains 100 um a year in the median (USUAL of catalogue.following.play), so less
than 10 um in a month, beside an error of 5 % of a clearance that somebody measures. What is found later is wear as well
as an error of the model. A day before, because who only knows the date of an inspection tells its midnight."""

NEVER, ENDLESS = datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC)
"""Before and after all that was recorded."""

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
        Answers to recordings of machines of this kind, and what was found at their joints soon after.
    limits_um : Mapping
        Its own limits by joint, in place of the machine's.
    """

    machine: Mapping[str, Any]
    visits: Sequence[tuple[datetime, str, Mapping[str, Any]]]
    findings: Sequence[tuple[datetime, str, Mapping[str, Any]]]
    lessons: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]
    limits_um: Mapping[str, float]


def gather(store: Store, asset: str, up_to: DiagnosisRow | None = None) -> Life:
    """Return what is known of an asset, or what was recorded and found up to the recording of a diagnosis.

    Every recording counts once, by its bytes: in the answer that was asked for last, of those that several have
    together, or else of its own; in a common answer without a verdict, as where recordings contradict each other, only
    if it has none of its own. One that is common to recordings of before and after a repair does not count: it is of no
    state that the machine was in.

    Parameters
    ----------
    store : Store
    asset : str
        External id.
    up_to : DiagnosisRow, optional
        Of the asset: what was recorded or found after its last recording is left out, wherever it was, and machine and
        limits are its own. By all there is unless given.

    Raises
    ------
    UnknownAssetError
        When there is none of this id.
    NothingToFollowError
        When none of its recordings was diagnosed, or only across a repair.
    DamagedRowError
        When a row of its own is damaged.
    """
    assets = Assets(store.database)
    row = assets.asset(asset)
    diagnoses = store.diagnoses(None, MOST_VISITS, among=diagnoses_of(asset))
    if not diagnoses:
        raise NothingToFollowError(f"asset {asset}: none of its recordings was diagnosed yet", field="asset")
    with store.database.reading() as session:
        turns = asked(session, asset)
    diagnoses.sort(key=lambda each: turns[each.id], reverse=True)
    # Whoever diagnoses a recording for an asset notes it as one of the asset's.
    recordings = store.measurements(None, MOST_RECORDINGS, measurements_of(asset), gone=True)
    own = Findings(store.database).of_asset(row, MOST_LESSONS)
    made = made_once((each.id, each.sha256, each.measured_at, each.measured_at_source) for each in recordings)
    until = ENDLESS
    if up_to:
        until = max((made[key][1] for key in up_to.measurements if key in made), default=NEVER)
        own = [found for found in own if found.at <= until]
        diagnoses = [up_to, *(each for each in diagnoses if _is_before(each, up_to, made, until))]
    counted = _counted(diagnoses, made, repairs_of(own))
    if not counted:
        said = "its recordings were diagnosed together only, those of before a repair with those of after it"
        raise NothingToFollowError(f"asset {asset}: {said}", field="asset")
    # Its file is that of the answer to its last recording, in whatever order they came.
    latest = up_to or max(counted, key=lambda each: each[:2])[2]
    return Life(
        machine=latest.machine,
        visits=[(at, key, _without_evidence(each)) for at, key, each in counted],
        findings=[(found.at, found.id, found.joints) for found in own],
        lessons=[(_without_evidence(answer), found.joints) for answer, found in _lessons(store, row.machine, until)],
        limits_um=latest.request.get("limits_um", {}) if up_to else row.limits_um,
    )


def _counted(
    diagnoses: Sequence[DiagnosisRow], made: Mapping[str, tuple[str, datetime]], repairs: Sequence[datetime]
) -> list[tuple[datetime, str, DiagnosisRow]]:
    """Return the answers that count, each with the moment and the name of what it is of."""
    heard: set[str] = set()
    counted: list[tuple[datetime, str, DiagnosisRow]] = []
    # What was asked last first of each kind.
    for answer in sorted(diagnoses, key=lambda each: turn_of(len(each.measurements), each.result["verdict"])):
        moments = {made[key] for key in answer.measurements if key in made}
        bytes_of = sorted(sha256 for sha256, _ in moments)
        at = [moment for _, moment in moments]
        if at and heard.isdisjoint(bytes_of) and not is_between(repairs, at):
            heard.update(bytes_of)
            counted.append((max(at), " ".join(bytes_of), answer))
    return counted


def _is_before(
    each: DiagnosisRow, up_to: DiagnosisRow, made: Mapping[str, tuple[str, datetime]], until: datetime
) -> bool:
    """Return whether an answer counts beside one: to nothing of the same, and to what was made up to a moment.

    Common answers were to be there already.
    """
    is_apart = set(each.measurements).isdisjoint(up_to.measurements)
    is_early = all(made[key][1] <= until for key in each.measurements if key in made)
    return is_apart and is_early and (len(each.measurements) == 1 or each.created_at <= up_to.created_at)


def _lessons(store: Store, machine: str, until: datetime) -> Iterator[tuple[DiagnosisRow, FindingRow]]:
    """Give answers of machines of one kind, and what was found soon after, up to a moment.

    A row that is damaged teaches nothing.
    """
    fleet = Findings(store.database).of_machine(machine, MOST_LESSONS, damaged=[])
    fleet = [found for found in fleet if found.at <= until]
    at_asset: dict[str | None, list[FindingRow]] = defaultdict(list)
    for found in fleet:
        at_asset[found.asset].append(found)
    repairs = {asset: repairs_of(findings) for asset, findings in at_asset.items()}
    ids = select(DiagnosisRow.id).where(DiagnosisRow.id.in_({found.diagnosis for found in fleet}))
    answers = {each.id: each for each in store.diagnoses(None, len(fleet), among=ids, damaged=[])}
    keys = {key for answer in answers.values() for key in answer.measurements}
    among = select(MeasurementRow.id).where(MeasurementRow.id.in_(keys))
    made = {each.id: each.measured_at for each in store.measurements(None, len(keys), among, [], gone=True)}
    for found in reversed(fleet):
        answer = answers.get(found.diagnosis)
        if answer is not None and made.keys() >= set(answer.measurements):
            moments = [made[key] for key in answer.measurements]
            if _is_of_one_state(found.at, moments, repairs[found.asset]):
                yield answer, found


def _is_of_one_state(at: datetime, moments: Collection[datetime], repairs: Iterable[datetime]) -> bool:
    """Return whether something was found at a machine as it was heard at some moments."""
    return -BEFORE <= at - max(moments) <= SOON and not is_between(repairs, (at, *moments))


def _without_evidence(row: DiagnosisRow) -> dict[str, Any]:
    return row.result | {"evidence": NO_EVIDENCE}


def follow_life(life: Life) -> WearState:
    """Return the state of wear of an asset; in a worker."""
    from jointplay.catalogue.diagnosing.answer import Diagnosis
    from jointplay.catalogue.errors import DiagnosisError
    from jointplay.catalogue.following.follow import follow
    from jointplay.catalogue.following.play import bounds_of
    from jointplay.catalogue.following.teaching import Lesson, learn_from
    from jointplay.catalogue.following.visits import Inspection, Visit
    from jointplay.solver.machines.machine import parse_machine

    visits = [Visit(at, key, Diagnosis.model_validate(result)) for at, key, result in life.visits]
    machine = parse_machine(life.machine)
    joints = dict.fromkeys(joint for visit in visits for joint in visit.answer.joints)
    bounds = bounds_of(machine, joints)
    for joint in {joint for *_, told in life.findings for joint in told if joint in machine.wearing_joints}:
        with suppress(DiagnosisError):  # of a fit that cannot be followed, which no answer names
            bounds |= bounds_of(machine, [joint])
    bounds = {
        name: replace(found, limit=1e-6 * life.limits_um[name]) if name in life.limits_um else found
        for name, found in sorted(bounds.items())
    }
    inspections = [
        Inspection(
            at,
            {joint: clearance for joint, clearance in _measured(joints).items() if joint in bounds},
            frozenset(joint for joint, found in joints.items() if found.get("repaired") and joint in bounds),
            key,
        )
        for at, key, joints in life.findings
    ]
    lessons = [
        Lesson(answer, joint, clearance, worn=clearance >= bounds[joint].worn_from)
        for answer, joints in _readable(life.lessons)
        for joint, clearance in _measured(joints).items()
        if joint in bounds
    ]
    return follow(visits, inspections, bounds=bounds, correction=learn_from(lessons))


def _measured(joints: Mapping[str, Any]) -> dict[str, float]:
    """Return the clearances of a finding [m]; a joint may have been repaired without being measured."""
    return {joint: 1e-6 * found["clearance_um"] for joint, found in joints.items() if "clearance_um" in found}


def _readable(
    lessons: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]],
) -> Iterator[tuple[Diagnosis, Mapping[str, Any]]]:
    """Answers of other assets, and what was found; one that this version cannot read teaches nothing."""
    from pydantic import ValidationError

    from jointplay.catalogue.diagnosing.answer import Diagnosis

    for result, joints in lessons:
        with suppress(ValidationError):
            yield Diagnosis.model_validate(result), joints
