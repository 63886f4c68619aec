"""Assets and what belongs to them: recordings, baseline, diagnoses, findings."""

from __future__ import annotations

import time
from datetime import datetime, timedelta
from typing import Any

import httpx
import pytest
from recordings import unpacked

API = "/api/v1"
PLACE = f"{API}/assets/press-7"


def sent(client: httpx.Client, name: str) -> str:
    content = unpacked(f"{name}.csv")
    answer = client.post(f"{API}/measurements", files={"file": (f"{name}.csv", content)})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def ids(client: httpx.Client, place: str, **query: str) -> list[str]:
    answer = client.get(f"{API}/{place}", params=query)
    assert answer.status_code == 200, answer.text
    return [item["id"] for item in answer.json()["items"]]


def said(asset: dict[str, Any]) -> dict[str, Any]:
    """Return all of an asset but how it stands, which is judged in the background and may follow at any time."""
    return {name: value for name, value in asset.items() if name != "standing"}


@pytest.fixture(scope="module")
def worn_id(client: httpx.Client) -> str:
    return sent(client, "slider-crank-02")


@pytest.fixture(scope="module")
def in_order(client: httpx.Client) -> str:
    return sent(client, "slider-crank-01")


@pytest.fixture(scope="module")
def asset(client: httpx.Client, in_order: str) -> dict[str, Any]:
    body = {"machine": "slider-crank", "notes": "hall <B>", "baseline": in_order}
    answer = client.put(PLACE, json=body)
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == PLACE
    found: dict[str, Any] = answer.json()
    return found


def ask(client: httpx.Client, measurement: str, **more: str) -> httpx.Response:
    body = {"measurement": measurement, "catalogue": "slider-crank", "effort": "fast", **more}
    return client.post(f"{API}/diagnoses", json=body)


@pytest.fixture(scope="module")
def diagnosis(client: httpx.Client, asset: dict[str, Any], worn_id: str) -> dict[str, Any]:
    answer = ask(client, worn_id, asset=asset["external_id"])
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    return found


# --- assets


def test_an_asset_is_read_again_and_listed(client: httpx.Client, asset: dict[str, Any]) -> None:
    while not (answer := client.get(PLACE)).json()["standing"]["up_to_date"]:  # it is part of the tag
        time.sleep(0.1)
    assert said(answer.json()) == said(asset)
    assert client.get(PLACE, headers={"If-None-Match": answer.headers["etag"]}).status_code == 304
    assert answer.json() in client.get(f"{API}/assets").json()["items"]


def test_the_same_again_changes_nothing_and_other_content_does(client: httpx.Client, asset: dict[str, Any]) -> None:
    body = {name: asset[name] for name in ("machine", "notes", "baseline")}
    again = client.put(PLACE, json=body)
    assert (again.status_code, said(again.json())) == (200, said(asset))
    place = f"{API}/assets/press-8"
    first = said(client.put(place, json={"machine": "four-bar", "notes": "new"}).json())
    tag = client.get(place).headers["etag"]
    answer = client.put(place, json={"machine": "four-bar"})
    second = said(answer.json())
    assert answer.status_code == 200
    assert second == {**first, "notes": "", "updated_at": second["updated_at"]}
    assert second["updated_at"] > first["updated_at"]
    assert client.get(place).headers["etag"] != tag


@pytest.mark.parametrize(
    ("name", "body", "field"),
    [
        ("a", {}, "machine"),
        ("a", {"machine": "slider-crank", "baseline": "none"}, "baseline"),
        ("a", {"machine": "slider-crank", "baselines": ["none"]}, "baselines"),
        ("a", {"machine": "slider-crank", "baseline": "none", "baselines": ["other"]}, "baseline"),
        ("a", {"machine": "slider-crank", "owner": "x"}, "owner"),
        ("a", {"machine": "slider\u0000crank"}, "machine"),
        (".a", {"machine": "slider-crank"}, "path.external_id"),
        ("a" * 129, {"machine": "slider-crank"}, "path.external_id"),
    ],
)
def test_a_wrong_asset_is_refused_by_field(client: httpx.Client, name: str, body: dict[str, Any], field: str) -> None:
    answer = client.put(f"{API}/assets/{name}", json=body)
    assert answer.status_code == 422, answer.text
    assert [entry["field"] for entry in answer.json()["errors"]] == [field]
    assert client.get(f"{API}/assets/a").status_code == 404


def test_recordings_of_an_asset(client: httpx.Client, asset: dict[str, Any], in_order: str) -> None:
    assert in_order in ids(client, "measurements", asset="press-7"), "a baseline is one of them"
    client.put(f"{API}/assets/press-9", json={"machine": "slider-crank"})
    assert ids(client, "measurements", asset="press-9") == []
    for _ in range(2):
        assert client.put(f"{API}/assets/press-9/measurements/{in_order}").status_code == 204
    assert ids(client, "measurements", asset="press-9") == [in_order]
    assert client.put(f"{API}/assets/press-9/measurements/none").status_code == 404
    assert client.put(f"{API}/assets/none/measurements/{in_order}").status_code == 404


# --- diagnoses of an asset


def test_a_diagnosis_of_an_asset_uses_its_baseline(
    client: httpx.Client, diagnosis: dict[str, Any], worn_id: str
) -> None:
    assert diagnosis["asset"] == "press-7"
    assert diagnosis["baseline"]["measurement"] == "slider-crank-01.csv"
    assert diagnosis["baseline"]["used"] is True
    assert client.get(f"{API}/diagnoses/{diagnosis['id']}").json() == diagnosis
    assert worn_id in ids(client, "measurements", asset="press-7")
    report = client.get(f"{API}/diagnoses/{diagnosis['id']}/report").text
    assert "Joint play of press-7" in report
    assert "baseline slider-crank-01.csv, used" in report


def test_several_baselines(client: httpx.Client, in_order: str, worn_id: str) -> None:
    """All of them are used and shown, but for the one that is asked about; clients that know one see the first."""
    place = f"{API}/assets/press-10"
    body = {"machine": "slider-crank", "baselines": [in_order, worn_id, in_order]}
    made = said(client.put(place, json=body).json())
    assert (made["baseline"], made["baselines"]) == (in_order, [in_order, worn_id])
    again = client.put(place, json={**body, "baseline": in_order})
    assert said(client.get(place).json()) == made == said(again.json())
    assert sorted(ids(client, "measurements", asset="press-10")) == sorted([in_order, worn_id])
    answer = ask(client, sent(client, "slider-crank-05"), asset="press-10").json()
    assert answer["baseline"]["measurement"] == "slider-crank-01.csv"
    assert [each["measurement"] for each in answer["baseline"]["further"]] == ["slider-crank-02.csv"]
    alone = ask(client, worn_id, asset="press-10").json()["baseline"]
    assert (alone["measurement"], alone["further"]) == ("slider-crank-01.csv", [])
    fewer = client.put(place, json={"machine": "slider-crank", "baselines": [worn_id]}).json()
    assert (fewer["baseline"], fewer["baselines"]) == (worn_id, [worn_id])


def test_a_baseline_is_not_judged_by_itself(client: httpx.Client, asset: dict[str, Any], in_order: str) -> None:
    answer = ask(client, in_order, asset=asset["external_id"])
    assert answer.status_code == 201, answer.text
    assert answer.json()["baseline"] is None


def test_diagnoses_are_listed_by_asset(client: httpx.Client, diagnosis: dict[str, Any], worn_id: str) -> None:
    plain = ask(client, worn_id).json()
    assert plain["asset"] is None
    assert plain["id"] != diagnosis["id"]
    of_asset = ids(client, "diagnoses", asset="press-7")
    assert diagnosis["id"] in of_asset
    assert plain["id"] not in of_asset
    assert {diagnosis["id"], plain["id"]} <= set(ids(client, "diagnoses"))


def test_an_asset_of_another_machine_is_refused(client: httpx.Client, worn_id: str) -> None:
    client.put(f"{API}/assets/bar-1", json={"machine": "four-bar"})
    answer = ask(client, worn_id, asset="bar-1")
    assert answer.status_code == 422
    assert answer.json()["detail"] == "asset: bar-1: is a four-bar; the catalogue is of slider-crank"
    assert ask(client, worn_id, asset="none").status_code == 404


def test_an_asset_that_was_diagnosed_stays_the_machine_that_it_is(client: httpx.Client, worn_id: str) -> None:
    client.put(f"{API}/assets/crank-9", json={"machine": "four-bar"})
    assert client.put(f"{API}/assets/crank-9", json={"machine": "slider-crank"}).status_code == 200
    assert ask(client, worn_id, asset="crank-9").status_code == 201
    refused = client.put(f"{API}/assets/crank-9", json={"machine": "four-bar"})
    assert refused.status_code == 422
    said = (
        "machine: four-bar: asset crank-9 has diagnoses of a slider-crank: must stay; another machine is another asset"
    )
    assert refused.json()["detail"] == said
    assert client.get(f"{API}/assets/crank-9").json()["machine"] == "slider-crank"
    assert client.put(f"{API}/assets/crank-9", json={"machine": "slider-crank", "notes": "x"}).status_code == 200


def test_the_diagnoses_since_a_moment(client: httpx.Client, diagnosis: dict[str, Any]) -> None:
    made = datetime.fromisoformat(diagnosis["created_at"])
    assert diagnosis["id"] in ids(client, "diagnoses", since=made.isoformat())
    elsewhere = (made + timedelta(hours=2)).strftime("%Y-%m-%dT%H:%M:%S.%f+02:00")
    assert diagnosis["id"] in ids(client, "diagnoses", since=elsewhere)
    assert diagnosis["id"] not in ids(client, "diagnoses", since=(made + timedelta(microseconds=1)).isoformat())


@pytest.mark.parametrize("since", ["yesterday", "2026-01-01", "0", "2026-01-01T00:00:00", "0001-01-01T00:00:00+09:00"])
def test_what_is_no_moment_is_refused(client: httpx.Client, since: str) -> None:
    answer = client.get(f"{API}/diagnoses", params={"since": since})
    assert answer.status_code == 422
    assert [entry["field"] for entry in answer.json()["errors"]] == ["query.since"]


# --- findings


def test_a_finding_is_kept_once_read_again_and_listed(client: httpx.Client, diagnosis: dict[str, Any]) -> None:
    body = {"joints": {"B": {"clearance_um": 151.5}}, "text": "bush worn", "at": "2026-03-01T08:00:00+02:00"}
    place = f"{API}/diagnoses/{diagnosis['id']}/finding"
    answer = client.post(place, json=body)
    assert answer.status_code == 201, answer.text
    found = answer.json()
    assert found["at"] == "2026-03-01T06:00:00Z"
    joints = {name: {**told, "repaired": False} for name, told in body["joints"].items()}
    assert (found["joints"], found["text"], found["asset"]) == (joints, "bush worn", "press-7")
    assert client.get(answer.headers["location"]).json() == found
    assert client.post(place, json=body).json() == found
    assert client.post(place, json={**body, "text": "again"}).json()["id"] != found["id"]
    for query in ({"diagnosis": diagnosis["id"]}, {"asset": "press-7"}, {"since": found["created_at"]}):
        assert ids(client, "findings", **query).count(found["id"]) == 1
    assert ids(client, "findings", asset="press-8") == []


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ({"joints": {"Z": {"clearance_um": 1.0}}, "at": "2026-03-01T08:00:00Z"}, "Z: is no joint"),
        ({"joints": {"G1": {"clearance_um": 1.0}}, "at": "2026-03-01T08:00:00Z"}, "G1: is no joint"),
        ({"joints": {"B": {"clearance_um": -1.0}}, "at": "2026-03-01T08:00:00Z"}, "joints.B.clearance_um"),
        ({"at": "2026-03-01T08:00:00Z"}, "give joints with their clearance, or a text"),
        ({"text": "all well"}, "at: Field required"),
        ({"text": "all well", "at": "2026-03-01T08:00:00"}, "at: must be a moment with a time zone"),
    ],
)
def test_a_wrong_finding_is_refused(
    client: httpx.Client, diagnosis: dict[str, Any], body: dict[str, Any], text: str
) -> None:
    answer = client.post(f"{API}/diagnoses/{diagnosis['id']}/finding", json=body)
    assert answer.status_code == 422, answer.text
    assert text in answer.json()["detail"]


def test_findings_need_a_diagnosis(client: httpx.Client) -> None:
    body = {"text": "all well", "at": "2026-03-01T08:00:00Z"}
    assert client.post(f"{API}/diagnoses/none/finding", json=body).status_code == 404
    assert client.get(f"{API}/findings/none").status_code == 404
