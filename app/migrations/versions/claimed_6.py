"""A key of idempotency says which request has claimed it, and until when without a sign of life."""

import sqlalchemy as sa
from alembic import op

revision = "6"
down_revision = "5"


def upgrade() -> None:
    """Add two columns where there are none, and free the keys of servers that have ended without saying so."""
    there = {each["name"] for each in sa.inspect(op.get_bind()).get_columns("idempotency")}
    for column in (sa.Column("owner", sa.String(32)), sa.Column("lease_until", sa.Double)):
        if column.name not in there:
            op.add_column("idempotency", column)
    op.execute("DELETE FROM idempotency WHERE status IS NULL")
