"""The index of a catalogue: which entry lies in which shard, and how far the build is.

It is made from the shards and can be made again from them at any time; whoever only reads spectra does not need it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sqlalchemy import (
    Column,
    Connection,
    ForeignKey,
    Integer,
    MetaData,
    String,
    Table,
    create_engine,
    delete,
    event,
    func,
    insert,
    select,
    text,
    update,
)
from sqlalchemy.exc import DatabaseError

from catalogue.errors import CatalogueFileError
from catalogue.keys import canonical_json
from catalogue.shard import Shard

__all__ = ["ChunkRow", "ChunkStatus", "Index", "ShardRow"]

INDEX_VERSION = 1
"""Kept in SQLite's ``user_version``; an index of another version is made anew."""


class ChunkStatus(StrEnum):
    """How far a chunk is."""

    PENDING = "pending"
    RUNNING = "running"
    DONE = "done"
    LOST = "lost"


@dataclass(frozen=True)
class ShardRow:
    """One shard: its SHA-256, which is its name, its size in bytes and its number of entries."""

    sha256: str
    size: int
    entries: int


@dataclass(frozen=True)
class ChunkRow:
    """One chunk of a build: how many entries of which joints, its status, how often it was begun, and what happened."""

    id: str
    joints: str
    entries: int
    status: ChunkStatus
    attempts: int
    message: str


_METADATA = MetaData()

_SHARDS = Table(
    "shards",
    _METADATA,
    Column("sha256", String, primary_key=True),
    Column("size", Integer, nullable=False),
    Column("entries", Integer, nullable=False),
)

_ENTRIES = Table(
    "entries",
    _METADATA,
    Column("key", String, primary_key=True),
    Column("shard", ForeignKey("shards.sha256", ondelete="CASCADE"), nullable=False, index=True),
    Column("position", Integer, nullable=False),
    Column("hypothesis", String, nullable=False, index=True),
    Column("clearances", String, nullable=False),
    Column("status", String, nullable=False),
    Column("message", String, nullable=False),
)

_CHUNKS = Table(
    "chunks",
    _METADATA,
    Column("id", String, primary_key=True),
    Column("joints", String, nullable=False),
    Column("entries", Integer, nullable=False),
    Column("status", String, nullable=False),
    Column("attempts", Integer, nullable=False, server_default=text("0")),
    Column("message", String, nullable=False, server_default=text("''")),
)


class Index:
    """An SQLite database in WAL mode; opened (and made, where there is none) by the constructor.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    CatalogueFileError
        The file is no database, is damaged, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._engine = create_engine(f"sqlite:///{path}")
        event.listen(self._engine, "connect", _configure)
        try:
            with self._engine.begin() as connection:
                if connection.scalar(text("PRAGMA user_version")) != INDEX_VERSION:
                    _METADATA.drop_all(connection)
                    connection.execute(text(f"PRAGMA user_version = {INDEX_VERSION}"))
                _METADATA.create_all(connection)
        except DatabaseError as error:
            self._engine.dispose()
            raise CatalogueFileError(path, f"cannot be used as an index ({error.orig})") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the file back; SQLite then folds its side files into it."""
        self._engine.dispose()

    def is_sound(self) -> bool:
        """Whether SQLite finds the file undamaged and complete."""
        try:
            with self._engine.connect() as connection:
                return str(connection.scalar(text("PRAGMA integrity_check"))) == "ok"
        except DatabaseError:
            return False

    def shards(self) -> dict[str, ShardRow]:
        """Shards by name."""
        with self._engine.connect() as connection:
            return {row.sha256: ShardRow(*row) for row in connection.execute(select(_SHARDS))}

    def places(self) -> dict[str, tuple[str, int]]:
        """Shard and position in it of every entry, by key."""
        query = select(_ENTRIES.c.key, _ENTRIES.c.shard, _ENTRIES.c.position)
        with self._engine.connect() as connection:
            return {key: (shard, position) for key, shard, position in connection.execute(query)}

    def statuses(self) -> dict[str, str]:
        """Status of every entry, by key."""
        with self._engine.connect() as connection:
            return {row.key: row.status for row in connection.execute(select(_ENTRIES.c.key, _ENTRIES.c.status))}

    def counts(self) -> dict[tuple[str, str], int]:
        """Number of entries by hypothesis and status."""
        query = select(_ENTRIES.c.hypothesis, _ENTRIES.c.status, func.count()).group_by(
            _ENTRIES.c.hypothesis, _ENTRIES.c.status
        )
        with self._engine.connect() as connection:
            return {(hypothesis, status): number for hypothesis, status, number in connection.execute(query)}

    def add_shard(self, sha256: str, size: int, shard: Shard, *, chunk: str | None = None) -> int:
        """Enter a shard, its entries and the end of its chunk, all or nothing.

        Entries that are in the index already stay where they are.

        Returns
        -------
        int
            Number of new entries.
        """
        rows = [
            {
                "key": shard.key[position],
                "shard": sha256,
                "position": position,
                "hypothesis": shard.hypothesis.label,
                "clearances": canonical_json(shard.entry(position).fault),
                "status": shard.status[position],
                "message": shard.message[position],
            }
            for position in range(shard.count)
        ]
        with self._engine.begin() as connection:
            connection.execute(insert(_SHARDS).values(sha256=sha256, size=size, entries=shard.count))
            known = _known(connection, shard.key)
            new = [row for row in rows if row["key"] not in known]
            if new:
                connection.execute(insert(_ENTRIES), new)
            if chunk is not None:
                _change(connection, chunk, status=ChunkStatus.DONE.value, message="")
        return len(new)

    def remove_shards(self, names: Iterable[str]) -> None:
        """Forget shards and their entries."""
        with self._engine.begin() as connection:
            for name in names:
                connection.execute(delete(_SHARDS).where(_SHARDS.c.sha256 == name))

    def plan_chunks(self, chunks: Sequence[ChunkRow]) -> None:
        """Make `chunks` the ones to be done.

        Others that are not done are forgotten; one that was planned before keeps its number of attempts.
        """
        wanted = {chunk.id for chunk in chunks}
        with self._engine.begin() as connection:
            old = {row.id: row for row in connection.execute(select(_CHUNKS))}
            for row in old.values():
                if row.id not in wanted and row.status != ChunkStatus.DONE:
                    connection.execute(delete(_CHUNKS).where(_CHUNKS.c.id == row.id))
            for chunk in chunks:
                if chunk.id in old:
                    _change(connection, chunk.id, status=ChunkStatus.PENDING.value)
                else:
                    connection.execute(insert(_CHUNKS).values(_pending(chunk)))

    def begin_chunk(self, chunk: str) -> None:
        """A worker has it: one attempt more."""
        with self._engine.begin() as connection:
            _change(connection, chunk, status=ChunkStatus.RUNNING.value, attempts=_CHUNKS.c.attempts + 1)

    def split_chunk(self, chunk: str, parts: Sequence[ChunkRow]) -> None:
        """Put `parts` in the place of a chunk."""
        with self._engine.begin() as connection:
            connection.execute(delete(_CHUNKS).where(_CHUNKS.c.id == chunk))
            connection.execute(insert(_CHUNKS), [_pending(part) for part in parts])

    def end_attempt(self, chunk: str, message: str, *, lost: bool) -> None:
        """The attempt failed: lost for this build, or to be tried again."""
        status = ChunkStatus.LOST if lost else ChunkStatus.PENDING
        with self._engine.begin() as connection:
            _change(connection, chunk, status=status.value, message=message)

    def chunks(self) -> tuple[ChunkRow, ...]:
        """All chunks the builds of this catalogue know, in the order in which they were planned."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(_CHUNKS).order_by(text("rowid")))
            return tuple(
                ChunkRow(row.id, row.joints, row.entries, ChunkStatus(row.status), row.attempts, row.message)
                for row in rows
            )


def _configure(connection: Any, _record: object) -> None:
    """WAL lets readers read while a build writes; a lost last transaction is found again in the shards."""
    cursor = connection.cursor()
    for pragma in ("journal_mode = WAL", "synchronous = NORMAL", "foreign_keys = ON", "busy_timeout = 10000"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _known(connection: Connection, keys: Sequence[str]) -> set[str]:
    known: set[str] = set()
    for start in range(0, len(keys), 500):  # SQLite limits the parameters of a statement
        query = select(_ENTRIES.c.key).where(_ENTRIES.c.key.in_(keys[start : start + 500]))
        known.update(connection.scalars(query))
    return known


def _change(connection: Connection, chunk: str, **values: Any) -> None:
    connection.execute(update(_CHUNKS).where(_CHUNKS.c.id == chunk).values(**values))


def _pending(chunk: ChunkRow) -> dict[str, Any]:
    return {"id": chunk.id, "joints": chunk.joints, "entries": chunk.entries, "status": ChunkStatus.PENDING.value}
