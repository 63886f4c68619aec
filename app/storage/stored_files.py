"""Files of recordings that may be deleted: no row speaks of them any more, or nobody goes on sending them."""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TypeVar

from sqlalchemy import select, text
from sqlalchemy.orm import Session

from jointplay.app.errors import RecordingDamagedError
from jointplay.app.storage import belonging
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.recording_files import CURE, NAMED
from jointplay.app.storage.rows import MeasurementRow
from jointplay.app.storage.tombstones import deleted

PARTIAL = "partial-"
"""Beginning of the name of an upload that is on its way."""

RECORDINGS = "measurements"
"""Folder of uploads."""

SIGNALS = "signals"
"""Folder of the samples of recordings that were read."""

ABANDONED_S = 86_400.0
"""Age from which on nobody is sending an upload any more, and no row of a file is on its way."""

CHUNK = 10_000
"""Checksums that are asked for in one statement: SQLite takes no more than 32766 values."""

ORPHANS = "orphans"
"""Folder of files that no row spoke of: a database that is brought back from a backup may do so again."""

ORPHANS_S = 30 * 86_400.0
"""How long they are kept there."""

FILES_LOCK = 7_264_917_003_121
"""Key of PostgreSQL's advisory lock that whoever deletes files holds alone, and whoever names them holds in common."""


_ALONE, _SHARED = text("SELECT pg_advisory_xact_lock(:key)"), text("SELECT pg_advisory_xact_lock_shared(:key)")

Item = TypeVar("Item")


class StoredFiles:
    """The files below a folder of data.

    Parameters
    ----------
    directory : Path
    database : ServiceDatabase
        Says which of them are spoken of.
    """

    def __init__(self, directory: Path, database: ServiceDatabase) -> None:
        self._directory, self._database = directory, database

    def settle(self) -> None:
        """Let a folder without recordings and its database belong together; others are looked at before tidying."""
        if belonging.id_of(self._directory) is None and not any(self._folders()):
            belonging.tie(self._directory, self._database)

    def why_apart(self, *, settle: bool = False) -> str:
        """Return why nothing is to be deleted of what no row speaks of; empty where it may be.

        Parameters
        ----------
        settle : bool
            Whether a folder of before there were ids gets one, if most of its files are spoken of.
        """
        if belonging.id_of(self._directory) is None:
            count, spoken = 0, 0
            for sizes in self._named():
                with self._database.reading() as session:
                    count, spoken = count + len(sizes), spoken + len(spoken_of(session, sizes))
            if 2 * spoken > count or not count:
                if settle:
                    belonging.tie(self._directory, self._database)
                return ""
        return belonging.why_apart(self._directory, self._database)

    def partials(self) -> list[tuple[Path, int, float]]:
        """Return uploads that are on their way, or that killed servers left: path, size, seconds since they grew."""
        found = []
        for path in (self._directory / RECORDINGS).glob(f"{PARTIAL}*"):
            with suppress(FileNotFoundError):
                facts = path.stat()
                found.append((path, facts.st_size, time.time() - facts.st_mtime))
        return found

    def orphans(self) -> Iterator[tuple[str, int]]:
        """Give checksums and sizes of files that no recording is of: a server died between a file and its row."""
        for sizes in self._named(ABANDONED_S):
            with self._database.reading() as session:
                spoken = spoken_of(session, sizes)
            yield from ((sha256, size) for sha256, size in sizes.items() if sha256 not in spoken)

    def old_orphans(self) -> list[tuple[str, int]]:
        """Return checksums and sizes of files that were put aside, and that no row has spoken of for long since."""
        sizes = self._sizes(self._directory / ORPHANS, ORPHANS_S)
        with self._database.reading() as session:
            spoken = spoken_of(session, sizes)
        return [(sha256, size) for sha256, size in sizes.items() if sha256 not in spoken]

    def put_aside(self, checksums: Collection[str]) -> None:
        """Take files that no recording is of out of the way; they are kept for a while."""
        aside = self._directory / ORPHANS
        aside.mkdir(exist_ok=True)
        with self._database.writing() as session:
            self.lock(session, alone=True)
            for sha256 in set(checksums) - spoken_of(session, checksums):
                with suppress(FileNotFoundError):
                    os.utime(recording_path(self._directory, sha256))  # from now on it counts
                    os.replace(recording_path(self._directory, sha256), aside / sha256)

    def bring_back(self) -> int:
        """Put files back that a row speaks of again; returns how many there were."""
        aside = self._directory / ORPHANS
        with self._database.writing() as session:
            self.lock(session, alone=True)
            spoken = spoken_of(session, self._sizes(aside))
            for sha256 in spoken:
                target = recording_path(self._directory, sha256)
                target.parent.mkdir(exist_ok=True)
                os.replace(aside / sha256, target)
        return len(spoken)

    def drop_orphans(self, checksums: Collection[str]) -> None:
        """Delete files that were put aside."""
        for sha256 in checksums:
            (self._directory / ORPHANS / sha256).unlink(missing_ok=True)

    def _folders(self) -> Iterator[Path]:
        folders = sorted((self._directory / RECORDINGS).iterdir())
        return (folder for folder in folders if len(folder.name) == 2 and folder.is_dir())

    def _named(self, age_s: float = 0.0) -> Iterator[dict[str, int]]:
        """Give the sizes of the files of recordings that are older, by checksum, a folder at a time."""
        return (self._sizes(folder, age_s) for folder in self._folders())

    def _sizes(self, folder: Path, age_s: float = 0.0) -> dict[str, int]:
        sizes = {}
        for path in folder.iterdir() if folder.is_dir() else ():
            with suppress(FileNotFoundError):
                facts = path.lstat()
                if NAMED.fullmatch(path.name) and facts.st_mtime <= time.time() - age_s:  # the others are not ours
                    sizes[path.name] = facts.st_size
        return sizes

    def drop(self, checksums: Collection[str]) -> None:
        """Delete the files that no recording is of any more, of some checksums."""
        if not checksums:
            return
        with self._database.writing() as session:
            self.lock(session, alone=True)
            for sha256 in set(filter(NAMED.fullmatch, checksums)) - spoken_of(session, checksums):
                recording_path(self._directory, sha256).unlink(missing_ok=True)

    def drop_samples(self, key: str) -> None:
        """Delete the samples that were read of a measurement."""
        for ending in ("npy", "json"):
            (self._directory / SIGNALS / f"{key}.{ending}").unlink(missing_ok=True)

    def lock(self, session: Session, *, alone: bool) -> None:
        """Keep whoever deletes files from those that a row is about to speak of; SQLite has one writer anyway."""
        if not self._database.is_sqlite:
            session.execute(_ALONE if alone else _SHARED, {"key": FILES_LOCK})


def spoken_of(session: Session, checksums: Collection[str]) -> set[str]:
    """Return which checksums are of a recording that there is."""
    query = select(MeasurementRow.sha256).where(MeasurementRow.id.not_in(deleted("measurement")))
    found: set[str] = set()
    for some in parts(checksums, CHUNK):
        found.update(session.scalars(query.where(MeasurementRow.sha256.in_(some))))
    return found


def parts(items: Iterable[Item], most: int) -> Iterator[list[Item]]:
    """Give items in lists of so many at most."""
    left = iter(items)
    while some := list(islice(left, most)):
        yield some


def recording_path(directory: Path, sha256: str) -> Path:
    """Return where the bytes with a checksum lie below a folder of data.

    Raises
    ------
    RecordingDamagedError
        It is none: what a row says must not lead elsewhere.
    """
    if not NAMED.fullmatch(sha256):
        raise RecordingDamagedError(f"recording {sha256[:16]!r}: is no SHA-256; {CURE}")
    return directory / RECORDINGS / sha256[:2] / sha256
