"""The service's database: every kind, made anew, taken over from an earlier version, refused from a later one."""

from __future__ import annotations

import io
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from answers import diagnosis
from sqlalchemy import event, text
from uploaded import SHA256, SIZE, uploaded

from jointplay.app.errors import AppError, BadFieldError, UnauthorizedError, UnknownAssetError, UnknownMeasurementError
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.database import REVISION, VERSION_TABLE, database_url, revision_of
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.store import Base, NewDiagnosis, Store, measurement_key
from jointplay.app.storage.told import Told


def test_what_is_stored_comes_back(store: Store, url: str, tmp_path: Path) -> None:
    first = store.add_measurement(uploaded(store), "a.csv", None, {"samples": 3})
    again = store.add_measurement(uploaded(store), "a.csv", None, {"samples": 4})
    assert (again.number, again.summary) == (first.number, {"samples": 3})
    new = NewDiagnosis(first.id, "c" * 64, {"name": "m"}, {}, diagnosis())
    asked = store.add_diagnosis(new)
    assert store.add_diagnosis(new).number == asked.number
    other = Store(tmp_path, url)
    row = other.measurement(first.id)
    other.close()
    assert row.size_bytes == SIZE
    assert row.created_at == first.created_at
    assert row.created_at.utcoffset() == timedelta(0)
    assert [found.id for found in store.diagnoses(None, 5)] == [asked.id]
    store.ready()


@pytest.mark.parametrize("key", ["0" * 32, "\0", "\ud800", "x" * 9000])
def test_ids_that_are_none(store: Store, key: str) -> None:
    with pytest.raises(UnknownMeasurementError):
        store.measurement(key)
    with pytest.raises(UnknownAssetError):
        Assets(store.database).asset(key)
    with pytest.raises(UnauthorizedError):
        Keys(store.database).find(f"jp_{key}_secret")


def test_revisions_make_the_tables_that_the_program_uses(store: Store) -> None:
    with store.database.engine.connect() as connection:
        opts = {"version_table": VERSION_TABLE, "compare_type": not store.database.is_sqlite}  # its types are loose
        context = MigrationContext.configure(connection, opts=opts)
        assert compare_metadata(context, Base.metadata) == []


def test_many_open_a_new_database_at_once(url: str, tmp_path: Path) -> None:
    def opened(_number: int) -> bool:
        found = Store(tmp_path, url)
        try:
            found.ready()
            return True
        finally:
            found.close()

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(opened, range(8))) == [True] * 8


def test_a_transaction_that_fails_leaves_nothing(store: Store) -> None:
    def spoiled() -> None:
        with store.database.writing() as session:
            session.execute(text("DELETE FROM measurements"))
            raise KeyError

    kept = store.add_measurement(uploaded(store), "a.csv", None, {})
    with pytest.raises(KeyError):
        spoiled()
    assert store.measurement(kept.id).id == kept.id


def test_a_file_of_an_earlier_version_keeps_what_it_has(tmp_path: Path) -> None:
    store = Store(tmp_path)
    kept = store.add_measurement(uploaded(store), "a.csv", None, {})
    store.close()
    with sqlite3.connect(tmp_path / "service.sqlite") as connection:
        connection.execute(f"DROP TABLE {VERSION_TABLE}")
        connection.execute("PRAGMA user_version = 1")
    connection.close()
    store = Store(tmp_path)
    assert store.measurement(kept.id).created_at == kept.created_at
    with store.database.engine.connect() as found:
        assert revision_of(found) == REVISION
    store.close()


def test_builds_of_an_earlier_version_stay(url: str, tmp_path: Path) -> None:
    store = Store(tmp_path, url)
    kept = BuildQueue(store.database).add({"name": "m"}, {"name": "p"}, "h" * 64, "c", None)
    with store.database.writing() as session:
        session.execute(text("ALTER TABLE builds DROP COLUMN request_id"))
        session.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '0001'"))
    store.close()
    store = Store(tmp_path, url)
    assert BuildQueue(store.database).find(kept.id).request_id is None
    store.close()


def test_measurements_of_an_earlier_version_are_read_as_they_were(url: str, tmp_path: Path) -> None:
    store = Store(tmp_path, url)
    told = Told(10_000.0)
    kept = store.add_measurement(uploaded(store), "a.csv", told, {})
    with store.database.writing() as session:
        session.execute(text("ALTER TABLE measurements DROP COLUMN beside_rate"))
        session.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '0002'"))
    store.close()
    store = Store(tmp_path, url)
    assert store.measurement(kept.id).told == told
    assert store.add_measurement(uploaded(store), "a.csv", told, {}).number == kept.number
    others = [Told(10_000.0, {"*": "g"}), Told(10_000.0, {}, {"full_scale": "5 g"}), Told(10_000.0, {"a": "g"})]
    rows = [store.add_measurement(uploaded(store), "a.csv", each, {}) for each in others]
    assert len({row.id for row in (kept, *rows)}) == 4
    assert [store.measurement(row.id).told for row in rows] == others
    store.close()


def test_databases_of_later_versions_are_refused(url: str, tmp_path: Path) -> None:
    store = Store(tmp_path, url)
    with store.database.writing() as session:
        session.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '9999'"))
    store.close()
    with pytest.raises(AppError, match="revision 9999, made by a newer version"):
        Store(tmp_path, url)


def test_a_file_of_another_layout_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "service.sqlite") as connection:
        connection.execute("PRAGMA user_version = 7")
    connection.close()
    with pytest.raises(AppError, match="has layout 7"):
        Store(tmp_path)


@pytest.mark.parametrize(
    ("given", "rule"),
    [
        ("nonsense", "is no URL of a database"),
        ("mysql://root:secret@host/x", "mysql: must be postgresql://"),
        ("sqlite://", "sqlite: must be"),
    ],
)
def test_settings_that_name_no_database(given: str, rule: str) -> None:
    with pytest.raises(BadFieldError, match=rule) as caught:
        database_url(given)
    assert str(caught.value).startswith("JOINTPLAY_DATABASE: ")
    assert "secret" not in str(caught.value)


def test_a_measurement_and_its_diagnosis_in_one_transaction(store: Store) -> None:
    commits: list[object] = []
    event.listen(store.database.engine, "commit", commits.append)
    told = Told(sample_rate_hz=1000.0)
    key = measurement_key(SHA256, "a.csv", told)
    noted: list[str] = []
    new = NewDiagnosis(key, "c" * 64, {"name": "m"}, {}, diagnosis(), lambda _session, made: noted.append(made))
    row = store.add_both(uploaded(store), "a.csv", told, {"samples": 3}, new)
    assert len(commits) == 1
    assert (store.measurement(key).told, row.measurement, noted) == (told, key, [row.id])
    found = store.diagnosis(row.id)
    for name in ("number", "id", "measurement", "catalogue", "machine", "created_at", "request", "result"):
        assert getattr(found, name) == getattr(row, name)
    assert store.add_both(uploaded(store), "a.csv", told, {"samples": 4}, new).number == row.number
    assert store.measurement(key).summary == {"samples": 3}
    assert noted == [row.id]


def test_an_upload_whose_measurement_was_not_stored_goes(store: Store) -> None:
    def fail(_session: object, _key: str) -> None:
        raise RuntimeError("the transaction fails")

    upload = store.receive(io.BytesIO(b"bytes"))
    with pytest.raises(RuntimeError, match="transaction fails"):
        store.add_measurement(upload, "a.csv", None, {}, fail)
    store.settle(upload)
    assert not upload.path.exists()


def test_writing_threads_wait_for_each_other_without_sleeping(tmp_path: Path) -> None:
    store = Store(tmp_path)

    @event.listens_for(store.database.engine, "checkout")
    def without_patience(connection: Any, *_: object) -> None:
        connection.execute("PRAGMA busy_timeout = 0")

    def write(number: int) -> None:
        for turn in range(20):
            store.add_measurement(uploaded(store), f"{number}-{turn}.csv", None, {})

    with ThreadPoolExecutor(8) as threads:
        assert list(threads.map(write, range(8))) == [None] * 8
    assert len(store.measurements(None, 1000)) == 160
    store.close()
