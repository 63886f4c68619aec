"""The attacks on evidence, over HTTP and at the prompt: a damaged thing is a named problem, and never a verdict."""

from __future__ import annotations

import asyncio
import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from command_line import invoke
from http_answers import send
from small_service import asking
from sqlalchemy.exc import OperationalError

from jointplay.app.errors import AppError, DamagedCatalogueError, DeletedError, UnknownCatalogueError
from jointplay.app.jobs import verification
from jointplay.app.jobs.scrubber import Scrubber
from jointplay.app.metrics import Metrics
from jointplay.app.settings import ServiceSettings
from jointplay.app.shelves.catalogues import CatalogueShelf
from jointplay.app.storage.store import Store

API = "/api/v1"
ASKED = {"catalogue": "slider-crank", "effort": "fast", "asset": "press-7"}


@pytest.fixture(scope="module")
def place(shelf: Path, tmp_path_factory: pytest.TempPathFactory) -> ServiceSettings:
    """Where the service of these tests keeps what it keeps."""
    data = tmp_path_factory.mktemp("custody")
    return ServiceSettings(catalogues=shelf, data=data, time_limit_s=300.0, workers=1)


@pytest.fixture(scope="module")
def custody(place: ServiceSettings) -> Iterator[httpx.Client]:
    with asking(place) as client:
        yield client


@pytest.fixture(scope="module")
def answered(custody: httpx.Client, worn: bytes, in_order: bytes) -> dict[str, Any]:
    """A diagnosis with a baseline."""
    baseline = send(custody, in_order, "in-order.csv").json()["id"]
    measured = send(custody, worn, "worn.csv").json()["id"]
    custody.put(f"{API}/assets/press-7", json={"machine": "slider-crank", "baseline": baseline}).raise_for_status()
    response = custody.post(f"{API}/diagnoses", json={"measurement": measured, **ASKED})
    assert response.status_code == 201, response.text
    document: dict[str, Any] = response.json()
    return document | {"of_baseline": baseline}


def file_of(place: ServiceSettings, client: httpx.Client, measurement: str) -> Path:
    sha256 = client.get(f"{API}/measurements/{measurement}").json()["sha256"]
    return place.data / "measurements" / sha256[:2] / sha256


def verified(client: httpx.Client, answered: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = client.get(f"{API}/diagnoses/{answered['id']}/verification").raise_for_status().json()
    return found


def at_prompt(place: ServiceSettings, *more: str | Path) -> Any:
    return invoke("verify", "--data", place.data, "--catalogues", place.catalogues, *more)


def test_a_diagnosis_comes_out_the_same_bit_for_bit(custody: httpx.Client, answered: dict[str, Any]) -> None:
    found = verified(custody, answered)
    assert (found["verified"], found["repeated"], found["differences"]) == (True, "equal", [])
    assert [each["state"] for each in (*found["recordings"], *found["baselines"])] == ["sound", "sound"]
    assert found["baselines"][0]["measurement"] == answered["of_baseline"]
    assert found["catalogue"] == {"id": answered["catalogue"], "name": "slider-crank", "state": "same"}
    assert all(each["then"] == each["now"] for each in found["versions"].values())
    assert answered["made_by"] == "127.0.0.1"


def test_everything_is_in_order_at_the_prompt(
    place: ServiceSettings, custody: httpx.Client, answered: dict[str, Any]
) -> None:
    result = at_prompt(place, "--repeat", "1", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["sound"] and found["looked_at"].pop("audit") >= 4
    assert found["looked_at"] == {"row": 4, "recording": 2, "repeated": 1, "not_repeated": 0}


@pytest.mark.parametrize("of", ["measurement", "of_baseline"])
def test_other_samples_under_the_old_name_give_no_verdict(
    place: ServiceSettings, custody: httpx.Client, answered: dict[str, Any], of: str
) -> None:
    path = file_of(place, custody, answered[of])
    content = path.read_bytes()
    lines = content.decode().splitlines()
    swapped = [line.split(",") for line in lines]
    path.write_text("\n".join(",".join([each[0], *each[:0:-1]]) for each in swapped))
    try:
        response = custody.post(f"{API}/diagnoses", json={"measurement": answered["measurement"], **ASKED})
        assert response.status_code == 409
        assert response.json()["type"] == "urn:jointplay:problem:recording-damaged"
        found = verified(custody, answered)
        assert (found["verified"], found["repeated"]) == (False, "not_repeated")
        assert {each["state"] for each in (*found["recordings"], *found["baselines"])} == {"sound", "damaged"}
        result = at_prompt(place)
        assert result.exit_code == 1
        assert [line[:10] for line in result.stdout.splitlines()] == ["recording "]
        assert result.stderr.startswith(f"jointplay: {place.data}: 1 damaged")
    finally:
        path.write_bytes(content)
    assert verified(custody, answered)["verified"] is True


@pytest.mark.parametrize("how", ["linked", "gone"])
def test_a_link_or_nothing_in_place_of_a_recording(
    place: ServiceSettings, custody: httpx.Client, answered: dict[str, Any], how: str
) -> None:
    path = file_of(place, custody, answered["measurement"])
    content = path.read_bytes()
    path.unlink()
    if how == "linked":
        path.symlink_to("/etc/passwd")
    try:
        asked = custody.post(f"{API}/diagnoses", json={"measurement": answered["measurement"], **ASKED})
        wanted = {"measurement": answered["measurement"], "catalogue": "slider-crank"}
        page = custody.get("/confirm", params=wanted, headers={"Accept": "text/html"})
        slug = "recording-damaged" if how == "linked" else "recording-missing"
        assert (asked.status_code, asked.json()["type"]) == (409, f"urn:jointplay:problem:{slug}")
        assert page.status_code == 409 and "bring it back from a backup" in page.text
        assert f'jointplay_damage_met_total{{problem="{slug}"}}' in custody.get("/metrics").text
    finally:
        path.unlink(missing_ok=True)
        path.write_bytes(content)


def test_samples_that_are_kept_for_charts_are_checked(
    place: ServiceSettings, custody: httpx.Client, answered: dict[str, Any]
) -> None:
    address = f"{API}/measurements/{answered['measurement']}/signal"
    before = custody.get(address).raise_for_status().json()
    kept = place.data / "signals" / f"{answered['measurement']}.npy"
    content = bytearray(kept.read_bytes())
    content[-4:] = b"\x00\x00\x80\x50"  # 1.7e10
    kept.write_bytes(content)
    assert custody.get(address).raise_for_status().json() == before


def test_one_flipped_row_is_listed_as_damaged(
    place: ServiceSettings, custody: httpx.Client, answered: dict[str, Any]
) -> None:
    def set_result(value: bytes) -> None:
        with closing(sqlite3.connect(place.data / "service.sqlite")) as connection, connection:
            connection.execute("UPDATE diagnoses SET result = CAST(? AS TEXT) WHERE id = ?", [value, answered["id"]])

    with closing(sqlite3.connect(place.data / "service.sqlite")) as connection:
        query = "SELECT CAST(result AS BLOB) FROM diagnoses WHERE id = ?"
        [content] = connection.execute(query, [answered["id"]]).fetchone()
    spoiled = bytearray(content)
    spoiled[content.index(b"clearance_um") + 15] ^= 1  # another digit, or no number
    set_result(bytes(spoiled))
    try:
        for address in ("", "/verification", "/report"):
            response = custody.get(f"{API}/diagnoses/{answered['id']}{address}", headers={"Accept": "*/*"})
            assert (response.status_code, response.json()["type"]) == (409, "urn:jointplay:problem:row-damaged")
        listed = custody.get(f"{API}/diagnoses").raise_for_status().json()
        assert [each["id"] for each in listed["damaged"]] == [answered["id"]]
        assert answered["id"] not in [each["id"] for each in listed["items"]]
        page = custody.get("/assets/press-7", headers={"Accept": "text/html"})
        assert page.status_code == 200 and f"diagnosis {answered['id']}: its row is not" in page.text
        assert at_prompt(place).stdout.startswith(f"diagnosis {answered['id']}: its row is not what was written")
    finally:
        set_result(content)
    assert custody.get(f"{API}/diagnoses").json()["damaged"] == []


def test_a_report_is_checked_against_what_is_stored(
    place: ServiceSettings, custody: httpx.Client, answered: dict[str, Any], tmp_path: Path
) -> None:
    for form in ("html", "pdf"):
        content = custody.get(f"{API}/diagnoses/{answered['id']}/report?format={form}").raise_for_status().content
        file = tmp_path / f"report.{form}"
        file.write_bytes(content)
        result = at_prompt(place, "--report", file)
        assert (result.exit_code, result.stdout) == (0, f"{file}: in order\n"), result.output
    file.write_bytes(content.replace(answered["id"].encode(), b"0" * 32))
    result = at_prompt(place, "--report", file)
    assert result.exit_code == 1 and "is not here" in result.stdout
    file.write_bytes(b"<p>E, 321 um</p>")
    assert "names no diagnosis" in at_prompt(place, "--report", file).stdout


def test_a_deleted_recording_is_no_damage(
    place: ServiceSettings, custody: httpx.Client, answered: dict[str, Any], tmp_path: Path
) -> None:
    file = tmp_path / "report.html"
    file.write_bytes(custody.get(f"{API}/diagnoses/{answered['id']}/report?format=html").raise_for_status().content)
    path = file_of(place, custody, answered["measurement"])
    content = path.read_bytes()
    custody.delete(f"{API}/measurements/{answered['measurement']}", params={"why": "old"}).raise_for_status()
    try:
        assert not path.exists()
        found = verified(custody, answered)
        assert (found["verified"], found["repeated"]) == (False, "not_repeated")
        assert found["recordings"][0]["state"] == "deleted" and "was deleted at" in found["said"]
        counted = json.loads(at_prompt(place, "--repeat", "1", "--json").stdout)
        looked = counted["looked_at"]
        assert (counted["sound"], looked["repeated"], looked["not_repeated"]) == (True, 0, 1)
        assert at_prompt(place, "--report", file).stdout == f"{file}: in order\n"
    finally:
        assert send(custody, content, "worn.csv").json()["id"] == answered["measurement"]


@pytest.mark.parametrize(
    ("error", "state", "code"),
    [
        (DeletedError("catalogue slider-crank: was deleted at noon"), "deleted", 0),
        (UnknownCatalogueError("there is none"), "missing", 1),
        (DamagedCatalogueError("is damaged"), "damaged", 1),
    ],
)
def test_a_catalogue_that_cannot_be_had_is_told_by_why(
    place: ServiceSettings,
    custody: httpx.Client,
    answered: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    error: AppError,
    state: str,
    code: int,
) -> None:
    def find(_shelf: CatalogueShelf, _name: str) -> None:
        raise error

    monkeypatch.setattr(CatalogueShelf, "find", find)
    found = verified(custody, answered)
    assert (found["catalogue"]["state"], found["repeated"]) == (state, "not_repeated")
    result = at_prompt(place, "--repeat", "1")
    assert (result.exit_code, result.stdout.startswith(f"diagnosis {answered['id']}: cannot be")) == (code, bool(code))
    assert ("1 not: their recordings" in result.stdout) is not bool(code)


def test_who_did_what_can_be_asked_and_exported(
    place: ServiceSettings, custody: httpx.Client, answered: dict[str, Any], tmp_path: Path
) -> None:
    first = custody.get(f"{API}/audit", params={"limit": 2}).raise_for_status().json()
    second = custody.get(f"{API}/audit", params={"limit": 2, "cursor": first["next_cursor"]}).json()
    assert [each["number"] for each in (*first["items"], *second["items"])] == list(
        range(first["items"][0]["number"], first["items"][0]["number"] - 4, -1)
    )
    asset = custody.get(f"{API}/audit", params={"kind": "asset", "object": "press-7"}).json()["items"]
    [made] = [each for each in asset if each["action"] == "made"]
    assert (made["address"], made["key"]) == ("127.0.0.1", None) and len(made["request_id"]) == 32
    out = tmp_path / "audit.jsonl"
    assert invoke("audit", "--data", place.data, "--out", out).exit_code == 0
    rows = [json.loads(line) for line in out.read_text().splitlines()]
    assert [each["previous"] for each in rows[1:]] == [each["hash"] for each in rows[:-1]]
    assert rows[-1]["number"] >= first["items"][0]["number"]


def test_what_is_looked_through_in_the_background_is_counted(tmp_path: Path, worn: bytes) -> None:
    import io

    with closing(Store(tmp_path)) as store:
        upload = store.uploads.receive(io.BytesIO(worn))
        row = store.add_measurement(upload, "worn.csv", None, {})
        metrics = Metrics()
        asyncio.run(Scrubber(store, metrics, rate=1e9).look())
        assert b'jointplay_damaged{kind="recording"} 0.0' in metrics.text()
        store.path_of(row.sha256).write_bytes(b"other")
        asyncio.run(Scrubber(store, metrics, rate=1e9).look())
        assert b'jointplay_damaged{kind="recording"} 1.0' in metrics.text()
        assert b"jointplay_scrubbed_bytes_total" in metrics.text()


def test_a_look_that_broke_off_is_begun_again_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []
    outcomes: list[Exception | None] = [OperationalError("SELECT", {}, Exception("gone")), ValueError("odd"), None]

    async def sleep(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) == 4:
            raise asyncio.CancelledError

    async def look() -> None:
        if (error := outcomes[len(pauses) - 1]) is not None:
            raise error

    with closing(Store(tmp_path)) as store:
        scrubber = Scrubber(store, Metrics())
        monkeypatch.setattr(scrubber, "look", look)
        # Of the scrubber alone: a server that runs in a thread of this process sleeps, too.
        monkeypatch.setattr(f"{Scrubber.__module__}.asyncio", SimpleNamespace(sleep=sleep))
        with pytest.raises(asyncio.CancelledError):
            asyncio.run(scrubber.run())
    assert pauses == [60.0, 300.0, 300.0, 86_400.0]


def test_members_that_differ_are_named() -> None:
    made = {"provenance": {"solver_version": "1", "matcher": {"version": "2"}}}
    then = {"a": 1.0, "b": [1.0, {"c": "x"}], "hash": "h", **made}
    assert verification.compare(then, {**then, "hash": "g"}).outcome == "equal"
    assert verification.compare(then, {**then, "a": 1.0 + 1e-8}).outcome == "rounding"
    found = verification.compare(then, {**then, "a": 1.1, "b": [1.0, {"c": "y"}]})
    assert found.outcome == "differs"
    assert [(each.member, each.then, each.now) for each in found.differences] == [("a", 1.0, 1.1), ("b[1].c", "x", "y")]
    assert verification.compare({**then, "a": True}, {**then, "a": 2}).outcome == "differs"


@pytest.mark.parametrize("options", [[], ["--data", "d", "--catalogue", "c"], ["--catalogue", "c", "--repeat", "1"]])
def test_options_of_verify_that_do_not_go_together(options: list[str]) -> None:
    assert invoke("verify", *options).exit_code == 2
