"""The HTTP interface as a client sees it, over a real server."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from http_answers import API, assert_problem, assert_time, send
from small_service import serving, spoiled

from jointplay.app.jobs import tasks
from jointplay.app.settings import ServiceSettings
from jointplay.app.shelves.catalogues import stamp_of
from jointplay.catalogue.matching.prior import Prior


@pytest.fixture(scope="module")
def diagnosis(client: httpx.Client, measurement: dict[str, Any]) -> httpx.Response:
    body = {"measurement": measurement["id"], "catalogue": "slider-crank", "effort": "fast", "speed": "606.8 rpm"}
    return client.post(f"{API}/diagnoses", json=body)


def test_a_mode_may_be_asked_for(client: httpx.Client, measurement: dict[str, Any]) -> None:
    body = {"measurement": measurement["id"], "catalogue": "slider-crank", "effort": "fast", "mode": "robust"}
    answer = client.post(f"{API}/diagnoses", json=body).json()
    assert answer["mode"] == {"asked": "robust", "used": "robust", "trusted_p_value": None}
    assert [step["name"] for step in answer["provenance"]["recipe"]][:2] == ["sensors", "steady part"]


def test_what_is_held_likely_beforehand_may_be_said(client: httpx.Client, diagnosis: httpx.Response) -> None:
    usual = diagnosis.json()
    most = max(len(each["joints"]) for each in usual["hypotheses"])
    numbers = pytest.approx(Prior().numbers(3, most))
    assert usual["prior"] == {"worn": Prior().worn, "another": Prior().another, "joints": {}, "numbers": numbers}
    asked = {"measurement": usual["measurement"], "catalogue": "slider-crank", "effort": "fast", "speed": "606.8 rpm"}
    other = client.post(f"{API}/diagnoses", json={**asked, "prior": {"joints": {"A": 1000}}}).json()
    assert other["prior"] == {
        "worn": Prior().worn,
        "another": Prior().another,
        "joints": {"A": 1000.0},
        "numbers": numbers,
    }
    assert other["id"] != usual["id"]
    odds = [{each["label"]: each["probability"] for each in found["hypotheses"]} for found in (usual, other)]
    assert odds[1]["A"] / odds[1]["healthy"] == pytest.approx(1000 * odds[0]["A"] / odds[0]["healthy"])


# --- machines and catalogues


def test_machines(client: httpx.Client) -> None:
    page = client.get(f"{API}/machines").json()
    names = [item["name"] for item in page["items"]]
    assert names == sorted(names)
    assert {"slider-crank", "four-bar", "quick-return"} <= set(names)
    assert page["next_cursor"] is None
    walked = []
    cursor: str | None = ""
    while cursor is not None:
        part = client.get(f"{API}/machines", params={"limit": 1, **({"cursor": cursor} if cursor else {})}).json()
        walked += [item["name"] for item in part["items"]]
        cursor = part["next_cursor"]
    assert walked == names


def test_a_machine_has_an_entity_tag(client: httpx.Client) -> None:
    response = client.get(f"{API}/machines/slider-crank")
    assert response.json()["joints"]["B"]["kind"] == "turning"
    tag = response.headers["etag"]
    again = client.get(f"{API}/machines/slider-crank", headers={"If-None-Match": f'"x", W/{tag}'})
    assert again.status_code == 304
    assert again.content == b""
    assert client.get(f"{API}/machines/slider-crank", headers={"If-None-Match": '"x"'}).status_code == 200


@pytest.mark.parametrize("place", ["machines/slider-crank", "catalogues/slider-crank"])
def test_drawings(client: httpx.Client, place: str) -> None:
    response = client.get(f"{API}/{place}/drawing.svg")
    assert response.headers["content-type"] == "image/svg+xml"
    assert response.text.startswith("<svg")


def test_catalogues(client: httpx.Client) -> None:
    (item,) = client.get(f"{API}/catalogues").json()["items"]
    assert item["name"] == "slider-crank"
    assert item["entries"] == 252
    assert item["hypotheses"] == ["healthy", "A", "B", "O"]
    assert item["nominal_speed_rpm"] == pytest.approx(600)
    detail = client.get(f"{API}/catalogues/{item['id']}").json()
    assert detail["statuses"] == {"ok": 252}
    assert {name: detail[name] for name in item} == item
    assert client.get(f"{API}/catalogues/slider-crank").json() == detail


# --- diagnoses


def test_a_diagnosis(client: httpx.Client, diagnosis: httpx.Response, measurement: dict[str, Any]) -> None:
    assert diagnosis.status_code == 201, diagnosis.text
    document = diagnosis.json()
    assert document["verdict"] == "worn"
    assert document["measurement"] == measurement["id"]
    assert document["machine"] == "slider-crank"
    assert document["drive_speed_rpm"] == pytest.approx(606.8)
    best = document["hypotheses"][0]
    assert best["joints"].keys() == {"B"}
    low, high = best["joints"]["B"]["interval_um"]
    assert low < best["joints"]["B"]["clearance_um"] < high
    assert sum(entry["probability"] for entry in document["hypotheses"]) == pytest.approx(1)
    assert document["evidence"]["orders"]
    assert document["evidence"]["bands"]
    assert_time(document["created_at"])
    place = diagnosis.headers["location"]
    assert place == f"{API}/diagnoses/{document['id']}"
    again = client.get(place)
    assert again.json() == document
    assert client.get(place, headers={"If-None-Match": again.headers["etag"]}).status_code == 304


def test_the_same_question_has_the_same_answer(client: httpx.Client, diagnosis: httpx.Response) -> None:
    asked = {"measurement": diagnosis.json()["measurement"], "effort": "fast", "speed": f"{606.8 * math.pi / 30} rad/s"}
    again = client.post(f"{API}/diagnoses", json={**asked, "catalogue": diagnosis.json()["catalogue"]})
    for one, other in zip(again.json()["hypotheses"], diagnosis.json()["hypotheses"], strict=True):
        assert one["label"] == other["label"]
        assert one["probability"] == pytest.approx(other["probability"])


def test_a_file_in_the_same_call(client: httpx.Client, worn: bytes, diagnosis: httpx.Response) -> None:
    response = client.post(
        f"{API}/diagnoses",
        files={"file": ("worn.csv", worn)},
        data={"catalogue": "slider-crank", "effort": "fast", "speed": "606.8 rpm", "mapping": "{}", "prior": "{}"},
    )
    assert response.status_code == 201
    assert response.json() == diagnosis.json()


def test_diagnoses_are_listed_newest_first(client: httpx.Client, diagnosis: httpx.Response) -> None:
    # Asked nowhere else: a question that was asked before has the answer of then, which is not the newest.
    body = {"measurement": diagnosis.json()["measurement"], "catalogue": "slider-crank", "speed": "606.35 rpm"}
    newer = client.post(f"{API}/diagnoses", json={**body, "effort": "fast"}).json()
    first = client.get(f"{API}/diagnoses", params={"limit": 1}).json()
    assert first["items"][0]["id"] == newer["id"]
    assert first["items"][0]["verdict"] == "worn"
    second = client.get(f"{API}/diagnoses", params={"limit": 1, "cursor": first["next_cursor"]}).json()
    assert second["items"][0]["id"] != newer["id"]
    assert client.get(f"{API}/measurements").json()["items"]


@pytest.mark.parametrize(
    ("body", "status", "text"),
    [
        ({"catalogue": "slider-crank"}, 422, "measurement: give one of measurement, measurements, or since with asset"),
        ({"measurement": "0" * 32, "catalogue": "slider-crank"}, 404, "measurement 0000"),
        ({"measurement": "ID", "catalogue": "nonsense"}, 404, "catalogue: nonsense"),
        ({"measurement": "ID", "catalogue": "slider-crank", "effort": "much"}, 422, "effort"),
        ({"measurement": "ID", "catalogue": "slider-crank", "mode": "blind"}, 422, "mode"),
        ({"measurement": "ID", "catalogue": "slider-crank", "speed": "3 kg"}, 422, "speed: 3 kg: "),
        ({"measurement": "ID", "catalogue": "slider-crank", "speed": -1}, 422, "speed: -1"),
        (
            {"measurement": "ID", "catalogue": "slider-crank", "speed": 600},
            422,
            "speed: 600: give a unit: 600rpm or 62.8rad/s?",
        ),
        (
            {"measurement": "ID", "catalogue": "slider-crank", "speed": "600"},
            422,
            "speed: 600: give a unit: 600rpm or 62.8rad/s?",
        ),
        ({"measurement": "ID", "catalogue": "slider-crank", "speed": True}, 422, "speed"),
        ({"measurement": "ID", "catalogue": "slider-crank", "mapping": {"x": "y"}}, 422, "s1-x"),
        ({"measurement": "ID", "catalogue": "slider-crank", "prior": {"joints": {"Q": 2}}}, 422, "prior.joints.Q"),
        ({"measurement": "ID", "catalogue": "slider-crank", "prior": {"another": 0}}, 422, "prior.another"),
        ({"measurement": "ID", "catalogue": "slider-crank", "colour": "red"}, 422, "colour"),
        ([], 422, ""),
        ("text", 422, ""),
    ],
)
def test_bad_questions(client: httpx.Client, measurement: dict[str, Any], body: Any, status: int, text: str) -> None:
    if isinstance(body, dict) and body.get("measurement") == "ID":
        body = {**body, "measurement": measurement["id"]}
    assert_problem(client.post(f"{API}/diagnoses", json=body), status, text)


@pytest.mark.parametrize("content", [b"", b"{", b'{"measurement": NaN}', b"\xff", b"[" * 20000])
def test_bodies_that_are_not_json(client: httpx.Client, content: bytes) -> None:
    response = client.post(f"{API}/diagnoses", content=content, headers={"Content-Type": "application/json"})
    assert_problem(response, 400, "is not JSON")


def test_a_large_json_body(client: httpx.Client) -> None:
    response = client.post(f"{API}/diagnoses", json={"measurement": "x" * 1_100_000})
    assert_problem(response, 413, "1 MB")


def test_bodies_of_other_types(client: httpx.Client) -> None:
    response = client.post(f"{API}/diagnoses", content=b"x", headers={"Content-Type": "text/plain"})
    assert_problem(response, 415, "text/plain")


def test_a_recording_sampled_too_slowly(client: httpx.Client, worn: bytes) -> None:
    response = client.post(
        f"{API}/diagnoses",
        files={"file": ("slow.csv", spoiled(worn, "slow"))},
        data={"catalogue": "slider-crank"},
    )
    assert_problem(response, 422, "slow.csv")


# --- everything else


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/api/v1/nonsense", 404),
        ("GET", "/nonsense", 404),
        ("GET", "/static/nonsense.js", 404),
        ("GET", "/static/../settings.py", 404),
        ("GET", "/static/%2e%2e/settings.py", 404),
        ("GET", "/api/v1/machines/nonsense", 404),
        ("GET", "/api/v1/catalogues/nonsense", 404),
        ("GET", "/api/v1/measurements/nonsense", 404),
        ("GET", "/api/v1/diagnoses/nonsense", 404),
        ("DELETE", "/api/v1/machines", 405),
        ("PATCH", "/api/v1/diagnoses", 405),
        ("POST", "/healthz", 405),
        ("GET", "/api/v1/machines?limit=0", 422),
        ("GET", "/api/v1/machines?limit=x", 422),
        ("GET", "/api/v1/machines?cursor=%21", 400),
        ("GET", "/api/v1/diagnoses?cursor=YWJj", 400),
        ("GET", "/api/v1/measurements?cursor=YWJj", 400),
    ],
)
def test_every_error_is_a_problem_document(client: httpx.Client, method: str, path: str, status: int) -> None:
    assert_problem(client.request(method, path), status)


def test_health(client: httpx.Client) -> None:
    assert client.get("/healthz").json() == {"status": "ok"}
    assert client.get("/readyz").json() == {"status": "ready", "catalogues": 1}


def test_workers_that_loaded_models_beforehand_answer_the_same(
    client: httpx.Client, diagnosis: httpx.Response, worn: bytes, settings: ServiceSettings, tmp_path: Path
) -> None:
    folder = settings.catalogues / "slider-crank"
    assert tasks.warm([(str(folder), stamp_of(folder)), (str(tmp_path / "gone"), "")]) > 0
    with (
        serving(settings.model_copy(update={"data": tmp_path}), warm=True) as address,
        httpx.Client(base_url=address, timeout=300) as warmed,
    ):
        assert warmed.get("/readyz").status_code == 200
        sent = send(warmed, worn).json()
        asked = {"measurement": sent["id"], "catalogue": "slider-crank", "effort": "fast", "speed": "606.8 rpm"}
        answered = warmed.post(f"{API}/diagnoses", json=asked)
    assert answered.status_code == 201
    for member in ("hypotheses", "goodness_of_fit", "candidate_set", "evidence"):
        assert answered.json()[member] == diagnosis.json()[member]


def test_every_answer_carries_the_security_headers(client: httpx.Client) -> None:
    for path in ("/", "/healthz", "/nonsense", "/static/page.css"):
        headers = client.get(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert not re.search(r"https?:", policy)
        assert headers["x-content-type-options"] == "nosniff"


@pytest.fixture(scope="module")
def hurried(shelf: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    data = tmp_path_factory.mktemp("hurried")
    settings = ServiceSettings(catalogues=shelf, data=data, max_upload_mb=3.0, time_limit_s=0.2, workers=1)
    with serving(settings) as address:
        yield address


def test_work_that_takes_too_long_is_stopped(hurried: str, worn: bytes) -> None:
    with httpx.Client(base_url=hurried, timeout=300) as client:
        assert_problem(send(client, worn, "worn.csv"), 504, "stopped after 0.2 s", "time-limit")
        assert client.get("/healthz").status_code == 200
