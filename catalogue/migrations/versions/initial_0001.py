"""Catalogues, shards, entries and chunks."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision: str | None = None


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "catalogues",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("instance", sa.String(36), nullable=False, unique=True),
    )
    op.create_table(
        "shards",
        _of_catalogue(),
        sa.Column("sha256", sa.String(64), primary_key=True),
        sa.Column("size", sa.BigInteger, nullable=False),
        sa.Column("entries", sa.Integer, nullable=False),
    )
    op.create_table(
        "entries",
        sa.Column("catalogue", sa.Integer, primary_key=True),
        sa.Column("key", sa.String(64), primary_key=True),
        sa.Column("shard", sa.String(64), nullable=False),
        sa.Column("position", sa.Integer, nullable=False),
        sa.Column("hypothesis", sa.Text, nullable=False),
        sa.Column("status", sa.Text, nullable=False),
        sa.Column("message", sa.Text, nullable=False),
        sa.ForeignKeyConstraint(["catalogue", "shard"], ["shards.catalogue", "shards.sha256"], ondelete="CASCADE"),
    )
    op.create_index("entries_by_shard", "entries", ["catalogue", "shard"])
    op.create_table(
        "chunks",
        _of_catalogue(),
        sa.Column("id", sa.String(64), primary_key=True),
        sa.Column("position", sa.Integer, nullable=False),
        sa.Column("hypothesis", sa.Text, nullable=False),
        sa.Column("entries", sa.Integer, nullable=False),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("owner", sa.Text, nullable=False),
        sa.Column("lease_until", sa.Double, nullable=False),
        sa.Column("output_sha256", sa.String(64), nullable=False),
        sa.Column("seconds", sa.Double, nullable=False),
        sa.Column("message", sa.Text, nullable=False),
    )


def downgrade() -> None:
    """Take the tables away: an index is made again from the shards."""
    for table in ("chunks", "entries", "shards", "catalogues"):
        op.drop_table(table)


def _of_catalogue() -> sa.Column[int]:
    return sa.Column("catalogue", sa.Integer, sa.ForeignKey("catalogues.id", ondelete="CASCADE"), primary_key=True)
