"""What the service keeps: uploaded recordings as files by content, what is known of them in a database."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO

from sqlalchemy import Select, select
from sqlalchemy.engine import URL
from sqlalchemy.orm import Session

from jointplay.app.errors import UnknownDiagnosisError, UnknownMeasurementError
from jointplay.app.storage.assets import touch_owners
from jointplay.app.storage.database import ServiceDatabase, database_url
from jointplay.app.storage.rows import Base, DiagnosisRow, MeasurementRow, MomentSource, Row, newest, now
from jointplay.app.storage.told import Told
from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.storage.directory import sync_folder

PARTIAL = "partial-"
"""Beginning of the name of an upload that is on its way."""

RECORDINGS = "measurements"
"""Folder of uploads."""

ABANDONED_S = 86_400.0
"""Age from which on nobody is sending it any more."""


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


@dataclass(frozen=True)
class NewDiagnosis:
    """A diagnosis that is to be stored.

    Parameters
    ----------
    measurement, catalogue, machine, request, result
        As in :class:`DiagnosisRow`. Where the request names an asset, the diagnosis is of that asset alone.
    also : callable, optional
        Called with the id in the same transaction, if the diagnosis is new.
    """

    measurement: str
    catalogue: str
    machine: Mapping[str, Any]
    request: Mapping[str, Any]
    result: Diagnosis
    also: Callable[[Session, str], None] | None = None

    def row(self) -> dict[str, Any]:
        """Return the members of the row."""
        of = " ".join(self.request.get("measurements") or [self.measurement])
        said = f"{of} {self.catalogue} {self.result.hash}"
        if self.request.get("asset"):
            said += f" {self.request['asset']}"
        return {
            "id": hashlib.sha256(said.encode()).hexdigest()[:32],
            "measurement": self.measurement,
            "catalogue": self.catalogue,
            "machine": dict(self.machine),
            "created_at": now(),
            "request": dict(self.request),
            "result": self.result.model_dump(mode="json"),
        }


class Store:
    """Recordings under one directory, and what is known of them in a database.

    Parameters
    ----------
    directory : Path
        Made when missing.
    url : str
        The database; by default a file of SQLite in the directory.

    Attributes
    ----------
    database : ServiceDatabase
        Other modules keep their tables in it, too.

    Raises
    ------
    AppError
        When the tables in the database are those of another version of the program.
    """

    def __init__(self, directory: Path, url: str = "") -> None:
        self._directory = directory
        self._files = directory / RECORDINGS
        self._files.mkdir(parents=True, exist_ok=True)
        self._tidy()
        file = URL.create("sqlite", database=str(directory / "service.sqlite"))
        self.database = ServiceDatabase(database_url(url) if url else file, Base.metadata)
        self._session = self.database.session

    def close(self) -> None:
        """Let go of the database."""
        self.database.close()

    def try_writing(self) -> None:
        """Write a file where uploads go, and delete it.

        Raises
        ------
        OSError
            When that cannot be done.
        """
        with tempfile.NamedTemporaryFile(dir=self._files, prefix=PARTIAL) as attempt:
            attempt.write(b"?")
            attempt.flush()

    def receive(self, source: BinaryIO) -> Upload:
        """Copy an upload below the directory, to the disk, and return where it is.

        The copy is this upload's own until it becomes a measurement. Each is to be settled once.
        """
        digest = hashlib.sha256()
        size = 0
        with tempfile.NamedTemporaryFile(dir=self._files, prefix=PARTIAL, delete=False) as partial:
            try:
                while block := source.read(1 << 20):
                    digest.update(block)
                    size += len(block)
                    partial.write(block)
                partial.flush()
                os.fsync(partial.fileno())
            except BaseException:
                Path(partial.name).unlink(missing_ok=True)
                raise
        return Upload(Path(partial.name), digest.hexdigest(), size)

    def _name(self, upload: Upload) -> None:
        """Give an upload the name of its content, to the disk, before a row says that it is there.

        A file that has this name is never deleted: another server may be about to store the same bytes. So bytes whose
        row cannot be committed stay, too; they lie there for whoever sends them again.
        """
        target = self.path_of(upload.sha256)
        target.parent.mkdir(exist_ok=True)
        sync_folder(self._files)
        try:
            os.replace(upload.path, target)
        except FileNotFoundError:
            if not target.is_file():  # else it has the name already
                raise
        sync_folder(target.parent)

    def _tidy(self) -> None:
        """Delete what killed servers left of uploads; young ones may be on their way to another server."""
        for path in self._files.glob(f"{PARTIAL}*"):
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < time.time() - ABANDONED_S:
                    path.unlink()

    def path_of(self, sha256: str) -> Path:
        """Return where the bytes with this checksum lie."""
        return recording_path(self._directory, sha256)

    def settle(self, upload: Upload) -> None:
        """Delete an upload, unless it became a measurement."""
        upload.path.unlink(missing_ok=True)

    def add_measurement(
        self,
        upload: Upload,
        name: str,
        told: Told | None,
        summary: Mapping[str, Any],
        also: Callable[[Session, str], None] | None = None,
    ) -> MeasurementRow:
        """Store a measurement, or return the one stored before from the same bytes, of which the same was said.

        When it was measured does not tell measurements apart: the same bytes were measured once. Whoever says it
        later corrects it.

        Parameters
        ----------
        upload, name, told
            As in :class:`MeasurementRow`.
        summary : Mapping
            As in :class:`MeasurementRow`, with ``measured_at`` besides: what the file says, in ISO 8601.
        also : callable, optional
            Called with the id in the same transaction.
        """
        self._name(upload)
        with self.database.writing() as session:
            kept = self._put_measurement(session, upload, name, told or Told(), summary)
            if also is not None:
                also(session, kept.id)
        return kept

    def add_both(
        self, upload: Upload, name: str, told: Told, summary: Mapping[str, Any], diagnosis: NewDiagnosis
    ) -> DiagnosisRow:
        """Store a measurement and a diagnosis of it in one transaction, as one call after the other would."""
        self._name(upload)
        with self.database.writing() as session:
            self._put_measurement(session, upload, name, told, summary)
            kept = self._put_diagnosis(session, diagnosis)
        return kept

    def _put_measurement(
        self, session: Session, upload: Upload, name: str, told: Told, summary: Mapping[str, Any]
    ) -> MeasurementRow:
        held = dict(summary)
        received, in_file = now(), held.pop("measured_at", None)
        moment = told.measured_at or (datetime.fromisoformat(in_file) if in_file else received)
        source: MomentSource = "sender" if told.measured_at else "file" if in_file else "received"
        row = {
            "id": measurement_key(upload.sha256, name, told),
            "sha256": upload.sha256,
            "name": name,
            "size_bytes": upload.size,
            "said": told.shown,
            "created_at": received,
            "summary": held,
            "measured_at": moment,
            "measured_at_source": source,
        }
        kept, new = self._put(session, MeasurementRow, row)
        is_first_told = source == "file" and kept.measured_at_source == "received"
        if not new and (told.measured_at is not None or is_first_told):
            kept.measured_at, kept.measured_at_source = moment, source
            touch_owners(session, kept.id)
        return kept

    def _put(self, session: Session, table: type[Row], row: dict[str, Any]) -> tuple[Row, bool]:
        """Insert a row, or find the one of the same id; return it, and whether it is new."""
        statement = self.database.insert(table).values(row).on_conflict_do_nothing(index_elements=["id"])
        number = session.scalar(statement.returning(table.number))
        if number is not None:
            return table(number=number, **row), True
        return session.scalars(select(table).filter_by(id=row["id"])).one(), False

    def measurement(self, key: str) -> MeasurementRow:
        """Return a measurement.

        Raises
        ------
        UnknownMeasurementError
            When there is none of this id.
        """
        row = self.database.find(MeasurementRow, key)
        if row is None:
            raise UnknownMeasurementError(f"measurement {key[:80]}: there is none of this id", field="measurement")
        return row

    def correct_moment(self, key: str, measured_at: datetime) -> MeasurementRow:
        """Note when a stored measurement was made, as somebody says, and return it.

        Raises
        ------
        UnknownMeasurementError
            When there is none of this id.
        """
        number = self.measurement(key).number
        with self.database.writing() as session:
            row = session.get_one(MeasurementRow, number, with_for_update=True)
            row.measured_at, row.measured_at_source = measured_at, "sender"
            touch_owners(session, key)
        return row

    def measurements_between(
        self, among: Select[str], since: datetime, until: datetime | None, most: int
    ) -> list[MeasurementRow]:
        """Return measurements of some ids that were made from a moment on, and before another, the first first."""
        query = select(MeasurementRow).where(MeasurementRow.id.in_(among), MeasurementRow.measured_at >= since)
        if until is not None:
            query = query.where(MeasurementRow.measured_at < until)
        with self._session() as session:
            return list(session.scalars(query.order_by(MeasurementRow.measured_at, MeasurementRow.number).limit(most)))

    def add_diagnosis(self, diagnosis: NewDiagnosis) -> DiagnosisRow:
        """Store a finished diagnosis, or return the one stored before if it says the same of the same measurement."""
        with self.database.writing() as session:
            return self._put_diagnosis(session, diagnosis)

    def _put_diagnosis(self, session: Session, diagnosis: NewDiagnosis) -> DiagnosisRow:
        kept, new = self._put(session, DiagnosisRow, diagnosis.row())
        if new and diagnosis.also is not None:
            diagnosis.also(session, kept.id)
        return kept

    def diagnosis(self, key: str) -> DiagnosisRow:
        """Return a diagnosis.

        Raises
        ------
        UnknownDiagnosisError
            When there is none of this id.
        """
        row = self.database.find(DiagnosisRow, key)
        if row is None:
            raise UnknownDiagnosisError(f"diagnosis {key[:80]}: there is none of this id")
        return row

    def diagnoses(
        self, before: int | None, limit: int, since: datetime | None = None, among: Select[str] | None = None
    ) -> list[DiagnosisRow]:
        """Return diagnoses, the newest first, from below a row number on; not those before a moment.

        Parameters
        ----------
        before : int, optional
        limit : int
        since : datetime, optional
        among : Select, optional
            Query for the ids that may occur.
        """
        with self._session() as session:
            query = newest(session, DiagnosisRow, before, limit, among)
            if since is not None:
                query = query.where(DiagnosisRow.created_at >= since)
            return list(session.scalars(query))

    def measurements(self, before: int | None, limit: int, among: Select[str] | None = None) -> list[MeasurementRow]:
        """Return measurements, the newest first, from below a row number on; of the ids in a query, if there is one."""
        with self._session() as session:
            return list(session.scalars(newest(session, MeasurementRow, before, limit, among)))


def recording_path(directory: Path, sha256: str) -> Path:
    """Return where the bytes with a checksum lie below a folder of data."""
    return directory / RECORDINGS / sha256[:2] / sha256


def measurement_key(sha256: str, name: str, told: Told) -> str:
    """Return the id of a measurement: its bytes, and what its sender said of them but for when they were measured."""
    said = {"sha256": sha256, "name": name, **told.shown}
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:32]
