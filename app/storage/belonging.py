"""Whether a folder of data and a database belong together: only then is a file without a row nobody's.

A service that is started with another database than before finds a folder full of files that no row of that speaks of.
So both have the same random id. It is made when both are new, and where one of them has none yet although most files of
the folder are spoken of.
"""

from __future__ import annotations

import secrets
from pathlib import Path

from sqlalchemy import String, delete, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Base
from jointplay.catalogue.storage.directory import publish

NAME = "database.id"
"""File of a folder of data with the id that it has in common with its database."""


class BelongingRow(Base):
    """The id of the folder of data that a database belongs to."""

    __tablename__ = "belonging"

    place: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    id: Mapped[str] = mapped_column(String(32))


def id_of(directory: Path) -> str | None:
    """Return the id of a folder of data; None where it has none."""
    try:
        return (directory / NAME).read_text(encoding="utf-8").strip()
    except FileNotFoundError:
        return None


def id_in(session: Session) -> str | None:
    """Return the id of a database; None where it has none."""
    return session.scalar(select(BelongingRow.id))


def tie(directory: Path, database: ServiceDatabase, *, anew: bool = False) -> None:
    """Give a folder of data and its database the same id, the database first: it has one, whoever is faster."""
    with database.writing() as session:
        if anew:
            session.execute(delete(BelongingRow))
        values = {"place": 1, "id": secrets.token_hex(16)}
        session.execute(database.insert(BelongingRow).values(values).on_conflict_do_nothing())
        known = id_in(session)
    publish(directory / NAME, f"{known}\n".encode())


def why_apart(directory: Path, database: ServiceDatabase) -> str:
    """Return why nothing is to be deleted of what no row speaks of; empty where both have the same id."""
    held = id_of(directory)
    with database.reading() as session:
        known = id_in(session)
    if held is not None and held == known:
        return ""
    cure = f"name the right one in JOINTPLAY_DATABASE; if this is the right one, delete {directory / NAME}"
    whose = "most of its files are of another" if held is None else "it has the id of another"
    return f"{directory}: {whose} database than {database.name}: files of no recording stay there; {cure}"
