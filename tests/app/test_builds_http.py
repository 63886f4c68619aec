"""Builds over HTTP, with real servers that are killed and stopped in the middle of one."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from small_service import PLAN, asking

from jointplay.app.jobs import build_watch
from jointplay.app.settings import ServiceSettings
from jointplay.catalogue.building.build import build
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import shipped_machine

API = "/api/v1"
TINY = {**PLAN, "draws": {"healthy": 3, "single": 70}, "guard": 0}
ASKED = {"machine": "slider-crank", "plan": TINY, "catalogue": "made", "workers": 1}


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A service that takes builds and leaves them to others."""
    folder = tmp_path_factory.mktemp("idle")
    settings = ServiceSettings(catalogues=folder / "catalogues", data=folder / "data", builds=0, workers=1)
    Manifest.of(shipped_machine("four-bar"), parse_plan(PLAN).resolve(shipped_machine("four-bar"))).write(
        made(CatalogueDirectory(folder / "catalogues" / "other"))
    )
    with asking(settings) as client:
        yield client


def made(layout: CatalogueDirectory) -> CatalogueDirectory:
    layout.create()
    return layout


def states(response: httpx.Response) -> Iterator[dict[str, Any]]:
    """Data of the events of a stream."""
    for line in response.iter_lines():
        if line.startswith("data: "):
            yield json.loads(line.removeprefix("data: "))


def test_a_build_waits_is_followed_and_cancelled(idle: httpx.Client) -> None:
    response = idle.post(f"{API}/builds", json=ASKED)
    assert response.status_code == 202, response.text
    document = response.json()
    place = response.headers["location"]
    assert place == f"{API}/builds/{document['id']}"
    assert (document["state"], document["machine"], document["plan"]) == ("queued", "slider-crank", "tests")
    got = idle.get(place)
    assert got.json() == document
    assert idle.get(place, headers={"If-None-Match": got.headers["etag"]}).status_code == 304
    assert idle.get(f"{API}/builds", params={"limit": 1}).json()["items"] == [document]
    with idle.stream("GET", f"{place}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        lines = stream.iter_lines()
        head = [next(lines) for _ in range(4)]
        assert (head[0], head[1][:4], head[3]) == ("event: state", "id: ", "")
        assert json.loads(head[2].removeprefix("data: ")) == document
        assert idle.post(f"{place}/cancel").json()["state"] == "cancelled"
        rest = list(lines)  # the stream ends by itself
    last = json.loads(rest[2].removeprefix("data: "))
    assert (last["state"], len(rest)) == ("cancelled", 4)
    assert idle.post(f"{place}/cancel").status_code == 202
    with idle.stream("GET", f"{place}/events") as stream:
        assert [state["state"] for state in states(stream)] == ["cancelled"]
    again = idle.get(f"{place}/events", headers={"Last-Event-ID": rest[1].removeprefix("id: ")})
    assert again.status_code == 204


def test_one_client_listens_to_so_many_streams(idle: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build_watch, "MOST_OF_ONE", 1)
    place = idle.post(f"{API}/builds", json=ASKED).headers["location"]
    with idle.stream("GET", f"{place}/events") as stream:
        lines = stream.iter_lines()
        assert next(lines) == "event: state"
        refused = idle.get(f"{place}/events")
        assert refused.status_code == 429, refused.text
        assert refused.headers["retry-after"] == "5"
        idle.post(f"{place}/cancel")
        assert list(lines)[-1] == ""
    with idle.stream("GET", f"{place}/events") as stream:
        assert stream.status_code == 200


def test_a_build_that_is_asked_for_again_with_its_key_is_one(idle: httpx.Client) -> None:
    headers = {"Idempotency-Key": "once"}
    first, again = (idle.post(f"{API}/builds", json=ASKED, headers=headers) for _ in range(2))
    assert (again.status_code, again.json()) == (202, first.json())
    assert again.headers["location"] == first.headers["location"]
    assert idle.post(f"{API}/builds", json={**ASKED, "workers": 2}, headers=headers).status_code == 422
    assert idle.post(f"{API}/builds", json=ASKED).json()["id"] == first.json()["id"], "the same build is one anyway"


def test_the_same_build_asked_for_at_once_is_one(idle: httpx.Client) -> None:
    asked = {**ASKED, "catalogue": "same"}
    with ThreadPoolExecutor(6) as pool:
        answers = list(pool.map(lambda _: idle.post(f"{API}/builds", json=asked), range(6)))
    assert {answer.status_code for answer in answers} == {202}
    assert len({(answer.json()["id"], answer.headers["location"]) for answer in answers}) == 1
    other = idle.post(f"{API}/builds", json={**asked, "plan": {**TINY, "seed": 2}}).json()["id"]
    first = answers[0].headers["location"]
    assert not first.endswith(other)
    assert idle.post(f"{first}/cancel").json()["state"] == "cancelled"
    assert idle.post(f"{API}/builds", json=asked).headers["location"] != first


@pytest.mark.parametrize(
    ("change", "status", "text"),
    [
        ({"machine": "loom"}, 422, "machine: loom: there is none of this name"),
        ({"machine": None}, 422, "machine"),
        ({"plan": "quik"}, 422, "plan: quik: is not a shipped plan; did you mean"),
        ({"plan": "/etc/passwd"}, 422, "plan: /etc/passwd: is not a shipped plan"),
        ({"plan": {"draws": {"single": 0}}}, 422, "plan: draws.single: 0: "),
        ({"plan": {"sets": [["A", "Z"]]}}, 422, "plan: sets"),
        ({"plan": {"sets": [["A", "B"], ["B", "A"]]}}, 422, "plan: sets.1: ['B', 'A']: is the same set as sets.0"),
        ({"plan": {"seconds": 1e15}}, 422, "plan: seconds: 1000000000000000.0: duration: "),
        ({"plan": {"speeds": [1e-9]}}, 422, "plan: seconds: 1.0: duration: "),
        ({"plan": {"colour": "red"}}, 422, "plan: colour"),
        ({"catalogue": "../up"}, 422, "catalogue: "),
        ({"catalogue": ".hidden"}, 422, "catalogue: "),
        ({"catalogue": "other"}, 409, "other: is a catalogue of another machine"),
        ({"workers": 0}, 422, "workers"),
        ({"workers": True}, 422, "workers"),
        ({"colour": "red"}, 422, "colour"),
    ],
)
def test_builds_that_are_refused(idle: httpx.Client, change: dict[str, Any], status: int, text: str) -> None:
    response = idle.post(f"{API}/builds", json={**ASKED, **change})
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    assert text in response.json()["detail"]
    assert "\n" not in response.json()["detail"]


def test_bodies_and_ids_that_are_none(idle: httpx.Client) -> None:
    assert idle.post(f"{API}/builds", content=b"{").status_code == 415
    headers = {"Content-Type": "application/json"}
    assert idle.post(f"{API}/builds", content=b'{"plan": NaN}', headers=headers).status_code == 400
    for method, place in (("GET", ""), ("GET", "/events"), ("POST", "/cancel")):
        response = idle.request(method, f"{API}/builds/{'0' * 32}{place}")
        assert response.status_code == 404
        assert response.json()["type"] == "urn:jointplay:problem:unknown-build"


@contextmanager
def command(folder: Path) -> Iterator[tuple[subprocess.Popen[str], httpx.Client]]:
    """``jointplay serve`` as its users start it."""
    arguments = ["--port", "0", "--workers", "1", "--catalogues", str(folder / "catalogues")]
    with subprocess.Popen(
        [sys.executable, "-m", "jointplay.app.cli", "serve", *arguments, "--data", str(folder / "data")],
        env={**os.environ, "JOINTPLAY_BUILD_LEASE_S": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stderr is not None
            heard = iter(process.stderr.readline, "")
            address = next(found[0] for line in heard if (found := re.search(r"http://127\.0\.0\.1:\d+", line)))
            next(line for line in heard if "startup complete" in line)
            with httpx.Client(base_url=address, timeout=300) as client:
                yield process, client
        finally:
            process.kill()


@pytest.mark.long
def test_a_server_killed_another_stopped_a_third_finishes(tmp_path: Path, worn: bytes) -> None:
    with command(tmp_path) as (process, client):
        kept = client.post(f"{API}/measurements", files={"file": ("worn.csv", worn)})
        place = client.post(f"{API}/builds", json=ASKED).headers["location"]
        with client.stream("GET", f"{place}/events") as stream:
            first = next(state for state in states(stream) if state["cases_done"])
            process.kill()
    assert (first["attempts"], kept.status_code) == (1, 201)
    with command(tmp_path) as (process, client), client.stream("GET", f"{place}/events") as stream:
        following = states(stream)
        there = next(state for state in following if state["attempts"] == 2 and state["cases_done"])
        process.send_signal(signal.SIGTERM)
        rest = list(following)  # it ends, and lets the server go
        assert process.wait(300) == 0
    assert there["cases_done"] < there["cases_total"]
    assert all(state["state"] in ("running", "queued") for state in rest)

    settings = ServiceSettings(catalogues=tmp_path / "catalogues", data=tmp_path / "data", workers=1)
    with asking(settings) as client:
        with client.stream("GET", f"{place}/events") as stream:
            seen = list(states(stream))
        assert client.get(kept.headers["location"]).json() == kept.json()
        (offered,) = client.get(f"{API}/catalogues").json()["items"]
    last = seen[-1]
    assert (last["state"], last["attempts"]) == ("done", 2)  # a stop in good order counts as none
    assert last["cases_done"] == last["cases_total"] == 3 + 3 * 70
    assert (offered["name"], offered["id"]) == ("made", last["catalogue_id"])
    build(shipped_machine("slider-crank"), parse_plan(TINY), tmp_path / "undisturbed", workers=0)
    assert Catalogue.open(tmp_path / "undisturbed").id == last["catalogue_id"]
