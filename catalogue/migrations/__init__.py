"""Alembic's revisions of the index; they run when an index is opened."""
