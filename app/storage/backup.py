"""A copy of everything a service keeps, made while it works, and the way back.

Rows come first, in one transaction that sees one moment; then the files that they speak of. Those never change once
they are named, and are there before a row says so: whatever is stored meanwhile is in no row of the copy.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Integer, func, insert, select
from sqlalchemy.engine import URL, make_url

from jointplay.app.errors import BackupError
from jointplay.app.storage import assets, build_queue, idempotency, keys, remembered, webhooks
from jointplay.app.storage.database import REVISION, ServiceDatabase, database_url
from jointplay.app.storage.rows import Base, MeasurementRow, now
from jointplay.app.storage.store import recording_path
from jointplay.catalogue.storage.directory import CatalogueDirectory, publish, sync_folder

#: All tables are known once the modules that define them are loaded.
_DEFINING = (assets, build_queue, idempotency, keys, remembered, webhooks)
TABLES = Base.metadata

FORMAT = 1
ROWS = "service.sqlite"
SEAL = "backup.json"
"""Written last: a folder without it is no backup."""

DERIVED = ("networks", "models", "matrix", "shards")
"""Folders of a catalogue, what may be thrown away first; the index is made again when it is needed."""

TRIES = 5
CHUNK = 500


@dataclass(frozen=True)
class Place:
    """Where a service keeps what it keeps.

    Parameters
    ----------
    data : Path
    catalogues : Path
    database : str
        URL; empty for a file of SQLite in `data`.
    """

    data: Path
    catalogues: Path
    database: str

    @property
    def url(self) -> URL:
        """URL of the database."""
        return database_url(self.database) if self.database else sqlite(self.data / ROWS)


def back_up(place: Place, target: Path, *, catalogues: bool = True) -> dict[str, Any]:
    """Copy everything a service keeps to a new folder; the service may go on meanwhile.

    Parameters
    ----------
    place : Place
    target : Path
        New or empty; nobody else may read it, as signing secrets of webhooks are in it.
    catalogues : bool
        Whether to copy the catalogues, too, which could be built again.

    Returns
    -------
    dict
        What is in it.

    Raises
    ------
    BackupError
        There is nothing to copy, the folder is not empty, or a recording is not what it was.
    """
    if not place.database and not (place.data / ROWS).is_file():
        raise BackupError(f"{place.data}: holds no data of a service")
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise BackupError(f"{target}: must be a new or empty folder")
    target.mkdir(mode=0o700, parents=True, exist_ok=True)
    with open_database(place.url) as source, open_database(sqlite(target / ROWS)) as copy:
        counts = copy_rows(source, copy)
        with copy.reading() as session:
            recordings = sorted(set(session.scalars(select(MeasurementRow.sha256))))
    for sha256 in recordings:
        copy_recording(place.data, target, sha256)
    machines = copy_machines(place.data, target)
    names = (
        [copy_catalogue(path, target / "catalogues" / name) for name, path in find_catalogues(place)]
        if catalogues
        else []
    )
    content = {
        "format": FORMAT,
        "made_at": now().isoformat().replace("+00:00", "Z"),
        "revision": REVISION,
        "rows": counts,
        "recordings": len(recordings),
        "machines": machines,
        "catalogues": names,
    }
    publish(target / SEAL, (json.dumps(content, indent=1) + "\n").encode())
    return content


def restore(source: Path, place: Place) -> dict[str, Any]:
    """Bring a backup to where a service is to find it.

    Parameters
    ----------
    source : Path
        As :func:`back_up` made it; it stays as it is.
    place : Place
        Empty; its database may be of another kind than that of the copied service.

    Returns
    -------
    dict
        What was in it.

    Raises
    ------
    BackupError
        It is no complete backup, something in it is not what it was, or there is something at the place already.
    """
    content = read_seal(source)
    if (source / "catalogues").is_dir() and any(find_catalogues(place)):
        raise BackupError(f"{place.catalogues}: holds catalogues already")
    for name in ("measurements", "machines"):
        if (place.data / name).is_dir() and any((place.data / name).iterdir()):
            raise BackupError(f"{place.data / name}: is not empty")
    place.data.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch, open_database(place.url) as target:
        if rows_in(target):
            raise BackupError(f"{target.name}: holds data already")
        rows = Path(scratch) / ROWS  # one of an older version is brought up to date there, not in the backup
        shutil.copyfile(source / ROWS, rows)
        with open_database(sqlite(rows)) as copy:
            with copy.reading() as session:
                for sha256 in set(session.scalars(select(MeasurementRow.sha256))):
                    copy_recording(source, place.data, sha256)
            copy_machines(source, place.data)
            for name in content["catalogues"]:
                copy_catalogue(source / "catalogues" / name, place.catalogues / name)
            copy_rows(copy, target)  # last: rows speak of files
    return content


def read_seal(source: Path) -> dict[str, Any]:
    """Return what a backup says of itself.

    Raises
    ------
    BackupError
        It is none, is not complete, or of a later version.
    """
    try:
        content: dict[str, Any] = json.loads((source / SEAL).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise BackupError(f"{source}: is no complete backup: it has no {SEAL}") from None
    except ValueError:
        raise BackupError(f"{source / SEAL}: is damaged") from None
    if content.get("format") != FORMAT:
        raise BackupError(f"{source}: has format {content.get('format')}; this program reads {FORMAT}")
    return content


def sqlite(path: Path) -> URL:
    """Return the URL of a file."""
    return URL.create("sqlite", database=str(path))


@contextmanager
def open_database(url: URL) -> Iterator[ServiceDatabase]:
    """A database, which is made or brought up to date."""
    database = ServiceDatabase(make_url(url), TABLES)
    try:
        yield database
    finally:
        database.close()


def rows_in(database: ServiceDatabase) -> int:
    """Return the number of rows in all tables."""
    with database.reading() as session:
        return sum(session.scalar(select(func.count()).select_from(table)) or 0 for table in TABLES.sorted_tables)


def copy_rows(source: ServiceDatabase, target: ServiceDatabase) -> dict[str, int]:
    """Copy all rows as they are at one moment, in one transaction; returns how many each table has."""
    counts: dict[str, int] = {}
    with source.engine.connect() as plain, target.writing() as session:
        # SQLite shows a transaction one moment anyway.
        reading = plain if source.is_sqlite else plain.execution_options(isolation_level="REPEATABLE READ")
        for table in TABLES.sorted_tables:
            counts[table.name] = 0
            for chunk in reading.execute(select(table)).mappings().partitions(CHUNK):
                session.execute(insert(table), [dict(row) for row in chunk])
                counts[table.name] += len(chunk)
            if not target.is_sqlite:  # whose counters follow the rows by themselves
                for column in table.primary_key.columns:
                    if isinstance(column.type, Integer) and counts[table.name]:
                        sequence = func.pg_get_serial_sequence(table.name, column.name)
                        session.execute(select(func.setval(sequence, select(func.max(column)).scalar_subquery())))
    return counts


def copy_recording(source: Path, target: Path, sha256: str) -> None:
    """Copy a recording from one folder of data to another, and check that it is what it was."""
    place = recording_path(target, sha256)
    place.parent.mkdir(parents=True, exist_ok=True)
    try:
        digest = copy_file(recording_path(source, sha256), place)
    except FileNotFoundError:
        raise BackupError(f"{source}: the recording {sha256} is missing") from None
    if digest != sha256:
        raise BackupError(f"{source}: the recording {sha256} is not what it was")


def copy_machines(source: Path, target: Path) -> int:
    """Copy machines that were put there, and what they were before; returns how many."""
    files = sorted((source / "machines").rglob("*.json"))
    for file in files:
        place = target / file.relative_to(source)
        place.parent.mkdir(parents=True, exist_ok=True)
        copy_file(file, place)
    return sum(file.parent.name == "machines" for file in files)


def find_catalogues(place: Place) -> Iterator[tuple[str, Path]]:
    """Give names and folders of the catalogues of a service."""
    if CatalogueDirectory(place.catalogues).manifest.is_file():
        yield place.catalogues.resolve().name, place.catalogues
    elif place.catalogues.is_dir():
        for path in sorted(place.catalogues.iterdir()):
            if CatalogueDirectory(path).manifest.is_file():
                yield path.name, path


def copy_catalogue(source: Path, target: Path) -> str:
    """Copy a catalogue as its manifest says it is; one that a build changes meanwhile is copied anew."""
    manifest = CatalogueDirectory(source).manifest
    for _ in range(TRIES):
        shutil.rmtree(target, ignore_errors=True)
        before = manifest.read_bytes()
        try:
            for name in DERIVED:
                copy_folder(source / name, target / name)
        except FileNotFoundError:  # the end of a build has put another in its place
            continue
        if manifest.read_bytes() == before:
            publish(target / manifest.name, before)
            return target.name
    raise BackupError(f"{source}: changed {TRIES} times while it was copied; try again later")


def copy_folder(source: Path, target: Path) -> None:
    """Copy the finished files of a folder and those below it."""
    target.mkdir(parents=True, exist_ok=True)
    for path in sorted(source.iterdir()) if source.is_dir() else ():
        if path.name.startswith("."):
            continue  # somebody is writing it
        if path.is_dir():
            copy_folder(path, target / path.name)
        else:
            copy_file(path, target / path.name)
    sync_folder(target)


def copy_file(source: Path, target: Path) -> str:
    """Copy a file to the disk; returns the SHA-256 of what was copied."""
    digest = hashlib.sha256()
    with open(source, "rb") as reading, open(target, "wb") as writing:
        while block := reading.read(1 << 20):
            digest.update(block)
            writing.write(block)
        writing.flush()
        os.fsync(writing.fileno())
    return digest.hexdigest()
