"""Bodies that come too slowly, forms that are too large, and clients that go."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.requests import Request
from starlette.types import Message, Receive, Scope, Send

from jointplay.app.errors import AppError, BadRequestError, SlowRequestError, UploadTooLargeError
from jointplay.app.http import middleware
from jointplay.app.http.middleware import BodyLimit
from jointplay.app.http.uploads import MAX_PLAIN_FIELDS, PLAIN_BYTES, plain_fields
from jointplay.app.jobs.clients import client_here

FORM = [(b"content-type", b"application/x-www-form-urlencoded")]


async def nothing(message: Message) -> None:
    """Send nothing."""


def asked(app: Callable[[Scope, Receive, Send], Awaitable[None]], receive: Receive, **limits: Any) -> None:
    """Let an application behind the limits answer a request."""
    scope: Scope = {"type": "http", "path": "/", "method": "POST", "headers": [], "client": ("10.0.0.5", 1)}
    asyncio.run(BodyLimit(app, **{"upload_bytes": 10**6, "receive_timeout": 300.0, **limits})(scope, receive, nothing))


async def read_all(scope: Scope, receive: Receive, send: Send) -> None:
    """Read a body."""
    await Request(scope, receive).body()


def test_a_body_that_never_pauses_for_long_may_be_too_slow_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    async def drip() -> Message:
        await asyncio.sleep(0.01)
        return {"type": "http.request", "body": b"a", "more_body": True}

    monkeypatch.setattr(middleware, "SLOWEST", 10**9)
    with pytest.raises(SlowRequestError, match="came slower than 1000000000 bytes a second"):
        asked(read_all, drip, receive_timeout=0.3)


def test_a_body_may_take_the_longer_the_more_of_it_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(0.0, 0.2)  # every look at it finds it later, whatever this machine does meanwhile
    left = [b"a" * 10_000] * 20

    async def flow() -> Message:
        return {"type": "http.request", "body": left.pop(), "more_body": bool(left)}

    monkeypatch.setattr(middleware, "time", SimpleNamespace(monotonic=clock.__next__))
    monkeypatch.setattr(middleware, "SLOWEST", 1)  # so that every part gives it hours more
    asked(read_all, flow, receive_timeout=1.0)
    assert next(clock) > 3.0


def test_tasks_are_for_whoever_asks_and_know_when_they_go() -> None:
    went = asyncio.Event()
    messages: list[Message] = [{"type": "http.request", "body": b"", "more_body": False}, {"type": "http.disconnect"}]

    async def receive() -> Message:
        if len(messages) == 1:
            await went.wait()
        return messages.pop(0)

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        client = client_here()
        assert client.name == "10.0.0.5"
        leaving = asyncio.ensure_future(client.leave())
        await asyncio.sleep(0.01)
        assert not leaving.done()
        went.set()
        await leaving

    asked(app, receive)
    assert client_here().name == ""


async def fields_of(body: bytes, **limits: int) -> list[tuple[str, str]]:
    async def receive() -> Message:
        return {"type": "http.request", "body": body, "more_body": False}

    return await plain_fields(Request({"type": "http", "headers": FORM}, receive), **limits)


def test_fields_of_a_form() -> None:
    found = asyncio.run(fields_of("a=1&b=&a=x+y%26z&n=%C3%A9\u00e9".encode()))
    assert found == [("a", "1"), ("b", ""), ("a", "x y&z"), ("n", "\u00e9\u00e9")]


@pytest.mark.parametrize(
    ("body", "kind", "rule"),
    [
        (b"a=1&" * 400_000, UploadTooLargeError, "the form is larger than 64 kB, the limit of this page"),
        (b"a=1&" * MAX_PLAIN_FIELDS, BadRequestError, "301 fields: a form may have at most 300"),
        (b"a" * (PLAIN_BYTES + 1), UploadTooLargeError, "the form is larger than 64 kB"),
    ],
)
def test_forms_that_are_refused_before_they_are_read(body: bytes, kind: type[AppError], rule: str) -> None:
    with pytest.raises(kind, match=rule):
        asyncio.run(fields_of(body))
