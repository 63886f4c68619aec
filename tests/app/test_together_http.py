"""One answer to several recordings over HTTP, on the page and in the report."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest
from http_answers import API, assert_problem
from recordings import RECORDINGS


def sent(client: httpx.Client, number: int, asset: str | None = None) -> str:
    """Id of a stored recording."""
    name = f"slider-crank-{number:02}.csv.gz"
    files = {"file": (name, (RECORDINGS / name).read_bytes())}
    answer = client.post(f"{API}/measurements", files=files, data={} if asset is None else {"asset": asset})
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
    assert_problem(client.post(f"{API}/diagnoses", json=early), 422)


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
    ],
)
def test_refusals(client: httpx.Client, members: dict[str, Any], field: str) -> None:
    answer = client.post(f"{API}/diagnoses", json={**members, "catalogue": "slider-crank"})
    assert answer.status_code == 422, answer.text
    assert [error["field"] for error in answer.json()["errors"]] == [field]


def test_one_that_is_not_there(client: httpx.Client, two: list[str]) -> None:
    body = {"measurements": [two[0], "0" * 32], "catalogue": "slider-crank"}
    assert_problem(client.post(f"{API}/diagnoses", json=body), 404)
