"""A request has an end, whatever it waits for; what works at it meanwhile is not doubled, and nobody else waits."""

from __future__ import annotations

import asyncio
import threading
import time
from pathlib import Path
from typing import Any

import httpx
import pytest
from skipping_loop import run_skipping
from small_service import asking
from starlette.types import Message, Receive, Scope, Send

from jointplay.app.errors import OverdueError
from jointplay.app.http.deadline import Deadline
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.store import Store

API = "/api/v1"
OVERDUE = "urn:jointplay:problem:overdue"


def settings(folder: Path, time_limit: float) -> ServiceSettings:
    return ServiceSettings(
        catalogues=folder / "catalogues", data=folder / "data", workers=1, builds=0, time_limit_s=time_limit
    )


def test_a_disk_that_gives_nothing_ends_a_request_at_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held, found = threading.Event(), Store.measurements

    def stalled(self: Store, *given: Any) -> Any:  # as a read of a file on a disk that has gone: nothing bounds it
        held.wait(60)
        return found(self, *given)

    monkeypatch.setattr(Store, "measurements", stalled)
    with asking(settings(tmp_path, 1.0), timeout=30) as client:
        begun = time.monotonic()
        answer = client.get(f"{API}/measurements")
        took = time.monotonic() - begun
        assert (answer.status_code, answer.json()["type"]) == (503, OVERDUE)
        assert answer.json()["detail"] == "no answer within 2 s, the longest time of a request"
        assert answer.headers["retry-after"] == "5" and "x-request-id" in answer.headers
        assert 2.0 <= took < 20.0
        assert client.get("/healthz").status_code == 200  # over the same connection
        held.set()
        assert client.get(f"{API}/measurements").json()["items"] == []


@pytest.mark.long  # the limit leaves a busy computer the time to start a process
def test_what_is_stored_after_the_answer_is_stored_once(
    tmp_path: Path, worn: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, store = threading.Event(), Store.add_measurement
    stored: list[Any] = []

    def slow(self: Store, *given: Any) -> Any:
        if not stored:
            held.wait(60)
        stored.append(store(self, *given))
        return stored[-1]

    monkeypatch.setattr(Store, "add_measurement", slow)
    with asking(settings(tmp_path, 15.0), timeout=120, headers={"Idempotency-Key": "once"}) as client:

        def send() -> httpx.Response:
            return client.post(f"{API}/measurements", files={"file": ("w.csv", worn)})

        assert send().json()["type"] == OVERDUE
        assert send().json()["type"] == "urn:jointplay:problem:idempotency-key-in-use"
        held.set()
        until = time.monotonic() + 30
        while (answer := send()).status_code == 409 and time.monotonic() < until:
            time.sleep(0.05)
        assert (answer.status_code, answer.json()["id"]) == (201, stored[0].id)
        assert len(stored) == 1


async def run(app: Any, incoming: list[Message], sent: list[Message], gap: float = 0.0) -> None:
    """Ask an application with a limit of 0.2 s; parts of a body come with gaps."""

    async def receive() -> Message:
        await asyncio.sleep(gap)
        return incoming.pop(0)

    async def send(message: Message) -> None:
        sent.append(message)

    await Deadline(app, 0.1)({"type": "http", "path": "/x", "root_path": ""}, receive, send)


PART: Message = {"type": "http.request", "body": b"x", "more_body": True}
START: Message = {"type": "http.response.start", "status": 200}


def test_a_long_body_and_a_long_answer_have_limits_of_their_own() -> None:
    async def slow(scope: Scope, receive: Receive, send: Send) -> None:
        for _ in range(4):
            await receive()
        await send(START)
        await asyncio.sleep(0.4)
        await send({"type": "http.response.body"})

    sent: list[Message] = []
    run_skipping(run(slow, [PART] * 4, sent, gap=0.1))
    assert len(sent) == 2


def test_nothing_is_said_after_the_answer() -> None:
    ended = []

    async def late(scope: Scope, receive: Receive, send: Send) -> None:
        await asyncio.sleep(0.3)
        await send(START)
        ended.append(True)

    async def both() -> None:
        sent: list[Message] = []
        with pytest.raises(OverdueError, match=r"no answer within 0\.2 s"):
            await run(late, [], sent)
        await asyncio.sleep(0.3)
        assert (sent, ended) == ([], [True])

    run_skipping(both())


def test_what_is_refused_is_raised_as_it_is() -> None:
    async def refusing(scope: Scope, receive: Receive, send: Send) -> None:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        run_skipping(run(refusing, [], []))
