"""Measurements as a client sends them, over a real server: what is stored, and what is refused."""

from __future__ import annotations

import hashlib
import io
import socket
from pathlib import Path
from typing import Any

import httpx
import pytest
from http_answers import API, assert_problem, assert_time, send
from small_service import spoiled

from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.store import Store


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
    [("no number", "line 301"), ("infinite", "line 301"), ("short", "samples"), ("spectrum", "give its scaling: psd")],
)
def test_unreadable_recordings(client: httpx.Client, worn: bytes, kind: str, text: str) -> None:
    document = assert_problem(send(client, spoiled(worn, kind), "bad.csv"), 422, text, "measurement")
    assert document["detail"].startswith("bad.csv: ")


def test_a_refused_recording_leaves_no_file(client: httpx.Client, worn: bytes, settings: ServiceSettings) -> None:
    def stored() -> set[Path]:
        return {path for path in (settings.data / "measurements").rglob("*") if path.is_file()}

    send(client, worn, "worn.csv")
    before = stored()
    assert_problem(send(client, spoiled(worn, "infinite"), "bad.csv"), 422)
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
    client: httpx.Client, worn: bytes, settings: ServiceSettings, place: str, fields: dict[str, str]
) -> None:
    content = b"# never sent elsewhere\n" + worn
    response = client.post(place, files={"file": ("fresh.csv", content)}, data=fields)
    assert response.status_code == 422
    name = hashlib.sha256(content).hexdigest()
    assert not list((settings.data / "measurements").rglob(name))


@pytest.mark.parametrize("stored_first", [False, True])
def test_one_server_refuses_what_another_keeps(tmp_path: Path, url: str, stored_first: bool) -> None:
    one, other = Store(tmp_path, url), Store(tmp_path, url)
    refused, kept = one.uploads.receive(io.BytesIO(b"bytes")), other.uploads.receive(io.BytesIO(b"bytes"))
    place = one.path_of(kept.sha256)
    if stored_first:
        other.add_measurement(kept, "kept.csv", None, {})
        one.uploads.settle(refused)
    else:
        one.uploads.settle(refused)
        assert kept.path.read_bytes() == b"bytes"
        other.add_measurement(kept, "kept.csv", None, {})
    other.uploads.settle(kept)
    assert place.read_bytes() == b"bytes"
    assert [path.name for path in (tmp_path / "measurements").rglob("*") if path.is_file()] == [place.name]
    again = one.uploads.receive(io.BytesIO(b"bytes"))
    assert one.add_measurement(again, "kept.csv", None, {}).id == one.measurements(None, 2)[0].id
    one.uploads.settle(again)
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


def test_an_upload_over_the_limit(client: httpx.Client, settings: ServiceSettings) -> None:
    content = b"0" * (settings.max_upload_bytes + 1)
    assert_problem(send(client, content), 413, "3 MB", "too-large")


def test_a_declared_length_over_the_limit_is_refused_unread(server: str) -> None:
    answer = refusal_of(server, "Content-Length: 1000000000", b"")
    assert answer.startswith(b"HTTP/1.1 413 ")
    assert b"application/problem+json" in answer


def test_an_undeclared_length_is_cut_off_at_the_limit(server: str, settings: ServiceSettings) -> None:
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
