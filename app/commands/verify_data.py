"""What ``jointplay verify --data`` does: look through what a service keeps, repeat diagnoses, check a report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from jointplay.app.errors import AppError, DamageError, RecordingMissingError, UnknownDiagnosisError

if TYPE_CHECKING:
    from jointplay.app.settings import ServiceSettings
    from jointplay.app.storage.rows import DiagnosisRow
    from jointplay.app.storage.store import Store


def verify_service(settings: ServiceSettings, repeat: int, report: Path | None, *, as_json: bool) -> None:
    """Check what a service keeps, and print what is wrong, a line each.

    Parameters
    ----------
    settings : ServiceSettings
        Where it is.
    repeat : int
        How many diagnoses are made again, the newest.
    report : Path, optional
        A report that is to be one of a diagnosis which is there, unchanged; then nothing else is looked at.
    as_json : bool

    Raises
    ------
    DamageError
        Something is damaged.
    """
    from jointplay.app.commands.parameters import print_json
    from jointplay.app.storage.custody import KINDS, look_through
    from jointplay.app.storage.store import Store

    store = Store(settings.data, settings.database)
    looked: Counter[str] = Counter()
    damage: list[str] = []

    def tell(said: str) -> None:
        damage.append(said)
        if not as_json:
            click.echo(said)

    try:
        if report is not None:
            for said in check_report(store, report):
                tell(said)
        else:
            for step in look_through(store):
                looked[step.kind] += step.count
                for said in step.damage:
                    tell(said)
            for kind, said in repeat_newest(settings, store, repeat):
                looked[kind] += 1
                if said:
                    tell(said)
    finally:
        store.close()
    counts = {kind: looked[kind] for kind in (*KINDS, "repeated", "not_repeated")}
    if as_json:
        print_json({"data": str(settings.data), "sound": not damage, "looked_at": counts, "damage": damage})
    elif not damage:
        said = f"{looked['row']} rows, {looked['recording']} recordings, {looked['audit']} rows of the audit log"
        said += f", {looked['repeated']} diagnoses repeated" if repeat else ""
        if looked["not_repeated"]:
            said += f", {looked['not_repeated']} not: their recordings or catalogue were deleted, or have changed"
        click.echo(f"{report or settings.data}: in order{'' if report else f': {said}'}")
    if damage:
        raise DamageError(f"{report or settings.data}: {len(damage)} damaged; `jointplay restore` brings a backup back")


def repeat_newest(settings: ServiceSettings, store: Store, count: int) -> Iterator[tuple[str, str]]:
    """Make the newest diagnoses again; give of each whether it was ("repeated", "not_repeated"), and what is wrong.

    That something was deleted, or a catalogue has grown, is nothing wrong.
    """
    from jointplay.app.jobs.verification import check, repeat
    from jointplay.app.shelves.catalogues import CatalogueShelf
    from jointplay.app.storage.tombstones import missing
    from jointplay.catalogue.errors import CatalogueError

    shelf = CatalogueShelf(settings.catalogues, partial(missing, store.database, "catalogue"))

    def verified(row: DiagnosisRow) -> tuple[str, str]:
        found = check(store, row, shelf.place_of)
        if found.again is None:
            said = f"diagnosis {row.id}: cannot be repeated: {found.said}"
            return "not_repeated", said if found.is_damaged else ""
        try:
            again = repeat(found.again.then, found.again.recordings, found.again.question)
        except (AppError, CatalogueError) as error:
            return "not_repeated", f"diagnosis {row.id}: cannot be repeated: {error}"
        if again.outcome in ("equal", "rounding"):
            return "repeated", ""
        first = again.differences[0]
        was = f"{first.member} was {first.then}, is {first.now}"
        return "repeated", f"diagnosis {row.id}: comes out otherwise: {was}"

    if count:
        for row in store.diagnoses(None, count, damaged=[]):
            yield verified(row)


def check_report(store: Store, path: Path) -> Iterator[str]:
    """Give what is wrong with a report: what it is of is not there, or not what it was."""
    from jointplay.app.errors import AppError
    from jointplay.app.reports.evidence import evidence_of, read_evidence
    from jointplay.app.storage.recording_files import check_file
    from jointplay.app.storage.tombstones import checksums_of

    said = read_evidence(path.read_bytes())
    if said is None:
        yield f"{path}: names no diagnosis that it is of"
        return
    try:
        row = store.diagnosis(said.diagnosis)
        known = evidence_of(row)
    except UnknownDiagnosisError:
        yield f"{path}: diagnosis {said.diagnosis}: is not here"
        return
    except AppError as error:
        yield f"{path}: {error}"
        return
    for name in ("checksum", "catalogue", "recordings"):
        if getattr(said, name) != getattr(known, name):
            yield f"{path}: diagnosis {said.diagnosis}: its {name} is not the one of this report"
    gone = checksums_of(store.database, "measurement", store.deleted_of(row))
    for sha256 in known.recordings:
        try:
            for _ in check_file(store.path_of(sha256)):
                pass
        except RecordingMissingError as error:
            if sha256 not in gone:  # else somebody has deleted it, as the diagnosis says, too
                yield f"{path}: {error}"
        except AppError as error:
            yield f"{path}: {error}"
