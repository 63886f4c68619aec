"""A service over a small catalogue, and recordings with something wrong in them."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import httpx
from starlette.types import ASGIApp

from jointplay.app.http.connections import Server, listen
from jointplay.app.main import create_app
from jointplay.app.settings import ServiceSettings

PLAN = {
    "name": "tests",
    "clearance": {"low": "30 um", "high": "0.8 mm"},
    "draws": {"healthy": 36, "single": 72},
    "laws": {"own": 1},
    "seconds": 1.0,
}


@contextmanager
def serving(settings: ServiceSettings, *, warm: bool = False) -> Iterator[str]:
    """Run a real server in a thread; gives its address."""
    with running(create_app(settings, warm=warm)) as address:
        yield address


@contextmanager
def running(application: ASGIApp, most: int = 200, most_of_one: int = 200) -> Iterator[str]:
    """Run an application by a real server in a thread; gives its address."""
    server = Server(application, listen("127.0.0.1", 0), most, most_of_one, log_level="warning", proxy_headers=False)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    deadline = time.monotonic() + 300
    while not server.started:
        assert thread.is_alive() and time.monotonic() < deadline, "the server did not start"
        time.sleep(0.02)
    port = server.servers[0].sockets[0].getsockname()[1]
    try:
        yield f"http://127.0.0.1:{port}"
    finally:
        server.should_exit = True
        thread.join(30)


@contextmanager
def asking(
    settings: ServiceSettings, *, timeout: float = 300.0, headers: Mapping[str, str] | None = None
) -> Iterator[httpx.Client]:
    """Run a real server in a thread; gives a client of it."""
    with serving(settings) as address, httpx.Client(base_url=address, timeout=timeout, headers=headers) as client:
        yield client


def spoiled(recording: bytes, kind: str) -> bytes:
    """A recording with something wrong in it."""
    lines = recording.decode().splitlines()
    if kind == "short":
        return "\n".join(lines[:40]).encode()
    if kind == "slow":
        return "\n".join([lines[0], *lines[1::200]]).encode()
    if kind == "spectrum":
        return "\n".join(["frequency [Hz],s1-x [m/s2]", *(f"{k},{0.001 * k}" for k in range(1, 2000))]).encode()
    fields = lines[300].split(",")
    fields[2] = {"no number": "abc", "infinite": "inf"}[kind]
    lines[300] = ",".join(fields)
    return "\n".join(lines).encode()
