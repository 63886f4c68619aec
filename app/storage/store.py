"""What the service keeps: uploaded recordings as files by content, what is known of them in a database."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy import Select, select
from sqlalchemy.engine import URL
from sqlalchemy.orm import Session

from jointplay.app.errors import BusyError, UnknownDiagnosisError, UnknownMeasurementError
from jointplay.app.storage import audit
from jointplay.app.storage.assets import touch_owners, touch_taught
from jointplay.app.storage.database import ServiceDatabase, database_url
from jointplay.app.storage.idempotency import Claims
from jointplay.app.storage.retention import Quotas
from jointplay.app.storage.rows import (
    Base,
    Damaged,
    DiagnosisRow,
    MeasurementRow,
    MomentSource,
    Row,
    newest,
    now,
    one_of,
    rows_of,
)
from jointplay.app.storage.stored_files import StoredFiles, recording_path
from jointplay.app.storage.told import Told
from jointplay.app.storage.tombstones import TombstoneRow, deleted, dig_up, missing, refuse_deleted
from jointplay.app.storage.uploads import Upload, Uploads
from jointplay.catalogue.diagnosing.answer import Diagnosis


@dataclass(frozen=True)
class NewDiagnosis:
    """A diagnosis that is to be stored.

    Parameters
    ----------
    measurement, catalogue, machine, request, result
        As in :class:`DiagnosisRow`. Where the request names an asset, the diagnosis is of that asset alone.
    also : callable, optional
        Called in the same transaction with the id, and whether the diagnosis is new.
    """

    measurement: str
    catalogue: str
    machine: Mapping[str, Any]
    request: Mapping[str, Any]
    result: Diagnosis
    also: Callable[[Session, str, bool], None] | None = None

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
    quotas : Quotas, optional
        How much may be stored; as much as there is space for by default.

    Attributes
    ----------
    database : ServiceDatabase
        Other modules keep their tables in it, too.
    claims : Claims
        Of keys of idempotency.
    files : StoredFiles
        What lies in the folder, and may be deleted.
    uploads : Uploads
        What is on its way into it.

    Raises
    ------
    AppError
        When the tables in the database are those of another version of the program.
    """

    def __init__(self, directory: Path, url: str = "", quotas: Quotas | None = None) -> None:
        self.directory = directory
        self._quotas = quotas or Quotas()
        directory.mkdir(parents=True, exist_ok=True)
        file = URL.create("sqlite", database=str(directory / "service.sqlite"))
        self.database = ServiceDatabase(database_url(url) if url else file, Base.metadata)
        self.files = StoredFiles(directory, self.database)
        self.uploads = Uploads(directory, self.files)
        self.files.settle()
        self.claims = Claims(self.database)  # before what ends a transaction: that waits for nothing any more
        audit.attend(self.database)
        self._session = self.database.session

    def close(self) -> None:
        """Let go of the database."""
        self.database.close()

    def path_of(self, sha256: str) -> Path:
        """Return where the bytes with this checksum lie."""
        return recording_path(self.directory, sha256)

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

        Raises
        ------
        QuotaError
            When it is more than may be stored.
        BusyError
            When the same bytes were deleted at this moment.
        """
        with self.uploads.named(upload), self.database.writing() as session:
            kept, _ = self._put_measurement(session, upload, name, told or Told(), summary)
            if also is not None:
                also(session, kept.id)
        return kept

    def add_both(
        self, upload: Upload, name: str, told: Told, summary: Mapping[str, Any], diagnosis: NewDiagnosis
    ) -> DiagnosisRow:
        """Store a measurement and a diagnosis of it in one transaction, as one call after the other would."""
        with self.uploads.named(upload), self.database.writing() as session:
            _, new = self._put_measurement(session, upload, name, told, summary)
            if not new:  # what nobody else knows yet, nobody has deleted
                refuse_deleted(session, "measurement", [diagnosis.measurement])
            kept = self._put_diagnosis(session, diagnosis)
        return kept

    def _put_measurement(
        self, session: Session, upload: Upload, name: str, told: Told, summary: Mapping[str, Any]
    ) -> tuple[MeasurementRow, bool]:
        """Return what is stored, and whether it was not there before."""
        self.files.lock(session, alone=False)
        if not self.path_of(upload.sha256).is_file():
            raise BusyError("the same bytes were deleted at this moment; send them again")
        held = dict(summary)
        received, in_file = now(), held.pop("measured_at", None)
        of_file = datetime.fromisoformat(in_file) if in_file else received
        is_of_file = of_file < received  # what is later was read as UTC, and is of a clock further east
        moment = told.measured_at or (of_file if is_of_file else received)
        source: MomentSource = "sender" if told.measured_at else "file" if is_of_file else "received"
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
        row = MeasurementRow.seal(row)
        kept, new = self._put(session, MeasurementRow, row)
        if not new and dig_up(session, "measurement", kept.id):  # what was deleted is there again, as it is sent now
            for name_of, value in row.items():
                setattr(kept, name_of, value)
            session.flush()
            touch_owners(session, kept.id)
            new = True
        if new:
            self._quotas.take(session, upload.size)
        is_first_told = source == "file" and kept.measured_at_source == "received" and of_file < kept.created_at
        if new:
            audit.note(session, "made", "measurement", kept.id, after=about_measurement(kept))
        elif told.measured_at is not None or is_first_told:
            correct(session, kept, moment, source)
        return kept, new

    def _put(self, session: Session, table: type[Row], row: dict[str, Any]) -> tuple[Row, bool]:
        """Insert a row, or find the one of the same id; return it, and whether it is new."""
        number = session.scalar(self.database.insert_new(table), row)
        if number is not None:
            return table(number=number, **row), True
        return session.scalars(select(table).filter_by(id=row["id"])).one(), False

    def measurement(self, key: str) -> MeasurementRow:
        """Return a measurement.

        Raises
        ------
        UnknownMeasurementError
            When there is none of this id.
        DeletedError
            When it was deleted.
        """
        row = one_of(self.database, MeasurementRow, key)
        if row is None:
            raise UnknownMeasurementError(f"measurement {key[:80]}: there is none of this id", field="measurement")
        with self._session() as session:
            refuse_deleted(session, "measurement", [key])
        return row

    def measurement_of(self, diagnosis: DiagnosisRow) -> MeasurementRow:
        """Return the measurement of a diagnosis, of several the first; also when it was deleted."""
        with self._session() as session:
            return session.scalars(select(MeasurementRow).filter_by(id=diagnosis.measurement)).one()

    def deleted_of(self, diagnosis: DiagnosisRow) -> list[str]:
        """Return which of the measurements of a diagnosis were deleted."""
        with self._session() as session:
            gone = set(session.scalars(deleted("measurement").where(TombstoneRow.id.in_(diagnosis.measurements))))
        return [key for key in diagnosis.measurements if key in gone]

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
            correct(session, row, measured_at, "sender")
        return row

    def measurements_between(
        self, among: Select[str], since: datetime, until: datetime | None, most: int, *, without: Iterable[str] = ()
    ) -> list[MeasurementRow]:
        """Return measurements of some ids that were made from a moment on, and before another, the first first.

        Those of bytes with some checksums, `without`, are left out.
        """
        query = select(MeasurementRow).where(MeasurementRow.id.in_(among), MeasurementRow.measured_at >= since)
        query = query.where(MeasurementRow.id.not_in(deleted("measurement")), MeasurementRow.sha256.not_in(without))
        if until is not None:
            query = query.where(MeasurementRow.measured_at < until)
        with self._session() as session:
            ordered = query.order_by(MeasurementRow.measured_at, MeasurementRow.number).limit(most)
            return rows_of(session, MeasurementRow, ordered, None)

    def add_diagnosis(self, diagnosis: NewDiagnosis) -> DiagnosisRow:
        """Store a finished diagnosis, or return the one stored before if it says the same of the same measurement."""
        with self.database.writing() as session:
            refuse_deleted(session, "measurement", diagnosis.request.get("measurements") or [diagnosis.measurement])
            return self._put_diagnosis(session, diagnosis)

    def _put_diagnosis(self, session: Session, diagnosis: NewDiagnosis) -> DiagnosisRow:
        kept, new = self._put(session, DiagnosisRow, DiagnosisRow.seal(diagnosis.row()))
        if new:
            kept.answer = diagnosis.result  # not read again from what was just made of it
            audit.note(session, "made", "diagnosis", kept.id, after=about_diagnosis(kept))
        if diagnosis.also is not None:
            diagnosis.also(session, kept.id, new)
        return kept

    def diagnosis(self, key: str) -> DiagnosisRow:
        """Return a diagnosis.

        Raises
        ------
        UnknownDiagnosisError
            When there is none of this id.
        DeletedError
            When it was deleted.
        """
        row = one_of(self.database, DiagnosisRow, key)
        if row is None:
            unknown = UnknownDiagnosisError(f"diagnosis {key[:80]}: there is none of this id")
            raise missing(self.database, "diagnosis", key, unknown)
        return row

    def diagnoses(
        self,
        before: int | None,
        limit: int,
        since: datetime | None = None,
        among: Select[str] | None = None,
        damaged: list[Damaged] | None = None,
    ) -> list[DiagnosisRow]:
        """Return diagnoses, the newest first, from below a row number on; not those before a moment.

        Parameters
        ----------
        before : int, optional
        limit : int
        since : datetime, optional
        among : Select, optional
            Query for the ids that may occur.
        damaged : list, optional
            Is given those that are damaged; without it one such is refused.
        """
        with self._session() as session:
            query = newest(session, DiagnosisRow, before, limit, among)
            if since is not None:
                query = query.where(DiagnosisRow.created_at >= since)
            return rows_of(session, DiagnosisRow, query, damaged)

    def measurements(
        self,
        before: int | None,
        limit: int,
        among: Select[str] | None = None,
        damaged: list[Damaged] | None = None,
        *,
        gone: bool = False,
    ) -> list[MeasurementRow]:
        """Return measurements, the newest first, from below a row number on; the rest as for :meth:`diagnoses`.

        Those that were deleted occur, too, where `gone` is true: diagnoses go on speaking of them.
        """
        with self._session() as session:
            query = newest(session, MeasurementRow, before, limit, among)
            if not gone:
                query = query.where(MeasurementRow.id.not_in(deleted("measurement")))
            return rows_of(session, MeasurementRow, query, damaged)


def correct(session: Session, row: MeasurementRow, moment: datetime, source: MomentSource) -> None:
    """Note in a transaction when a measurement was made, as somebody says who knows better."""
    before = about_measurement(row)
    row.measured_at, row.measured_at_source = moment, source
    if about_measurement(row) != before:
        audit.note(session, "corrected", "measurement", row.id, before, about_measurement(row))
    touch_taught(session, row.id)


def about_measurement(row: MeasurementRow) -> dict[str, Any]:
    """Return what the audit log says of a measurement."""
    names = ("sha256", "name", "size_bytes", "said", "measured_at", "measured_at_source")
    return {name: getattr(row, name) for name in names}


def about_diagnosis(row: DiagnosisRow) -> dict[str, Any]:
    """Return what the audit log says of a diagnosis."""
    told = {"measurements": list(row.measurements), "catalogue": row.catalogue, **row.request}
    return told | {name: row.result[name] for name in ("verdict", "candidate_set", "hash") if name in row.result}


def measurement_key(sha256: str, name: str, told: Told) -> str:
    """Return the id of a measurement: its bytes, and what its sender said of them but for when they were measured."""
    said = {"sha256": sha256, "name": name, **told.shown}
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:32]
