"""The log: a line for every request, under its id wherever it is worked on, and nothing secret in it."""

from __future__ import annotations

import asyncio
import json
import logging
import re
import signal
import socket
import threading
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from service_process import client_of, service_process
from small_service import PLAN
from sqlalchemy import text
from starlette.datastructures import Headers

from jointplay.app import logs
from jointplay.app.http.middleware import Templates, identity_of
from jointplay.app.jobs.workers import WorkerPool
from jointplay.app.scopes import Scope
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.store import Store

API = "/api/v1"
TOKEN = "jp_0123456789ab_" + "s3cret-" * 6


def record(message: str, **members: Any) -> logging.LogRecord:
    found = logging.LogRecord("jointplay.app.x", logging.WARNING, "x.py", 1, message, (), None)
    setattr(found, logs.MEMBERS, members)
    return found


@pytest.mark.parametrize(
    ("given", "written"),
    [
        (f"key {TOKEN} came", "key jp_0123456789ab_*** came"),
        ("sent bearer abc.def once", "sent bearer *** once"),
        ("Authorization: Bearer abc.def", "Authorization: ***"),
        ("{'x-api-key': 'abc'}", "{'x-api-key': '***'}"),
        ("Cookie: jointplay_session=abc; other", "Cookie: ***"),
        ("a jointplay_session=abc; b", "a jointplay_session=***; b"),
        ("postgresql://me:pass%40word@host:5432/base", "postgresql://me:***@host:5432/base"),
        ("host=x password=abc user=y", "host=x password=*** user=y"),
        ("http://host:80/path?a=b and 12:30 x@y", "http://host:80/path?a=b and 12:30 x@y"),
    ],
)
def test_what_looks_like_a_secret_is_not_written(given: str, written: str) -> None:
    assert logs.without_secrets(given) == written
    line = json.loads(logs.JsonFormatter().format(record("m", path=given)))
    assert "abc" not in json.dumps(line)
    assert "s3cret" not in json.dumps(line)


@pytest.mark.parametrize("formatter", [logs.JsonFormatter(), logs.TextFormatter()])
def test_a_record_is_one_line_whatever_it_says(formatter: logging.Formatter) -> None:
    with logs.of_request("r-1"):
        line = formatter.format(record('one\ntwo "three"', path="/a\r\nb", status=200))
    assert len(line.splitlines()) == 1
    assert "r-1" in line
    assert "200" in line
    assert "r-1" not in formatter.format(record("outside"))


def test_json_lines_have_these_members() -> None:
    line = json.loads(logs.JsonFormatter().format(record("m", status=200)))
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", line.pop("time"))
    assert line == {"level": "warning", "logger": "jointplay.app.x", "message": "m", "status": 200}


@pytest.mark.parametrize("given", ["a", "7f3c1c1e-2f5b-4d0e", "A_b.9" * 12])
def test_an_id_that_is_safe_is_kept(given: str) -> None:
    assert identity_of(Headers({"X-Request-ID": given})) == given


@pytest.mark.parametrize("given", ["", "a b", "a\n", "x" * 65, "<script>", "é", '"'])
def test_an_id_that_is_not_is_replaced(given: str) -> None:
    assert re.fullmatch(r"[0-9a-f]{32}", identity_of(Headers(raw=[(b"x-request-id", given.encode())])))


def test_templates_in_place_of_paths() -> None:
    templates = Templates(["/a", "/a/{key}", "/a/{key}/b", "/static/{path:path}"])
    found = [templates.of(path) for path in ("/a", "/a/x", "/a/x/b", "/static/x/y.css", "/b", "/a/x/c")]
    assert found == ["/a", "/a/{key}", "/a/{key}/b", "/static/{path:path}", None, None]


def test_every_answer_has_an_id(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    head = {"X-Request-ID": "mine-1"}
    with monkeypatch.context() as broken:

        def fail(*_arguments: object) -> None:
            raise ZeroDivisionError

        broken.setattr(Store, "measurements", fail)
        unforeseen = client.get(f"{API}/measurements", headers=head)
    assert unforeseen.status_code == 500
    assert "content-security-policy" in unforeseen.headers  # as on every other answer
    answers = [
        unforeseen,
        client.get("/healthz", headers=head),
        client.get("/nowhere", headers=head),
        client.delete("/healthz", headers=head),
        client.get("/healthz", headers={**head, "Host": "elsewhere.example"}),
        client.get(f"{API}/machines", headers={**head, "Host": "elsewhere.example"}),
        client.get("/static/nothing.css", headers=head),
        client.get(f"{API}/diagnoses/none", headers=head),
        client.post(f"{API}/diagnoses", content=b"{", headers={**head, "Content-Type": "application/json"}),
    ]
    assert [answer.status_code for answer in answers] == [500, 200, 404, 405, 200, 421, 404, 404, 400]
    assert {answer.headers["x-request-id"] for answer in answers} == {"mine-1"}
    other = client.get("/healthz", headers={"X-Request-ID": "not safe"}).headers["x-request-id"]
    assert re.fullmatch(r"[0-9a-f]{32}", other)


def test_errors_of_the_database_are_told_without_values(url: str, tmp_path: Path) -> None:
    store = Store(tmp_path, url)
    with pytest.raises(Exception, match="nothing_there") as caught, store.database.writing() as session:
        session.execute(text("INSERT INTO nothing_there VALUES (:secret)"), {"secret": "s3cret"})
    assert "s3cret" not in str(caught.value)
    store.close()


@pytest.fixture
def receiver() -> Any:
    """A place that refuses what webhooks tell it; gives its port, and an event set when it was told."""
    told = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        try:
            while True:
                with listener.accept()[0] as connection:
                    connection.recv(65536)
                    told.set()
        except OSError:
            return

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield listener.getsockname()[1], told
    listener.shutdown(socket.SHUT_RDWR)
    listener.close()
    thread.join(10)


@pytest.mark.long
def test_a_whole_service_logs_json_and_no_secret(
    tmp_path: Path, shelf: Path, worn: bytes, receiver: tuple[int, threading.Event]
) -> None:
    (tmp_path / "catalogues").symlink_to(shelf)
    store = Store(tmp_path / "data")
    key, token = Keys(store.database).create("all", frozenset(Scope), timedelta(hours=1))
    store.close()
    head = {"Authorization": f"Bearer {token}"}
    secret = token.split("_", 2)[2]  # which may hold an underscore itself
    port, told = receiver
    given = {"keys": "required", "log_format": "json", "log_level": "debug", "webhooks_private": "true"}
    with service_process(tmp_path, **given) as running:
        with client_of(running) as client:
            client.get(f"{API}/machines", params={"key": token}, headers={"X-Forwarded-For": "192.0.2.1"})
            client.get(f"{API}/machines/{token}", headers={"X-API-Key": token})
            client.get(f"{API}/machines", headers={"Authorization": f"Bearer {token}x"})
            session = client.post("/sign-in", data={"key": token, "next": "/"}).cookies["jointplay_session"]
            client.get("/", headers={"Cookie": f"jointplay_session={session}"})
            address = f"http://127.0.0.1:{port}/hook?token=t0ken"
            hook = client.post(
                f"{API}/webhooks", json={"url": address, "events": ["diagnosis.created"]}, headers=head
            ).json()
            upload = {"file": ("worn.csv", worn)}
            asked = client.post(
                f"{API}/diagnoses",
                files=upload,
                data={"catalogue": "slider-crank", "effort": "fast"},
                headers={**head, "X-Request-ID": "diagnosis-1"},
            )
            assert asked.status_code == 201, asked.text
            build = {"machine": "slider-crank", "plan": PLAN, "catalogue": "slider-crank", "workers": 1}
            place = client.post(f"{API}/builds", json=build, headers={**head, "X-Request-ID": "build-1"})
            with client.stream("GET", f"{place.headers['location']}/events", headers=head) as stream:
                assert '"done"' in [line for line in stream.iter_lines() if line.startswith("data: ")][-1]
            assert told.wait(300)
        running.process.send_signal(signal.SIGTERM)
        assert running.process.wait(300) == 0
    whole = "".join(running.written)
    for each in (secret, session, hook["secret"], "t0ken"):
        assert each not in whole
    entries = running.entries()
    requests = [entry for entry in entries if entry["logger"] == "jointplay.app.http.middleware"]
    shown = [(entry["method"], entry["route"], entry["status"], entry["key"]) for entry in requests]
    assert shown[:3] == [
        ("GET", f"{API}/machines", 401, None),
        ("GET", f"{API}/machines/{{name}}", 404, key.id),
        ("GET", f"{API}/machines", 401, None),
    ]
    assert ("POST", f"{API}/diagnoses", 201, key.id) in shown
    assert all(entry["duration_ms"] >= 0 and entry["request_id"] for entry in requests)
    assert requests[0]["problem"] == "unauthorized"
    assert {entry["address"] for entry in requests} == {"127.0.0.1"}  # this computer is no proxy here
    workers = [entry for entry in entries if entry["logger"] == "jointplay.app.jobs.workers"]
    assert {entry["request_id"] for entry in workers if "diagnose" in entry["message"]} == {"diagnosis-1"}
    for logger in ("jointplay.app.jobs.build_runner", "jointplay.app.jobs.build_process"):
        assert {entry["request_id"] for entry in entries if entry["logger"] == logger} == {"build-1"}


def test_an_exception_in_a_worker_is_logged_there_with_its_request(
    capfd: pytest.CaptureFixture[str],
) -> None:
    async def story() -> None:
        pool = WorkerPool(1, 1, 60.0, logs.LogSettings("json", "info"))
        try:
            with logs.of_request("r-2"), pytest.raises(Exception, match="did not foresee"):
                await pool.run(int, "Bearer abc")
        finally:
            pool.close()

    asyncio.run(story())
    (line,) = [json.loads(line) for line in capfd.readouterr().err.splitlines() if line.startswith("{")]
    assert (line["request_id"], line["level"], line["message"]) == ("r-2", "error", "task int failed")
    assert "invalid literal" in line["exception"]
    assert "Bearer abc" not in line["exception"]
