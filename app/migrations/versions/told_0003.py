"""What the sender of a measurement said of its file, besides the sample rate."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision: str | None = "0002"


def upgrade() -> None:
    """Add the column; of what is stored nothing was said."""
    columns = [each["name"] for each in sa.inspect(op.get_bind()).get_columns("measurements")]
    if "beside_rate" not in columns:  # a file without revisions may be of any version
        op.add_column("measurements", sa.Column("beside_rate", sa.JSON))


def downgrade() -> None:
    """Forget what was said."""
    op.drop_column("measurements", "beside_rate")
