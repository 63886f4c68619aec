"""What a service keeps no longer: recordings whose time is over, told webhooks, and what killed servers have left."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from sqlalchemy import ColumnElement, delete, func, select

from jointplay.app.storage.asset_rows import AssetBaselineRow, AssetRow
from jointplay.app.storage.removal import GOING, Removal, tidy_folders
from jointplay.app.storage.retention import RetentionRow, class_in, recordings
from jointplay.app.storage.rows import MeasurementRow, now
from jointplay.app.storage.store import Store
from jointplay.app.storage.stored_files import ABANDONED_S, SIGNALS, parts
from jointplay.app.storage.tombstones import deleted
from jointplay.app.storage.webhooks import DeliveryRow

TOLD_DAYS = 30.0
"""How long it is kept what webhooks were told."""

BATCH = 200
"""Recordings that are deleted in one transaction."""

#: What goes besides recordings whose time is over, and why.
PARTIALS = ("uploads that broke off", f"nobody has sent more of them for {ABANDONED_S / 3600:g} hours")
ORPHANS = ("files of no recording", "a server ended before or after their row; kept in orphans/ for 30 days")
OLD_ORPHANS = ("files in orphans/", "no row has spoken of them for 30 days")
TOLD = ("deliveries of webhooks", f"made, or given up, more than {TOLD_DAYS:g} days ago")
REMAINS = ("catalogues", "a server ended while it deleted them")


@dataclass(frozen=True)
class Going:
    """Something that goes, or has gone.

    Parameters
    ----------
    what : str
        In the plural.
    why : str
    ids : tuple of str
        Of recordings their ids, of files their names.
    size_bytes : int
    """

    what: str
    why: str
    ids: tuple[str, ...]
    size_bytes: int


class Pruner:
    """Deletes what is kept no longer.

    Parameters
    ----------
    store : Store
    catalogues : Path
    keep_days : Mapping
        How long recordings of a class are kept, from when they came; None for ever.
    """

    def __init__(self, store: Store, catalogues: Path, keep_days: Mapping[str, float | None]) -> None:
        self._store, self._catalogues = store, catalogues
        self._keep = {of: days for of, days in keep_days.items() if days is not None}

    def look(self) -> list[Going]:
        """Return what would go; nothing is changed."""
        found = []
        for of, days in self._keep.items():
            rows = self._expired(of, days)
            found.append(Going(*self._said(of, days), tuple(key for key, _ in rows), sum(size for _, size in rows)))
        apart = self._store.files.why_apart()
        partials, orphans = self._partials(), [] if apart else list(self._store.files.orphans())
        old = [] if apart else self._store.files.old_orphans()
        found.append(
            Going(*PARTIALS, tuple(path.name for path, _ in partials), sum(size for _, size in partials)),
        )
        found += [of_files(ORPHANS, orphans), of_files(OLD_ORPHANS, old)]
        with self._store.database.reading() as session:
            told = select(DeliveryRow.id, func.length(DeliveryRow.body)).where(*self._told())
            rows = [(str(key), int(size)) for key, size in session.execute(told)]
        found.append(Going(*TOLD, tuple(key for key, _ in rows), sum(size for _, size in rows)))
        left = tuple(path.name for path in self._catalogues.glob(f"{GOING}*"))
        found.append(Going(*REMAINS, left, 0))
        return [each for each in found if each.ids]

    def why_apart(self) -> str:
        """Return why files of no recording stay; empty where they go."""
        return self._store.files.why_apart()

    def prune(self) -> Iterator[Going]:
        """Delete all of it, and give what has gone, a transaction at a time: whoever iterates may stop in between.

        What one kind of it fails of keeps no other kind from going.

        Raises
        ------
        Exception
            At the end, the first of what failed, with notes of the others.
        """
        failed: list[Exception] = []
        kinds = (self._prune_expired, self._prune_partials, self._prune_orphans, self._prune_told, self._prune_remains)
        for kind in kinds:
            try:
                yield from kind()
            except Exception as error:
                failed.append(error)
        if failed:
            first, *others = failed
            for each in others:
                first.add_note(f"besides: {type(each).__name__}: {each}")
            raise first

    def _prune_expired(self) -> Iterator[Going]:
        removal = Removal(self._store)
        for of, days in self._keep.items():
            what, why = self._said(of, days)
            for rows in parts(self._expired(of, days), BATCH):
                # Those stay for now that somebody needs since just now, and damaged ones.
                if gone := removal.delete_measurements([key for key, _ in rows], why):
                    yield Going(what, why, tuple(gone), sum(gone.values()))

    def _prune_partials(self) -> Iterator[Going]:
        for path, size in self._partials():
            path.unlink(missing_ok=True)
            yield Going(*PARTIALS, (path.name,), size)

    def _prune_orphans(self) -> Iterator[Going]:
        files = self._store.files
        if files.why_apart(settle=True):
            return
        files.bring_back()
        for orphans in parts(files.orphans(), BATCH):
            files.put_aside([sha256 for sha256, _ in orphans])
            yield of_files(ORPHANS, orphans)
        if old := files.old_orphans():
            files.drop_orphans([sha256 for sha256, _ in old])
            yield of_files(OLD_ORPHANS, old)

    def _prune_told(self) -> Iterator[Going]:
        with self._store.database.writing() as session:
            told = list(session.scalars(delete(DeliveryRow).where(*self._told()).returning(DeliveryRow.id)))
        if told:
            yield Going(*TOLD, tuple(told), 0)

    def _prune_remains(self) -> Iterator[Going]:
        if left := tidy_folders(self._catalogues):
            yield Going(*REMAINS, (GOING,) * left, 0)
        self._drop_samples()

    def _said(self, of: str, days: float) -> tuple[str, str]:
        return f"{of} recordings", f"kept for {days:g} days"

    def _expired(self, of: str, days: float) -> Sequence[tuple[str, int]]:
        """Ids and sizes of recordings of a class whose time is over; not those on hold, and no baseline in use."""
        first = select(AssetRow.baseline).where(AssetRow.baseline.is_not(None))
        with self._store.database.reading() as session:
            query = recordings(MeasurementRow.id, MeasurementRow.size_bytes).where(
                MeasurementRow.created_at < now() - timedelta(days=days),
                RetentionRow.hold.is_(None),
                class_in(session) == of,
                MeasurementRow.id.not_in(first),
                MeasurementRow.id.not_in(select(AssetBaselineRow.measurement)),
            )
            found = session.execute(query.order_by(MeasurementRow.number))
            return [(str(key), int(size)) for key, size in found]

    def _partials(self) -> list[tuple[Path, int]]:
        return [(path, size) for path, size, age in self._store.files.partials() if age > ABANDONED_S]

    def _told(self) -> tuple[ColumnElement[bool], ...]:
        return DeliveryRow.state != "waiting", DeliveryRow.created_at < now() - timedelta(days=TOLD_DAYS)

    def _drop_samples(self) -> None:
        """Delete samples that a worker had read of a recording just before that was deleted."""
        folder = self._store.directory / SIGNALS
        known = {path.stem for path in folder.iterdir()} if folder.is_dir() else set()
        with self._store.database.reading() as session:
            for key in known & set(session.scalars(deleted("measurement"))):
                self._store.files.drop_samples(key)


def of_files(kind: tuple[str, str], found: Iterable[tuple[str, int]]) -> Going:
    """Return files, with their sizes, as what goes."""
    found = list(found)
    return Going(*kind, tuple(sha256 for sha256, _ in found), sum(size for _, size in found))
