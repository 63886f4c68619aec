"""Files of recordings that may be deleted: no row speaks of them any more, or nobody goes on sending them."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path

from sqlalchemy import select, text
from sqlalchemy.orm import Session

from jointplay.app.storage.database import ServiceDatabase
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

FILES_LOCK = 7_264_917_003_120
"""Key of PostgreSQL's advisory lock that whoever deletes files holds alone, and whoever names them holds in common."""


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
        for folder in sorted((self._directory / RECORDINGS).iterdir()):
            if len(folder.name) != 2 or not folder.is_dir():
                continue
            sizes = {}
            for path in folder.iterdir():
                with suppress(FileNotFoundError):
                    facts = path.lstat()
                    if len(path.name) == 64 and facts.st_mtime < time.time() - ABANDONED_S:  # the others are not ours
                        sizes[path.name] = facts.st_size
            with self._database.reading() as session:
                spoken = spoken_of(session, sizes)
            yield from ((sha256, size) for sha256, size in sizes.items() if sha256 not in spoken)

    def drop(self, checksums: Collection[str]) -> None:
        """Delete the files that no recording is of any more, of some checksums."""
        if not checksums:
            return
        with self._database.writing() as session:
            self.lock(session, alone=True)
            for sha256 in set(checksums) - spoken_of(session, checksums):
                recording_path(self._directory, sha256).unlink(missing_ok=True)

    def drop_samples(self, key: str) -> None:
        """Delete the samples that were read of a measurement."""
        for ending in ("npy", "json"):
            (self._directory / SIGNALS / f"{key}.{ending}").unlink(missing_ok=True)

    def lock(self, session: Session, *, alone: bool) -> None:
        """Keep whoever deletes files from those that a row is about to speak of; SQLite has one writer anyway."""
        if not self._database.is_sqlite:
            how = "" if alone else "_shared"
            session.execute(text(f"SELECT pg_advisory_xact_lock{how}(:key)"), {"key": FILES_LOCK})


def spoken_of(session: Session, checksums: Collection[str]) -> set[str]:
    """Return which checksums are of a recording that there is."""
    query = select(MeasurementRow.sha256).where(MeasurementRow.id.not_in(deleted("measurement")))
    return set(session.scalars(query.where(MeasurementRow.sha256.in_(list(checksums)))))


def recording_path(directory: Path, sha256: str) -> Path:
    """Return where the bytes with a checksum lie below a folder of data."""
    return directory / RECORDINGS / sha256[:2] / sha256
