"""Checksums of what people send, say and are answered, and who made it; of rows that are there, nobody knows who."""

import sqlalchemy as sa
from alembic import op

from jointplay.app.storage.checksums import checksum, row_checksum
from jointplay.app.storage.database import UtcDateTime

revision = "4"
down_revision = "3"

CHUNK = 200

MEASUREMENTS = {
    **{"id": sa.String, "sha256": sa.String, "name": sa.String, "size_bytes": sa.BigInteger, "said": sa.JSON},
    **{"created_at": UtcDateTime, "summary": sa.JSON, "measured_at": UtcDateTime, "measured_at_source": sa.String},
}
DIAGNOSES = {
    **{"id": sa.String, "measurement": sa.String, "catalogue": sa.String, "machine": sa.JSON},
    **{"created_at": UtcDateTime, "request": sa.JSON, "result": sa.JSON},
}
FINDINGS = {
    **{"id": sa.String, "diagnosis": sa.String, "asset": sa.String, "created_at": UtcDateTime, "at": UtcDateTime},
    **{"joints": sa.JSON, "text": sa.Text},
}
ASSETS = {
    **{"external_id": sa.String, "machine": sa.String, "notes": sa.Text, "baseline": sa.String},
    **{"baselines_sha256": sa.String, "created_at": UtcDateTime, "updated_at": UtcDateTime, "limits_um": sa.JSON},
    **{"silent_after_days": sa.Integer, "warn_within_days": sa.Integer},
}
SEALED = {"measurements": MEASUREMENTS, "diagnoses": DIAGNOSES, "findings": FINDINGS, "assets": ASSETS}


def upgrade() -> None:
    """Add both, and give every row its checksum."""
    # SQLite adds no column without a default, and takes none away: a row of now always says all.
    seals = [(table, sa.Column("checksum", sa.String(64), nullable=False, server_default="")) for table in SEALED]
    seals.append(("assets", sa.Column("baselines_sha256", sa.String(64), nullable=False, server_default="")))
    for table, column in seals:
        op.add_column(table, column)
    for table in SEALED:
        op.add_column(table, sa.Column("made_by", sa.String(256)))
    connection = op.get_bind()
    name_baselines(connection)
    for table, columns in SEALED.items():
        seal(connection, table, columns)
    if connection.dialect.name != "sqlite":
        for table, column in seals:
            op.alter_column(table, column.name, server_default=None)


def name_baselines(connection: sa.Connection) -> None:
    """Give assets the checksum of their baselines."""
    assets = sa.table("assets", *map(sa.column, ("number", "external_id", "baseline", "baselines_sha256")))
    further = sa.table("asset_baselines", *map(sa.column, ("asset", "place", "measurement")))
    more: dict[str, list[str]] = {}
    # The newest tables are made after this: a database of before there were several baselines has not this one yet.
    if sa.inspect(connection).has_table("asset_baselines"):
        for asset, measurement in connection.execute(
            sa.select(further.c.asset, further.c.measurement).order_by(further.c.asset, further.c.place)
        ):
            more.setdefault(asset, []).append(measurement)
    for number, name, first in connection.execute(
        sa.select(assets.c.number, assets.c.external_id, assets.c.baseline)
    ).all():
        found = [] if first is None else [first, *more.get(name, [])]
        named = sa.update(assets).where(assets.c.number == number)
        connection.execute(named.values(baselines_sha256=checksum(found)))


def seal(connection: sa.Connection, name: str, columns: dict[str, type[sa.types.TypeEngine]]) -> None:  # type: ignore[type-arg]
    """Give the rows of a table their checksums."""
    typed = [sa.column(each, kind()) for each, kind in columns.items()]
    table = sa.table(name, sa.column("number"), sa.column("checksum"), *typed)
    last = 0
    while True:
        query = sa.select(table.c.number, *typed).where(table.c.number > last).order_by(table.c.number).limit(CHUNK)
        rows = connection.execute(query).mappings().all()
        if not rows:
            return
        for row in rows:
            found = row_checksum({"made_by": None, **{each: row[each] for each in columns}})
            connection.execute(sa.update(table).where(table.c.number == row["number"]).values(checksum=found))
        last = rows[-1]["number"]
