"""The database behind an index: SQLite in write-ahead mode, or PostgreSQL; made and brought up to date on opening."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, create_engine, event, inspect, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DatabaseError, IntegrityError, InterfaceError, NoSuchModuleError

from jointplay.catalogue.errors import CatalogueFileError

REVISION = "0001"
"""The newest revision in :mod:`jointplay.catalogue.migrations`."""

VERSION_TABLE = "index_revision"
"""Where Alembic notes the revision; a name of its own, because the database may be shared with other programs."""

WAIT = 30.0
"""Longest wait for another process's write transaction [s]; they take milliseconds."""

_MIGRATION_LOCK = 7_264_917_003_118
"""Key of PostgreSQL's advisory lock that one opening process holds while it makes the tables."""


def database_url(source: Path | str) -> URL:
    """Where an index is, as a URL.

    Parameters
    ----------
    source : Path or str
        A file of SQLite; or a URL, ``postgresql://user@host:port/database``.

    Raises
    ------
    CatalogueFileError
        It is no URL, or one of another kind of database.
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
    shown = url.render_as_string(hide_password=True)
    raise CatalogueFileError(shown, "is no database an index can be in: SQLite or PostgreSQL")


class Database:
    """Connections to one database, whose tables are those of :mod:`jointplay.catalogue.storage.tables`.

    Parameters
    ----------
    source : Path or str
        As for :func:`database_url`; the tables are made where there are none.

    Raises
    ------
    CatalogueFileError
        It cannot be reached, is damaged, belongs to a newer program, or cannot be written.
    """

    def __init__(self, source: Path | str) -> None:
        url = database_url(source)
        self.is_sqlite = url.get_backend_name() == "sqlite"
        self.name = str(source) if self.is_sqlite else url.set(drivername="postgresql").render_as_string()
        # Statements prepared while the tables are empty would keep plans that read all rows.
        postgres = {"pool_pre_ping": True, "connect_args": {"prepare_threshold": None}}
        options: dict[str, Any] = {} if self.is_sqlite else postgres
        try:
            self._engine = create_engine(url, **options)
        except (ImportError, NoSuchModuleError):
            rule = "needs the package psycopg: pip install 'jointplay[cluster]'"
            raise CatalogueFileError(self.name, rule) from None
        if self.is_sqlite:
            event.listen(self._engine, "connect", _configure)
            event.listen(self._engine, "begin", _begin)
        try:
            self._migrate()
        except BaseException:
            self._engine.dispose()
            raise

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A connection for reading.

        Raises
        ------
        CatalogueFileError
            The database cannot be read.
        """
        with self._named(), self._engine.connect() as connection:
            yield connection

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A transaction that writes, all or nothing; SQLite lets one in at a time, from its beginning on.

        Raises
        ------
        CatalogueFileError
            The database cannot be written.
        sqlalchemy.exc.IntegrityError
            Another writer has entered the same rows.
        """
        with self._named(), self._engine.connect() as plain:
            connection = plain.execution_options(writes=True)
            with connection.begin():
                yield connection

    def close(self) -> None:
        """Give the database back; SQLite then folds its side files into it."""
        self._engine.dispose()

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
    def _named(self) -> Iterator[None]:
        try:
            yield
        except IntegrityError:
            raise
        except (DatabaseError, InterfaceError) as error:
            raise CatalogueFileError(self.name, f"cannot be used as an index ({error.orig})") from error

    def _migrate(self) -> None:
        with self.reading() as connection:
            if self._revision(connection) == REVISION:
                return
        with self.writing() as connection:
            if not self.is_sqlite:
                connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _MIGRATION_LOCK})
            revision = self._revision(connection)
            if revision is None and self.is_sqlite and inspect(connection).get_table_names():
                raise CatalogueFileError(self.name, "is an index of an earlier version")
            if revision != REVISION:
                self._upgrade(connection, revision)

    def _revision(self, connection: Connection) -> str | None:
        if not inspect(connection).has_table(VERSION_TABLE):
            return None
        found: str | None = connection.scalar(text(f"SELECT version_num FROM {VERSION_TABLE}"))
        return found

    def _upgrade(self, connection: Connection, revision: str | None) -> None:
        from alembic import command
        from alembic.config import Config
        from alembic.util.exc import CommandError

        config = Config()
        config.set_main_option("script_location", "jointplay.catalogue:migrations")
        config.attributes.update(connection=connection, version_table=VERSION_TABLE)
        try:
            command.upgrade(config, "head")
        except CommandError:
            rule = f"is an index of a newer version ({revision}): use the newer program"
            raise CatalogueFileError(self.name, rule) from None


def _configure(connection: Any, _record: object) -> None:
    """WAL lets readers read while a build writes; a lost last transaction is found again in the shards."""
    connection.isolation_level = None  # transactions begin as `_begin` says, not as the driver guesses
    cursor = connection.cursor()
    for pragma in (
        "journal_mode = WAL",
        "synchronous = NORMAL",
        "foreign_keys = ON",
        f"busy_timeout = {WAIT * 1000:.0f}",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin(connection: Connection) -> None:
    """Writers take the lock at once: two that read first and write later would refuse each other."""
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
