"""What was asked last of an asset: when, where it was asked before, and by which sensors and speed of a recording."""

import sqlalchemy as sa
from alembic import op

from jointplay.app.storage.database import UtcDateTime

revision = "7"
down_revision = "6"


def upgrade() -> None:
    """Add columns where there are none."""
    for table, column in (
        ("asset_diagnoses", sa.Column("asked_again_at", UtcDateTime())),
        ("asset_measurements", sa.Column("mapping", sa.JSON())),
        ("asset_measurements", sa.Column("speed", sa.Double())),
    ):
        if column.name not in {each["name"] for each in sa.inspect(op.get_bind()).get_columns(table)}:
            op.add_column(table, column)
