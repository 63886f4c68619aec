"""What is kept is what was sent and answered: whatever is damaged is named, and nothing is concluded from it."""

from __future__ import annotations

import copy
import io
import os
import pickle
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from answers import diagnosis
from sqlalchemy import text

from jointplay.app.actor import Actor, acting
from jointplay.app.errors import AppError, DamagedRowError, RecordingDamagedError, RecordingMissingError
from jointplay.app.jobs import tasks
from jointplay.app.schemas.assets import AssetIn, FindingIn
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.checksums import Document
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.recording_files import read_bytes
from jointplay.app.storage.rows import Damaged, now
from jointplay.app.storage.standings import Standings
from jointplay.app.storage.store import NewDiagnosis, Store
from jointplay.app.storage.told import Told

MACHINE = {"name": "m", "joints": {"B": {"kind": "turning"}}}


def kept(store: Store, content: bytes = b"bytes", name: str = "a.csv") -> tuple[str, Path]:
    """The id of a stored measurement, and where its file lies."""
    upload = store.uploads.receive(io.BytesIO(content))
    row = store.add_measurement(upload, name, None, {"samples": 3})
    return row.id, store.path_of(row.sha256)


def exchange(path: Path) -> None:
    path.write_bytes(b"other bytes")


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def link(path: Path) -> None:
    """The same bytes, but by a link, which may lead elsewhere a moment later."""
    path.rename(path.with_suffix(".moved"))
    path.symlink_to(path.with_suffix(".moved"))


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


SPOILED: dict[str, tuple[Callable[[Path], Any], type[AppError], str]] = {
    "exchanged": (exchange, RecordingDamagedError, "is not what was stored: its SHA-256 is a3ead5eedad5df82"),
    "flipped": (flip, RecordingDamagedError, "is not what was stored"),
    "linked": (link, RecordingDamagedError, "is a link"),
    "pipe": (pipe, RecordingDamagedError, "is no file"),
    "gone": (Path.unlink, RecordingMissingError, "its file is missing"),
}


@pytest.mark.parametrize("kind", SPOILED)
@pytest.mark.parametrize("reader", ["diagnosed", "baseline", "bytes"])
def test_a_recording_that_is_not_what_was_stored_is_never_read(tmp_path: Path, kind: str, reader: str) -> None:
    with closing(Store(tmp_path)) as store:
        _, path = kept(store)
    readers: dict[str, Callable[[], object]] = {
        "diagnosed": lambda: tasks.summarise(str(path), "a.csv", Told()),
        "baseline": lambda: tasks.in_order((str(path), "a.csv", Told(), None, None)),
        "bytes": lambda: read_bytes(path),
    }
    assert read_bytes(path) == b"bytes"
    spoil, error, said = SPOILED[kind]
    spoil(path)
    with pytest.raises(error, match=said) as caught:
        readers[reader]()
    assert str(caught.value).endswith("bring it back from a backup")


def test_the_same_bytes_sent_again_heal_a_recording(tmp_path: Path) -> None:
    with closing(Store(tmp_path)) as store:
        _, path = kept(store)
        link(path)
        kept(store)
        assert read_bytes(path) == b"bytes" and not path.is_symlink()


def everything(store: Store) -> dict[str, str]:
    """One row of each kind, by the table it stands in."""
    measurement, _ = kept(store)
    Assets(store.database).put("press-7", AssetIn.model_validate({"machine": "m", "baseline": measurement}))
    asked = store.add_diagnosis(NewDiagnosis(measurement, "c" * 64, MACHINE, {"asset": None}, diagnosis()))
    found = Findings(store.database).add(
        asked, FindingIn.model_validate({"at": "2026-03-01T06:00:00Z", "text": "in order"})
    )
    return {"measurements": measurement, "assets": "press-7", "diagnoses": asked.id, "findings": found.id}


def execute(store: Store, statement: str) -> None:
    with store.database.engine.begin() as connection:
        connection.execute(text(statement))


def readers(store: Store) -> dict[str, tuple[Callable[[str], object], Callable[[list[Damaged] | None], list[Any]]]]:
    """How one row of each kind is read, and how all are."""
    assets, findings = Assets(store.database), Findings(store.database)
    return {
        "measurements": (store.measurement, lambda found: store.measurements(None, 9, damaged=found)),
        "diagnoses": (store.diagnosis, lambda found: store.diagnoses(None, 9, damaged=found)),
        "findings": (findings.finding, lambda found: findings.page(None, 9, damaged=found)),
        "assets": (assets.asset, lambda found: assets.page(None, 9, damaged=found)),
    }


CHANGED = {
    "measurements": "sha256 = 'b'",
    "diagnoses": "catalogue = 'd'",
    "findings": "text = 'worn'",
    "assets": "baseline = NULL",
}


@pytest.mark.parametrize("table", CHANGED)
def test_a_changed_row_is_named_and_takes_no_list_with_it(store: Store, table: str) -> None:
    key = everything(store)[table]
    kept(store, b"more", "b.csv")
    one, many = readers(store)[table]
    assert one(key) is not None
    before = len(many(None))
    execute(store, f"UPDATE {table} SET {CHANGED[table]} WHERE number = 1")
    with pytest.raises(DamagedRowError, match=f" {key}: its row is not what was written; bring it back from a backup$"):
        one(key)
    with pytest.raises(DamagedRowError):
        many(None)
    damaged: list[Damaged] = []
    assert len(many(damaged)) == before - 1
    assert [(each.number, each.id) for each in damaged] == [(1, key)]


def test_a_baseline_that_was_exchanged_is_named(store: Store) -> None:
    first, second = kept(store)[0], kept(store, b"more", "b.csv")[0]
    wanted = {"machine": "m", "baselines": [first, second]}
    Assets(store.database).put("press-7", AssetIn.model_validate(wanted))
    assert Assets(store.database).asset("press-7").in_order == (first, second)
    execute(store, "DELETE FROM asset_baselines")
    with pytest.raises(DamagedRowError, match="asset press-7: its row"):
        Assets(store.database).asset("press-7")


SPOILED_SQLITE = {
    "json": "UPDATE diagnoses SET result = substr(result, 2) WHERE number = 1",
    "letters": "UPDATE diagnoses SET result = CAST(X'FF' || result AS TEXT) WHERE number = 1",
    "moment": "UPDATE diagnoses SET created_at = '2026-13-40' WHERE number = 1",
    "kind": "UPDATE diagnoses SET created_at = 7 WHERE number = 1",
    "id": "UPDATE diagnoses SET id = CAST(X'FF' AS TEXT) WHERE number = 1",
}


@pytest.mark.parametrize("kind", SPOILED_SQLITE)
def test_a_row_that_cannot_even_be_read_takes_no_list_with_it(tmp_path: Path, kind: str) -> None:
    with closing(Store(tmp_path)) as store:
        key = everything(store)["diagnoses"]
        other = store.add_diagnosis(
            NewDiagnosis(kept(store, b"more")[0], "c" * 64, MACHINE, {"asset": None}, diagnosis())
        )
        with sqlite3.connect(tmp_path / "service.sqlite") as connection:
            connection.execute("PRAGMA foreign_keys = OFF")
            connection.execute(SPOILED_SQLITE[kind])
        connection.close()
        damaged: list[Damaged] = []
        assert [row.id for row in store.diagnoses(None, 9, damaged=damaged)] == [other.id]
        assert [each.number for each in damaged] == [1]
        if kind != "id":
            with pytest.raises(DamagedRowError, match=key):
                store.diagnosis(key)


def test_every_single_flipped_bit_of_a_result_is_seen(tmp_path: Path) -> None:
    with closing(Store(tmp_path)) as store:
        everything(store)
        with sqlite3.connect(tmp_path / "service.sqlite") as connection:
            [(content,)] = connection.execute("SELECT CAST(result AS BLOB) FROM diagnoses").fetchall()
        for place in range(0, len(content), 7):
            spoiled = bytearray(content)
            spoiled[place] ^= 1 << place % 8
            with connection:
                connection.execute("UPDATE diagnoses SET result = CAST(? AS TEXT)", [bytes(spoiled)])
            with pytest.raises(DamagedRowError):
                store.diagnoses(None, 9)
        connection.close()


def test_what_was_read_is_copied_as_what_it_holds(store: Store) -> None:
    """A copy may be changed and stored: it has no checksum of what it was."""
    read = store.measurement(everything(store)["measurements"]).summary
    assert isinstance(read, Document)
    assert [type(made) for made in (copy.deepcopy(read), pickle.loads(pickle.dumps(read)), read | {})] == [dict] * 3


def test_a_damaged_asset_does_not_keep_others_from_being_judged(store: Store) -> None:
    for name in ("press-7", "press-8"):
        Assets(store.database).put(name, AssetIn.model_validate({"machine": "m"}))
    execute(store, "UPDATE assets SET notes = 'moved' WHERE number = 1")
    with pytest.raises(DamagedRowError, match="asset press-7"):
        Standings(store.database).take(now())
    due = Standings(store.database).take(now())
    assert due is not None and due.external_id == "press-8"


def test_rows_say_who_made_them(store: Store) -> None:
    with acting(Actor(key="0a1b2c", address="192.0.2.7")):
        keys = everything(store)
    found = {table: one(keys[table]) for table, (one, _) in readers(store).items()}
    assert {row.made_by for row in found.values()} == {"key 0a1b2c"}  # type: ignore[attr-defined]
