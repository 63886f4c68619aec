"""When a measurement was made: said by its sender, found in its file, or neither; kept, corrected, gone by."""

from __future__ import annotations

import io
import json
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner
from http_answers import API, assert_problem, send
from older_tables import take_seals
from sqlalchemy import select
from uploaded import uploaded

from jointplay.app.cli import main
from jointplay.app.schemas.assets import AssetIn
from jointplay.app.storage.asset_rows import AssetMeasurementRow
from jointplay.app.storage.assets import Assets, measurements_of
from jointplay.app.storage.backup import ROWS, Place, back_up, restore
from jointplay.app.storage.rows import MeasurementRow
from jointplay.app.storage.store import Store
from jointplay.app.storage.told import Told, read_told

SAID = "2024-11-21T11:03:00+01:00"
AT = datetime(2024, 11, 21, 10, 3, tzinfo=UTC)


def dated(worn: bytes, line: str) -> bytes:
    return f"{line}\n".encode() + worn


def moment_of(document: dict[str, Any]) -> tuple[datetime, str]:
    return datetime.fromisoformat(document["measured_at"]), document["measured_at_source"]


# --- the store --------------------------------------------------------------------------------------------------------


def test_who_says_it_is_stored_with_it(store: Store) -> None:
    plain = store.add_measurement(uploaded(store), "a.csv", None, {"samples": 3, "measured_at": None})
    assert (plain.measured_at, plain.measured_at_source) == (plain.created_at, "received")
    assert plain.summary == {"samples": 3}
    of_file = store.add_measurement(uploaded(store), "b.csv", None, {"measured_at": AT.isoformat()})
    assert (of_file.measured_at, of_file.measured_at_source) == (AT, "file")
    ahead = {"measured_at": (datetime.now(UTC) + timedelta(hours=1)).isoformat()}
    local = store.add_measurement(uploaded(store), "local.csv", None, ahead)
    assert (local.measured_at, local.measured_at_source) == (local.created_at, "received")
    with store.database.writing() as session:  # an hour and more ago, so that the file's moment is over by now
        session.get_one(MeasurementRow, local.number).created_at -= timedelta(hours=3)
        session.get_one(MeasurementRow, local.number).measured_at -= timedelta(hours=3)
    over = {"measured_at": (datetime.now(UTC) - timedelta(hours=1)).isoformat()}
    again = store.add_measurement(uploaded(store), "local.csv", None, over)
    assert (again.measured_at, again.measured_at_source) == (again.created_at, "received"), "sent again it is no later"
    later = AT + timedelta(days=1)
    said = store.add_measurement(uploaded(store), "c.csv", Told(measured_at=later), {"measured_at": AT.isoformat()})
    assert (said.measured_at, said.measured_at_source) == (later, "sender")
    for row in (plain, of_file, said):
        found = store.measurement(row.id)
        assert (found.measured_at, found.measured_at_source) == (row.measured_at, row.measured_at_source)
        assert found.measured_at.utcoffset() == timedelta(0)
        assert found.told.measured_at == (later if row is said else None)


def test_the_same_bytes_were_measured_once(store: Store) -> None:
    """Whoever says when, corrects it; whoever says nothing, leaves it."""
    first = store.add_measurement(uploaded(store), "a.csv", None, {})
    for moment in (AT, AT - timedelta(days=30)):
        again = store.add_measurement(uploaded(store), "a.csv", Told(measured_at=moment), {})
        assert (again.number, again.id) == (first.number, first.id)
        found = store.measurement(first.id)
        assert (found.measured_at, found.measured_at_source) == (moment, "sender")
    store.add_measurement(uploaded(store), "a.csv", None, {"measured_at": None})
    assert store.measurement(first.id).measured_at == AT - timedelta(days=30)
    assert store.correct_moment(first.id, AT).measured_at == store.measurement(first.id).measured_at == AT
    assert len(store.measurements(None, 5)) == 1


def test_a_window_goes_by_when_they_were_made(store: Store) -> None:
    assets = Assets(store.database)
    assets.put("press", AssetIn(machine="slider-crank"))
    days = {"third.csv": 3, "first.csv": 1, "second.csv": 2}
    for name, day in days.items():
        row = store.add_measurement(uploaded(store), name, Told(measured_at=AT + timedelta(days=day)), {})
        assets.own("press", row.id)
    window = (measurements_of("press"), AT + timedelta(days=1), AT + timedelta(days=3))
    assert [row.name for row in store.measurements_between(*window, 9)] == ["first.csv", "second.csv"]
    everything = store.measurements_between(measurements_of("press"), AT, None, 9)
    assert [row.name for row in everything] == ["first.csv", "second.csv", "third.csv"]


def of_version_1(file: Path, sha256: str) -> None:
    """Make a database as version 1 has it, with a measurement that is the baseline of an asset."""
    script = (Path(__file__).parents[1] / "data/service/revision-1.sql").read_text()
    with closing(sqlite3.connect(file)) as connection:
        connection.executescript(script)
        values = f"1, 'm1', '{sha256}', 'a.csv', 7, '{{}}', '2023-05-06 07:08:09.000010', '{{}}'"
        connection.execute(f"INSERT INTO measurements VALUES ({values})")
        connection.execute(
            "INSERT INTO assets VALUES (1, 'press', 'slider-crank', '', 'm1', '2023-01-01', '2023-01-01')"
        )
        connection.execute("INSERT INTO asset_measurements VALUES ('press', 'm1')")
        connection.commit()


def test_of_version_1_the_moment_of_receipt_is_known(tmp_path: Path) -> None:
    of_version_1(tmp_path / "service.sqlite", "aa")
    with closing(Store(tmp_path)) as store:
        row = store.measurement("m1")
        assert row.measured_at == row.created_at == datetime(2023, 5, 6, 7, 8, 9, 10, tzinfo=UTC)
        assert row.measured_at_source == "received"
        assert store.correct_moment("m1", AT).measured_at == AT
        with store.database.reading() as session:
            assert list(session.scalars(select(AssetMeasurementRow.measurement))) == ["m1"]


def test_tables_of_version_1_in_any_database(store: Store) -> None:
    """The revision itself, where its columns are taken away first."""
    from importlib import import_module

    from alembic.migration import MigrationContext
    from alembic.operations import Operations

    kept = store.add_measurement(uploaded(store), "a.csv", Told(measured_at=AT), {})
    with store.database.engine.begin() as connection:
        take_seals(connection)
        operations = Operations(MigrationContext.configure(connection))
        for name in ("measured_at", "measured_at_source"):
            operations.drop_column("measurements", name)
        with Operations.context(operations.migration_context):
            for revision in ("measured_2", "sealed_4"):
                import_module(f"jointplay.app.migrations.versions.{revision}").upgrade()
    found = store.measurement(kept.id)
    assert (found.measured_at, found.measured_at_source) == (kept.created_at, "received")
    assert store.add_measurement(uploaded(store), "b.csv", None, {}).measured_at_source == "received"


def test_a_backup_brings_it_back(tmp_path: Path) -> None:
    place = Place(tmp_path / "data", tmp_path / "shelf", "")
    with closing(Store(place.data)) as store:
        kept = store.add_measurement(store.uploads.receive(io.BytesIO(b"bytes")), "a.csv", Told(measured_at=AT), {})
    back_up(place, tmp_path / "backup")
    other = Place(tmp_path / "other", tmp_path / "shelf-2", "")
    restore(tmp_path / "backup", other)
    with closing(Store(other.data)) as store:
        found = store.measurement(kept.id)
        assert (found.measured_at, found.measured_at_source) == (AT, "sender")


def test_a_backup_of_version_1_is_brought_up_to_date(tmp_path: Path) -> None:
    place = Place(tmp_path / "data", tmp_path / "shelf", "")
    with closing(Store(place.data)) as store:
        kept = store.add_measurement(store.uploads.receive(io.BytesIO(b"bytes")), "a.csv", None, {})
    back_up(place, tmp_path / "backup")
    (tmp_path / "backup" / ROWS).unlink()
    of_version_1(tmp_path / "backup" / ROWS, kept.sha256)
    other = Place(tmp_path / "other", tmp_path / "shelf-2", "")
    restore(tmp_path / "backup", other)
    with closing(Store(other.data)) as store:
        found = store.measurement("m1")
        assert found.measured_at == found.created_at and found.measured_at_source == "received"


def test_what_is_told_of_it(worn: bytes) -> None:
    assert read_told({"measured_at": SAID}) == Told(measured_at=AT)
    assert read_told({"measured_at": "2024-11-21 11:03", "time_zone": "Europe/Berlin"}).measured_at == AT
    assert read_told({"measured_at": "2024-11-21 10:03"}).measured_at == AT
    in_profile = read_told({"profile": f'{{"measured_at": "{SAID}", "skip_lines": 3}}'})
    assert (in_profile.measured_at, in_profile.profile, in_profile.shown) == (
        AT,
        {"skip_lines": 3},
        {"profile": {"skip_lines": 3}},
    )
    assert read_told({"profile": "measured_at: 2020-01-01T00:00:00Z", "measured_at": SAID}).measured_at == AT


# --- over HTTP --------------------------------------------------------------------------------------------------------


def test_a_file_and_its_sender(client: httpx.Client, worn: bytes) -> None:
    plain = send(client, worn, "m plain.csv").json()
    assert moment_of(plain) == (datetime.fromisoformat(plain["created_at"]), "received")
    content = dated(worn, "# Datum: 20.11.2024 10:03")
    of_file = send(client, content, "m dated.csv").json()
    assert moment_of(of_file) == (AT - timedelta(days=1), "file")
    assert any("taken as UTC, unless time_zone is given" in line for line in of_file["import_report"])
    zone = send(client, content, "m zoned.csv", time_zone="+01:00").json()
    assert moment_of(zone) == (AT - timedelta(days=1, hours=1), "file")
    said = send(client, content, "m dated.csv", measured_at=SAID).json()
    assert moment_of(said) == (AT, "sender")
    assert said["id"] == of_file["id"] and said["told"] == {}
    again = send(client, content, "m dated.csv").json()
    assert again == client.get(f"{API}/measurements/{said['id']}").json()
    assert moment_of(again) == (AT, "sender")
    assert again in client.get(f"{API}/measurements").json()["items"]


def test_json_has_a_member_of_its_own(client: httpx.Client) -> None:
    held = {"sample_rate_hz": 2560, "channels": [{"name": "a", "unit": "g", "values": [k % 7 for k in range(256)]}]}
    said = client.post(f"{API}/measurements", json={**held, "measured_at": SAID}).json()
    assert moment_of(said) == (AT, "sender")
    profile = {"measured_at": "2024-01-01T00:00:00Z"}
    both = client.post(f"{API}/measurements", json={**held, "measured_at": SAID, "profile": profile}).json()
    assert (both["id"], moment_of(both)) == (said["id"], (AT, "sender"))
    wrong = client.post(f"{API}/measurements", json={**held, "measured_at": "2024-11-21"})
    assert_problem(wrong, 422, "must be a moment with a time zone")


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("21.11.2024 10:03", "measured_at: 21.11.2024 10:03: must be a date with a time"),
        ("2999-01-01T00:00:00Z", "measured_at: 2999-01-01T00:00:00Z: lies more than a day ahead"),
        ("1969-01-01T00:00:00Z", "measured_at: 1969-01-01T00:00:00Z: lies before 1970"),
    ],
)
def test_what_cannot_be_is_refused(client: httpx.Client, worn: bytes, given: str, text: str) -> None:
    document = assert_problem(send(client, worn, "m wrong.csv", measured_at=given), 422, text, "invalid-field")
    assert document["errors"][0]["field"] == "measured_at"


def test_the_same_request_again_says_the_same_moment(client: httpx.Client, worn: bytes) -> None:
    headers = {"Idempotency-Key": "measured-once"}

    def sent(moment: str) -> httpx.Response:
        files = {"file": ("m keyed.csv", worn)}
        return client.post(f"{API}/measurements", files=files, data={"measured_at": moment}, headers=headers)

    assert sent(SAID).json() == sent(SAID).json()
    assert_problem(sent("2024-11-22T11:03:00+01:00"), 422, "was used for another request", "idempotency-key-reused")


def test_it_is_corrected(client: httpx.Client, worn: bytes) -> None:
    found = send(client, worn, "m late.csv").json()
    place = f"{API}/measurements/{found['id']}"
    tag = client.get(place).headers["etag"]
    answer = client.patch(place, json={"measured_at": SAID})
    assert (answer.status_code, moment_of(answer.json())) == (200, (AT, "sender"))
    assert {**found, **{name: answer.json()[name] for name in ("measured_at", "measured_at_source")}} == answer.json()
    fresh = client.get(place, headers={"If-None-Match": tag})
    assert (fresh.status_code, fresh.json()) == (200, answer.json())
    for body in (
        {},
        {"measured_at": None},
        {"measured_at": SAID, "name": "x"},
        {"measured_at": "2999-01-01T00:00:00Z"},
    ):
        assert_problem(client.patch(place, json=body), 422)
    assert client.get(place).json() == answer.json()
    assert_problem(client.patch(f"{API}/measurements/none", json={"measured_at": SAID}), 404)


def test_an_asset_lives_by_it(client: httpx.Client, worn: bytes, in_order: bytes) -> None:
    """Five visits in any order of sending: the page and a window of time have them as they were made."""
    client.put(f"{API}/assets/measured-1", json={"machine": "slider-crank"})
    keys = {}
    for month, content in ((5, worn), (1, in_order)):
        told = {"measured_at": f"2024-0{month}-01T06:00:00Z", "asset": "measured-1"}
        asked = {**told, "catalogue": "slider-crank", "effort": "fast"}
        answer = client.post(f"{API}/diagnoses", files={"file": (f"visit-{month}.csv", content)}, data=asked)
        assert answer.status_code == 201, answer.text
        keys[month] = answer.json()
        stored = client.get(f"{API}/measurements/{answer.json()['measurement']}").json()
        assert moment_of(stored) == (datetime(2024, month, 1, 6, tzinfo=UTC), "sender")
    page = client.get("/assets/measured-1").text
    assert page.index("2024-05-01") < page.index("2024-01-01")
    assert ">received<" not in page
    report = client.get(f"{API}/diagnoses/{keys[5]['id']}/report", params={"format": "html"}).text
    assert "2024-05-01 06:00 UTC, as its sender says" in report
    window = {"asset": "measured-1", "since": "2024-04-01T00:00:00Z", "until": "2024-06-01T00:00:00Z"}
    answer = client.post(f"{API}/diagnoses", json={**window, "catalogue": "slider-crank", "effort": "fast"})
    assert answer.json()["measurements"] == [keys[5]["measurement"]]
    client.patch(f"{API}/measurements/{keys[5]['measurement']}", json={"measured_at": "2023-12-01T06:00:00Z"})
    page = client.get("/assets/measured-1").text.partition('<h2 id="diagnoses">')[2]
    assert "2024-05-01" not in page and page.index("2024-01-01") < page.index("2023-12-01")


# --- commands ---------------------------------------------------------------------------------------------------------


def test_the_option_says_it_of_each(shelf: Path, worn: bytes, tmp_path: Path) -> None:
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    files[0].write_bytes(worn)
    files[1].write_bytes(dated(worn, "# Date: 2024-11-20 10:03"))
    ask = ["diagnose", "--catalogue", str(shelf / "slider-crank"), "--effort", "fast"]
    plain = CliRunner().invoke(main, [*ask, str(files[1])], catch_exceptions=False)
    assert "measured: b.csv, 2024-11-20 10:03 UTC" in plain.output
    several = CliRunner().invoke(
        main,
        [*ask, *map(str, files), "--json", "--measured-at", SAID, "--measured-at", "2024-11-22 10:03"],
        catch_exceptions=False,
    )
    assert several.exit_code == 0, several.output
    said = json.loads(several.stdout)["measured_at"]
    assert said == ["2024-11-21T10:03:00+00:00", "2024-11-22T10:03:00+00:00"]
    one = CliRunner().invoke(main, [*ask, *map(str, files), "--measured-at", SAID])
    assert one.exit_code == 2 and "1 for 2 measurements: must be one for each, or none" in one.output
    wrong = CliRunner().invoke(main, [*ask, str(files[0]), "--measured-at", "yesterday"])
    assert wrong.exit_code == 2 and "'--measured-at': yesterday: must be a date with a time" in wrong.output
