"""Who stored a recording is said by its row alone; what recordings hold, and what was answered of them, is found."""

import sqlalchemy as sa
from alembic import op

revision = "5"
down_revision = "4"


def upgrade() -> None:
    """Take a column away that said it again, where there is one, and add two indices."""
    found = sa.inspect(op.get_bind())
    if found.has_table("retention") and any(each["name"] == "stored_by" for each in found.get_columns("retention")):
        op.drop_index("ix_retention_stored_by", "retention")
        op.drop_column("retention", "stored_by")
    for table, column in (("measurements", "sha256"), ("diagnoses", "measurement")):
        op.create_index(f"ix_{table}_{column}", table, [column], if_not_exists=True)
