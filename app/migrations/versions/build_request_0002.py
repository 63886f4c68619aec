"""Builds know the request that asked for them; those asked for before do not."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision: str | None = "0001"


def upgrade() -> None:
    """Add the column, where there are builds; a table that is not there is made with it."""
    found = sa.inspect(op.get_bind())
    if found.has_table("builds") and all(column["name"] != "request_id" for column in found.get_columns("builds")):
        op.add_column("builds", sa.Column("request_id", sa.String(64)))


def downgrade() -> None:
    """Take it away."""
    op.drop_column("builds", "request_id")
