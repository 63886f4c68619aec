"""Connections that wait make room, end after a time, and are never more than there may be."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any, cast

import httpx
import pytest
from small_service import running
from starlette.types import Message, Receive, Scope, Send

from jointplay.app.errors import AddressError
from jointplay.app.http import connections
from jointplay.app.http.connections import Connection, Connections, Listener, listen, most_connections
from jointplay.app.settings import ServiceSettings

HEAD = b"GET /%s HTTP/1.1\r\nHost: localhost\r\n"


class Pages:
    """An application with an answer at once, one that is held, and one that is large; a body is never read."""

    def __init__(self) -> None:
        self.held = asyncio.Event()
        self.loop: asyncio.AbstractEventLoop | None = None
        self.at_work = threading.Semaphore(0)
        self.ended = threading.Event()

    def release(self) -> None:
        assert self.loop is not None
        self.loop.call_soon_threadsafe(self.held.set)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            for kind in ("startup", "shutdown"):
                await receive()
                await send({"type": f"lifespan.{kind}.complete"})
            return
        self.loop = asyncio.get_running_loop()
        start: Message = {"type": "http.response.start", "status": 200, "headers": []}
        await send(start)
        if scope["path"] == "/held":
            self.at_work.release()
            await self.held.wait()
        if scope["path"] == "/large":
            for _ in range(400):
                await send({"type": "http.response.body", "body": bytes(100_000), "more_body": True})
            self.ended.set()
        await send({"type": "http.response.body", "body": b"here"})


@pytest.fixture
def pages() -> Pages:
    return Pages()


@contextlib.contextmanager
def talking(address: str, sent: bytes = b"", source: str = "127.0.0.1") -> Iterator[socket.socket]:
    """A connection over which something was sent."""
    place = httpx.URL(address)
    with socket.create_connection((place.host, place.port or 0), 60, (source, 0)) as connection:
        connection.sendall(sent)
        yield connection


def has_ended(connection: socket.socket) -> bool:
    """Whether the other end closes a connection, sooner or later; what it says before is read."""
    with contextlib.suppress(ConnectionError):
        while connection.recv(65536):
            pass
    return True


def is_open(connection: socket.socket) -> bool:
    """Whether nothing has come over a connection, not even its end."""
    connection.setblocking(False)
    try:
        return bool(connection.recv(1))
    except BlockingIOError:
        return True
    except ConnectionError:
        return False
    finally:
        connection.settimeout(60)


def drip(connection: socket.socket, byte: bytes) -> None:
    """Send a byte every now and then until the other end has had enough."""
    connection.settimeout(0.1)
    for _ in range(600):
        try:
            connection.sendall(byte)
            if not connection.recv(65536):
                return
        except TimeoutError:
            continue
        except ConnectionError:
            return
    pytest.fail("the connection still stands")


@pytest.mark.parametrize("begun", [b"", b"GET /", HEAD % b"quick"])
def test_who_sends_no_whole_head_is_left(pages: Pages, begun: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 0.5)
    with running(pages) as address, talking(address, begun) as idle, talking(address, begun) as dripping:
        assert has_ended(idle)
        drip(dripping, b"a")
        assert httpx.get(f"{address}/quick", timeout=300).text == "here"


def test_a_body_that_comes_after_its_answer_does_not_hold_the_connection(
    pages: Pages, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 0.5)
    with running(pages) as address, talking(address, HEAD % b"quick" + b"Content-Length: 9999\r\n\r\n") as connection:
        drip(connection, b"a")


def test_who_does_not_take_an_answer_is_left(pages: Pages, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "STALL_S", 0.5)
    with running(pages) as address, talking(address, HEAD % b"large" + b"\r\n"):
        assert pages.ended.wait(60)


def test_who_takes_an_answer_slowly_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    class Transport:
        left = 100_000_000

        def get_write_buffer_size(self) -> int:
            return self.left

    connection = Connection.__new__(Connection)
    connection._unsent = None
    connection.transport = cast(Any, Transport())
    taken = cast(Any, connection.transport)
    for second in range(100):  # 2 kB a second
        assert not connection.is_stalled(float(second))
        taken.left -= 2000
    assert not connection.is_stalled(connections.STALL_S + 90)
    assert connection.is_stalled(connections.STALL_S + 121)
    taken.left = 0
    assert not connection.is_stalled(connections.STALL_S + 200)


def test_whoever_has_waited_longest_makes_room(pages: Pages, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 600.0)  # of no matter here, however slow the computer is
    with running(pages, most=4) as address, contextlib.ExitStack() as stack:
        silent = [stack.enter_context(talking(address)) for _ in range(4)]
        assert httpx.get(f"{address}/quick", timeout=300).text == "here"
        assert has_ended(silent[0])
        assert is_open(silent[3])


def test_who_has_a_request_does_not(pages: Pages) -> None:
    with running(pages, most=2) as address, contextlib.ExitStack() as stack:
        held = [stack.enter_context(talking(address, HEAD % b"held" + b"\r\n")) for _ in range(2)]
        for _ in held:
            assert pages.at_work.acquire(timeout=60)
        with talking(address, HEAD % b"quick" + b"\r\n") as refused:
            assert has_ended(refused)
        pages.release()
        for each in held:
            each.sendall(b"GET /")  # and nothing more: it waits, and so may be closed
        answer = b""
        while b"here" not in answer:
            answer += held[0].recv(65536)
        assert httpx.get(f"{address}/quick", timeout=300).text == "here"


def test_one_address_does_not_take_the_place_of_others(pages: Pages, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "HEAD_S", 600.0)  # of no matter here, however slow the computer is
    with running(pages, most=10, most_of_one=3) as address, contextlib.ExitStack() as stack:
        other = stack.enter_context(talking(address, source="127.0.0.2"))
        silent = [stack.enter_context(talking(address)) for _ in range(5)]
        assert has_ended(silent[0])
        assert has_ended(silent[1])
        assert is_open(silent[4])
        assert is_open(other)


class Waiting:
    """A connection that waits for its request."""

    address, has_sent_all, accepted = "127.0.0.1", True, None

    def __init__(self, place: int, accepted: socket.socket, left: list[int], *, has_more: bool = False) -> None:
        self.place, self.socket, self.transport, self.left, self.has_more = place, accepted, self, left, has_more

    def get_extra_info(self, _name: str) -> socket.socket:
        return self.socket

    def abort(self) -> None:
        self.left.append(self.place)


def test_a_request_that_is_there_is_read_by_a_server_that_is_behind() -> None:
    left: list[int] = []
    with contextlib.ExitStack() as stack:
        known = Connections(most=10, most_of_one=10)
        for place, has_more in enumerate((False, True)):
            near, far = map(stack.enter_context, socket.socketpair())
            each = stack.enter_context(known.accepted(near, "127.0.0.1"))
            known.begin(cast(Any, Waiting(place, each, left, has_more=has_more)), 0.0)
            assert far.fileno() > 0
        for moment, gone in ((0.9, []), (1.1, [0]), (1.9, [0]), (2.1, [0, 1])):
            known.sweep([], moment * connections.HEAD_S)
            assert left == gone


def test_of_many_at_once_of_one_address_only_those_too_many_leave() -> None:
    left: list[int] = []
    with contextlib.ExitStack() as stack:
        known = Connections(most=10, most_of_one=3)
        ends = [pair for _ in range(5) for pair in [socket.socketpair()]]
        arrived = [known.accepted(stack.enter_context(near), "127.0.0.1") for near, _ in ends]
        for place, each in enumerate(arrived):  # all are accepted before the first is closed
            known.begin(cast(Any, Waiting(place, each, left)), float(place))
        assert left == [0, 1]
        for each, (_, far) in zip(arrived, ends, strict=True):
            each.close()
            far.close()
    assert len(known) == 0


def test_a_rush_never_takes_more_places_than_there_are(pages: Pages, monkeypatch: pytest.MonkeyPatch) -> None:
    counts = []
    accepted = Connections.accepted

    def counted(self: Connections, connection: socket.socket, address: str) -> Any:
        counts.append(len(self) + 1)
        return accepted(self, connection, address)

    monkeypatch.setattr(Connections, "accepted", counted)
    with running(pages, most=10) as address, contextlib.ExitStack() as stack:
        for _ in range(120):
            stack.enter_context(talking(address))
        assert httpx.get(f"{address}/quick", timeout=300).text == "here"
    assert len(counts) > 100
    assert max(counts) == 10


def test_a_request_that_came_in_a_rush_is_answered(pages: Pages) -> None:
    with running(pages, most=6) as address, contextlib.ExitStack() as stack:
        for _ in range(20):
            asked = stack.enter_context(talking(address, HEAD % b"quick" + b"\r\n"))
            for _ in range(8):
                stack.enter_context(talking(address))
            answer = b""
            while b"here" not in answer:
                part = asked.recv(65536)
                assert part, answer
                answer += part


def test_without_descriptors_it_is_tried_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    def none_left(self: socket.socket) -> Any:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(socket.socket, "accept", none_left)
    with contextlib.closing(listen("127.0.0.1", 0)) as listener:
        listener.connections = Connections(10, 10)
        with pytest.raises(OSError, match="Too many open files"):
            listener.accept()
        for _ in range(100):  # as often as connections may wait
            with pytest.raises(BlockingIOError):
                listener.accept()
        listener._rest_until = time.monotonic()
        with pytest.raises(OSError, match="Too many open files"):
            listener.accept()


def test_that_no_connection_can_be_accepted_is_one_line(caplog: pytest.LogCaptureFixture) -> None:
    with contextlib.closing(asyncio.new_event_loop()) as loop:
        connections.tell(loop, {"message": "x", "exception": OSError(errno.EMFILE, "Too many open files")})
    (record,) = caplog.records
    assert record.getMessage() == "no connection can be accepted: Too many open files"
    assert record.exc_info is None


def test_descriptors_are_left_for_everything_else(monkeypatch: pytest.MonkeyPatch) -> None:
    import resource

    def limit(allowed: int) -> int:
        monkeypatch.setattr(resource, "getrlimit", lambda _which: (allowed, allowed))
        return most_connections(ServiceSettings(connections=500, workers=2))

    assert [limit(each) for each in (300, 1024, 10**6, resource.RLIM_INFINITY)] == [90, 452, 500, 500]
    with pytest.raises(AddressError, match=r"open files: 100 \(ulimit -n\): must be at least 124"):
        limit(100)


def test_a_listener_is_one_that_counts() -> None:
    with contextlib.closing(listen("127.0.0.1", 0)) as listener:
        assert isinstance(listener, Listener)
        assert listener.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
