"""The index of a catalogue: which entry lies in which shard, and how far the build is.

It is made from the shards and can be made again from them at any time; whoever only reads spectra does not need it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self, TypeVarTuple

from sqlalchemy import Connection, Select, delete, func, insert, select
from sqlalchemy.exc import IntegrityError

from jointplay.catalogue.storage.database import CATALOGUES, ENTRIES, SHARDS, IndexDatabase
from jointplay.catalogue.storage.leases import ChunkRow, Leases, finish_chunk
from jointplay.catalogue.storage.shard import Shard

Q = TypeVarTuple("Q")

LOCAL = "local"
"""Instance of a catalogue whose index is a file of its own."""


@dataclass(frozen=True)
class ShardRow:
    """One shard: its SHA-256, which is its name, its size in bytes and its number of entries."""

    sha256: str
    size: int
    entries: int


class EntriesPresentError(Exception):
    """Some entries of a shard lie in another one already; nothing was entered.

    Parameters
    ----------
    keys : frozenset of str
        Those entries.
    """

    def __init__(self, keys: frozenset[str]) -> None:
        self.keys = keys
        super().__init__(keys)

    def __str__(self) -> str:
        return f"{len(self.keys)} of its entries lie in another shard"


class Index:
    """The rows of one catalogue in a database; opened (and made, where there is none) by the constructor.

    Parameters
    ----------
    source : Path or str
        A file of SQLite, or the URL of a database.
    instance : str, optional
        Which catalogue, in a database of several.
    anew : bool
        Whether tables of another layout are made anew, see :class:`jointplay.catalogue.storage.database.IndexDatabase`.

    Attributes
    ----------
    leases : Leases
        The chunks of builds.

    Raises
    ------
    CatalogueFileError
        It is no database, cannot be reached or written, is damaged, or its tables are not those of this program.
    """

    def __init__(self, source: Path | str, instance: str = LOCAL, *, anew: bool = False) -> None:
        self._database = IndexDatabase(source, anew=anew)
        try:
            self._catalogue = self._register(instance)
        except BaseException:
            self._database.close()
            raise
        self.leases = Leases(self._database, self._catalogue)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def name(self) -> str:
        """Its file, or its URL without password."""
        return self._database.name

    def close(self) -> None:
        """Give the database back; SQLite then folds its side files into it."""
        self._database.close()

    def is_sound(self) -> bool:
        """Whether the database finds itself undamaged and complete."""
        return self._database.is_sound()

    def shards(self) -> dict[str, ShardRow]:
        """Shards by name."""
        with self._database.reading() as connection:
            rows = connection.execute(self._of(select(SHARDS.c.sha256, SHARDS.c.size, SHARDS.c.entries)))
            return {row.sha256: ShardRow(*row) for row in rows}

    def places(self) -> dict[str, tuple[str, int]]:
        """Shard and position in it of every entry, by key."""
        query = self._of(select(ENTRIES.c.key, ENTRIES.c.shard, ENTRIES.c.position))
        with self._database.reading() as connection:
            return {key: (shard, position) for key, shard, position in connection.execute(query)}

    def statuses(self) -> dict[str, str]:
        """Status of every entry, by key."""
        with self._database.reading() as connection:
            rows = connection.execute(self._of(select(ENTRIES.c.key, ENTRIES.c.status)))
            return {row.key: row.status for row in rows}

    def counts(self) -> dict[tuple[str, str], int]:
        """Number of entries by hypothesis and status."""
        columns = (ENTRIES.c.hypothesis, ENTRIES.c.status)
        query = self._of(select(*columns, func.count())).group_by(*columns)
        with self._database.reading() as connection:
            return {(hypothesis, status): number for hypothesis, status, number in connection.execute(query)}

    def add_shard(
        self, sha256: str, size: int, shard: Shard, *, chunk: str | None = None, seconds: float = 0.0, message: str = ""
    ) -> int:
        """Enter a shard, its entries and the end of its chunk, all or nothing.

        Parameters
        ----------
        sha256 : str
            Its name.
        size : int
            Bytes.
        shard : Shard
        chunk : str, optional
            The chunk that is done with it.
        seconds : float, optional
            Processor time of the chunk [s].
        message : str, optional
            What went wrong in the chunk; it counts as lost then.

        Returns
        -------
        int
            Number of new entries; 0 if the very shard is known already.

        Raises
        ------
        EntriesPresentError
            Some of the entries lie in another shard.
        """
        rows = [
            {
                "catalogue": self._catalogue,
                "key": shard.key[position],
                "shard": sha256,
                "position": position,
                "hypothesis": shard.hypothesis.label,
                "status": shard.status[position],
                "message": shard.message[position],
            }
            for position in range(shard.count)
        ]
        try:
            with self._database.writing() as connection:
                is_new = sha256 not in self._find_shards(connection, [sha256])
                if is_new:
                    present = self._find_known(connection, shard.key)
                    if present:
                        raise EntriesPresentError(present)
                    values = {"catalogue": self._catalogue, "sha256": sha256, "size": size, "entries": shard.count}
                    connection.execute(insert(SHARDS).values(values))
                    connection.execute(insert(ENTRIES), rows)
                if chunk is not None:
                    finish_chunk(connection, self._catalogue, chunk, sha256, seconds, message)
        except IntegrityError:  # another builder entered them meanwhile, which is seen now
            return self.add_shard(sha256, size, shard, chunk=chunk, seconds=seconds, message=message)
        return shard.count if is_new else 0

    def remove_shards(self, names: Iterable[str]) -> None:
        """Forget shards and their entries."""
        with self._database.writing() as connection:
            for name in names:
                connection.execute(delete(SHARDS).where(SHARDS.c.catalogue == self._catalogue, SHARDS.c.sha256 == name))

    def find_known(self, keys: Sequence[str]) -> dict[str, str]:
        """Status of those of the entries that are there, by key."""
        found: dict[str, str] = {}
        with self._database.reading() as connection:
            for part in _parts(keys):
                query = self._of(select(ENTRIES.c.key, ENTRIES.c.status)).where(ENTRIES.c.key.in_(part))
                found.update({row.key: row.status for row in connection.execute(query)})
        return found

    def chunks(self) -> tuple[ChunkRow, ...]:
        """All chunks the builds of this catalogue know, in the order in which they were planned."""
        return self.leases.rows()

    def _register(self, instance: str) -> int:
        """Number of the catalogue in this database."""
        query = select(CATALOGUES.c.id).where(CATALOGUES.c.instance == instance)
        with self._database.reading() as connection:
            number: int | None = connection.scalar(query)
        if number is not None:
            return number
        try:
            with self._database.writing() as connection:
                connection.execute(insert(CATALOGUES).values(instance=instance))
        except IntegrityError:  # another process was first
            pass
        with self._database.reading() as connection:
            return int(connection.scalar(query) or 0)

    def _of(self, query: Select[*Q]) -> Select[*Q]:
        """Only the rows of this catalogue."""
        return query.where(query.get_final_froms()[0].c.catalogue == self._catalogue)

    def _find_shards(self, connection: Connection, names: Sequence[str]) -> set[str]:
        return set(connection.scalars(self._of(select(SHARDS.c.sha256)).where(SHARDS.c.sha256.in_(names))))

    def _find_known(self, connection: Connection, keys: Sequence[str]) -> frozenset[str]:
        query = self._of(select(ENTRIES.c.key))
        return frozenset(
            key for part in _parts(keys) for key in connection.scalars(query.where(ENTRIES.c.key.in_(part)))
        )


def _parts(keys: Sequence[str], size: int = 500) -> list[Sequence[str]]:
    """SQLite limits the parameters of a statement."""
    return [keys[start : start + size] for start in range(0, len(keys), size)]
