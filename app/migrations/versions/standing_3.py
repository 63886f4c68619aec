"""Limits of assets, and what each asks of somebody; assets that are there are judged as soon as a server runs."""

import sqlalchemy as sa
from alembic import op

revision = "3"
down_revision = "2"


def upgrade() -> None:
    """Add both."""
    # SQLite adds no column without a default, and takes none away: a row of now always says all.
    columns = (
        sa.Column("limits_um", sa.JSON, nullable=False, server_default="{}"),
        sa.Column("silent_after_days", sa.Integer, nullable=False, server_default="30"),
        sa.Column("warn_within_days", sa.Integer, nullable=False, server_default="30"),
        sa.Column("state", sa.String(16), nullable=False, server_default="unknown"),
        sa.Column("need", sa.Integer, nullable=False, server_default="0"),
        sa.Column("reasons", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("known", sa.JSON, nullable=False, server_default="{}"),
        sa.Column("said", sa.JSON, nullable=False, server_default="[]"),
        sa.Column("acknowledged", sa.JSON),
        sa.Column("limit_at", sa.DateTime(timezone=True)),
        sa.Column("changes", sa.Integer, nullable=False, server_default="1"),
        sa.Column("followed", sa.Integer, nullable=False, server_default="0"),
        sa.Column("due_at", sa.DateTime(timezone=True), server_default="1970-01-01 00:00:00"),
    )
    for column in columns:
        op.add_column("assets", column)
    op.create_index("ix_assets_due_at", "assets", ["due_at"])
    if op.get_bind().dialect.name != "sqlite":
        for column in columns:
            op.alter_column("assets", column.name, server_default=None)
