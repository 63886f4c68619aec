"""Tables of the service: their common root, and those of recordings and diagnoses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from typing import Any, ClassVar, Literal, TypeVar

from sqlalchemy import JSON, BigInteger, ForeignKey, Select, String, event, select
from sqlalchemy.exc import DatabaseError, OperationalError
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column

from jointplay.app.actor import actor
from jointplay.app.errors import DamagedDatabaseError, DamagedRowError
from jointplay.app.storage.checksums import Written, row_checksum
from jointplay.app.storage.database import ServiceDatabase, UtcDateTime, is_id
from jointplay.app.storage.told import Told
from jointplay.catalogue.diagnosing.answer import Diagnosis


class Base(DeclarativeBase):
    """Root of the tables.

    A new table needs no revision: one that is missing is made on opening. A change of one that is there does.
    """

    type_annotation_map: ClassVar = {dict[str, Any]: JSON, datetime: UtcDateTime}


MADE_BY = 256
"""Longest name of who made a row, as far as it is kept; nobody else is counted by it."""


class Sealed:
    """A row with a checksum of what it holds: set whenever it is written, checked whenever it is read."""

    NAME: ClassVar[str] = "id"
    SEALED: ClassVar[tuple[str, ...]]
    """Columns that the checksum is of."""

    checksum: Mapped[str] = mapped_column(String(64))
    made_by: Mapped[str | None] = mapped_column(String(MADE_BY))

    @classmethod
    def seal(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of a row that is made, with who makes it and the checksum of all."""
        made: dict[str, Any] = {"made_by": actor().name[:MADE_BY]}
        for name, value in values.items():
            made[name] = Written.of(value) if isinstance(value, Mapping) else value
        return {**made, "checksum": row_checksum({name: made[name] for name in cls.SEALED})}

    def check(self) -> None:
        """Refuse a row of which something is damaged that stands in other rows."""

    def digest(self) -> str:
        """Return the checksum of what the row holds."""
        return row_checksum({name: getattr(self, name) for name in self.SEALED})


@event.listens_for(Sealed, "load", propagate=True)
@event.listens_for(Sealed, "refresh", propagate=True)
def check_row(row: Any, *_: object) -> None:
    """Refuse a row that is not what was written.

    Raises
    ------
    DamagedRowError
    """
    if row.digest() != row.checksum:
        raise damaged_row(row.__tablename__, getattr(row, row.NAME), row.number)


@event.listens_for(Sealed, "before_insert", propagate=True)
@event.listens_for(Sealed, "before_update", propagate=True)
def seal_again(_mapper: object, _connection: object, row: Any) -> None:
    """Give a row that is made or changes the checksum of what it is then."""
    row.checksum = row.digest()


def damaged_row(table: str, name: str, number: int) -> DamagedRowError:
    """Return the error for a row that is not what was written, or cannot be read."""
    shown = "".join(letter if letter.isprintable() else "?" for letter in str(name))[:40]
    said = f"{SINGULAR.get(table, table)} {shown}: its row is not what was written; bring it back from a backup"
    return DamagedRowError(said, number=number)


SINGULAR = {"measurements": "measurement", "diagnoses": "diagnosis", "findings": "finding", "assets": "asset"}


MomentSource = Literal["sender", "file", "received"]
"""Who says when a measurement was made: its sender, its file, or nobody, so that it is the moment of receipt."""


class MeasurementRow(Sealed, Base):
    """An uploaded recording."""

    __tablename__ = "measurements"
    SEALED: ClassVar = (
        *("id", "sha256", "name", "size_bytes", "said", "created_at", "summary", "measured_at", "measured_at_source"),
        "made_by",
    )

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    sha256: Mapped[str] = mapped_column(String(64), index=True)
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


class DiagnosisRow(Sealed, Base):
    """A finished diagnosis: what was asked, of which machine, and what was answered.

    The machine is kept with it, because a catalogue that has grown has another id than when it was asked.
    """

    __tablename__ = "diagnoses"
    SEALED: ClassVar = (
        *("id", "measurement", "catalogue", "machine", "created_at", "request", "result"),
        "made_by",
    )

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    measurement: Mapped[str] = mapped_column(ForeignKey("measurements.id"), index=True)
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


@dataclass(frozen=True)
class Damaged:
    """A row that a list has, but cannot show.

    Parameters
    ----------
    number : int
        Its place.
    id : str
        Empty where even that cannot be read.
    problem : str
        What is wrong, in a line.
    """

    number: int
    id: str
    problem: str


Any_Row = TypeVar("Any_Row")


def rows_of(session: Session, table: type[Any_Row], query: Any, damaged: list[Damaged] | None) -> list[Any_Row]:
    """Return the rows of a query; what is damaged among them is put into a list, if there is one.

    Raises
    ------
    DamagedRowError
        One is damaged, and there is no such list.
    """

    def checked(rows: Iterable[Any]) -> list[Any]:
        found = list(rows)
        for row in found:
            row.check()
        return found

    try:
        return checked(session.scalars(query))
    except UNREADABLE as error:
        if is_passing(error):
            raise
        found: Any = table
        intact = []
        for number in session.scalars(query.with_only_columns(found.number)).all():
            session.expunge_all()
            try:
                intact += checked(session.scalars(select(table).where(found.number == number)))
            except UNREADABLE as problem:
                name = name_of(session, found, number)
                named = damaged_row(found.__tablename__, name or f"in row {number}", number)
                if damaged is None:
                    raise named from problem
                damaged.append(Damaged(number, name, str(named)))
        return intact


def one_of(database: ServiceDatabase, table: type[Any_Row], key: str) -> Any_Row | None:
    """Return the row of an id; None where there is none.

    Raises
    ------
    DamagedRowError
        When it is damaged.
    """
    if not is_id(key):
        return None
    found: Any = table
    with database.reading() as session:
        rows = rows_of(session, table, select(table).where(getattr(found, found.NAME) == key), None)
    return rows[0] if rows else None


UNREADABLE = (DamagedRowError, DamagedDatabaseError, ValueError, TypeError, DatabaseError)
"""What reading a damaged row may raise: its checksum, JSON or a moment that is none, a text that is none."""


def is_passing(error: Exception) -> bool:
    """Return whether a database could not be asked, rather than not be read."""
    return isinstance(error, OperationalError) and not any(said in str(error) for said in ("decode", "malformed JSON"))


def name_of(session: Session, table: Any, number: int) -> str:
    """Return the id of a row; empty where it cannot be read."""
    try:
        return str(session.scalar(select(getattr(table, table.NAME)).where(table.number == number)) or "")
    except UNREADABLE:
        return ""


def newest(session: Session, table: Any, before: int | None, limit: int, among: Select[str] | None = None) -> Any:
    """Return the query for one page of a table, the newest rows first; of the ids in a query, if there is one."""
    query = select(table).order_by(table.number.desc()).limit(limit)
    if among is not None:
        query = query.where(table.id.in_(among))
    return query if before is None else query.where(table.number < before)


def now() -> datetime:
    """Return the present time in UTC."""
    return datetime.now(UTC)
