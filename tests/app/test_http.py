"""The HTTP interface as a client sees it, over a real server."""

from __future__ import annotations

import hashlib
import io
import re
import socket
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from small_service import serving, spoiled

from app.jobs import tasks
from app.settings import Settings
from app.shelves.catalogues import stamp_of
from app.storage.store import Store

API = "/api/v1"
PROBLEM = {"type", "title", "status", "detail", "instance"}


def assert_problem(response: httpx.Response, status: int, text: str = "", slug: str = "") -> dict[str, Any]:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = response.json()
    assert set(document) - {"errors"} == PROBLEM
    assert document["status"] == status
    assert document["instance"] == response.request.url.path
    assert "\n" not in document["detail"]
    assert text in document["detail"]
    if slug:
        assert document["type"] == f"urn:jointplay:problem:{slug}"
    return document


def send(client: httpx.Client, content: bytes, name: str = "recording.csv", **fields: str) -> httpx.Response:
    return client.post(f"{API}/measurements", files={"file": (name, content)}, data=fields)


@pytest.fixture(scope="module")
def measurement(client: httpx.Client, worn: bytes) -> dict[str, Any]:
    response = send(client, worn, "worn.csv")
    assert response.status_code == 201, response.text
    document: dict[str, Any] = response.json()
    return document


@pytest.fixture(scope="module")
def diagnosis(client: httpx.Client, measurement: dict[str, Any]) -> httpx.Response:
    body = {"measurement": measurement["id"], "catalogue": "slider-crank", "effort": "fast", "speed": "606.8 rpm"}
    return client.post(f"{API}/diagnoses", json=body)


def test_a_mode_may_be_asked_for(client: httpx.Client, measurement: dict[str, Any]) -> None:
    body = {"measurement": measurement["id"], "catalogue": "slider-crank", "effort": "fast", "mode": "robust"}
    answer = client.post(f"{API}/diagnoses", json=body).json()
    assert answer["mode"] == {"asked": "robust", "used": "robust", "trusted_p_value": None}
    assert [step["name"] for step in answer["provenance"]["recipe"]][:2] == ["sensors", "steady part"]


def assert_time(text: str) -> None:
    moment = datetime.fromisoformat(text)
    assert moment.utcoffset() == timedelta(0)


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


# --- measurements


def test_a_measurement_is_stored_by_content(client: httpx.Client, measurement: dict[str, Any], worn: bytes) -> None:
    assert measurement["name"] == "worn.csv"
    assert measurement["sample_rate_hz"] == pytest.approx(10_000)
    assert [channel["quantity"] for channel in measurement["channels"]] == ["acceleration"] * 4
    assert_time(measurement["created_at"])
    other = send(client, worn, "other name.csv").json()
    assert other["sha256"] == measurement["sha256"]
    assert other["id"] != measurement["id"]
    again = send(client, worn, "worn.csv")
    assert again.status_code == 201
    assert again.json() == measurement
    assert again.headers["location"] == f"{API}/measurements/{measurement['id']}"
    got = client.get(again.headers["location"])
    assert got.json() == measurement
    assert client.get(again.headers["location"], headers={"If-None-Match": got.headers["etag"]}).status_code == 304


@pytest.mark.parametrize(
    ("kind", "text"),
    [("no number", "line 301"), ("nan", "line 301"), ("short", "samples"), ("spectrum", "spectrum")],
)
def test_unreadable_recordings(client: httpx.Client, worn: bytes, kind: str, text: str) -> None:
    document = assert_problem(send(client, spoiled(worn, kind), "bad.csv"), 422, text, "measurement")
    assert document["detail"].startswith("bad.csv: ")


def test_a_refused_recording_leaves_no_file(client: httpx.Client, worn: bytes, settings: Settings) -> None:
    def stored() -> set[Path]:
        return {path for path in (settings.data / "measurements").rglob("*") if path.is_file()}

    send(client, worn, "worn.csv")
    before = stored()
    assert_problem(send(client, spoiled(worn, "nan"), "bad.csv"), 422)
    assert stored() == before


@pytest.mark.parametrize(
    ("place", "fields"),
    [
        (f"{API}/measurements", {"tacho": "none of its columns"}),
        (f"{API}/measurements", {"sample_rate": "fast"}),
        (f"{API}/diagnoses", {}),
        ("/recordings", {"catalogue": "slider-crank", "sample_rate": "fast"}),
    ],
)
def test_a_refused_form_leaves_no_file(
    client: httpx.Client, worn: bytes, settings: Settings, place: str, fields: dict[str, str]
) -> None:
    content = b"# never sent elsewhere\n" + worn
    response = client.post(place, files={"file": ("fresh.csv", content)}, data=fields)
    assert response.status_code == 422
    name = hashlib.sha256(content).hexdigest()
    assert not list((settings.data / "measurements").rglob(name))


@pytest.mark.parametrize("stored_first", [False, True])
def test_one_server_refuses_what_another_keeps(tmp_path: Path, url: str, stored_first: bool) -> None:
    one, other = Store(tmp_path, url), Store(tmp_path, url)
    refused, kept = one.receive(io.BytesIO(b"bytes")), other.receive(io.BytesIO(b"bytes"))
    place = one.path_of(kept.sha256)
    if stored_first:
        other.add_measurement(kept, "kept.csv", None, {})
        one.settle(refused)
    else:
        one.settle(refused)
        assert kept.path.read_bytes() == b"bytes"
        other.add_measurement(kept, "kept.csv", None, {})
    other.settle(kept)
    assert place.read_bytes() == b"bytes"
    assert [path.name for path in (tmp_path / "measurements").rglob("*") if path.is_file()] == [place.name]
    again = one.receive(io.BytesIO(b"bytes"))
    assert one.add_measurement(again, "kept.csv", None, {}).id == one.measurements(None, 2)[0].id
    one.settle(again)
    assert place.read_bytes() == b"bytes"
    for store in (one, other):
        store.close()


@pytest.mark.parametrize("name", ["recording", "recording.pdf", "../../etc/passwd", "x" * 300 + ".docx", "\u202e.exe"])
def test_files_of_unknown_kinds(client: httpx.Client, worn: bytes, name: str) -> None:
    assert_problem(send(client, worn, name), 422)


def test_a_recording_without_times_needs_a_rate(client: httpx.Client, worn: bytes) -> None:
    bare = b"\n".join(line.partition(b",")[2] for line in worn.splitlines())
    assert_problem(send(client, bare), 422, "sample rate")
    assert send(client, bare, sample_rate="10 kHz").json()["sample_rate_hz"] == 10_000
    document = assert_problem(send(client, bare, sample_rate="fast"), 422, "sample_rate: fast: ", "invalid-field")
    assert document["errors"][0]["field"] == "sample_rate"


def test_an_upload_over_the_limit(client: httpx.Client, settings: Settings) -> None:
    content = b"0" * (settings.max_upload_bytes + 1)
    assert_problem(send(client, content), 413, "3 MB", "too-large")


def test_a_declared_length_over_the_limit_is_refused_unread(server: str) -> None:
    answer = refusal_of(server, "Content-Length: 1000000000", b"")
    assert answer.startswith(b"HTTP/1.1 413 ")
    assert b"application/problem+json" in answer


def test_an_undeclared_length_is_cut_off_at_the_limit(server: str, settings: Settings) -> None:
    part = b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n'
    block = b"%x\r\n%s\r\n" % (len(part), part)
    filler = b"%x\r\n%s\r\n" % (100_000, b"1" * 100_000)
    body = block + filler * (settings.max_upload_bytes // 100_000 + 1)
    answer = refusal_of(server, "Transfer-Encoding: chunked", body)
    assert answer.startswith(b"HTTP/1.1 413 ")


def refusal_of(server: str, header: str, body: bytes) -> bytes:
    """What comes back for a body that never ends."""
    url = httpx.URL(server)
    head = (
        f"POST {API}/measurements HTTP/1.1\r\nHost: localhost\r\n"
        f"Content-Type: multipart/form-data; boundary=x\r\n{header}\r\n\r\n"
    )
    with socket.create_connection((url.host, url.port), timeout=300) as connection:
        connection.sendall(head.encode() + body)
        return connection.recv(65536)


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        ({"json": {"file": "x"}}, 422, "channels: Field required"),
        ({"content": b"1,2,3", "headers": {"Content-Type": "text/csv"}}, 415, "must be application/json or multipart"),
        ({"content": b"x"}, 415, "none"),
        ({"files": {"other": ("a.csv", b"1")}}, 422, "other: is not a field"),
        ({"files": {"file": ("a.csv", b"1")}, "data": {"colour": "red"}}, 422, "colour: is not a field"),
        ({"files": {"file": ("", b"")}}, 422, "file"),
        ({"files": {"sample_rate": ("a.csv", b"1")}}, 422, "sample_rate: must be text"),
        ({"files": [("file", ("a.csv", b"1")), ("file", ("b.csv", b"2"))]}, 422, "file: is given twice"),
        ({"content": b"nonsense", "headers": {"Content-Type": "multipart/form-data"}}, 400, ""),
        ({"content": b"nonsense", "headers": {"Content-Type": "multipart/form-data; boundary=x"}}, 400, ""),
    ],
)
def test_bad_uploads(client: httpx.Client, arguments: dict[str, Any], status: int, text: str) -> None:
    assert_problem(client.post(f"{API}/measurements", **arguments), status, text)


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
    asked = {"measurement": diagnosis.json()["measurement"], "effort": "fast", "speed": 606.8 * 3.141592653589793 / 30}
    again = client.post(f"{API}/diagnoses", json={**asked, "catalogue": diagnosis.json()["catalogue"]})
    for one, other in zip(again.json()["hypotheses"], diagnosis.json()["hypotheses"], strict=True):
        assert one["label"] == other["label"]
        assert one["probability"] == pytest.approx(other["probability"])


def test_a_file_in_the_same_call(client: httpx.Client, worn: bytes, diagnosis: httpx.Response) -> None:
    response = client.post(
        f"{API}/diagnoses",
        files={"file": ("worn.csv", worn)},
        data={"catalogue": "slider-crank", "effort": "fast", "speed": "606.8 rpm", "mapping": "{}"},
    )
    assert response.status_code == 201
    assert response.json() == diagnosis.json()


def test_diagnoses_are_listed_newest_first(client: httpx.Client, diagnosis: httpx.Response) -> None:
    # Asked nowhere else: a question that was asked before has the answer of then, which is not the newest.
    body = {"measurement": diagnosis.json()["measurement"], "catalogue": "slider-crank", "speed": "606.5 rpm"}
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
        ({"catalogue": "slider-crank"}, 422, "measurement: Field required"),
        ({"measurement": "0" * 32, "catalogue": "slider-crank"}, 404, "measurement 0000"),
        ({"measurement": "ID", "catalogue": "nonsense"}, 404, "catalogue: nonsense"),
        ({"measurement": "ID", "catalogue": "slider-crank", "effort": "much"}, 422, "effort"),
        ({"measurement": "ID", "catalogue": "slider-crank", "mode": "blind"}, 422, "mode"),
        ({"measurement": "ID", "catalogue": "slider-crank", "speed": "3 kg"}, 422, "speed: 3 kg: "),
        ({"measurement": "ID", "catalogue": "slider-crank", "speed": -1}, 422, "speed: -1"),
        ({"measurement": "ID", "catalogue": "slider-crank", "speed": True}, 422, "speed"),
        ({"measurement": "ID", "catalogue": "slider-crank", "mapping": {"x": "y"}}, 422, "s1-x"),
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
    client: httpx.Client, diagnosis: httpx.Response, worn: bytes, settings: Settings, tmp_path: Path
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
    settings = Settings(catalogues=shelf, data=data, max_upload_mb=3.0, time_limit_s=0.2, workers=1)
    with serving(settings) as address:
        yield address


def test_work_that_takes_too_long_is_stopped(hurried: str, worn: bytes) -> None:
    with httpx.Client(base_url=hurried, timeout=300) as client:
        assert_problem(send(client, worn, "worn.csv"), 504, "stopped after 0.2 s", "time-limit")
        assert client.get("/healthz").status_code == 200
