"""What is left of what was deleted: its id, the checksum of a recording, when, by whom and why."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from typing import Literal

from sqlalchemy import Select, String, Text, delete, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from jointplay.app.errors import AppError, DeletedError
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Base, now

Kind = Literal["measurement", "diagnosis", "asset", "finding", "build", "machine", "catalogue"]


class TombstoneRow(Base):
    """One thing that was deleted."""

    __tablename__ = "tombstones"

    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    id: Mapped[str] = mapped_column(String(200), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64))
    deleted_at: Mapped[datetime]
    by: Mapped[str] = mapped_column(Text)
    why: Mapped[str] = mapped_column(Text)

    def error(self) -> DeletedError:
        """Return what is said to whoever asks for it."""
        by = f" by {self.by}" if self.by else ""
        why = f": {self.why}" if self.why else ""
        moment = self.deleted_at.isoformat(timespec="seconds").replace("+00:00", "Z")
        return DeletedError(f"{self.kind} {self.id}: was deleted at {moment}{by}{why}", field=self.kind)


def bury(session: Session, kind: Kind, key: str, by: str, why: str, sha256: str = "") -> None:
    """Note in a transaction that something is deleted."""
    row = TombstoneRow(kind=kind, id=key, sha256=sha256, deleted_at=now(), by=by, why=why)
    session.merge(row)


def dig_up(session: Session, kind: Kind, key: str) -> bool:
    """Forget in a transaction that something was deleted; return whether it was."""
    gone = delete(TombstoneRow).where(TombstoneRow.kind == kind, TombstoneRow.id == key)
    return session.execute(gone.returning(TombstoneRow.id)).first() is not None


def refuse_deleted(session: Session, kind: Kind, keys: Iterable[str]) -> None:
    """Refuse what was deleted.

    Raises
    ------
    DeletedError
        Of the first of them.
    """
    found = select(TombstoneRow).where(TombstoneRow.kind == kind, TombstoneRow.id.in_(list(keys)))
    row = session.scalar(found.limit(1))
    if row is not None:
        raise row.error()


def missing(database: ServiceDatabase, kind: Kind, key: str, otherwise: AppError) -> AppError:
    """Return why there is nothing of an id: it was deleted, or there never was."""
    if not key.isprintable() or not key.isascii() or len(key) > 200:
        return otherwise  # what can be no id does not reach the database
    with database.reading() as session:
        row = session.get(TombstoneRow, (kind, key))
    return otherwise if row is None else row.error()


def deleted(kind: Kind) -> Select[str]:
    """Return the query for the ids of what was deleted."""
    return select(TombstoneRow.id).where(TombstoneRow.kind == kind)


def checksums_of(database: ServiceDatabase, kind: Kind, keys: Iterable[str]) -> set[str]:
    """Return the checksums of what was deleted, of those of some ids that have one."""
    query = select(TombstoneRow.sha256).where(TombstoneRow.kind == kind, TombstoneRow.id.in_(list(keys)))
    with database.reading() as session:
        return set(session.scalars(query))
