"""One answer to several recordings over HTTP, on the page and in the report."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest
from http_answers import API, assert_problem
from recordings import RECORDINGS


def sent(client: httpx.Client, number: int, asset: str | None = None, prefix: str = "", at: str = "") -> str:
    """Id of a stored recording; under a name with a prefix, and as made at a moment, where these are given."""
    name = f"slider-crank-{number:02}.csv.gz"
    files = {"file": (prefix + name, (RECORDINGS / name).read_bytes())}
    told = {"asset": asset or "", "measured_at": at}
    answer = client.post(f"{API}/measurements", files=files, data={key: each for key, each in told.items() if each})
    assert answer.status_code == 201, answer.text
    key: str = answer.json()["id"]
    return key


@pytest.fixture(scope="module")
def two(client: httpx.Client) -> list[str]:
    """The same worn joint, as two machines have it."""
    return [sent(client, 2), sent(client, 5)]


@pytest.fixture(scope="module")
def together(client: httpx.Client, two: list[str]) -> dict[str, Any]:
    body = {"measurements": two, "catalogue": "slider-crank", "effort": "fast"}
    answer = client.post(f"{API}/diagnoses", json=body)
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_what_each_has_contributed(client: httpx.Client, together: dict[str, Any], two: list[str]) -> None:
    assert together["measurements"] == two
    assert together["measurement"] == two[0]
    assert len(together["recordings"]) == 2
    for share in together["recordings"]:
        assert 0.0 < share["weight"] < 1.0
    assert client.get(f"{API}/diagnoses/{together['id']}").json() == together


def test_a_speed_of_each(client: httpx.Client, together: dict[str, Any], two: list[str]) -> None:
    """One is given, the other one is found; made again, the answer is the same."""
    found = [share["drive_speed_rpm"] for share in together["recordings"]]
    given = round(1.002 * found[0], 2)
    body = {"measurements": two, "catalogue": "slider-crank", "effort": "fast", "speeds": [f"{given} rpm", None]}
    answer = client.post(f"{API}/diagnoses", json=body)
    assert answer.status_code == 201, answer.text
    assert [share["drive_speed_rpm"] for share in answer.json()["recordings"]] == pytest.approx([given, found[1]])
    verified = client.get(f"{API}/diagnoses/{answer.json()['id']}/verification").json()
    assert verified["repeated"] == "equal", verified
    twice = {**body, "measurements": [two[0], two[0]], "speeds": ["600 rpm", "601 rpm"]}
    assert_problem(client.post(f"{API}/diagnoses", json=twice), 422, "is given twice, and something else is said of it")


def test_the_page_and_the_report_show_it(client: httpx.Client, together: dict[str, Any]) -> None:
    page = client.get(f"/diagnoses/{together['id']}").text
    report = client.get(f"{API}/diagnoses/{together['id']}/report", params={"format": "html"}).text
    assert "2 recordings" in page
    for share in together["recordings"]:
        assert share["measurement"] in page
        assert share["measurement"] in report
    assert "Recording 2" in report


def test_all_of_an_asset_in_a_window(client: httpx.Client, two: list[str]) -> None:
    asset = "press-of-two-visits"
    made = client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"})
    assert made.status_code in (200, 201), made.text
    began = datetime.now(UTC) - timedelta(days=1)
    keys = [sent(client, 2, asset), sent(client, 5, asset)]
    assert keys == two  # the same bytes are one measurement
    body = {"asset": asset, "since": began.isoformat(), "catalogue": "slider-crank", "effort": "fast"}
    answer = client.post(f"{API}/diagnoses", json=body)
    assert answer.status_code == 201, answer.text
    assert sorted(answer.json()["measurements"]) == sorted(two)
    assert answer.json()["asset"] == asset
    listed = client.get(f"{API}/diagnoses", params={"asset": asset}).json()["items"]
    assert [item["id"] for item in listed] == [answer.json()["id"]]
    early = {**body, "until": began.isoformat()}
    assert_problem(client.post(f"{API}/diagnoses", json=early), 422, "must be after since")


def test_the_baseline_is_no_evidence(client: httpx.Client, two: list[str]) -> None:
    """In a window it is what the others are compared with; among named ones it is refused."""
    asset = "press-with-baseline"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank", "baseline": sent(client, 1)})
    for key in (sent(client, 1, asset), *(sent(client, number, asset) for number in (2, 5))):
        assert key
    body = {"asset": asset, "catalogue": "slider-crank", "effort": "fast"}
    answer = client.post(f"{API}/diagnoses", json={**body, "since": "2026-01-01T00:00:00Z"})
    assert answer.status_code == 201, answer.text
    assert sorted(answer.json()["measurements"]) == sorted(two)
    assert answer.json()["baseline"] is not None
    refused = client.post(f"{API}/diagnoses", json={**body, "measurements": [*two, sent(client, 1)]})
    assert_problem(refused, 422, "is the baseline that the others are compared with")


def test_what_is_no_evidence_takes_no_place_in_a_window(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many recordings in order there are, all others count."""
    monkeypatch.setattr("jointplay.app.questions.MOST_TOGETHER", 2)
    asset, at = "press-with-copies", "2026-02-01T00:00:00Z"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank", "baseline": sent(client, 1)})
    for prefix in ("a-", "b-", "c-"):
        sent(client, 1, asset, prefix, at)
    others = [sent(client, number, asset, "later-", "2026-02-02T00:00:00Z") for number in (2, 5)]
    body = {"asset": asset, "catalogue": "slider-crank", "effort": "fast", "since": at}
    answer = client.post(f"{API}/diagnoses", json=body)
    assert answer.status_code == 201, answer.text
    assert sorted(answer.json()["measurements"]) == sorted(others)
    sent(client, 3, asset, "later-", "2026-02-03T00:00:00Z")
    assert_problem(client.post(f"{API}/diagnoses", json=body), 422, "more than 2 measurements")


def test_what_is_sent_again_is_no_newer_recording(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a window of time the bytes of before are not what was recorded in it, and take no place there."""
    monkeypatch.setattr("jointplay.app.questions.MOST_TOGETHER", 1)
    asset = "press-sent-again"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"})
    sent(client, 2, asset, "old-", "2026-01-05T00:00:00Z")
    for prefix in ("again-", "and-again-"):
        sent(client, 2, asset, prefix)
    new = sent(client, 5, asset, "new-")
    body = {"asset": asset, "catalogue": "slider-crank", "effort": "fast", "since": "2026-02-01T00:00:00Z"}
    assert client.post(f"{API}/diagnoses", json=body).json()["measurements"] == [new]


def test_a_repair_is_between_two_states(client: httpx.Client) -> None:
    """Nobody has to have measured what was repaired; recordings before and after it have no common answer."""
    asset = "press-repaired"
    client.put(f"{API}/assets/{asset}", json={"machine": "slider-crank"})
    worn = sent(client, 2, asset, "march-", "2026-03-01T00:00:00Z")
    later = sent(client, 1, asset, "april-", "2026-04-01T00:00:00Z")
    body = {"asset": asset, "catalogue": "slider-crank", "effort": "fast"}
    alone = client.post(f"{API}/diagnoses", json={**body, "measurement": worn}).json()
    finding, at = f"{API}/diagnoses/{alone['id']}/finding", "2026-03-10T00:00:00Z"
    nothing = client.post(finding, json={"joints": {"B": {}}, "at": at})
    assert_problem(nothing, 422, "joints.B: give clearance_um, or repaired, or both")
    found = client.post(finding, json={"joints": {"B": {"repaired": True}}, "at": at})
    assert found.status_code == 201, found.text
    assert found.json()["joints"] == {"B": {"clearance_um": None, "repaired": True}}
    assert "B repaired" in client.get(f"/assets/{asset}").text
    rule = "joint B of asset press-repaired was repaired on 2026-03-10, between them: must be of one state"
    for field, several in (("since", "2026-02-28T00:00:00Z"), ("measurements", [later, worn])):
        refused = client.post(f"{API}/diagnoses", json={**body, field: several})
        assert_problem(refused, 422, f"{field}: {rule}")
    since = client.post(f"{API}/diagnoses", json={**body, "since": "2026-03-11T00:00:00Z"})
    assert since.status_code == 201, since.text
    state = client.get(f"{API}/assets/{asset}/state").json()
    assert [(each["joint"], each["probability"]) for each in state["repairs"]] == [("B", 1.0)]


def test_an_answer_to_equal_bytes_is_one_of_its_own(client: httpx.Client, two: list[str]) -> None:
    """Two measurements of the same bytes say what one says, but the answer is to both."""
    name = "slider-crank-02.csv.gz"
    other = client.post(f"{API}/measurements", files={"file": (f"copy-{name}", (RECORDINGS / name).read_bytes())})
    keys = [two[0], other.json()["id"]]
    body = {"catalogue": "slider-crank", "effort": "fast"}
    one = client.post(f"{API}/diagnoses", json={**body, "measurement": two[0]}).json()
    both = client.post(f"{API}/diagnoses", json={**body, "measurements": keys}).json()
    assert both["id"] != one["id"]
    assert both["measurements"] == keys
    assert both["hypotheses"] == one["hypotheses"]


@pytest.mark.parametrize(
    ("members", "field"),
    [
        ({}, "measurement"),
        ({"measurement": "0" * 32, "measurements": ["0" * 32]}, "measurements"),
        ({"measurements": []}, "measurements"),
        ({"measurements": ["0" * 32] * 21}, "measurements"),
        ({"since": "2026-01-01T00:00:00Z"}, "asset"),
        ({"since": "2026-01-01T00:00:00", "asset": "x"}, "since"),
        ({"measurement": "0" * 32, "until": "2026-01-01T00:00:00Z"}, "until"),
        ({"measurements": ["0" * 32], "speed": "600 rpm"}, "speed"),
        ({"measurements": ["0" * 32], "speeds": ["600 rpm", None]}, "speeds"),
        ({"measurements": ["0" * 32], "speeds": ["0 rpm"]}, "speeds"),
        ({"measurements": ["0" * 32], "speeds": [600]}, "speeds.0"),
        ({"measurement": "0" * 32, "speeds": ["600 rpm"]}, "speeds"),
        ({"since": "2026-01-01T00:00:00Z", "speeds": ["600 rpm"]}, "speeds"),
    ],
)
def test_refusals(client: httpx.Client, members: dict[str, Any], field: str) -> None:
    answer = client.post(f"{API}/diagnoses", json={**members, "catalogue": "slider-crank"})
    assert answer.status_code == 422, answer.text
    assert [error["field"] for error in answer.json()["errors"]] == [field]


def test_one_that_is_not_there(client: httpx.Client, two: list[str]) -> None:
    body = {"measurements": [two[0], "0" * 32], "catalogue": "slider-crank"}
    assert_problem(client.post(f"{API}/diagnoses", json=body), 404)
