"""Databases for an index: a file of SQLite always, and PostgreSQL wherever one answers.

``JOINTPLAY_TEST_POSTGRES`` names another server than the one of this computer. With ``JOINTPLAY_REQUIRE_POSTGRES`` set
(as ``.ci/run`` does), tests that need PostgreSQL fail where none answers; without it there are none of them then.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError

POSTGRES = os.environ.get("JOINTPLAY_TEST_POSTGRES", "postgresql://postgres@127.0.0.1:5432/test")


def answers() -> bool:
    engine = create_engine(POSTGRES.replace("postgresql:", "postgresql+psycopg:"), connect_args={"connect_timeout": 20})
    try:
        engine.connect().close()
    except OperationalError:
        return False
    finally:
        engine.dispose()
    return True


KINDS = ("sqlite", "postgresql") if os.environ.get("JOINTPLAY_REQUIRE_POSTGRES") or answers() else ("sqlite",)


@contextmanager
def database(kind: str, folder: Path) -> Iterator[str]:
    """URL of a new, empty database (in PostgreSQL: a schema), which is gone at the end."""
    if kind == "sqlite":
        yield f"sqlite:///{folder / 'index.db'}"
        return
    schema = f"jointplay_test_{secrets.token_hex(6)}"
    engine = create_engine(POSTGRES.replace("postgresql:", "postgresql+psycopg:"))
    try:
        with engine.begin() as connection:
            connection.execute(text(f"CREATE SCHEMA {schema}"))
        yield f"{POSTGRES}?options=-csearch_path%3D{schema}"
        with engine.begin() as connection:
            connection.execute(text(f"DROP SCHEMA {schema} CASCADE"))
    finally:
        engine.dispose()
