"""Measurements and diagnoses; those of a file made before there were revisions stay as they are."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision: str | None = None


def upgrade() -> None:
    """Make the tables that are not there."""
    present = sa.inspect(op.get_bind()).get_table_names()
    if "measurements" not in present:
        op.create_table(
            "measurements",
            sa.Column("number", sa.Integer, primary_key=True, autoincrement=True),
            sa.Column("id", sa.String(32), nullable=False, unique=True),
            sa.Column("sha256", sa.String(64), nullable=False),
            sa.Column("name", sa.String(255), nullable=False),
            sa.Column("size_bytes", sa.BigInteger, nullable=False),
            sa.Column("given_sample_rate_hz", sa.Float),
            sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
            sa.Column("summary", sa.JSON, nullable=False),
        )
    if "diagnoses" not in present:
        op.create_table(
            "diagnoses",
            sa.Column("number", sa.Integer, primary_key=True, autoincrement=True),
            sa.Column("id", sa.String(32), nullable=False, unique=True),
            sa.Column("measurement", sa.String(32), sa.ForeignKey("measurements.id"), nullable=False),
            sa.Column("catalogue", sa.String(64), nullable=False),
            sa.Column("machine", sa.JSON, nullable=False),
            sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
            sa.Column("request", sa.JSON, nullable=False),
            sa.Column("result", sa.JSON, nullable=False),
        )


def downgrade() -> None:
    """Take the tables away, and with them what was measured."""
    op.drop_table("diagnoses")
    op.drop_table("measurements")
