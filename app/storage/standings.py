"""How assets stand: who is to be judged anew, what was judged, who has acknowledged it, and what is told of it.

Whatever changes how an asset may stand makes it due in its own transaction, and what was judged is stored together with
what is told of it. So a server that is killed loses nothing, and of two that judge the same one alone finds a change.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from jointplay.app.errors import BadFieldError, DamagedRowError
from jointplay.app.schemas.assets import Acknowledged, StandingOut
from jointplay.app.storage.asset_rows import AssetRow, FindingRow
from jointplay.app.storage.assets import NEEDED, asked, diagnoses_of, measurements_of, one_locked
from jointplay.app.storage.audit import note
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.repairs import is_between, repairs_of
from jointplay.app.storage.rows import (
    UNREADABLE,
    DiagnosisRow,
    MeasurementRow,
    is_passing,
    newest,
    now,
    rows_of,
)
from jointplay.app.storage.webhooks import announce
from jointplay.catalogue.following.standing import (
    RECORDINGS,
    SEVERITY,
    JointKnown,
    Known,
    Patience,
    Reason,
    find_due,
    is_worse,
    judge,
    next_change,
    state_of,
)

MOST_VISITS = 2000
"""Diagnoses of an asset that are looked at, the newest so many."""

SAYING = {"sender": 0, "file": 1, "received": 2}
"""How sure it is when a recording was made by who says it, the surest first."""

LEASE = timedelta(seconds=300)
"""Longer than judging takes: an asset that was taken by a server that died is due again after it."""


@dataclass(frozen=True)
class Due:
    """An asset that this server is to judge now.

    Parameters
    ----------
    external_id : str
    changes : int
        How often it had changed when it was taken.
    known : Known or None
        What is known of it; None where that has to be learned anew.
    last : dict
        What was known of it when it was judged last, as JSON values.
    patience : Patience
    limits_um : dict
        Its own limits by joint.
    """

    external_id: str
    changes: int
    known: Known | None
    last: dict[str, Any]
    patience: Patience
    limits_um: dict[str, float]


class Standings:
    """How the assets of a service stand.

    Parameters
    ----------
    database : ServiceDatabase
        Of the service's store.
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database

    def take(self, moment: datetime) -> Due | None:
        """Return the asset that is due for longest, taken for the time of a lease; ``None`` if none is."""
        due = select(AssetRow).where(AssetRow.due_at <= moment).order_by(AssetRow.due_at).limit(1)
        try:
            with self._database.reading() as session:  # most looks find nothing, and need no lock for that
                if not rows_of(session, AssetRow, due, None):
                    return None
        except DamagedRowError as error:  # the others are to be judged all the same
            with self._database.writing() as session:
                later = update(AssetRow).where(AssetRow.number == error.number)
                session.execute(later.values(due_at=moment + LEASE))
            raise
        with self._database.writing() as session:
            found = rows_of(session, AssetRow, due.with_for_update(key_share=True, skip_locked=True), None)
            if not found:
                return None
            [row] = found
            row.due_at = moment + LEASE
            known = Known.model_validate(row.known) if row.followed == row.changes else None
            return Due(row.external_id, row.changes, known, dict(row.known), row.patience, dict(row.limits_um))

    def last_heard(self, external_id: str) -> tuple[datetime | None, DiagnosisRow | None, datetime | None]:
        """Return when an asset was last recorded, and the answer to the last recording diagnosed and its time.

        Of several recordings that have an answer together the last counts. An answer to recordings of before and after
        a repair is of no state of wear, and only returned where there is no other. Of several to the same last
        recording it is the one that counts for the state of wear, by :func:`turn_of`.

        Raises
        ------
        DamagedRowError
            When it cannot be said which answer that is, or it is damaged.
        """
        with self._database.reading() as session:
            made = moments_of(session, external_id)
            since = select(AssetRow.created_at).where(AssetRow.external_id == external_id).scalar_subquery()
            findings = select(FindingRow).where(FindingRow.asset == external_id, FindingRow.created_at >= since)
            repairs = repairs_of(rows_of(session, FindingRow, findings, []))
            answered = []
            turns = asked(session, external_id)
            for diagnosis, (keys, turn) in recordings_of(session, external_id).items():
                moments = [made[key] for key in keys if key in made]
                if moments:
                    answered.append((not is_between(repairs, moments), max(moments), -turn, turns[diagnosis]))
            heard = max(made.values(), default=None)
            if not answered:
                return heard, None, None
            _, at, _, (_, number) = max(answered)
            [row] = rows_of(session, DiagnosisRow, select(DiagnosisRow).where(DiagnosisRow.number == number), None)
        return heard, row, at

    def settle(self, due: Due, known: Known, moment: datetime) -> None:
        """Store how an asset stands by what is known of it, with what is told of that.

        What was learned before others learned more is left out; what has changed meanwhile is due again.
        """
        reasons = judge(known, moment, due.patience)
        with self._database.writing() as session:
            row = locked(session, due.external_id)
            if row.followed > due.changes:
                return
            self._tell(session, row, known, reasons, due, moment)
            if row.state != (state := state_of(reasons)):
                note(session, "judged", "asset", row.external_id, {"state": row.state}, {"state": state})
            row.state, row.reasons = state, [reason.model_dump() for reason in reasons]
            row.known = known.model_dump(mode="json")
            row.limit_at = None if known.limit_at is None else known.limit_at[1]
            if row.acknowledged is not None and (not reasons or is_worse(reasons, acknowledged_of(row))):
                row.acknowledged = None
            row.need = need_of(row)
            row.followed = due.changes
            if row.changes == due.changes:
                row.due_at = next_change(known, moment, due.patience)
            else:
                row.due_at = moment

    def acknowledge(self, external_id: str, state: str, by: str, told: str) -> None:
        """Note that somebody has seen how an asset stands.

        Raises
        ------
        BadFieldError
            When it is in order, or stands otherwise than they have seen.
        """
        with self._database.writing() as session:
            row = locked(session, external_id)
            if row.state != state:
                raise BadFieldError(f"state: {state}: {external_id} is {row.state} now", field="state")
            if not row.reasons:
                rule = "there is nothing to acknowledge of what is in order"
                raise BadFieldError(f"state: {state}: {rule}", field="state")
            note(session, "acknowledged", "asset", external_id, after={"state": state, "by": by, "note": told})
            row.acknowledged = {"by": by, "at": now().isoformat(), "note": told, "reasons": list(row.reasons)}
            row.need = need_of(row)

    def forget_acknowledgement(self, external_id: str) -> None:
        """Note that what was acknowledged needs somebody again."""
        with self._database.writing() as session:
            row = locked(session, external_id)
            if row.acknowledged is not None:
                note(session, "acknowledgement taken back", "asset", external_id)
            row.acknowledged = None
            row.need = need_of(row)

    def postpone(self, due: Due, moment: datetime) -> None:
        """Give an asset back that could not be judged now."""
        mine = (AssetRow.external_id == due.external_id, AssetRow.changes == due.changes)
        with self._database.writing() as session:
            session.execute(update(AssetRow).where(*mine).values(due_at=moment))

    def _tell(
        self, session: Session, row: AssetRow, known: Known, reasons: Sequence[Reason], due: Due, moment: datetime
    ) -> None:
        """Announce what has changed since the asset was judged last, each change once."""
        named = {"asset": row.external_id, "machine": row.machine}
        state = state_of(reasons)
        if row.state != state or is_worse(reasons, row.judged):
            said = {"state": state, "before": row.state, "diagnosis": known.diagnosis}
            told = [reason.model_dump() for reason in reasons]
            announce(session, "asset.state_changed", {**named, **said, "reasons": told})
        holds = [f"limit {joint}" for joint in find_due(known, moment, due.patience)]
        holds += ["silent" for reason in reasons if reason.about == RECORDINGS]
        for each in holds:
            if each not in row.said and each != "silent":
                joint = each.removeprefix("limit ")
                announce(session, "limit.predicted", {**named, "joint": joint, **limit_of(known.joints[joint])})
            elif each not in row.said and known.heard_at is not None:
                silence = {"heard_at": known.heard_at.isoformat(), "silent_after_days": due.patience.silent_after.days}
                announce(session, "asset.silent", {**named, **silence})
        row.said = holds


def moments_of(session: Session, external_id: str, which: Collection[str] | None = None) -> dict[str, datetime]:
    """Return when the recordings of an asset were made, by their ids, as :func:`made_of`."""
    return {key: moment for key, (_, moment) in made_of(session, external_id, which).items()}


def made_of(
    session: Session, external_id: str, which: Collection[str] | None = None
) -> dict[str, tuple[str, datetime]]:
    """Return the bytes of the recordings of an asset by their ids, and when they were made.

    All, or those of the bytes that some of them have.

    Raises
    ------
    DamagedRowError
    """
    query = select(MeasurementRow).where(MeasurementRow.id.in_(measurements_of(external_id)))
    if which is not None:
        alike = select(MeasurementRow.sha256).where(MeasurementRow.id.in_(which))
        query = query.where(MeasurementRow.sha256.in_(alike))
    columns = (MeasurementRow.id, MeasurementRow.sha256, MeasurementRow.measured_at, MeasurementRow.measured_at_source)
    return made_once(read_columns(session, query, *columns))


def made_once(recordings: Iterable[tuple[str, str, datetime, str]]) -> dict[str, tuple[str, datetime]]:
    """Return the bytes of recordings by their ids, and when they were made.

    The same bytes by several names were made once: when a sender says, or else a file, or else when they were first
    received.

    Parameters
    ----------
    recordings : iterable of (str, str, datetime, str)
        Id, checksum of the bytes, and of each name when it was made, and who says that.
    """
    made: dict[str, tuple[int, datetime]] = {}
    bytes_of = {}
    for key, sha256, at, source in recordings:
        moment = (SAYING.get(source, len(SAYING)), at)
        made[sha256] = min(made.get(sha256, moment), moment)
        bytes_of[key] = sha256
    return {key: (sha256, made[sha256][1]) for key, sha256 in bytes_of.items()}


def recordings_of(session: Session, external_id: str) -> dict[str, tuple[list[str], int]]:
    """Return the ids of what an asset's newest diagnoses are of, and when these count, by their ids.

    Raises
    ------
    DamagedRowError
    """
    query = newest(session, DiagnosisRow, None, MOST_VISITS, diagnoses_of(external_id))
    verdict = DiagnosisRow.result["verdict"].as_string()
    found = read_columns(session, query, DiagnosisRow.id, DiagnosisRow.measurement, DiagnosisRow.request, verdict)
    keys = {key: (request.get("measurements") or [one], said) for key, one, request, said in found}
    return {key: (several, turn_of(len(several), said)) for key, (several, said) in keys.items()}


def turn_of(recordings: int, verdict: str) -> int:
    """Return when an answer to so many recordings counts: common ones first, those without a verdict last."""
    if recordings == 1:
        return 1
    return 2 if verdict == "unknown" else 0


def read_columns(session: Session, query: Any, *columns: Any) -> Sequence[Any]:
    """Return columns of rows whose rest is too much to be read for them; which row is damaged is told.

    Raises
    ------
    DamagedRowError
    """
    try:
        return session.execute(query.with_only_columns(*columns)).all()
    except UNREADABLE as error:
        if not is_passing(error):
            rows_of(session, columns[0].class_, query, None)
        raise


def locked(session: Session, external_id: str) -> AssetRow:
    """Return an asset that nobody else changes until the end of a transaction."""
    return one_locked(session, external_id, key_share=True)


def acknowledged_of(row: AssetRow) -> tuple[Reason, ...]:
    """Return what somebody has acknowledged of an asset."""
    return tuple(map(Reason.model_validate, (row.acknowledged or {}).get("reasons", ())))


def need_of(row: AssetRow) -> int:
    """Return how much an asset needs somebody: by its state, what nobody has acknowledged before all that is."""
    severity = SEVERITY.index(row.state)
    return severity + (NEEDED if severity and row.acknowledged is None else 0)


def limit_of(joint: JointKnown) -> dict[str, object]:
    """Return what is told of a joint and its limit, as JSON values."""
    return joint.model_dump(mode="json", include={"limit_um", "limit_at", "clearance_um", "interval_um"})


def standing_out(row: AssetRow) -> StandingOut:
    """Return the outside shape of how an asset stands."""
    known, at, within = Known.model_validate(row.known), now(), row.patience.warn_within
    acknowledged = None
    if row.acknowledged is not None:
        acknowledged = Acknowledged(**{name: row.acknowledged[name] for name in Acknowledged.model_fields})
    return StandingOut(
        state=row.state,
        reasons=list(row.judged),
        acknowledged=acknowledged,
        verdict=known.verdict,
        verdict_at=known.verdict_at,
        diagnosis=known.diagnosis,
        heard_at=known.heard_at,
        over_limit=[name for name, joint in known.joints.items() if joint.is_over(at)],
        near_limit=[name for name, joint in known.joints.items() if joint.is_near(at, within)],
        limit_at=known.limit_at,
        up_to_date=row.followed == row.changes and (row.due_at is None or row.due_at > at),
    )
