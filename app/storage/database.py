"""The service's database: SQLite in write-ahead mode, or PostgreSQL; made and brought up to date on opening."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any, TypeVar

from sqlalchemy import (
    Connection,
    DateTime,
    Dialect,
    MetaData,
    TypeDecorator,
    create_engine,
    event,
    inspect,
    select,
    text,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError
from sqlalchemy.orm import DeclarativeBase, Session, sessionmaker

from jointplay.app.errors import AppError, BadFieldError

REVISION = "0003"
"""The newest revision in :mod:`jointplay.app.migrations`."""

VERSION_TABLE = "service_revision"
"""Where Alembic notes the revision; a name of its own, because the database may be shared with other programs."""

FORMER_LAYOUTS = (0, 1)
"""`user_version` of SQLite files: none, and the one of files that were made before there were revisions."""

WAIT_S = 10.0
"""Longest wait for another process's write transaction, or for a server to take a connection."""

MIGRATION_LOCK = 7_264_917_003_119
"""Key of PostgreSQL's advisory lock that one opening process holds while it makes the tables."""


class UtcDateTime(TypeDecorator[datetime]):
    """A moment that comes back in UTC: SQLite forgets the zone, PostgreSQL answers in that of its server."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Return what is stored."""
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Return what is read."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


def database_url(given: str) -> URL:
    """Return a setting as a URL.

    Raises
    ------
    BadFieldError
        When it is no URL, or one of another kind of database; a password in it is not shown.
    """
    try:
        url = make_url(given)
    except (ArgumentError, ValueError):
        raise refusal("is no URL of a database; one is postgresql://user@host:5432/database") from None
    if url.get_backend_name() == "postgresql":
        return url.set(drivername="postgresql+psycopg")
    if url.get_backend_name() == "sqlite" and url.database:
        return url.set(drivername="sqlite")
    raise refusal(f"{url.get_backend_name()}: must be postgresql:// or sqlite:///FILE")


def refusal(rule: str) -> BadFieldError:
    """Return the error for a setting that names no usable database."""
    return BadFieldError(f"JOINTPLAY_DATABASE: {rule}", field="database")


Row = TypeVar("Row", bound=DeclarativeBase)


def is_id(key: str) -> bool:
    """Return whether a text can be an id."""
    return key.isascii() and key.isalnum() and len(key) <= 64


class Database:
    """Connections to one database.

    Parameters
    ----------
    url : URL
        As of :func:`database_url`.
    metadata : MetaData
        The tables it is to have. Those that are missing are made; one that is there is changed by a revision only.

    Raises
    ------
    AppError
        It belongs to a newer version of the program, or its driver is not installed.
    sqlalchemy.exc.OperationalError
        It cannot be reached.
    """

    def __init__(self, url: URL, metadata: MetaData) -> None:
        self.is_sqlite = url.get_backend_name() == "sqlite"
        self.name = url.render_as_string(hide_password=True)
        waits = {"connect_timeout": round(WAIT_S), "tcp_user_timeout": round(WAIT_S * 1000)}
        postgres = {"pool_pre_ping": True, "connect_args": waits}
        options: dict[str, Any] = {} if self.is_sqlite else postgres
        try:
            # Errors are logged, values of a statement are not: some are secrets.
            self.engine = create_engine(url, hide_parameters=True, **options)
        except (ImportError, NoSuchModuleError):
            raise refusal("needs the package psycopg: pip install 'jointplay[cluster]'") from None
        if self.is_sqlite:
            event.listen(self.engine, "connect", configure)
            event.listen(self.engine, "begin", begin)
        self.session = sessionmaker(self.engine, expire_on_commit=False)
        self._writer = threading.Lock()
        try:
            self._update(metadata)
        except BaseException:
            self.engine.dispose()
            raise

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """A session for reading."""
        with self.session() as session:
            yield session

    @contextmanager
    def writing(self) -> Iterator[Session]:
        """A transaction that writes, all or nothing; SQLite lets one in at a time, from its beginning on.

        Threads of this process wait for each other here: SQLite's own way to wait is to sleep up to 100 ms and to look
        again. What lasts too long is left to SQLite, which knows what to say.
        """
        held = self.is_sqlite and self._writer.acquire(timeout=WAIT_S)
        try:
            with self.session.begin() as session:
                session.connection(execution_options={"writes": True})
                yield session
        finally:
            if held:
                self._writer.release()

    def find(self, table: type[Row], key: str) -> Row | None:
        """Return the row of a table whose ``id`` is `key`; None where there is none.

        Texts that can be no id do not reach the database: PostgreSQL refuses some characters.
        """
        if not is_id(key):
            return None
        with self.reading() as session:
            return session.scalar(select(table).filter_by(id=key))

    def insert(self, table: Any) -> Any:
        """Return an INSERT of this kind of database, which has ``on_conflict_do_nothing``."""
        return sqlite.insert(table) if self.is_sqlite else postgresql.insert(table)

    def close(self) -> None:
        """Let go of it."""
        self.engine.dispose()

    def _update(self, metadata: MetaData) -> None:
        with self.engine.connect() as connection:
            if self._is_current(connection, metadata):
                return
        with self.engine.connect() as plain:
            connection = plain.execution_options(writes=True)
            with connection.begin():
                if not self.is_sqlite:
                    connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": MIGRATION_LOCK})
                self._migrate(connection)
                metadata.create_all(connection)

    def _is_current(self, connection: Connection, metadata: MetaData) -> bool:
        present = set(inspect(connection).get_table_names())
        return revision_of(connection) == REVISION and set(metadata.tables) <= present

    def _migrate(self, connection: Connection) -> None:
        from alembic import command
        from alembic.config import Config
        from alembic.util.exc import CommandError

        if self.is_sqlite:
            layout = connection.execute(text("PRAGMA user_version")).scalar_one()
            if layout not in FORMER_LAYOUTS:
                raise AppError(f"{self.name}: has layout {layout}, made by another version of the program")
        config = Config()
        config.set_main_option("script_location", "jointplay.app:migrations")
        config.attributes.update(connection=connection, version_table=VERSION_TABLE)
        revision = revision_of(connection)
        try:
            command.upgrade(config, "head")
        except CommandError:
            raise AppError(
                f"{self.name}: has revision {revision}, made by a newer version of the program; use that"
            ) from None


def revision_of(connection: Connection) -> str | None:
    """Return the revision that a database is at; ``None`` for one without."""
    if not inspect(connection).has_table(VERSION_TABLE):
        return None
    found: str | None = connection.scalar(text(f"SELECT version_num FROM {VERSION_TABLE}"))
    return found


def configure(connection: Any, _record: object) -> None:
    """Set a new connection of SQLite up: readers never wait for a writer, references are checked.

    What is committed is on the disk (FULL): an answer that says "stored" outlives a loss of power.
    """
    connection.isolation_level = None  # transactions begin as `begin` says, not as the driver guesses
    connection.execute(f"PRAGMA busy_timeout = {WAIT_S * 1000:.0f}")
    write_ahead(connection)
    for pragma in ("foreign_keys = ON", "synchronous = FULL"):
        connection.execute(f"PRAGMA {pragma}")


def write_ahead(connection: Any) -> None:
    """Let a file be written ahead; that wants a new file alone, and does not wait for it as statements do."""
    until = time.monotonic() + WAIT_S
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.OperationalError:
            if time.monotonic() > until:
                raise
            time.sleep(0.01)


def begin(connection: Connection) -> None:
    """Writers take SQLite's lock at once: two that read first and write later would refuse each other."""
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
