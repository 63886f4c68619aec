"""How much a service stores, how fast that grows, and when there is no space left for more."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import case, func, select, text

from jointplay.app.storage.retention import CLASSES, class_in, recordings
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow, now
from jointplay.app.storage.store import Store

WINDOW = timedelta(days=7)
"""What came in it says how fast recordings come."""

LEAST = timedelta(days=1)
"""A service that is younger is not judged by less."""


@dataclass(frozen=True)
class Held:
    """What is stored of a class of recordings.

    Parameters
    ----------
    count : int
    size_bytes : int
        The same bytes under two ids count twice.
    oldest : datetime or None
        When the first of them came.
    per_day : float
        Bytes that came in a day.
    """

    count: int = 0
    size_bytes: int = 0
    oldest: datetime | None = None
    per_day: float = 0.0


@dataclass(frozen=True)
class Usage:
    """What a service stores.

    Parameters
    ----------
    classes : Mapping
    partials : Held
        Uploads that are on their way or broke off.
    diagnoses : int
    database_bytes : int
        Size of the database.
    database_per_day : float
        Bytes by which it grows in a day, where it lies on the same disk.
    free_bytes, disk_bytes : int
        Of the disk of recordings.
    """

    classes: Mapping[str, Held]
    partials: Held
    diagnoses: int
    database_bytes: int
    database_per_day: float
    free_bytes: int
    disk_bytes: int

    def days_until_full(self, keep_days: Mapping[str, float | None]) -> float:
        """Return after how many days there is no space left, if all goes on as in the last week; infinite for never.

        Parameters
        ----------
        keep_days : Mapping
            How long recordings of a class are kept: from then on as much goes as comes.
        """
        growing = [(self.database_per_day, math.inf)]
        for of, held in self.classes.items():
            days = keep_days.get(of)
            most = math.inf if days is None else max(held.per_day * days - held.size_bytes, 0.0)
            growing.append((held.per_day, most))
        return days_to_fill(self.free_bytes, growing)


def days_to_fill(free: float, growing: Iterable[tuple[float, float]]) -> float:
    """Return after how many days what grows has filled a space.

    Parameters
    ----------
    free : float
        Bytes.
    growing : iterable of (float, float)
        Bytes that are added in a day, and in all at most.
    """
    rates = sorted((most / rate, rate) for rate, most in growing if rate > 0)
    day = 0.0
    while rates:
        speed, until = sum(rate for _, rate in rates), rates[0][0]
        if speed * (until - day) >= free:
            return day + free / speed
        free -= speed * (until - day)
        day = rates.pop(0)[0]
    return math.inf


def measure(store: Store) -> Usage:
    """Return what a service stores now."""
    moment = now()
    with store.database.reading() as session:
        of, size, came = class_in(session), MeasurementRow.size_bytes, MeasurementRow.created_at
        lately = func.sum(case((came > moment - WINDOW, size), else_=0))
        query = recordings(of, func.count(), func.sum(size), func.min(came), lately).group_by(of)
        rows = {name: (count, total, first, new) for name, count, total, first, new in session.execute(query)}
        since = case((DiagnosisRow.created_at > moment - WINDOW, 1), else_=0)
        answers = select(func.count(), func.sum(since), func.min(DiagnosisRow.created_at))
        diagnoses, recent, begun = session.execute(answers).one()
        database_bytes = size_of_database(store)
    classes: dict[str, Held] = {
        name: Held(int(count), int(total), first, float(new) / days_of(first, moment))
        for name in CLASSES
        for count, total, first, new in [rows.get(name, (0, 0, None, 0))]
    }
    partials = store.files.partials()
    disk = shutil.disk_usage(store.directory)
    # A file of SQLite lies beside the recordings; a server of its own has a disk of its own.
    growth = database_bytes * int(recent or 0) / max(diagnoses, 1) / days_of(begun, moment)
    return Usage(
        classes,
        Held(len(partials), sum(size for _, size, _ in partials)),
        int(diagnoses),
        database_bytes,
        growth if store.database.is_sqlite else 0.0,
        disk.free,
        disk.total,
    )


def days_of(first: datetime | None, moment: datetime) -> float:
    """Return over how many days it is known what came: those of the window, or since the first came."""
    known = WINDOW if first is None else min(max(moment - first, LEAST), WINDOW)
    return known / timedelta(days=1)


def size_of_database(store: Store) -> int:
    """Return the size of the database in bytes, the rows that SQLite has not folded into its file yet included."""
    with store.database.reading() as session:
        if store.database.is_sqlite:
            pages = session.scalar(text("PRAGMA page_count")) or 0
            return int(pages) * int(session.scalar(text("PRAGMA page_size")) or 0)
        return int(session.scalar(text("SELECT pg_database_size(current_database())")) or 0)
