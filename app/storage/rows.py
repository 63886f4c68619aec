"""Tables of the service: their common root, and those of recordings and diagnoses."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cached_property
from typing import Any, ClassVar, Literal, TypeVar

from sqlalchemy import JSON, BigInteger, ForeignKey, Select, String, select
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column

from jointplay.app.storage.database import UtcDateTime
from jointplay.app.storage.told import Told
from jointplay.catalogue.diagnosing.answer import Diagnosis


class Base(DeclarativeBase):
    """Root of the tables.

    A new table needs no revision: one that is missing is made on opening. A change of one that is there does.
    """

    type_annotation_map: ClassVar = {dict[str, Any]: JSON, datetime: UtcDateTime}


MomentSource = Literal["sender", "file", "received"]
"""Who says when a measurement was made: its sender, its file, or nobody, so that it is the moment of receipt."""


class MeasurementRow(Base):
    """An uploaded recording."""

    __tablename__ = "measurements"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    sha256: Mapped[str] = mapped_column(String(64))
    name: Mapped[str] = mapped_column(String(255))
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    said: Mapped[dict[str, Any]]
    created_at: Mapped[datetime]
    summary: Mapped[dict[str, Any]]
    measured_at: Mapped[datetime]
    measured_at_source: Mapped[str] = mapped_column(String(16))

    @property
    def told(self) -> Told:
        """What its sender said of it."""
        return Told(**self.said, measured_at=self.measured_at if self.measured_at_source == "sender" else None)


class DiagnosisRow(Base):
    """A finished diagnosis: what was asked, of which machine, and what was answered.

    The machine is kept with it, because a catalogue that has grown has another id than when it was asked.
    """

    __tablename__ = "diagnoses"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    measurement: Mapped[str] = mapped_column(ForeignKey("measurements.id"))
    catalogue: Mapped[str] = mapped_column(String(64))
    machine: Mapped[dict[str, Any]]
    created_at: Mapped[datetime]
    request: Mapped[dict[str, Any]]
    result: Mapped[dict[str, Any]]

    @property
    def measurements(self) -> tuple[str, ...]:
        """Ids of all measurements that have this answer."""
        return tuple(self.request.get("measurements") or [self.measurement])

    @cached_property
    def answer(self) -> Diagnosis:
        """What was answered."""
        return Diagnosis.model_validate(self.result)


Row = TypeVar("Row", MeasurementRow, DiagnosisRow)


def newest(session: Session, table: Any, before: int | None, limit: int, among: Select[str] | None = None) -> Any:
    """Return the query for one page of a table, the newest rows first; of the ids in a query, if there is one."""
    query = select(table).order_by(table.number.desc()).limit(limit)
    if among is not None:
        query = query.where(table.id.in_(among))
    return query if before is None else query.where(table.number < before)


def now() -> datetime:
    """Return the present time in UTC."""
    return datetime.now(UTC)
