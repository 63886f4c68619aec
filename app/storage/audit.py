"""The audit log: who did what to which object, a chain of rows each of which holds the checksum of the one before.

A note is written in the transaction of the change that it tells of, as its last statement. The row that holds the
chain's end is locked from there to the commit: however many servers write, there is one chain, and whoever holds that
lock waits for no other.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import JSON, Index, String, event, insert, select, update
from sqlalchemy.orm import Mapped, Session, mapped_column

from jointplay.app.actor import actor
from jointplay.app.logs import clean
from jointplay.app.storage.checksums import canonical, checksum
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Base, now

FIRST = "0" * 64
"""What the first row holds in place of a checksum of one before."""

LONGEST = 500
"""Characters of a member that are kept; of a longer one the checksum."""

_NOTES, _ATTENDED = "audit notes", "audited"


class AuditRow(Base):
    """One thing that was done.

    Before and after hold the checksum of all that was known of the object, and the members that differ.
    """

    __tablename__ = "audit"
    __table_args__ = (Index("ix_audit_object", "kind", "object"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    at: Mapped[datetime]
    action: Mapped[str] = mapped_column(String(64))
    kind: Mapped[str] = mapped_column(String(32))
    object: Mapped[str] = mapped_column(String(128))
    key: Mapped[str | None] = mapped_column(String(16))
    person: Mapped[str | None] = mapped_column(String(200))
    address: Mapped[str] = mapped_column(String(64))
    request_id: Mapped[str | None] = mapped_column(String(64))
    before: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    after: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    previous: Mapped[str] = mapped_column(String(64))
    hash: Mapped[str] = mapped_column(String(64))

    @property
    def content(self) -> dict[str, Any]:
        """All that its checksum is of."""
        return {column.name: getattr(self, column.name) for column in CONTENT}


CONTENT = tuple(column for column in AuditRow.__table__.columns if column.name != "hash")


class AuditEndRow(Base):
    """The end of the chain: without it nobody would see that the last rows are gone."""

    __tablename__ = "audit_end"

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    number: Mapped[int]
    hash: Mapped[str] = mapped_column(String(64))


ROWS, END = Base.metadata.tables["audit"], Base.metadata.tables["audit_end"]

# Put together once: that takes longer than to run them.
_READ_END = select(END.c.number, END.c.hash).with_for_update()
_ADD_ROWS, _MOVE_END = insert(ROWS), update(END)


def attend(database: ServiceDatabase) -> None:
    """Let transactions of a database end with the notes that were made in them."""
    database.session.configure(info={_ATTENDED: database})
    event.listen(database.session, "before_commit", write)


def note(
    session: Session,
    action: str,
    kind: str,
    object: str,
    before: Mapping[str, Any] | None = None,
    after: Mapping[str, Any] | None = None,
) -> None:
    """Note in a transaction that whoever acts here does something; it is written when the transaction ends.

    Parameters
    ----------
    session : Session
        Of a transaction that writes.
    action : str
        What is done: ``made``, ``changed``, ``deleted`` ...
    kind, object : str
        What it is done to: "measurement", "asset" ..., and its id.
    before, after : Mapping, optional
        What is known of the object, as JSON values: all of it, or what may differ; no secrets.

    Raises
    ------
    RuntimeError
        The session is of no database whose transactions are attended: the note would be lost.
    """
    if _ATTENDED not in session.info:
        raise RuntimeError("this session writes no audit log")
    session.info.setdefault(_NOTES, []).append((action, kind, object, *differences(before, after)))


def note_machine(database: ServiceDatabase, name: str, before: str | None, after: str) -> None:
    """Note that a machine, which is no row but a file, is put there; content keys say which."""
    known = None if before is None else {"content_key": before}
    with database.writing() as session:
        note(session, "made" if known is None else "changed", "machine", name, known, {"content_key": after})


def differences(
    before: Mapping[str, Any] | None, after: Mapping[str, Any] | None
) -> tuple[dict[str, Any] | None, dict[str, Any] | None]:
    """Return what is kept of an object before and after: the checksum of all, and the members that differ."""
    known, found = before or {}, after or {}
    same = {name for name in known.keys() & found.keys() if known[name] == found[name]}

    def kept(held: Mapping[str, Any] | None) -> dict[str, Any] | None:
        if held is None:
            return None
        members = {name: short(value) for name, value in held.items() if name not in same}
        return {"sha256": checksum(held), "members": members}

    return kept(before), kept(after)


def short(value: Any) -> Any:
    """Return a JSON value as it is kept: without secrets; of a long one its checksum."""
    if value is None or isinstance(value, bool | int | float):
        return value
    text = canonical(value)
    return {"sha256": checksum(value)} if len(text) > LONGEST else clean(json.loads(text))


def write(session: Session) -> None:
    """Write the notes of a transaction to the end of the chain."""
    notes = session.info.pop(_NOTES, None)
    if not notes:
        return
    session.flush()  # whatever else has to be locked is locked before
    who, moment = actor(), now()
    named = {
        **{"key": who.key, "person": None if who.person is None else who.person[:200]},
        **{"address": who.address[:64], "request_id": who.request_id},
    }
    number, previous = end_of(session)
    rows = []
    for action, kind, object, before, after in notes:
        number += 1
        content = {
            **{"number": number, "at": moment, "action": action, "kind": kind, "object": object},
            **named,
            **{"before": before, "after": after, "previous": previous},
        }
        previous = checksum(content)
        rows.append({**content, "hash": previous})
    session.execute(_ADD_ROWS, rows)
    session.execute(_MOVE_END, {"number": number, "hash": previous})


def end_of(session: Session) -> tuple[int, str]:
    """Return number and checksum of the chain's last row, which nobody else writes after until the transaction ends."""
    database: ServiceDatabase = session.info[_ATTENDED]
    found = session.execute(_READ_END).first()
    if found is None:
        first = {"id": 1, "number": 0, "hash": FIRST}
        session.execute(database.insert(AuditEndRow).values(first).on_conflict_do_nothing(index_elements=["id"]))
        found = session.execute(_READ_END).one()
    return found.number, found.hash


class AuditLog:
    """The audit log of a service.

    Parameters
    ----------
    database : ServiceDatabase
        Of the service's store.
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database

    def page(
        self, before: int | None, limit: int, kind: str | None = None, object: str | None = None
    ) -> list[AuditRow]:
        """Return what was done, the last first, from below a row number on; to one kind of objects, or to one."""
        query = select(AuditRow).order_by(AuditRow.number.desc()).limit(limit)
        for column, value in ((AuditRow.kind, kind), (AuditRow.object, object)):
            if value is not None:
                query = query.where(column == value)
        if before is not None:
            query = query.where(AuditRow.number < before)
        with self._database.reading() as session:
            return list(session.scalars(query))

    def end(self) -> tuple[int, str]:
        """Return number and checksum of the last row."""
        with self._database.reading() as session:
            found = session.execute(select(AuditEndRow.number, AuditEndRow.hash)).first()
        return (0, FIRST) if found is None else (found.number, found.hash)

    def all(self, until: int) -> Iterator[AuditRow]:
        """Give all rows up to a number, the first first, a thousand at a time."""
        last = 0
        while True:
            query = select(AuditRow).where(AuditRow.number > last, AuditRow.number <= until)
            with self._database.reading() as session:
                rows = list(session.scalars(query.order_by(AuditRow.number).limit(1000)))
            yield from rows
            if not rows:
                return
            last = rows[-1].number

    def damage(self) -> Iterator[str]:
        """Give what is wrong with the chain, in order; nothing where it is whole."""
        return (said for said in self.look() if said)

    def look(self) -> Iterator[str]:
        """Give what is wrong with each row, in order, mostly an empty text; at the end also what is wrong with that."""
        until, ending = self.end()  # first: what is added meanwhile is looked at another time
        number, previous = 0, FIRST
        for row in self.all(until):
            said = []
            if row.number != number + 1:
                said.append(f"{named(number + 1, row.number - 1)} missing")
            elif row.previous != previous:
                said.append(f"row {row.number} does not follow row {number}")
            if row.hash != checksum(row.content):
                said.append(f"row {row.number} ({row.action} {row.kind} {row.object[:40]}) is not what was written")
            yield "; ".join(said)
            number, previous = row.number, row.hash
        if number < until:
            yield f"{named(number + 1, until)} missing"
        elif previous != ending:
            yield f"row {number} is not the one that was written last"


def named(first: int, last: int) -> str:
    """Return the words for rows that follow each other."""
    return f"row {first} is" if first == last else f"rows {first} to {last} are"
