"""A database that stalls: told as such within seconds by everything, and all is well as soon as it goes on."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import databases
import httpx
import pytest
from lines import Line, remote
from small_service import asking
from sqlalchemy import text
from sqlalchemy.exc import DatabaseError, OperationalError

from jointplay.app.problems import problem_of
from jointplay.app.schemas.assets import AssetIn
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage import stalls
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.store import Store

API = "/api/v1"
ASSET = {"machine": "slider-crank"}
postgresql = pytest.mark.parametrize("kind", [kind for kind in databases.KINDS if kind == "postgresql"])


@pytest.fixture
def store(tmp_path: Path, kind: str) -> Iterator[tuple[Store, Line]]:
    """A store over a line, as a service has it."""
    with remote(tmp_path) as (line, url), closing(Store(tmp_path / "data", url)) as found:
        found.database.limit_waits()
        yield found, line


def took(begun: float) -> float:
    return time.monotonic() - begun


def fails(store: Store) -> float:
    """Seconds until a question to a database has failed."""
    begun = time.monotonic()
    with pytest.raises(OperationalError):
        store.measurements(None, 5)
    return took(begun)


@postgresql
def test_every_route_tells_a_stalled_database_within_seconds(tmp_path: Path, kind: str) -> None:
    with remote(tmp_path) as (line, url):
        settings = ServiceSettings(
            catalogues=tmp_path / "none", data=tmp_path / "data", database=url, workers=1, builds=0
        )
        with asking(settings, timeout=60) as client:
            assert client.get("/readyz").status_code == 200
            assert client.put(f"{API}/assets/a", json=ASSET).status_code == 201
            line.pause()
            asked = [("GET", "/readyz"), ("GET", "/metrics"), ("PUT", f"{API}/assets/b")]
            asked += [("GET", f"{API}/{of}") for of in ("assets", "diagnoses", "measurements", "builds", "webhooks")]
            begun = time.monotonic()
            with ThreadPoolExecutor(len(asked)) as pool:  # the first ones find out, all at once
                answers = list(pool.map(lambda each: ask(client, *each), asked))
            elapsed = took(begun)
            assert elapsed < stalls.STATEMENT_S  # 2.0 s where nothing else works
            for (_method, place), answer in zip(asked, answers, strict=True):
                if place == "/metrics":
                    assert answer.status_code == 200
                    assert "jointplay_database_up 0.0" in answer.text
                    continue
                assert answer.status_code == 503, (place, answer.text)
                assert answer.json()["type"] == "urn:jointplay:problem:database-gone"
                assert answer.headers["retry-after"] == "5"
            assert client.get("/healthz").status_code == 200
            line.resume()
            eventually(lambda: client.get("/readyz").status_code == 200)
            assert client.put(f"{API}/assets/b", json=ASSET).status_code in (200, 201)
            assert len(client.get(f"{API}/assets").json()["items"]) == 2


def ask(client: httpx.Client, method: str, place: str) -> httpx.Response:
    return client.request(method, place, json=ASSET if method == "PUT" else None)


def eventually(holds: object) -> None:
    """Wait for what a thread has yet to find out."""
    for _ in range(200):
        if holds():  # type: ignore[operator]
            return
        time.sleep(0.05)
    pytest.fail("never")


@postgresql
def test_only_the_first_wait_for_a_stalled_server(store: tuple[Store, Line], kind: str) -> None:
    found, line = store
    assert found.measurements(None, 5) == []
    line.pause()
    assert stalls.SILENCE_S <= fails(found) < stalls.STATEMENT_S
    assert fails(found) < stalls.SILENCE_S  # it is known by now
    line.resume()
    eventually(lambda: not threads("database-pulse"))
    assert found.measurements(None, 5) == []


def threads(name: str) -> list[threading.Thread]:
    return [each for each in threading.enumerate() if each.name == name]


@postgresql
def test_a_slow_statement_of_a_server_that_answers_others_is_waited_for(store: tuple[Store, Line], kind: str) -> None:
    found, _line = store
    with found.database.reading() as session:
        session.execute(text("SELECT pg_sleep(:long)"), {"long": stalls.SILENCE_S + 0.5})
        assert session.scalar(text("SELECT 1")) == 1


@postgresql
def test_the_server_ends_what_waits_for_a_lock(store: tuple[Store, Line], kind: str) -> None:
    found, _line = store
    with found.database.engine.connect() as holder:
        holder.execute(text("LOCK TABLE assets"))
        with pytest.raises(OperationalError, match="lock timeout"):
            Assets(found.database).put("a", AssetIn.model_validate(ASSET))
    assert Assets(found.database).put("a", AssetIn.model_validate(ASSET))[1]


def test_a_database_that_is_locked_for_writing_is_not_ready(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path / "none", data=tmp_path / "data", workers=1, builds=0)
    with asking(settings) as client:
        assert client.get("/readyz").status_code == 200
        with closing(sqlite3.connect(tmp_path / "data/service.sqlite", isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            refused = client.get("/readyz")
            assert (refused.status_code, refused.json()["detail"]) == (503, "database: cannot be written to")
            assert client.get(f"{API}/assets").status_code == 200  # reading goes on
            other.execute("ROLLBACK")
        assert client.get("/readyz").status_code == 200


def test_nothing_is_acknowledged_into_a_file_that_was_taken_away(tmp_path: Path) -> None:
    with closing(Store(tmp_path)) as store:
        assets, wanted = Assets(store.database), AssetIn.model_validate(ASSET)
        assets.put("a", wanted)
        file = tmp_path / "service.sqlite"
        with pytest.raises(OperationalError, match="not the one that was opened"), store.database.writing():
            file.rename(tmp_path / "elsewhere")  # in the middle of it
        with pytest.raises(OperationalError, match="not the one that was opened"):
            assets.put("b", wanted)
        (tmp_path / "elsewhere").rename(file)
        assert assets.put("b", wanted)[1]


def test_damage_of_a_database_is_a_named_problem(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path / "none", data=tmp_path / "data", workers=1, builds=0)
    file = tmp_path / "data/service.sqlite"
    with asking(settings) as client:
        hook = client.post(f"{API}/webhooks", json={"url": "https://hooks.example/", "events": ["build.ended"]})
        assert hook.status_code == 201
        with closing(sqlite3.connect(file)) as other, other:
            other.execute("UPDATE webhooks SET events = '{'")
        for place in ("webhooks", f"webhooks/{hook.json()['id']}"):
            answer = client.get(f"{API}/{place}")
            assert (answer.status_code, answer.json()["type"]) == (500, "urn:jointplay:problem:damaged-database")
            assert answer.json()["detail"] == "a row of the database is damaged: a column of it is no JSON"
    torn = sqlite3.DatabaseError("malformed")
    torn.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
    assert problem_of(DatabaseError("SELECT", None, torn)).type == "urn:jointplay:problem:damaged-database"
