"""The service's database: every kind, made anew, brought up to date, refused from another version."""

from __future__ import annotations

import io
import json
import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from answers import diagnosis
from older_tables import say_twice_who_stored, take_seals
from sqlalchemy import event, inspect, text
from sqlalchemy.orm import Session
from uploaded import SHA256, SIZE, uploaded

from jointplay.app.errors import AppError, BadFieldError, UnauthorizedError, UnknownAssetError, UnknownMeasurementError
from jointplay.app.rows import joint_rows
from jointplay.app.schemas.assets import AssetIn, FindingIn
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.backup import TABLES
from jointplay.app.storage.database import REVISION, VERSION_TABLE, database_url, revision_of
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.rows import DiagnosisRow, now
from jointplay.app.storage.standings import Standings
from jointplay.app.storage.store import NewDiagnosis, Store, measurement_key
from jointplay.app.storage.told import Told
from jointplay.app.storage.webhooks import announce
from jointplay.catalogue.storage.database import Database

MACHINE = {"name": "m", "joints": {"B": {"kind": "turning"}}}


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
    store.database.try_writing()


@pytest.mark.parametrize("key", ["0" * 32, "\0", "\ud800", "x" * 9000])
def test_ids_that_are_none(store: Store, key: str) -> None:
    with pytest.raises(UnknownMeasurementError):
        store.measurement(key)
    with pytest.raises(UnknownAssetError):
        Assets(store.database).asset(key)
    with pytest.raises(UnauthorizedError):
        Keys(store.database).find(f"jp_{key}_secret")


def differences(store: Store) -> list[Any]:
    """What differs between the tables of a database and those that the program uses."""
    with store.database.engine.connect() as connection:
        opts = {"version_table": VERSION_TABLE, "compare_type": not store.database.is_sqlite}  # its types are loose
        context = MigrationContext.configure(connection, opts=opts)
        return list(compare_metadata(context, TABLES))


def connected(url: str) -> Database:
    return Database(database_url(url), wait=10.0, durable=False, connect={})


def test_a_new_database_has_the_tables_that_the_program_uses(store: Store) -> None:
    assert differences(store) == []
    with store.database.engine.connect() as connection:
        assert revision_of(connection) == REVISION


def test_many_open_a_new_database_at_once(url: str, tmp_path: Path) -> None:
    def opened(_number: int) -> bool:
        found = Store(tmp_path, url)
        try:
            found.database.try_writing()
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


def test_a_recording_and_its_answer_are_one_transaction_of_few_statements(store: Store) -> None:
    """A statement more costs a server of many clients its rate: beside rows, webhooks are told and a chain is noted."""

    def told(session: Session, key: str, new: bool) -> None:
        announce(session, "diagnosis.created", {"diagnosis": key})

    def both(name: str) -> None:
        upload = uploaded(store)
        key = measurement_key(upload.sha256, name, Told())
        asked = NewDiagnosis(key, "c" * 64, MACHINE, {"asset": None}, diagnosis(), told)
        store.add_both(upload, name, Told(), {}, asked)

    both("a.csv")  # the first row of the audit log makes the chain's end
    said: list[str] = []
    event.listen(store.database.engine, "before_cursor_execute", lambda *given: said.append(given[2]))
    event.listen(store.database.engine, "commit", lambda _: said.append("COMMIT"))
    both("b.csv")
    words = [each.split()[0] for each in said[1:]]  # the first begins the transaction, or locks
    assert words == ["INSERT", "INSERT", "SELECT", "SELECT", "INSERT", "UPDATE", "COMMIT"]


def test_tables_of_version_1_become_those_of_now(tmp_path: Path) -> None:
    """A table that has changed without a revision is found here: new databases do not go through revisions."""
    with sqlite3.connect(tmp_path / "service.sqlite") as connection:
        connection.executescript((Path(__file__).parents[1] / "data/service/revision-1.sql").read_text())
    connection.close()
    with closing(Store(tmp_path)) as store:
        with store.database.engine.connect() as found:
            assert revision_of(found) == REVISION
        assert differences(store) == []


def test_assets_of_revision_2_are_due_to_be_judged(store: Store, url: str, tmp_path: Path) -> None:
    Assets(store.database).put("press-7", AssetIn.model_validate({"machine": "m", "notes": "hall B"}))
    added = "limits_um silent_after_days warn_within_days state need reasons known said acknowledged limit_at changes"
    with closing(connected(url)) as database, database.transaction() as connection:
        take_seals(connection)
        connection.execute(text("DROP INDEX ix_assets_due_at"))
        for column in [*added.split(), "followed", "due_at"]:
            connection.execute(text(f"ALTER TABLE assets DROP COLUMN {column}"))
        connection.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '2'"))
    with closing(Store(tmp_path, url)) as opened:
        assert differences(opened) == []
        row = Assets(opened.database).asset("press-7")
        assert (row.notes, row.limits_um, row.silent_after_days, row.state) == ("hall B", {}, 30, "unknown")
        due = Standings(opened.database).take(now())
        assert due is not None and (due.external_id, due.known) == ("press-7", None)
        assert Assets(opened.database).put("press-8", AssetIn.model_validate({"machine": "m"}))[1] is True


def test_rows_of_revision_3_get_their_checksums(store: Store, url: str, tmp_path: Path) -> None:
    keys = [store.add_measurement(uploaded(store), f"{name}.csv", None, {"rate": 0.1 + 0.2}).id for name in "abc"]
    wanted = {"machine": "m", "baselines": keys[:2], "limits_um": {"B": 1e-7 + 200}}
    Assets(store.database).put("press-7", AssetIn.model_validate(wanted))
    Assets(store.database).put("press-8", AssetIn.model_validate({"machine": "m"}))
    asked = store.add_diagnosis(NewDiagnosis(keys[2], "c" * 64, MACHINE, {"asset": None}, diagnosis()))
    Findings(store.database).add(
        asked, FindingIn.model_validate({"at": "2026-03-01T06:00:00.123Z", "joints": {"B": {"clearance_um": 12.5}}})
    )
    with closing(connected(url)) as database, database.transaction() as connection:
        take_seals(connection)
    with closing(Store(tmp_path, url)) as opened:
        assert differences(opened) == []
        assets = Assets(opened.database)
        assert [row.id for row in opened.measurements(None, 9)] == keys[::-1]
        assert [row.in_order for row in assets.page(None, 9)] == [(), tuple(keys[:2])]
        assert opened.diagnosis(asked.id).answer == diagnosis()
        assert [row.made_by for row in Findings(store.database).page(None, 9)] == [None]


def test_who_stored_a_recording_is_said_once_from_revision_5_on(store: Store, url: str, tmp_path: Path) -> None:
    kept = store.add_measurement(uploaded(store), "a.csv", None, {})
    with closing(connected(url)) as database, database.transaction() as connection:
        say_twice_who_stored(connection)
    with closing(Store(tmp_path, url)) as opened:
        assert differences(opened) == []
        assert opened.measurement(kept.id).made_by == "system"


def test_answers_of_version_1_are_read() -> None:
    """A member that is added later has a default, and none goes: whoever kept an answer finds it again."""
    kept = json.loads((Path(__file__).parents[1] / "data/service/answer-1.json").read_text())
    answer = DiagnosisRow(result=kept).answer
    assert answer.model_dump(mode="json", exclude_unset=True) == kept
    assert [row.name for row in joint_rows(answer)] == ["B", "A", "O"]


def test_what_is_said_of_a_measurement_is_part_of_what_it_is(store: Store) -> None:
    told = Told(10_000.0)
    kept = store.add_measurement(uploaded(store), "a.csv", told, {})
    assert store.add_measurement(uploaded(store), "a.csv", told, {}).number == kept.number
    others = [Told(), Told(10_000.0, {"*": "g"}), Told(10_000.0, {}, {"full_scale": "5 g"}), Told(10_000.0, {"a": "g"})]
    rows = [store.add_measurement(uploaded(store), "a.csv", each, {}) for each in others]
    assert len({row.id for row in (kept, *rows)}) == 5
    assert [store.measurement(row.id).told for row in (kept, *rows)] == [told, *others]


@pytest.mark.parametrize("revision", ["9999", "0001", "0003"])  # before version 1 there were three
def test_databases_of_other_versions_are_refused(url: str, tmp_path: Path, revision: str) -> None:
    Store(tmp_path, url).close()
    with closing(connected(url)) as database, database.transaction() as connection:
        connection.execute(text(f"UPDATE {VERSION_TABLE} SET version_num = '{revision}'"))
    with pytest.raises(AppError, match=f"has revision {revision}, made by another version of the program; use that$"):
        Store(tmp_path, url)


def test_tables_of_something_else_are_refused_and_left_alone(url: str, tmp_path: Path) -> None:
    with closing(connected(url)) as database, database.transaction() as connection:
        connection.execute(text("CREATE TABLE measurements (thesis TEXT)"))
    with pytest.raises(AppError, match="holds a table measurements that is not of this version of the program: name"):
        Store(tmp_path, url)
    with closing(connected(url)) as database, database.transaction() as connection:
        assert inspect(connection).get_table_names() == ["measurements"]


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
    noted: list[tuple[str, bool]] = []
    new = NewDiagnosis(key, "c" * 64, {"name": "m"}, {}, diagnosis(), lambda _, *said: noted.append(said))
    row = store.add_both(uploaded(store), "a.csv", told, {"samples": 3}, new)
    assert len(commits) == 1
    assert (store.measurement(key).told, row.measurement, noted) == (told, key, [(row.id, True)])
    found = store.diagnosis(row.id)
    for name in ("number", "id", "measurement", "catalogue", "machine", "created_at", "request", "result", "checksum"):
        assert getattr(found, name) == getattr(row, name)
    assert store.add_both(uploaded(store), "a.csv", told, {"samples": 4}, new).number == row.number
    assert store.measurement(key).summary == {"samples": 3}
    assert noted == [(row.id, True), (row.id, False)]


def test_an_upload_whose_measurement_was_not_stored_goes(store: Store) -> None:
    def fail(_session: object, _key: str) -> None:
        raise RuntimeError("the transaction fails")

    upload = store.uploads.receive(io.BytesIO(b"bytes"))
    with pytest.raises(RuntimeError, match="transaction fails"):
        store.add_measurement(upload, "a.csv", None, {}, fail)
    store.uploads.settle(upload)
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
