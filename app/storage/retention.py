"""Which recordings are evidence, baselines or routine, which are on hold, and how much whoever stores them may store.

What a recording is follows from what speaks of it; a row here says otherwise.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, get_args

from sqlalchemy import JSON, ColumnElement, Select, String, Text, case, cast, func, literal, or_, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from jointplay.app.actor import actor
from jointplay.app.errors import InUseError, QuotaError
from jointplay.app.storage import audit
from jointplay.app.storage.asset_rows import AssetBaselineRow, AssetRow, FindingRow
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import MADE_BY, Base, DiagnosisRow, MeasurementRow, now
from jointplay.app.storage.tombstones import deleted, refuse_deleted

Class = Literal["routine", "baseline", "evidence"]
CLASSES: tuple[Class, ...] = get_args(Class)

LOOK_S = 30.0
"""How long a sum of what is stored holds, but for what is added here [s]."""


class RetentionRow(Base):
    """What is known of how long a recording is to be kept; there is none for most."""

    __tablename__ = "retention"

    measurement: Mapped[str] = mapped_column(String(32), primary_key=True)
    said: Mapped[str | None] = mapped_column(String(16))
    hold: Mapped[str | None] = mapped_column(Text)
    changed_by: Mapped[str] = mapped_column(Text, default="")
    changed_at: Mapped[datetime | None]


@dataclass(frozen=True)
class Kept:
    """How a recording is kept.

    Parameters
    ----------
    of : str
        Its class.
    said : bool
        Whether somebody says so, in place of what follows from what speaks of it.
    hold : str or None
        Why nobody may delete it, nor what was answered of it.
    changed_by : str
        Who said one of them last.
    changed_at : datetime or None
        When.
    """

    of: Class
    said: bool
    hold: str | None
    changed_by: str
    changed_at: datetime | None


def class_in(session: Session) -> ColumnElement[str]:
    """Return the class of a row of measurements, beside which that of its retention is joined."""
    answers = select(DiagnosisRow.measurement).join(FindingRow, FindingRow.diagnosis == DiagnosisRow.id)
    together = select(DiagnosisRow.request["measurements"]).join(FindingRow, FindingRow.diagnosis == DiagnosisRow.id)
    several = sorted({key for found in session.scalars(together) if found for key in found})
    # In one value, as JSON: SQLite takes no more than 32766 in a statement.
    listed = literal(json.dumps(several), String)
    if session.get_bind().dialect.name == "sqlite":
        keys = func.json_each(listed).table_valued("value")
    else:
        keys = func.json_array_elements_text(cast(listed, JSON)).table_valued("value")
    first = select(AssetRow.baseline).where(AssetRow.baseline.is_not(None))
    baseline = or_(MeasurementRow.id.in_(first), MeasurementRow.id.in_(select(AssetBaselineRow.measurement)))
    evidence = or_(MeasurementRow.id.in_(answers), MeasurementRow.id.in_(select(keys.c.value)))
    said = RetentionRow.said
    return case((said.is_not(None), said), (baseline, "baseline"), (evidence, "evidence"), else_="routine")


def recordings(*columns: Any) -> Select[Any]:
    """Return the query for what is known of the recordings that there are, with their retention beside them."""
    joined = select(*columns).select_from(MeasurementRow)
    joined = joined.outerjoin(RetentionRow, RetentionRow.measurement == MeasurementRow.id)
    return joined.where(MeasurementRow.id.not_in(deleted("measurement")))


def kept_of(session: Session, key: str) -> Kept:
    """Return how a recording that is there is kept."""
    row = session.get(RetentionRow, key) or RetentionRow(measurement=key, changed_by="")
    of = session.scalar(recordings(class_in(session)).where(MeasurementRow.id == key))
    return Kept(of or "routine", row.said is not None, row.hold, row.changed_by, row.changed_at)


def say(database: ServiceDatabase, key: str, of: Class | None, hold: str | None) -> Kept:
    """Note of what class a recording is said to be, and why nobody may delete it; None takes either back.

    Raises
    ------
    DeletedError
        When it was deleted since somebody has looked.
    """
    with database.writing() as session:
        hold_rows(session, [key])
        refuse_deleted(session, "measurement", [key])
        first = {"measurement": key, "changed_by": ""}
        session.execute(database.insert(RetentionRow).values(first).on_conflict_do_nothing())
        row = session.get_one(RetentionRow, key, with_for_update=True)
        before = {"class": row.said, "hold": row.hold}
        row.said, row.hold, row.changed_by, row.changed_at = of, hold, actor().name, now()
        session.flush()
        audit.note(session, "retained", "measurement", key, before, {"class": of, "hold": hold})
        return kept_of(session, key)


def hold_rows(session: Session, keys: Iterable[str]) -> None:
    """Let nobody else delete recordings, nor say how they are kept, until the end of a transaction."""
    query = select(MeasurementRow.number).where(MeasurementRow.id.in_(list(keys))).order_by(MeasurementRow.number)
    session.execute(query.with_for_update(key_share=True)).all()


def refuse_held(session: Session, keys: Iterable[str]) -> None:
    """Refuse to delete what is on hold, or was answered of it.

    Raises
    ------
    InUseError
    """
    query = select(RetentionRow).where(RetentionRow.measurement.in_(list(keys)), RetentionRow.hold.is_not(None))
    row = session.scalar(query.limit(1))
    if row is not None:
        cure = f"lift that first, with PUT /measurements/{row.measurement}/retention"
        raise InUseError(f"measurement {row.measurement}: is on hold ({row.hold}): {cure}", field="measurement")


class Quotas:
    """How many bytes of recordings may be stored.

    Parameters
    ----------
    all_bytes : float, optional
        By all together; none for as many as there is space for.
    each_bytes : float, optional
        By whoever stores them: a person who signed in, or a key.
    """

    def __init__(self, all_bytes: float | None = None, each_bytes: float | None = None) -> None:
        self._allowed = {False: all_bytes, True: each_bytes}
        self._known: dict[str | None, tuple[float, int]] = {}
        self._lock = threading.Lock()

    def take(self, session: Session, size: int) -> None:
        """Count a recording whose row was just made in a transaction.

        Raises
        ------
        QuotaError
            When it is more than may be stored.
        """
        who = actor()
        for each in (None, who.name[:MADE_BY]) if who.key or who.person else (None,):
            allowed = self._allowed[each is not None]
            if allowed is not None:
                self._take(session, each, size, allowed)

    def _take(self, session: Session, by: str | None, size: int, allowed: float) -> None:
        with self._lock:
            until, used = self._known.get(by, (0.0, 0))
        if time.monotonic() > until or used + size > allowed:  # others store, too; and what was deleted counts no more
            until, used = time.monotonic() + LOOK_S, stored_bytes(session, by) - size
        if used + size > allowed:
            whose = by or "all together"
            rule = f"{used / 1e6:.6g} MB of {allowed / 1e6:.6g} MB are used by {whose}; this has {size / 1e6:.6g} MB"
            raise QuotaError(f"{rule}: delete recordings, or let the quota be raised", field="file")
        with self._lock:
            self._known[by] = (until, used + size)


def stored_bytes(session: Session, by: str | None) -> int:
    """Return the size of all recordings that there are, or of those that somebody has stored."""
    query = recordings(func.coalesce(func.sum(MeasurementRow.size_bytes), 0))
    if by is not None:
        query = query.where(MeasurementRow.made_by == by)
    return int(session.scalar(query) or 0)
