"""Tables of the service as older revisions had them."""

from __future__ import annotations

from sqlalchemy import Connection, text

from jointplay.app.storage.database import VERSION_TABLE


def take_seals(connection: Connection) -> None:
    """Make the tables those of revision 3."""
    for table in ("measurements", "diagnoses", "findings", "assets"):
        for column in ("checksum", "made_by", *(["baselines_sha256"] if table == "assets" else [])):
            connection.execute(text(f"ALTER TABLE {table} DROP COLUMN {column}"))
    connection.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '3'"))
