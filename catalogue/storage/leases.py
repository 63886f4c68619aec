"""Who may change a catalogue at the same time: many builders together, or one process alone; and chunks as rows.

A row says who computes a chunk, until when, and what came of it. A builder claims a chunk for a while and extends that
while it lives. The lease of one that died runs out, and another builder begins its chunks again; whatever a builder
that was given up in error still brings is the same result.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Any, Self

from filelock import FileLock, Timeout
from sqlalchemy import ColumnElement, Connection, Double, and_, bindparam, cast, delete, func, or_, select, update
from sqlalchemy.dialects import postgresql, sqlite

from jointplay.catalogue.errors import CatalogueBusyError, CatalogueFileError
from jointplay.catalogue.storage.database import CHUNKS, IndexDatabase
from jointplay.catalogue.storage.directory import CatalogueDirectory

WAIT = 60.0
"""Longest wait for another process that prepares, verifies or repairs [s]."""

_POLL = 0.05


class BuilderLock:
    """A builder's part of the lock of a catalogue: alone at first if nobody else is there, later shared.

    It is the lock that `CatalogueDirectory.hold_alone` holds alone, and it ends with the process, however that ends.
    Where files cannot be locked in common (Windows), a builder stays alone, and a second one is refused.

    Parameters
    ----------
    directory : CatalogueDirectory
    wait : float, optional
        Longest wait for a process that is alone there [s]; :data:`WAIT` by default.

    Attributes
    ----------
    alone : bool
        Whether no other process builds or verifies.

    Raises
    ------
    CatalogueBusyError
        Another process was alone there all the time.
    CatalogueFileError
        The lock file cannot be made.
    """

    def __init__(self, directory: CatalogueDirectory, wait: float | None = None) -> None:
        self._root, self._path = directory.root, directory.lock
        self._descriptor = -1
        self._exclusive: FileLock | None = None
        self.alone = False
        try:
            self._acquire(WAIT if wait is None else wait)
        except OSError as error:
            self.release()
            raise CatalogueFileError(self._path, f"cannot be locked ({error.strerror or error})") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def share(self) -> None:
        """Let other builders in.

        Systems may give the lock up before they share it: a process that waits to be alone can have it in between, and
        what was read of the catalogue until now may hold no more.
        """
        if sys.platform != "win32" and self._descriptor >= 0:
            self.alone = False
            _flock(self._descriptor, alone=False, wait=True)

    def release(self) -> None:
        """End it."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
        if self._exclusive is not None:
            self._exclusive.release()
            self._exclusive = None
        self.alone = False

    def _acquire(self, wait: float) -> None:
        if sys.platform == "win32":
            self._exclusive = FileLock(self._path)
            try:
                self._exclusive.acquire(timeout=0)
            except Timeout as error:
                raise CatalogueBusyError(self._root) from error
            self.alone = True
            return
        self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
        end = time.monotonic() + wait
        while True:
            if _flock(self._descriptor, alone=True, wait=False):
                self.alone = True
                return
            if _flock(self._descriptor, alone=False, wait=False):
                return
            if time.monotonic() >= end:
                self.release()
                raise CatalogueBusyError(self._root)
            time.sleep(_POLL)


def _flock(descriptor: int, *, alone: bool, wait: bool) -> bool:
    """Whether the lock was given; asking for the other kind gives the present one up."""
    if sys.platform == "win32":
        return False
    import fcntl

    kind = fcntl.LOCK_EX if alone else fcntl.LOCK_SH
    try:
        fcntl.flock(descriptor, kind if wait else kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


class ChunkStatus(StrEnum):
    """How far a chunk is."""

    PENDING = "pending"
    RUNNING = "running"
    DONE = "done"
    LOST = "lost"


@dataclass(frozen=True)
class ChunkRow:
    """One chunk of a build.

    Parameters
    ----------
    id : str
    hypothesis : str
        Label of its hypothesis.
    entries : int
        Number of its cases.
    status : ChunkStatus
    attempts : int
        How often it was claimed.
    owner : str
        Builder that has it, or had it last.
    lease_until : float
        End of that builder's right to it [s since 1970].
    output_sha256 : str
        The shard that came of it.
    seconds : float
        Processor time of its cases at workers [s].
    message : str
        What went wrong, last.
    """

    id: str
    hypothesis: str
    entries: int
    status: ChunkStatus = ChunkStatus.PENDING
    attempts: int = 0
    owner: str = ""
    lease_until: float = 0.0
    output_sha256: str = ""
    seconds: float = 0.0
    message: str = ""


_COLUMNS = [CHUNKS.c[name] for name in ChunkRow.__dataclass_fields__]


class Leases:
    """The chunks of one catalogue.

    Parameters
    ----------
    database : IndexDatabase
    catalogue : int
        Its number in that database.
    """

    def __init__(self, database: IndexDatabase, catalogue: int) -> None:
        self._database, self._catalogue = database, catalogue

    def plan(self, chunks: Sequence[ChunkRow], *, alone: bool) -> None:
        """Make chunks known that are to be done.

        Parameters
        ----------
        chunks : sequence of ChunkRow
        alone : bool
            Whether nobody else builds this catalogue. Then none of these chunks is done or in hand, whatever their rows
            say, and others that are not done are forgotten. Else those that are known stay as they are, but for lost
            ones, which are tried again.
        """
        rows = [
            {column.name: getattr(chunk, column.name) for column in _COLUMNS} | {"catalogue": self._catalogue}
            for chunk in chunks
        ]
        wanted = {chunk.id for chunk in chunks}
        pending = {"status": ChunkStatus.PENDING.value, "lease_until": 0.0}
        with self._database.writing() as connection:
            after = connection.scalar(select(func.max(CHUNKS.c.position)).where(self._mine())) or 0
            if alone:
                open_ones = select(CHUNKS.c.id).where(self._mine(), CHUNKS.c.status != ChunkStatus.DONE.value)
                forgotten = [{"chunk": chunk} for chunk in connection.scalars(open_ones) if chunk not in wanted]
                if forgotten:
                    connection.execute(delete(CHUNKS).where(self._mine(), CHUNKS.c.id == bindparam("chunk")), forgotten)
            if not rows:
                return
            for number, row in enumerate(rows, 1):
                row["position"] = after + number
            entered = (sqlite if self._database.is_sqlite else postgresql).insert(CHUNKS)
            again = None if alone else CHUNKS.c.status == ChunkStatus.LOST.value
            entered = entered.on_conflict_do_update(index_elements=["catalogue", "id"], set_=pending, where=again)
            connection.execute(entered, rows)

    def claim(self, owner: str, chunks: Sequence[str], seconds: float) -> set[str]:
        """Take those of the chunks that nobody has.

        Parameters
        ----------
        owner : str
            Who takes them.
        chunks : sequence of str
        seconds : float
            For how long, unless extended.

        Returns
        -------
        set of str
            The chunks that are the owner's now; of two builders that ask at once, one gets them.
        """
        free = or_(
            CHUNKS.c.status == ChunkStatus.PENDING.value,
            and_(CHUNKS.c.status == ChunkStatus.RUNNING.value, CHUNKS.c.lease_until < self._now()),
        )
        query = (
            select(CHUNKS.c.id)
            .where(self._mine(), CHUNKS.c.id.in_(chunks), free)
            .order_by(CHUNKS.c.position)
            .with_for_update(skip_locked=True)
        )
        values = {
            "status": ChunkStatus.RUNNING.value,
            "owner": owner,
            "lease_until": self._now() + seconds,
            "attempts": CHUNKS.c.attempts + 1,
        }
        with self._database.writing() as connection:
            granted = list(connection.scalars(query))
            if granted:
                connection.execute(update(CHUNKS).where(self._mine(), CHUNKS.c.id.in_(granted)).values(values))
        return set(granted)

    def extend(self, owner: str, seconds: float) -> None:
        """Keep what the owner has for another while."""
        with self._database.writing() as connection:
            connection.execute(
                update(CHUNKS)
                .where(self._mine(), CHUNKS.c.owner == owner, CHUNKS.c.status == ChunkStatus.RUNNING.value)
                .values(lease_until=self._now() + seconds)
            )

    def give_back(self, owner: str) -> None:
        """Put what an owner has back among the chunks to be done."""
        with self._database.writing() as connection:
            connection.execute(
                update(CHUNKS)
                .where(self._mine(), CHUNKS.c.owner == owner, CHUNKS.c.status == ChunkStatus.RUNNING.value)
                .values(status=ChunkStatus.PENDING.value, lease_until=0.0)
            )

    def finish(self, chunk: str, message: str = "") -> None:
        """Nothing is left to be stored of a chunk: all of it is there, or (with a message) all of it is lost."""
        with self._database.writing() as connection:
            finish_chunk(connection, self._catalogue, chunk, "", 0.0, message)

    def states(self, chunks: Sequence[str]) -> dict[str, ChunkStatus]:
        """Status of chunks; one that is running on a lease that has ended counts as pending."""
        over = and_(CHUNKS.c.status == ChunkStatus.RUNNING.value, CHUNKS.c.lease_until < self._now())
        found: dict[str, ChunkStatus] = {}
        with self._database.reading() as connection:
            for start in range(0, len(chunks), 500):
                wanted = CHUNKS.c.id.in_(chunks[start : start + 500])
                query = select(CHUNKS.c.id, CHUNKS.c.status, over.label("over")).where(self._mine(), wanted)
                for row in connection.execute(query):
                    found[row.id] = ChunkStatus.PENDING if row.over else ChunkStatus(row.status)
        return found

    def rows(self) -> tuple[ChunkRow, ...]:
        """All chunks, in the order in which they were planned."""
        query = select(*_COLUMNS).where(self._mine()).order_by(CHUNKS.c.position, CHUNKS.c.id)
        with self._database.reading() as connection:
            return tuple(
                ChunkRow(**{**row._mapping, "status": ChunkStatus(row.status)}) for row in connection.execute(query)
            )

    def _mine(self) -> ColumnElement[bool]:
        return CHUNKS.c.catalogue == self._catalogue

    def _now(self) -> ColumnElement[float]:
        """One clock for all builders: the database's; an SQLite file has the computer's."""
        if self._database.is_sqlite:
            return cast(time.time(), Double)
        return cast(func.extract("epoch", func.clock_timestamp()), Double)


def finish_chunk(connection: Connection, catalogue: int, chunk: str, sha256: str, seconds: float, message: str) -> None:
    """Within a transaction: a chunk is done, or (with a message) lost, whoever has the lease by now."""
    values: dict[str, Any] = {
        "status": (ChunkStatus.LOST if message else ChunkStatus.DONE).value,
        "lease_until": 0.0,
        "message": message,
    }
    if sha256:
        values |= {"output_sha256": sha256, "seconds": seconds}
    connection.execute(update(CHUNKS).where(CHUNKS.c.catalogue == catalogue, CHUNKS.c.id == chunk).values(values))
