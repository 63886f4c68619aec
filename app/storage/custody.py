"""Whether everything that a service keeps is what was stored: its rows, its recordings, its audit log.

The same for whoever asks for it once and for the server that looks all the time. It goes in small steps, between which
nothing is held, so that it can be as slow as it likes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import select

from jointplay.app.errors import RecordingDamagedError, RecordingMissingError
from jointplay.app.storage.asset_rows import AssetRow, FindingRow
from jointplay.app.storage.audit import AuditLog
from jointplay.app.storage.recording_files import check_file
from jointplay.app.storage.rows import Damaged, DiagnosisRow, MeasurementRow, rows_of
from jointplay.app.storage.store import Store
from jointplay.app.storage.tombstones import deleted

Kind = Literal["row", "recording", "audit"]
KINDS: tuple[Kind, ...] = ("row", "recording", "audit")

CHUNK = 20
ROW_BYTES = 20_000
"""What a row is counted as; most of a diagnosis is its evidence."""

MANY, NOTE_BYTES = 500, 1000
"""Rows of the audit log that are looked at in one step, and what each is counted as."""

SEALED: tuple[Any, ...] = (MeasurementRow, DiagnosisRow, FindingRow, AssetRow)


@dataclass(frozen=True)
class Step:
    """What was looked at just now.

    Parameters
    ----------
    kind : str
        row, recording, or audit.
    count, bytes : int
        How many of them, and how much that was to read; a large recording is read in several steps, of which the last
        counts.
    damage : tuple of str
        What is wrong, a line each.
    """

    kind: Kind
    count: int
    bytes: int
    damage: tuple[str, ...] = ()


def look_through(store: Store) -> Iterator[Step]:
    """Look at all rows, then at all recordings, then at the audit log."""
    yield from look_at_rows(store)
    yield from look_at_recordings(store)
    count = 0
    for said in AuditLog(store.database).look():
        count += 1
        if said or count == MANY:
            yield Step("audit", count, NOTE_BYTES * count, (f"audit log: {said}",) if said else ())
            count = 0
    yield Step("audit", count, NOTE_BYTES * count)


def look_at_rows(store: Store) -> Iterator[Step]:
    """Look at all rows that have a checksum."""
    for table in SEALED:
        last = 0
        while True:
            damaged: list[Damaged] = []
            query = select(table).where(table.number > last).order_by(table.number).limit(CHUNK)
            with store.database.reading() as session:
                found = [*rows_of(session, table, query, damaged), *damaged]
            if not found:
                break
            last = max(each.number for each in found)
            yield Step("row", len(found), ROW_BYTES * len(found), tuple(each.problem for each in damaged))


def look_at_recordings(store: Store) -> Iterator[Step]:
    """Look at all recordings that rows speak of; those that were deleted are to be missing."""
    last = ""
    there = select(MeasurementRow.sha256).where(MeasurementRow.id.not_in(deleted("measurement"))).distinct()
    while True:
        query = there.where(MeasurementRow.sha256 > last)
        with store.database.reading() as session:
            found = list(session.scalars(query.order_by(MeasurementRow.sha256).limit(CHUNK)))
        for sha256 in found:
            try:
                for size in check_file(store.path_of(sha256)):
                    yield Step("recording", 0, size)
                yield Step("recording", 1, 0)
            except (RecordingDamagedError, RecordingMissingError) as error:
                yield Step("recording", 1, 0, (str(error),))
        if not found:
            return
        last = found[-1]
