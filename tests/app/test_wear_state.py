"""The state of wear of an asset over HTTP and on its page."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from http_answers import API, assert_problem
from recordings import RECORDINGS
from service_process import client_of, service_process

ASSET = "crank-that-wears"


def diagnose(client: httpx.Client, number: int, asset: str = ASSET, called: str = "") -> dict[str, Any]:
    """Answer to a recording of the asset."""
    name = f"slider-crank-{number:02}.csv.gz"
    files = {"file": (called or name, (RECORDINGS / name).read_bytes())}
    asked = {"catalogue": "slider-crank", "asset": asset, "effort": "fast"}
    answer = client.post(f"{API}/diagnoses", files=files, data=asked)
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    return found


def state_of(client: httpx.Client, asset: str = ASSET) -> dict[str, Any]:
    answer = client.get(f"{API}/assets/{asset}/state")
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.fixture(scope="module")
def answers(client: httpx.Client) -> list[dict[str, Any]]:
    """Two recordings of a worn joint B."""
    client.put(f"{API}/assets/{ASSET}", json={"machine": "slider-crank"}).raise_for_status()
    return [diagnose(client, 2), diagnose(client, 5)]


def test_all_recordings_count_once(client: httpx.Client, answers: list[dict[str, Any]]) -> None:
    state = state_of(client)
    assert state["visits"] == 2
    assert [len(joint["course"]) for joint in state["joints"].values()] == [2] * len(state["joints"])
    assert state["joints"]["B"]["p_worn"] > 0.95
    assert state["joints"]["B"]["first_sure_at"] is not None
    diagnose(client, 2)
    diagnose(client, 2, called="the-same-again.csv.gz")
    again = client.get(f"{API}/assets/{ASSET}/state")
    assert again.json() == state
    tag = {"If-None-Match": again.headers["ETag"]}
    assert client.get(f"{API}/assets/{ASSET}/state", headers=tag).status_code == 304


def test_a_repair_that_somebody_reports_counts(client: httpx.Client) -> None:
    asset = "crank-that-is-mended"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"}).raise_for_status()
    answer = diagnose(client, 2, asset)
    before = state_of(client, asset)["joints"]["B"]
    moment = (datetime.now(UTC) + timedelta(hours=2)).replace(microsecond=0)
    found = {"joints": {"B": {"clearance_um": 170, "repaired": True}}, "at": moment.isoformat()}
    told = client.post(f"{API}/diagnoses/{answer['id']}/finding", json=found)
    assert told.status_code == 201, told.text
    assert told.json()["joints"]["B"] == {"clearance_um": 170, "repaired": True}
    state = state_of(client, asset)
    assert before["p_worn"] > 0.5 > state["joints"]["B"]["p_worn"]
    assert [repair["joint"] for repair in state["repairs"]] == ["B"]
    assert datetime.fromisoformat(state["at"]) == moment
    late = {**found, "at": "2126-01-01T00:00:00Z"}
    assert_problem(client.post(f"{API}/diagnoses/{answer['id']}/finding", json=late), 422)


def test_findings_of_a_deleted_asset_are_not_of_another_of_its_name(client: httpx.Client) -> None:
    asset, moment = "crank-deleted", datetime.now(UTC) + timedelta(hours=2)
    found = {"joints": {"A": {"clearance_um": 300}}, "at": moment.isoformat()}
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"}).raise_for_status()
    answer = diagnose(client, 2, asset)
    client.post(f"{API}/diagnoses/{answer['id']}/finding", json=found).raise_for_status()
    told = state_of(client, asset)["joints"]["A"]["clearance_um"]
    client.delete(f"{API}/assets/{asset}").raise_for_status()
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"}).raise_for_status()
    diagnose(client, 2, asset)
    assert told > 250 > state_of(client, asset)["joints"]["A"]["clearance_um"]
    client.post(f"{API}/diagnoses/{answer['id']}/finding", json=found).raise_for_status()
    assert state_of(client, asset)["joints"]["A"]["clearance_um"] == told


def test_recordings_that_have_several_answers_together_count_in_the_newest(client: httpx.Client) -> None:
    asset = "crank-heard-together"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"}).raise_for_status()
    keys = [diagnose(client, number, asset)["measurement"] for number in (2, 5, 1)]
    for together in (keys[:2], keys[:2][::-1], keys):
        body = {"measurements": together, "catalogue": "slider-crank", "asset": asset, "effort": "fast"}
        assert client.post(f"{API}/diagnoses", json=body).status_code == 201
    assert state_of(client, asset)["visits"] == 1


@pytest.mark.long
def test_two_servers_say_the_same_to_the_last_bit(shelf: Path, tmp_path: Path) -> None:
    (tmp_path / "catalogues").symlink_to(shelf)
    with ExitStack() as stack:
        options = {"builds": "0", "keys": "off"}
        both = [client_of(stack.enter_context(service_process(tmp_path, **options))) for _ in range(2)]
        first, second = (stack.enter_context(each) for each in both)
        first.put(f"{API}/assets/{ASSET}", json={"machine": "slider-crank"}).raise_for_status()
        keys = [diagnose(each, number)["measurement"] for each, number in ((first, 2), (second, 5), (first, 3))]
        body = {"measurements": keys, "catalogue": "slider-crank", "effort": "standard"}
        one, other = (each.post(f"{API}/diagnoses", json=body).json() for each in (first, second))
        assert one["verdict"] and one == {**other, "id": one["id"], "created_at": one["created_at"]}
        states = [each.get(f"{API}/assets/{ASSET}/state") for each in (first, second)]
        assert states[0].json()["visits"] == 3
        assert (states[0].content, states[0].headers["ETag"]) == (states[1].content, states[1].headers["ETag"])


def test_the_page_shows_it(client: httpx.Client, answers: list[dict[str, Any]]) -> None:
    whole = client.get(f"/assets/{ASSET}").text
    assert f'hx-get="/assets/{ASSET}/state"' in whole
    page = client.get(f"/assets/{ASSET}/state").text
    assert "State of wear" in page
    assert "By all 2 recordings" in page
    assert "µm a year" in page


def test_refusals(client: httpx.Client) -> None:
    assert_problem(client.get(f"{API}/assets/nobody/state"), 404, slug="unknown-asset")
    client.put(f"{API}/assets/never-heard", json={"machine": "slider-crank"}).raise_for_status()
    rule = "asset never-heard: none of its recordings was diagnosed yet"
    assert_problem(client.get(f"{API}/assets/never-heard/state"), 404, rule, "nothing-to-follow")
    assert "none of its recordings was diagnosed yet" in client.get("/assets/never-heard/state").text
