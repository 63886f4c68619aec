"""Copying rows and files into a backup and out of it, past what is damaged, which is named."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Integer, Table, and_, func, insert, select
from sqlalchemy.exc import IntegrityError, SQLAlchemyError
from sqlalchemy.orm import Session

from jointplay.app.errors import DamagedDatabaseError
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Base
from jointplay.catalogue.storage.directory import publish

CHUNK = 500

UNREADABLE = (SQLAlchemyError, ValueError, DamagedDatabaseError)
"""What is raised of damaged rows: by the database, or by what makes JSON of a text."""

HASHES = "files.sha256"
"""Every file of a backup with its SHA-256, in the form of ``sha256sum``."""


@dataclass(frozen=True)
class Damage:
    """Something that could not be copied as it was.

    Parameters
    ----------
    what : str
        ``recording``, ``row``, ``machine``, ``catalogue`` or ``file``.
    name : str
    how : str
    """

    what: str
    name: str
    how: str

    def __str__(self) -> str:
        return f"{self.what} {self.name}: {self.how}"

    def document(self) -> dict[str, str]:
        """Return it as JSON values."""
        return asdict(self)


class Copier:
    """Brings files into a folder, those that another such folder holds as links to them.

    Parameters
    ----------
    target : Path
    last : Path, optional
        A backup of before; what it says that it holds is believed.

    Attributes
    ----------
    hashes : dict
        SHA-256 of what was brought, by name.
    damaged : list of Damage
    copied_bytes, linked_bytes : int
    """

    def __init__(self, target: Path, last: Path | None = None) -> None:
        self._target, self._last = target, last
        self._known = {} if last is None else read_hashes(last)
        self.hashes: dict[str, str] = {}
        self.damaged: list[Damage] = []
        self.copied_bytes = self.linked_bytes = 0

    def bring(self, source: Path, name: str, what: str, sha256: str | None = None) -> bool:
        """Bring a file under a name; return whether it is there.

        Parameters
        ----------
        source : Path
        name : str
            Below the folder.
        what : str
            What is said to be damaged where it is.
        sha256 : str, optional
            What it is to have. Where the last backup holds that, the file itself is not read.

        Raises
        ------
        FileNotFoundError
            It is not there, and nobody says what it is to have.
        """
        known = self._known.get(name)
        try:
            size = source.stat().st_size
            wanted = sha256 or (digest_of(source) if known is not None else None)
            if wanted is not None and wanted == known and self._link(name, wanted, size):
                return True
            found = self._copy(source, name)
        except FileNotFoundError:
            if sha256 is None:
                raise
            return self._replace(name, Damage(what, sha256, "is missing"), sha256)
        except OSError as error:
            return self._replace(name, Damage(what, sha256 or name, f"cannot be read ({error.strerror})"), sha256)
        if sha256 is not None and found != sha256:
            return self._replace(name, Damage(what, sha256, "is not what it was"), sha256)
        self.hashes[name] = found
        return True

    def forget(self, folder: str) -> None:
        """Take back what was brought below a folder."""
        self.hashes = {name: found for name, found in self.hashes.items() if not name.startswith(f"{folder}/")}

    def seal(self) -> str:
        """Write down what was brought; returns the SHA-256 of that list."""
        text = "".join(f"{found}  {name}\n" for name, found in sorted(self.hashes.items())).encode()
        publish(self._target / HASHES, text)
        return hashlib.sha256(text).hexdigest()

    def _copy(self, source: Path, name: str) -> str:
        place = self._target / name
        place.parent.mkdir(parents=True, exist_ok=True)
        found = copy_file(source, place)
        self.copied_bytes += place.stat().st_size
        return found

    def _link(self, name: str, sha256: str, size: int | None) -> bool:
        """Link a file to that of the last backup, if it is there; files of it never change."""
        if self._last is None or self._known.get(name) != sha256:
            return False
        place = self._target / name
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            found = (self._last / name).stat().st_size
            if size not in (None, found):
                return False
            place.unlink(missing_ok=True)
            os.link(self._last / name, place)
        except OSError:  # it is gone, lies on another disk, or that knows no links
            return False
        self.linked_bytes += found
        self.hashes[name] = sha256
        return True

    def _replace(self, name: str, damage: Damage, sha256: str | None) -> bool:
        """Take a file from the last backup that is damaged where it was copied from."""
        (self._target / name).unlink(missing_ok=True)
        if sha256 is not None and self._link(name, sha256, None):
            self.damaged.append(Damage(damage.what, damage.name, f"{damage.how}; taken from the last backup"))
            return True
        self.damaged.append(damage)
        return False


def read_hashes(folder: Path) -> dict[str, str]:
    """Return what a backup says that it holds; nothing of one that was made before that was written down."""
    try:
        lines = (folder / HASHES).read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return {}
    return {name: found for found, _, name in (line.partition("  ") for line in lines)}


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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


def copy_rows(source: ServiceDatabase, target: ServiceDatabase, damaged: list[Damage]) -> dict[str, int]:
    """Copy all rows as they are at one moment, in one transaction; returns how many each table has.

    Rows that cannot be read, and those that speak of such, are left out and named.
    """
    counts: dict[str, int] = {}
    with source.engine.connect() as plain, target.writing() as session:
        # SQLite shows a transaction one moment anyway.
        reading = plain if source.is_sqlite else plain.execution_options(isolation_level="REPEATABLE READ")
        with reading.begin():
            for table in Base.metadata.sorted_tables:
                counts[table.name] = 0
                for rows in chunks(reading, table, damaged):
                    counts[table.name] += put_rows(session, table, rows, damaged)
                if not target.is_sqlite:  # whose counters follow the rows by themselves
                    for column in table.primary_key.columns:
                        if isinstance(column.type, Integer) and counts[table.name]:
                            sequence = func.pg_get_serial_sequence(table.name, column.name)
                            session.execute(select(func.setval(sequence, select(func.max(column)).scalar_subquery())))
    return counts


def chunks(reading: Connection, table: Table, damaged: list[Damage]) -> Iterator[list[dict[str, Any]]]:
    """Give the rows of a table, some at a time; what cannot be read is left out and named."""
    keys, seen = table.primary_key.columns, 0
    try:
        with reading.begin_nested():
            for part in reading.execute(select(table).order_by(*keys)).mappings().partitions(CHUNK):
                yield [dict(row) for row in part]
                seen += len(part)
        return
    except UNREADABLE:
        pass  # from there on one by one
    try:
        with reading.begin_nested():
            left = reading.execute(select(*keys).order_by(*keys).offset(seen)).all()
    except UNREADABLE as error:
        damaged.append(Damage("row", table.name, f"the rest of the table cannot be read ({type(error).__name__})"))
        return
    for key in left:
        query = select(table).where(and_(*(column == value for column, value in zip(keys, key, strict=True))))
        try:
            with reading.begin_nested():
                yield [dict(row) for row in reading.execute(query).mappings()]
        except UNREADABLE as error:
            damaged.append(Damage("row", name_of(table, key), f"cannot be read ({type(error).__name__})"))


def put_rows(session: Session, table: Table, rows: Sequence[Mapping[str, Any]], damaged: list[Damage]) -> int:
    """Store rows; those that speak of what was lost are left out and named. Returns how many there are."""
    if not rows:
        return 0
    try:
        with session.begin_nested():
            session.execute(insert(table), [dict(row) for row in rows])
        return len(rows)
    except IntegrityError:
        if len(rows) == 1:
            key = [rows[0][column.name] for column in table.primary_key.columns]
            damaged.append(Damage("row", name_of(table, key), "speaks of what is lost"))
            return 0
        return sum(put_rows(session, table, [row], damaged) for row in rows)


def name_of(table: Table, key: Sequence[Any]) -> str:
    """Return what a row is called."""
    return f"{table.name} {' '.join(map(str, key))}"
