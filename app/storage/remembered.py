"""What was said of the files of an asset, kept for its next file with the same columns: sensors, units and the like."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import JSON, ForeignKey, String, select
from sqlalchemy.orm import Mapped, Session, mapped_column

from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Base, now

MOST = 20
"""Kinds of files of an asset that a new one is compared with, those that came last."""


class RememberedRow(Base):
    """What was said of the last file of an asset that had certain columns."""

    __tablename__ = "asset_columns"

    asset: Mapped[str] = mapped_column(ForeignKey("assets.external_id"), primary_key=True)
    columns: Mapped[str] = mapped_column(String(64), primary_key=True)
    mapping: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    said: Mapped[dict[str, Any]]
    noted_at: Mapped[datetime]


def columns_key(names: Iterable[str]) -> str:
    """Return what tells columns from others, in whatever order they stand."""
    return hashlib.sha256(json.dumps(sorted(names)).encode()).hexdigest()


class Remembered:
    """What was said of the files of all assets.

    Parameters
    ----------
    database : ServiceDatabase
        Of the service's store.
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database

    def mapping(self, asset: str, names: Iterable[str]) -> dict[str, str] | None:
        """Return which column is which sensor in files of an asset with these columns; None where nobody said it."""
        with self._database.reading() as session:
            row = session.get(RememberedRow, (asset, columns_key(names)))
        return None if row is None or row.mapping is None else dict(row.mapping)

    def has_mappings(self, asset: str) -> bool:
        """Return whether somebody has said of any files of an asset which column is which sensor."""
        query = select(RememberedRow.asset).where(RememberedRow.asset == asset, RememberedRow.mapping.is_not(None))
        with self._database.reading() as session:
            return session.scalar(query.limit(1)) is not None

    def all_said(self, asset: str) -> list[tuple[str, dict[str, Any]]]:
        """Return what was said of how to read files of an asset, by their columns, the last first."""
        query = select(RememberedRow).where(RememberedRow.asset == asset).order_by(RememberedRow.noted_at.desc())
        with self._database.reading() as session:
            return [(row.columns, dict(row.said)) for row in session.scalars(query.limit(MOST)) if row.said]

    def remember(
        self,
        session: Session,
        asset: str,
        names: Iterable[str],
        said: Mapping[str, Any],
        mapping: Mapping[str, str] | None = None,
    ) -> None:
        """Note in a transaction what is said of a file of an asset.

        Parameters
        ----------
        session : Session
        asset : str
        names : iterable of str
            Its columns.
        said : Mapping
            How to read it, as JSON values; nothing leaves what was said before.
        mapping : Mapping, optional
            Column to sensor; None leaves what was said before.
        """
        key = {"asset": asset, "columns": columns_key(names)}
        values: dict[str, Any] = {"noted_at": now()}
        if said:
            values["said"] = dict(said)
        if mapping is not None:
            values["mapping"] = dict(mapping)
        if len(values) > 1:
            insert = self._database.insert(RememberedRow).values(**{**key, "said": {}, "mapping": None, **values})
            session.execute(insert.on_conflict_do_update(index_elements=["asset", "columns"], set_=values))
