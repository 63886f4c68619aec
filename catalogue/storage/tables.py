"""Tables of the index."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Column,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Integer,
    MetaData,
    String,
    Table,
    Text,
)
from sqlalchemy import Index as TableIndex

METADATA = MetaData()


def _of_catalogue() -> Column[int]:
    return Column("catalogue", Integer, ForeignKey("catalogues.id", ondelete="CASCADE"), primary_key=True)


LAYOUTS = Table("index_layout", METADATA, Column("number", Integer, primary_key=True))

CATALOGUES = Table(
    "catalogues",
    METADATA,
    Column("id", Integer, primary_key=True),
    Column("instance", String(36), nullable=False, unique=True),
)

SHARDS = Table(
    "shards",
    METADATA,
    _of_catalogue(),
    Column("sha256", String(64), primary_key=True),
    Column("size", BigInteger, nullable=False),
    Column("entries", Integer, nullable=False),
)

ENTRIES = Table(
    "entries",
    METADATA,
    Column("catalogue", Integer, primary_key=True),
    Column("key", String(64), primary_key=True),
    Column("shard", String(64), nullable=False),
    Column("position", Integer, nullable=False),
    Column("hypothesis", Text, nullable=False),
    Column("status", Text, nullable=False),
    Column("message", Text, nullable=False),
    ForeignKeyConstraint(["catalogue", "shard"], ["shards.catalogue", "shards.sha256"], ondelete="CASCADE"),
    TableIndex("entries_by_shard", "catalogue", "shard"),
)

CHUNKS = Table(
    "chunks",
    METADATA,
    _of_catalogue(),
    Column("id", String(64), primary_key=True),
    Column("position", Integer, nullable=False),
    Column("hypothesis", Text, nullable=False),
    Column("entries", Integer, nullable=False),
    Column("status", String(16), nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("owner", Text, nullable=False),
    Column("lease_until", Double, nullable=False),
    Column("output_sha256", String(64), nullable=False),
    Column("seconds", Double, nullable=False),
    Column("message", Text, nullable=False),
)
