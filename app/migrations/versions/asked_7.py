"""A diagnosis of an asset says when its question was asked again, after another one."""

import sqlalchemy as sa
from alembic import op

from jointplay.app.storage.database import UtcDateTime

revision = "7"
down_revision = "6"


def upgrade() -> None:
    """Add the column where there is none."""
    there = {each["name"] for each in sa.inspect(op.get_bind()).get_columns("asset_diagnoses")}
    if "asked_again_at" not in there:
        op.add_column("asset_diagnoses", sa.Column("asked_again_at", UtcDateTime()))
