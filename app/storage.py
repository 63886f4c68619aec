"""What the service keeps: uploaded recordings as files by content, their descriptions and the diagnoses in SQLite."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, ClassVar

from sqlalchemy import JSON, DateTime, ForeignKey, String, create_engine, event, select, text
from sqlalchemy.dialects.sqlite import insert
from sqlalchemy.engine import Engine
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column, sessionmaker

from app.errors import AppError, UnknownDiagnosisError, UnknownMeasurementError

SCHEMA_VERSION = 1


class Base(DeclarativeBase):
    """Root of the tables."""

    type_annotation_map: ClassVar = {dict[str, Any]: JSON, datetime: DateTime(timezone=True)}


class MeasurementRow(Base):
    """An uploaded recording."""

    __tablename__ = "measurements"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    sha256: Mapped[str] = mapped_column(String(64))
    name: Mapped[str] = mapped_column(String(255))
    size_bytes: Mapped[int]
    given_sample_rate_hz: Mapped[float | None]
    created_at: Mapped[datetime]
    summary: Mapped[dict[str, Any]]


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


@dataclass(frozen=True)
class Upload:
    """A file on its way in.

    Parameters
    ----------
    path : Path
        Where its bytes lie.
    sha256 : str
        Of the bytes.
    size : int
        Number of bytes.
    """

    path: Path
    sha256: str
    size: int


class Store:
    """Recordings and diagnoses under one directory.

    Parameters
    ----------
    directory : Path
        Made when missing.

    Raises
    ------
    AppError
        When the data base was made by a newer version of the program.
    """

    def __init__(self, directory: Path) -> None:
        self._files = directory / "measurements"
        self._files.mkdir(parents=True, exist_ok=True)
        self._engine = create_engine(f"sqlite:///{directory / 'service.sqlite'}")
        event.listen(self._engine, "connect", configure)
        adopt(self._engine, directory)
        self._session = sessionmaker(self._engine, expire_on_commit=False)
        self._lock = threading.Lock()
        self._in_use: Counter[str] = Counter()

    def close(self) -> None:
        """Let go of the data base."""
        self._engine.dispose()

    def ready(self) -> bool:
        """Return whether the data base answers."""
        with self._session() as session:
            return bool(session.execute(text("SELECT 1")).scalar_one())

    def receive(self, source: BinaryIO) -> Upload:
        """Copy an upload below the directory, named by its content, and return where it is.

        The copy appears under its name only when it is whole and on disk. Each is to be settled once.
        """
        digest = hashlib.sha256()
        size = 0
        with tempfile.NamedTemporaryFile(dir=self._files, delete=False) as partial:
            try:
                while block := source.read(1 << 20):
                    digest.update(block)
                    size += len(block)
                    partial.write(block)
                partial.flush()
                os.fsync(partial.fileno())
            except BaseException:
                os.unlink(partial.name)
                raise
        target = self.path_of(digest.hexdigest())
        target.parent.mkdir(exist_ok=True)
        with self._lock:
            self._in_use[digest.hexdigest()] += 1
            shutil.move(partial.name, target)
        return Upload(target, digest.hexdigest(), size)

    def path_of(self, sha256: str) -> Path:
        """Return where the bytes with this checksum lie."""
        return self._files / sha256[:2] / sha256

    def settle(self, upload: Upload) -> None:
        """Delete an upload that became no measurement, unless somebody else is sending the same bytes just now."""
        with self._lock, self._session() as session:
            self._in_use[upload.sha256] -= 1
            if self._in_use[upload.sha256]:
                return
            del self._in_use[upload.sha256]
            if session.scalar(select(MeasurementRow.id).where(MeasurementRow.sha256 == upload.sha256).limit(1)) is None:
                upload.path.unlink(missing_ok=True)

    def add_measurement(
        self, upload: Upload, name: str, sample_rate_hz: float | None, summary: Mapping[str, Any]
    ) -> MeasurementRow:
        """Store a measurement, or return the one stored before from the same bytes under the same name."""
        key = measurement_key(upload.sha256, name, sample_rate_hz)
        row = {
            "id": key,
            "sha256": upload.sha256,
            "name": name,
            "size_bytes": upload.size,
            "given_sample_rate_hz": sample_rate_hz,
            "created_at": now(),
            "summary": dict(summary),
        }
        with self._session.begin() as session:
            session.execute(insert(MeasurementRow).values(row).on_conflict_do_nothing(index_elements=["id"]))
        return self.measurement(key)

    def measurement(self, key: str) -> MeasurementRow:
        """Return a measurement.

        Raises
        ------
        UnknownMeasurementError
            When there is none of this id.
        """
        with self._session() as session:
            row = session.scalar(select(MeasurementRow).where(MeasurementRow.id == key))
        if row is None:
            raise UnknownMeasurementError(f"measurement {key}: there is none of this id", field="measurement")
        return row

    def add_diagnosis(
        self,
        measurement: str,
        catalogue: str,
        machine: Mapping[str, Any],
        request: Mapping[str, Any],
        result: Mapping[str, Any],
    ) -> DiagnosisRow:
        """Store a finished diagnosis, or return the one stored before if it says the same of the same measurement."""
        key = hashlib.sha256(f"{measurement} {catalogue} {result['hash']}".encode()).hexdigest()[:32]
        row = {
            "id": key,
            "measurement": measurement,
            "catalogue": catalogue,
            "machine": dict(machine),
            "created_at": now(),
            "request": dict(request),
            "result": dict(result),
        }
        with self._session.begin() as session:
            session.execute(insert(DiagnosisRow).values(row).on_conflict_do_nothing(index_elements=["id"]))
        return self.diagnosis(key)

    def diagnosis(self, key: str) -> DiagnosisRow:
        """Return a diagnosis.

        Raises
        ------
        UnknownDiagnosisError
            When there is none of this id.
        """
        with self._session() as session:
            row = session.scalar(select(DiagnosisRow).where(DiagnosisRow.id == key))
        if row is None:
            raise UnknownDiagnosisError(f"diagnosis {key}: there is none of this id")
        return row

    def diagnoses(self, before: int | None, limit: int) -> list[DiagnosisRow]:
        """Return diagnoses, the newest first, from below a row number on."""
        with self._session() as session:
            return list(session.scalars(newest(session, DiagnosisRow, before, limit)))

    def measurements(self, before: int | None, limit: int) -> list[MeasurementRow]:
        """Return measurements, the newest first, from below a row number on."""
        with self._session() as session:
            return list(session.scalars(newest(session, MeasurementRow, before, limit)))


def newest(session: Session, table: Any, before: int | None, limit: int) -> Any:
    """Return the query for one page of a table, the newest rows first."""
    query = select(table).order_by(table.number.desc()).limit(limit)
    return query if before is None else query.where(table.number < before)


def measurement_key(sha256: str, name: str, sample_rate_hz: float | None) -> str:
    """Return the id of a measurement: its bytes, and what its sender said of them."""
    content = json.dumps({"sha256": sha256, "name": name, "sample_rate_hz": sample_rate_hz}, sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:32]


def configure(connection: Any, _record: Any) -> None:
    """Set a new connection up: readers never wait for a writer, references are checked."""
    for pragma in ("journal_mode = WAL", "foreign_keys = ON", "busy_timeout = 10000", "synchronous = NORMAL"):
        connection.execute(f"PRAGMA {pragma}")


def adopt(engine: Engine, directory: Path) -> None:
    """Make the tables in a new data base; refuse one of another version."""
    with engine.begin() as connection:
        found = connection.execute(text("PRAGMA user_version")).scalar_one()
        if found not in (0, SCHEMA_VERSION):
            path = directory / "service.sqlite"
            raise AppError(f"{path}: has layout {found}, made by another version; this one reads {SCHEMA_VERSION}")
        Base.metadata.create_all(connection)
        connection.execute(text(f"PRAGMA user_version = {SCHEMA_VERSION}"))


def now() -> datetime:
    """Return the present time in UTC."""
    return datetime.now(UTC)


def aware(moment: datetime) -> datetime:
    """Return a stored time as UTC; SQLite forgets the zone."""
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
