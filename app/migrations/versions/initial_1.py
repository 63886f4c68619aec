"""The tables of version 1.0, from which later revisions go on; a new database gets the newest tables at once."""

revision = "1"
down_revision: str | None = None


def upgrade() -> None:
    """Change nothing."""
