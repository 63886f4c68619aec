"""A copy of everything a service keeps, made while it works, the way back, and whether that would lead anywhere.

Rows come first, in one transaction that sees one moment; then the files that they speak of. Those never change once
they are named, and are there before a row says so: whatever is stored meanwhile is in no row of the copy. What is
damaged is named and left out, and all else goes on: a backup that lacks one recording is worth more than none.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.engine import URL, make_url

from jointplay.app.errors import BackupError
from jointplay.app.storage import assets, belonging, build_queue, idempotency, keys, remembered, retention, webhooks
from jointplay.app.storage.belonging import BelongingRow
from jointplay.app.storage.copying import HASHES, Copier, Damage, copy_rows, digest_of, read_hashes
from jointplay.app.storage.database import REVISION, ServiceDatabase, database_url
from jointplay.app.storage.recording_files import NAMED
from jointplay.app.storage.rows import Base, MeasurementRow, now
from jointplay.app.storage.stored_files import recording_path
from jointplay.app.storage.tombstones import deleted
from jointplay.catalogue.storage.directory import CatalogueDirectory, publish

#: All tables are known once the modules that define them are loaded.
_DEFINING = (assets, belonging, build_queue, idempotency, keys, remembered, retention, webhooks)
TABLES = Base.metadata

FORMAT = 1
ROWS = "service.sqlite"
SEAL = "backup.json"
"""Written last: a folder without it is no backup."""

DERIVED = ("networks", "models", "matrix", "shards")
"""Folders of a catalogue, what may be thrown away first; the index is made again when it is needed."""

TRIES = 5


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


def back_up(place: Place, target: Path, *, catalogues: bool = True, last: Path | None = None) -> dict[str, Any]:
    """Copy everything a service keeps to a new folder; the service may go on meanwhile.

    Parameters
    ----------
    place : Place
    target : Path
        New or empty; nobody else may read it, as signing secrets of webhooks are in it.
    catalogues : bool
        Whether to copy the catalogues, too, which could be built again.
    last : Path, optional
        A backup of before: files that it holds are linked to, not copied.

    Returns
    -------
    dict
        What is in it, under ``damaged`` what is not, or not as it was, and under ``deleted_meanwhile`` the recordings
        that somebody deleted between the copy of their rows and that of their files.

    Raises
    ------
    BackupError
        There is nothing to copy, the folder is not empty, or the last backup is none.
    """
    if not place.database and not (place.data / ROWS).is_file():
        raise BackupError(f"{place.data}: holds no data of a service")
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise BackupError(f"{target}: must be a new or empty folder")
    if last is not None:
        read_seal(last)
    target.mkdir(mode=0o700, parents=True, exist_ok=True)
    copier = Copier(target, last)
    with open_database(place.url) as source:
        with open_database(sqlite(target / ROWS)) as copy:
            counts = copy_rows(source, copy, copier.damaged)
            recordings = recordings_in(copy)
        copier.hashes[ROWS] = digest_of(target / ROWS)
        found = [copy_recording(copier, place.data, sha256) for sha256 in recordings]
        gone = forget_deleted(copier.damaged, recordings_in(source))
    machines = copy_machines(copier, place.data)
    copied = [copy_catalogue(copier, path, name) for name, path in find_catalogues(place)] if catalogues else []
    content = {
        "format": FORMAT,
        "made_at": now().isoformat().replace("+00:00", "Z"),
        "revision": REVISION,
        "rows": counts,
        "recordings": sum(found),
        "machines": machines,
        "catalogues": [name for name in copied if name],
        "damaged": [damage.document() for damage in copier.damaged],
        "deleted_meanwhile": gone,
        "copied_bytes": copier.copied_bytes,
        "linked_bytes": copier.linked_bytes,
        "files": len(copier.hashes),
        "files_sha256": copier.seal(),
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
        What was in it; under ``damaged`` what it lacked when it was made, and what is damaged in it by now.

    Raises
    ------
    BackupError
        It is no complete backup, or there is something at the place already.
    """
    content = read_seal(source)
    if (source / "catalogues").is_dir() and any(find_catalogues(place)):
        raise BackupError(f"{place.catalogues}: holds catalogues already")
    for name in ("measurements", "machines"):
        if (place.data / name).is_dir() and any((place.data / name).iterdir()):
            raise BackupError(f"{place.data / name}: is not empty")
    place.data.mkdir(parents=True, exist_ok=True)
    copier, shelf = Copier(place.data), Copier(place.catalogues.parent)
    known = {(each["what"], each["name"]) for each in content.get("damaged", ())}
    known |= {("recording", sha256) for sha256 in content.get("deleted_meanwhile", ())}
    catalogues = {name: inside(source / "catalogues", name) for name in content["catalogues"]}
    with open_database(place.url) as target, opened_copy(source) as copy:
        if rows_in(target):
            raise BackupError(f"{target.name}: holds data already")
        for sha256 in recordings_in(copy):
            copy_recording(copier, source, sha256)
        copy_machines(copier, source)
        for name, folder in catalogues.items():
            copy_catalogue(shelf, folder, name, place.catalogues.name)
        copy_rows(copy, target, copier.damaged)  # last: rows speak of files
        belonging.tie(place.data, target, anew=True)  # the copied service and its folder have an id of their own
    found = [damage for damage in (*copier.damaged, *shelf.damaged) if (damage.what, damage.name) not in known]
    return {**content, "damaged": [*content.get("damaged", ()), *(damage.document() for damage in found)]}


def check(source: Path) -> dict[str, Any]:
    """Read everything that a backup holds, and compare it with what it says of itself; nothing is changed.

    Parameters
    ----------
    source : Path

    Returns
    -------
    dict
        What it says of itself; under ``damaged`` what it lacked when it was made, and what is damaged in it by now.

    Raises
    ------
    BackupError
        It is no complete backup.
    """
    content = read_seal(source)
    found: list[Damage] = []
    hashes = read_hashes(source)
    if hashlib.sha256((source / HASHES).read_bytes() if hashes else b"").hexdigest() != content.get("files_sha256"):
        found.append(Damage("file", HASHES, "is not what it was" if hashes else "is missing"))
    for name, sha256 in hashes.items():
        path = inside(source, name)
        try:
            if digest_of(path) != sha256:
                found.append(Damage("file", name, "is not what it was"))
        except OSError as error:
            found.append(Damage("file", name, f"cannot be read ({error.strerror})"))
    known = {*(each["name"] for each in content.get("damaged", ())), *content.get("deleted_meanwhile", ())}
    if not any(damage.name == ROWS for damage in found):
        with opened_copy(source) as copy, tempfile.TemporaryDirectory() as scratch:
            with open_database(sqlite(Path(scratch) / ROWS)) as again:
                counts = copy_rows(copy, again, found)
            for table, count in content["rows"].items():
                if counts.get(table) != count:
                    found.append(Damage("row", table, f"{counts.get(table)} rows; there were {count}"))
            for sha256 in recordings_in(copy):
                if sha256 in known:
                    continue
                if not NAMED.fullmatch(sha256):
                    found.append(unnamed(sha256))
                elif not recording_path(source, sha256).is_file():
                    found.append(Damage("recording", sha256, "is missing"))
    return {**content, "damaged": [*content.get("damaged", ()), *(damage.document() for damage in found)]}


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
    """Return the number of rows in all tables; that of its folder, which a service makes first, is none."""
    with database.reading() as session:
        tables = [table for table in TABLES.sorted_tables if table.name != BelongingRow.__tablename__]
        return sum(session.scalar(select(func.count()).select_from(table)) or 0 for table in tables)


@contextmanager
def opened_copy(source: Path) -> Iterator[ServiceDatabase]:
    """The rows of a backup: of an older version they are brought up to date in a copy, not there."""
    with tempfile.TemporaryDirectory() as scratch:
        rows = Path(scratch) / ROWS
        shutil.copyfile(source / ROWS, rows)
        with open_database(sqlite(rows)) as copy:
            yield copy


def recordings_in(database: ServiceDatabase) -> list[str]:
    """Return the checksums of the recordings that there are."""
    query = select(MeasurementRow.sha256).where(MeasurementRow.id.not_in(deleted("measurement")))
    with database.reading() as session:
        return sorted(set(session.scalars(query)))


def copy_recording(copier: Copier, source: Path, sha256: str) -> bool:
    """Bring a recording from a folder of data, if it is what it was; return whether it is there."""
    if not NAMED.fullmatch(sha256):
        copier.damaged.append(unnamed(sha256))
        return False
    return copier.bring(recording_path(source, sha256), str(recording_path(Path(), sha256)), "recording", sha256)


def unnamed(sha256: str) -> Damage:
    """Return what is said of a row that could name any file."""
    return Damage("recording", repr(sha256)[:80], "is no SHA-256")


def forget_deleted(damaged: list[Damage], left: Collection[str]) -> list[str]:
    """Take those from what is damaged whose files are missing since nothing speaks of them; returns their names."""
    there = set(left)
    gone = [
        each
        for each in damaged
        if each.what == "recording" and each.how.startswith("is missing") and each.name not in there
    ]
    damaged[:] = [each for each in damaged if each not in gone]
    return [each.name for each in gone]


def inside(folder: Path, name: str) -> Path:
    """Return what a backup names in a folder of it.

    Raises
    ------
    BackupError
        It lies elsewhere.
    """
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()) or path == folder.resolve():
        raise BackupError(f"{folder}: names {name[:80]!r}, which does not lie in it")
    return path


def copy_machines(copier: Copier, source: Path) -> int:
    """Bring machines that were put there, and what they were before; returns how many."""
    files = sorted((source / "machines").rglob("*.json"))
    for file in files:
        with suppress(FileNotFoundError):  # it was deleted just now
            copier.bring(file, str(file.relative_to(source)), "machine")
    return sum(file.parent.name == "machines" for file in files)


def find_catalogues(place: Place) -> Iterator[tuple[str, Path]]:
    """Give names and folders of the catalogues of a service."""
    if CatalogueDirectory(place.catalogues).manifest.is_file():
        yield place.catalogues.resolve().name, place.catalogues
    elif place.catalogues.is_dir():
        for path in sorted(place.catalogues.iterdir()):
            if not path.name.startswith(".") and CatalogueDirectory(path).manifest.is_file():
                yield path.name, path


def copy_catalogue(copier: Copier, source: Path, name: str, under: str = "catalogues") -> str:
    """Bring a catalogue as its manifest says it is; one that a build changes meanwhile is brought anew.

    Returns its name; nothing where it could not be brought.
    """
    manifest, place = CatalogueDirectory(source).manifest, f"{under}/{name}"
    for _ in range(TRIES):
        copier.forget(place)
        damaged = list(copier.damaged)
        try:
            before = digest_of(manifest)
            for folder in DERIVED:
                copy_folder(copier, source / folder, f"{place}/{folder}", name)
            card = CatalogueDirectory(source).quality
            if card.is_file():
                copier.bring(card, f"{place}/{card.name}", "catalogue")
            if digest_of(manifest) == before:
                copier.bring(manifest, f"{place}/{manifest.name}", "catalogue")
                return name
        except FileNotFoundError:  # the end of a build has put another in its place, or it was deleted
            pass
        copier.damaged[:] = damaged
    copier.damaged.append(Damage("catalogue", name, f"changed {TRIES} times while it was copied"))
    return ""


def copy_folder(copier: Copier, source: Path, place: str, catalogue: str) -> None:
    """Bring the finished files of a folder and those below it; a shard is called by its checksum."""
    for path in sorted(source.iterdir()) if source.is_dir() else ():
        if path.name.startswith("."):
            continue  # somebody is writing it
        if path.is_dir():
            copy_folder(copier, path, f"{place}/{path.name}", catalogue)
        else:
            wanted = path.stem if path.suffix == ".h5" and source.name == "shards" else None
            copier.bring(path, f"{place}/{path.name}", f"catalogue {catalogue}", wanted)
