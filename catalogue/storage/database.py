"""Databases, SQLite in write-ahead mode or PostgreSQL: how they are opened; that of an index, its tables and layout."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    create_engine,
    event,
    insert,
    inspect,
    select,
    text,
)
from sqlalchemy import Index as TableIndex
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DatabaseError, IntegrityError, InterfaceError, NoSuchModuleError

from jointplay.catalogue.errors import CatalogueFileError

METADATA = MetaData()


def _of_catalogue() -> Column[int]:
    return Column("catalogue", Integer, ForeignKey("catalogues.id", ondelete="CASCADE"), primary_key=True)


LAYOUTS = Table("index_layout", METADATA, Column("number", Integer, primary_key=True))

CATALOGUES = Table(
    "catalogues",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("instance", String(36), nullable=False, unique=True),
)

SHARDS = Table(
    "shards",
    METADATA,
    _of_catalogue(),
    Column("sha256", String(64), primary_key=True),
    Column("size", BigInteger, nullable=False),
    Column("entries", Integer, nullable=False),
)

ENTRIES = Table(
    "entries",
    METADATA,
    Column("catalogue", Integer, primary_key=True),
    Column("key", String(64), primary_key=True),
    Column("shard", String(64), nullable=False),
    Column("position", Integer, nullable=False),
    Column("hypothesis", Text, nullable=False),
    Column("status", Text, nullable=False),
    Column("message", Text, nullable=False),
    ForeignKeyConstraint(["catalogue", "shard"], ["shards.catalogue", "shards.sha256"], ondelete="CASCADE"),
    TableIndex("entries_by_shard", "catalogue", "shard"),
)

CHUNKS = Table(
    "chunks",
    METADATA,
    _of_catalogue(),
    Column("id", String(64), primary_key=True),
    Column("position", Integer, nullable=False),
    Column("hypothesis", Text, nullable=False),
    Column("entries", Integer, nullable=False),
    Column("status", String(16), nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("owner", Text, nullable=False),
    Column("lease_until", Double, nullable=False),
    Column("output_sha256", String(64), nullable=False),
    Column("seconds", Double, nullable=False),
    Column("message", Text, nullable=False),
)


INDEX_LAYOUT = 1
"""Of the tables of an index; any change of them raises it, and makes indexes anew from the shards."""

_WAIT = 30.0
_PASSING = (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_PROTOCOL)
"""What SQLite says while others open the same new file."""

_TABLES_LOCK = 7_264_917_003_118
"""Key of PostgreSQL's advisory lock that one opening process holds while it makes the tables."""


def database_url(source: Path | str) -> URL:
    """Where a database is, as a URL.

    Parameters
    ----------
    source : Path or str
        A file of SQLite; or a URL, ``postgresql://user@host:port/database``.

    Raises
    ------
    CatalogueFileError
        It is no URL, or one of another kind of database; a password in it is not shown.
    """
    if isinstance(source, Path):
        return URL.create("sqlite", database=str(source))
    try:
        url = make_url(source)
    except (ArgumentError, ValueError):
        raise CatalogueFileError(source, "is no URL of a database: postgresql://user@host:5432/database") from None
    if url.get_backend_name() == "postgresql":
        return url.set(drivername="postgresql+psycopg")
    if url.get_backend_name() == "sqlite" and url.database:
        return url.set(drivername="sqlite")
    rule = f"{url.get_backend_name()}: must be postgresql:// or sqlite:///FILE"
    raise CatalogueFileError(url.render_as_string(hide_password=True), rule)


class Database:
    """Connections to one database.

    Parameters
    ----------
    url : URL
        As of :func:`database_url`.
    wait : float
        Longest wait for another process's write transaction in SQLite [s].
    durable : bool
        Whether a transaction is on the disk when it ends, or may be lost with the power.
    connect : mapping
        Options of connections to PostgreSQL.
    pool_wait : float
        Longest wait for one of its connections [s].
    json_texts : (callable, callable)
        Read and write the JSON of columns.

    Attributes
    ----------
    name : str
        Its file, or its URL without password.

    Raises
    ------
    CatalogueFileError
        Its driver is not installed.
    """

    def __init__(
        self,
        url: URL,
        *,
        wait: float,
        durable: bool,
        connect: Mapping[str, Any],
        pool_wait: float = 30.0,
        json_texts: tuple[Callable[[Any], Any], Callable[[Any], str]] = (json.loads, json.dumps),
    ) -> None:
        self.is_sqlite = url.get_backend_name() == "sqlite"
        self.name = str(url.database) if self.is_sqlite else url.set(drivername="postgresql").render_as_string()
        options: dict[str, Any] = {"json_deserializer": json_texts[0], "json_serializer": json_texts[1]}
        if not self.is_sqlite:
            options |= {"pool_pre_ping": True, "pool_timeout": pool_wait, "connect_args": dict(connect)}
        try:
            # Errors are logged, values of a statement are not: some are secrets.
            self.engine = create_engine(url, hide_parameters=True, **options)
        except (ImportError, NoSuchModuleError):
            rule = "needs the package psycopg: pip install 'jointplay[cluster]'"
            raise CatalogueFileError(self.name, rule) from None
        if self.is_sqlite:

            def configure(connection: Any, _record: object) -> None:
                _configure(connection, wait, durable)

            event.listen(self.engine, "connect", configure)
            event.listen(self.engine, "begin", _begin)

    @contextmanager
    def transaction(self, lock: int | None = None) -> Iterator[Connection]:
        """A transaction that writes, all or nothing; SQLite lets one in at a time, from its beginning on.

        Parameters
        ----------
        lock : int, optional
            Key of an advisory lock, by which PostgreSQL, too, lets one in at a time.
        """
        with self.engine.connect() as plain:
            connection = plain.execution_options(writes=True)
            with connection.begin():
                if lock is not None and not self.is_sqlite:
                    connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": lock})
                yield connection

    def close(self) -> None:
        """Give the database back; SQLite then folds its side files into it."""
        self.engine.dispose()


class IndexDatabase(Database):
    """The database of an index; its tables stand above.

    Parameters
    ----------
    source : Path or str
        As for :func:`database_url`; the tables are made where there are none.
    anew : bool
        Whether tables of another layout are made anew, and empty, in place of being refused. Other catalogues with
        their index there enter their shards when they are built the next time.

    Raises
    ------
    CatalogueFileError
        It cannot be reached or written, is damaged, or its tables are not those of this program.
    """

    def __init__(self, source: Path | str, *, anew: bool = False) -> None:
        # A lost last transaction is found again in the shards. Statements prepared while the tables are empty would
        # keep plans that read all rows.
        super().__init__(database_url(source), wait=_WAIT, durable=False, connect={"prepare_threshold": None})
        try:
            self._make_tables(anew)
        except BaseException:
            self.close()
            raise

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A connection for reading.

        Raises
        ------
        CatalogueFileError
            The database cannot be read.
        """
        with self._name_failures(), self.engine.connect() as connection:
            yield connection

    @contextmanager
    def writing(self, lock: int | None = None) -> Iterator[Connection]:
        """As :meth:`transaction`.

        Raises
        ------
        CatalogueFileError
            The database cannot be written.
        sqlalchemy.exc.IntegrityError
            Another writer has entered the same rows.
        """
        with self._name_failures(), self.transaction(lock) as connection:
            yield connection

    def is_sound(self) -> bool:
        """Whether the database finds itself undamaged; PostgreSQL's is taken for granted."""
        if not self.is_sqlite:
            return True
        try:
            with self.reading() as connection:
                return str(connection.scalar(text("PRAGMA integrity_check"))) == "ok"
        except CatalogueFileError:
            return False

    @contextmanager
    def _name_failures(self) -> Iterator[None]:
        try:
            yield
        except IntegrityError:
            raise
        except (DatabaseError, InterfaceError) as error:
            raise CatalogueFileError(self.name, f"cannot be used as an index ({error.orig})") from error

    def _make_tables(self, anew: bool) -> None:
        with self.reading() as connection:
            if _layout(connection) == INDEX_LAYOUT:
                return
        with self.writing(_TABLES_LOCK) as connection:
            found = _layout(connection)
            if found == INDEX_LAYOUT:
                return
            present = sorted(set(inspect(connection).get_table_names()) & set(METADATA.tables))
            if present and found is None:
                raise CatalogueFileError(self.name, f"holds tables of something else ({', '.join(present)})")
            if present and not anew:
                rule = f"is an index of layout {found}, not {INDEX_LAYOUT}: `jointplay reindex` makes it anew"
                raise CatalogueFileError(self.name, rule)
            METADATA.drop_all(connection)
            METADATA.create_all(connection)
            connection.execute(insert(LAYOUTS).values(number=INDEX_LAYOUT))


def _layout(connection: Connection) -> int | None:
    """Layout of the tables; None where they do not say it, or there are none."""
    if not inspect(connection).has_table(LAYOUTS.name):
        return None
    return connection.scalar(select(LAYOUTS.c.number))


def _configure(connection: Any, wait: float, durable: bool) -> None:
    """Set a new connection of SQLite up: readers never wait for a writer, references are checked."""
    connection.isolation_level = None  # transactions begin as `_begin` says, not as the driver guesses
    connection.execute(f"PRAGMA busy_timeout = {wait * 1000:.0f}")
    _write_ahead(connection, wait)
    for pragma in ("foreign_keys = ON", f"synchronous = {'FULL' if durable else 'NORMAL'}"):
        connection.execute(f"PRAGMA {pragma}")


def _write_ahead(connection: Any, wait: float) -> None:
    """Let a file be written ahead; that wants a new file alone, and does not wait for it as statements do."""
    until = time.monotonic() + wait
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF not in _PASSING or time.monotonic() > until:
                raise
            time.sleep(0.01)


def _begin(connection: Connection) -> None:
    """Writers take SQLite's lock at once: two that read first and write later would refuse each other."""
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
