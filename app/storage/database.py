"""The service's database: SQLite in write-ahead mode, or PostgreSQL; made and brought up to date on opening."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from typing import Any, TypeVar

from sqlalchemy import (
    ColumnElement,
    Connection,
    DateTime,
    Dialect,
    Double,
    MetaData,
    TypeDecorator,
    cast,
    event,
    func,
    inspect,
    literal,
    select,
    text,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import URL
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import DeclarativeBase, Session, sessionmaker

from jointplay.app.errors import AppError, BadFieldError, DamagedDatabaseError, NotReadyError
from jointplay.app.storage.checksums import read_document, write_document
from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.storage import database
from jointplay.catalogue.storage.database import Database

REVISION = "7"
"""The newest revision in :mod:`jointplay.app.migrations`."""

VERSION_TABLE = "service_revision"
"""Where Alembic notes the revision; a name of its own, because the database may be shared with other programs."""

WAIT_S = 10.0
"""Longest wait for another process's write transaction, or for a server to take a connection."""

POOL_S = 2.5
"""Longest wait for one of the connections to a server, all of which are in use."""

PROBE_S = 1.0
"""Longest wait of a look whether the database can be written to."""

TABLES_LOCK = 7_264_917_003_119
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
        return database.database_url(given)
    except CatalogueFileError as error:
        raise refusal(error) from None


def refusal(error: CatalogueFileError) -> BadFieldError:
    """Return the error for a setting that names no usable database."""
    return BadFieldError(f"JOINTPLAY_DATABASE: {error.rule}", field="database")


Row = TypeVar("Row", bound=DeclarativeBase)


def load_json(content: str | bytes) -> Any:
    """Return the value of a column.

    Raises
    ------
    DamagedDatabaseError
        When it is no JSON.
    """
    try:
        return read_document(content)
    except ValueError:
        raise DamagedDatabaseError("a row of the database is damaged: a column of it is no JSON") from None


def is_id(key: str) -> bool:
    """Return whether a text can be an id."""
    return key.isascii() and key.isalnum() and len(key) <= 64


class ServiceDatabase(Database):
    """Connections to the database of a service.

    Parameters
    ----------
    url : URL
        As of :func:`database_url`.
    metadata : MetaData
        The tables it is to have. Those that are missing are made; one that is there is changed by a revision only.

    Raises
    ------
    AppError
        Its tables are those of another version of the program, or of another one, or its driver is not installed.
    sqlalchemy.exc.OperationalError
        It cannot be reached.
    """

    def __init__(self, url: URL, metadata: MetaData) -> None:
        waits = {"connect_timeout": round(WAIT_S), "tcp_user_timeout": round(WAIT_S * 1000)}
        try:
            # An answer that says "stored" outlives a loss of power.
            json_texts = (load_json, write_document)
            super().__init__(url, wait=WAIT_S, durable=True, connect=waits, pool_wait=POOL_S, json_texts=json_texts)
        except CatalogueFileError as error:
            raise refusal(error) from None
        self.session = sessionmaker(self.engine, expire_on_commit=False)
        self._writer = threading.Lock()
        try:
            self._update(metadata)
        except BaseException:
            self.close()
            raise
        self._opened = self._identity()

    def limit_waits(self) -> None:
        """From now on let nobody wait for a server that is stalled, nor longer for a statement or a lock than is told.

        For a service, which has somebody who waits for its answer; a backup may take its time.
        """
        if self.is_sqlite:
            return
        from jointplay.app.storage import stalls

        def plain() -> Any:
            arguments, options = self.engine.dialect.create_connect_args(self.engine.url)
            return stalls.connect_plain(*arguments, **options)

        pulse = stalls.Pulse(plain)

        def connect(_dialect: object, _record: object, arguments: Any, options: Any) -> Any:
            return stalls.connect_limited(pulse, *arguments, **options)

        event.listen(self.engine, "do_connect", connect)
        self.engine.dispose()  # connections of before are without

    def check_file(self) -> None:
        """Refuse to go on with a file that is not the one that was opened: what is written there would be lost.

        Raises
        ------
        sqlalchemy.exc.OperationalError
            When it was taken away, or another lies in its place.
        """
        if self._identity() != self._opened:
            # For everybody who goes on when the database is gone, it is.
            raise OperationalError(None, None, NotReadyError("its file is not the one that was opened"))

    def _identity(self) -> tuple[int, int] | None:
        """Tell the file from others; None where the database is none, or there is none any more."""
        if not self.is_sqlite or not self.engine.url.database:
            return None
        try:
            found = os.stat(self.engine.url.database)
        except FileNotFoundError:
            return None
        return found.st_dev, found.st_ino

    def try_writing(self) -> None:
        """Write a row as it is, and take that back.

        Raises
        ------
        sqlalchemy.exc.SQLAlchemyError
            As of :meth:`check_file`; or when it cannot be written to, or is locked by others for longer than a moment.
        """
        self.check_file()
        with self.engine.connect() as plain:
            driver: Any = plain.connection.driver_connection
            connection = plain.execution_options(writes=True)
            try:
                if self.is_sqlite:
                    driver.execute(f"PRAGMA busy_timeout = {PROBE_S * 1000:.0f}")
                connection.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = version_num"))
                connection.rollback()
            finally:
                if self.is_sqlite:
                    driver.execute(f"PRAGMA busy_timeout = {WAIT_S * 1000:.0f}")

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

        Raises
        ------
        sqlalchemy.exc.OperationalError
            When the file is not the one that was opened, or no longer when all is written: it is not to be said that
            it was stored.
        """
        self.check_file()
        held = self.is_sqlite and self._writer.acquire(timeout=WAIT_S)
        try:
            with self.session.begin() as session:
                session.connection(execution_options={"writes": True})
                yield session
        finally:
            if held:
                self._writer.release()
        self.check_file()

    def epoch(self) -> ColumnElement[float]:
        """Return the seconds since 1970, by one clock for all servers: the database's; SQLite has the computer's."""
        if self.is_sqlite:
            return literal(time.time(), Double)
        return cast(func.extract("epoch", func.clock_timestamp()), Double)

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

    def insert_new(self, table: type[DeclarativeBase]) -> Any:
        """Return the INSERT of a row, given as parameters, that gives its number unless there is one of the same id."""
        return _insert_new(table, self.is_sqlite)

    def _update(self, metadata: MetaData) -> None:
        with self.engine.connect() as connection:
            present = set(inspect(connection).get_table_names())
            if revision_of(connection) == REVISION and set(metadata.tables) <= present:
                return
        with self.transaction(TABLES_LOCK) as connection:
            self._migrate(connection, metadata)
            metadata.create_all(connection)

    def _migrate(self, connection: Connection, metadata: MetaData) -> None:
        """Bring the tables that are there up to date; where there are none, note the revision of those to be made."""
        from alembic import command
        from alembic.config import Config
        from alembic.util.exc import CommandError

        revision = revision_of(connection)
        present = sorted(set(inspect(connection).get_table_names()) & set(metadata.tables))
        if present and revision is None:
            rule = f"holds a table {present[0]} that is not of this version of the program: name another database"
            raise AppError(f"{self.name}: {rule}")
        config = Config()
        config.set_main_option("script_location", "jointplay.app:migrations")
        config.attributes.update(connection=connection, version_table=VERSION_TABLE)
        try:
            (command.upgrade if present else command.stamp)(config, "head")
        except CommandError:
            rule = f"has revision {revision}, made by another version of the program; use that"
            raise AppError(f"{self.name}: {rule}") from None


@cache  # to put a statement together takes longer than to run it
def _insert_new(table: type[DeclarativeBase], is_sqlite: bool) -> Any:
    made = (sqlite if is_sqlite else postgresql).insert(table.__table__)
    return made.on_conflict_do_nothing(index_elements=["id"]).returning(table.__table__.c.number)


def revision_of(connection: Connection) -> str | None:
    """Return the revision that a database is at; ``None`` for one without."""
    if not inspect(connection).has_table(VERSION_TABLE):
        return None
    found: str | None = connection.scalar(text(f"SELECT version_num FROM {VERSION_TABLE}"))
    return found
