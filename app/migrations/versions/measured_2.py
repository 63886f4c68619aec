"""When a measurement was made; of those there are, the moment of receipt is known."""

import sqlalchemy as sa
from alembic import op

revision = "2"
down_revision = "1"


def upgrade() -> None:
    """Add the moment and who says it."""
    # SQLite adds no column without a default, and takes none away: a row of now always says both.
    moment = sa.Column("measured_at", sa.DateTime(timezone=True), nullable=False, server_default="1970-01-01 00:00:00")
    source = sa.Column("measured_at_source", sa.String(16), nullable=False, server_default="received")
    for column in (moment, source):
        op.add_column("measurements", column)
    op.execute("UPDATE measurements SET measured_at = created_at")
    if op.get_bind().dialect.name != "sqlite":
        for column in (moment, source):
            op.alter_column("measurements", column.name, server_default=None)
