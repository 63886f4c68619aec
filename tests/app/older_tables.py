"""Tables of the service as older revisions had them."""

from __future__ import annotations

from sqlalchemy import Connection, text

from jointplay.app.storage.database import VERSION_TABLE


def say_twice_who_stored(connection: Connection) -> None:
    """Make the tables those of revision 4."""
    for index in ("ix_measurements_sha256", "ix_diagnoses_measurement"):
        connection.execute(text(f"DROP INDEX {index}"))
    connection.execute(text("ALTER TABLE retention ADD COLUMN stored_by VARCHAR(16)"))
    connection.execute(text("CREATE INDEX ix_retention_stored_by ON retention (stored_by)"))
    connection.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '4'"))


def take_seals(connection: Connection) -> None:
    """Make the tables those of revision 3."""
    for table in ("measurements", "diagnoses", "findings", "assets"):
        for column in ("checksum", "made_by", *(["baselines_sha256"] if table == "assets" else [])):
            connection.execute(text(f"ALTER TABLE {table} DROP COLUMN {column}"))
    connection.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '3'"))
