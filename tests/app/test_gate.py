"""Rate limits, host names, and bodies that never come."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
from small_service import running, serving
from starlette.applications import Starlette
from starlette.routing import Mount

from jointplay.app.commands.serve import answering, loopback
from jointplay.app.http.gate import CLIENTS_REMEMBERED, TokenBuckets
from jointplay.app.http.middleware import JSON_BYTES
from jointplay.app.main import create_app
from jointplay.app.routes import signin
from jointplay.app.scopes import API, Scope
from jointplay.app.settings import ServiceSettings


@pytest.fixture(scope="module")
def strict(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service with little patience: five requests, then one in a thousand seconds; a tenth of a second for a body."""
    data = tmp_path_factory.mktemp("strict")
    settings = ServiceSettings(
        catalogues=data, data=data, workers=1, rate_limit_per_s=0.001, rate_burst=5, receive_timeout_s=0.1
    )
    with serving(settings) as address:
        yield address


def test_a_bucket_empties_and_fills() -> None:
    present = [0.0]
    buckets = TokenBuckets(rate=2, burst=3, clock=lambda: present[0])
    assert [buckets.take("a") for _ in range(4)] == [0, 0, 0, 0.5]
    assert buckets.take("b") == 0
    present[0] = 0.5
    assert buckets.take("a") == 0
    assert buckets.take("a") == 0.5
    present[0] = 1000
    assert [buckets.take("a") for _ in range(4)] == [0, 0, 0, 0.5]


def test_buckets_do_not_grow_without_end() -> None:
    buckets = TokenBuckets(rate=1, burst=1, clock=lambda: 0.0)
    for client in range(CLIENTS_REMEMBERED + 10):
        buckets.take(str(client))
    assert len(buckets) == CLIENTS_REMEMBERED


def test_a_request_stops_waiting_for_its_body_and_a_client_is_slowed_down(strict: str) -> None:
    url = httpx.URL(strict)
    head = f"POST {API}/measurements HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=x\r\n"
    with socket.create_connection((url.host, url.port), timeout=300) as connection:
        connection.sendall(f"{head}Content-Length: 100\r\n\r\n--x".encode())
        assert connection.recv(65536).startswith(b"HTTP/1.1 408 ")
    answers = [httpx.get(f"{strict}{API}/machines", timeout=300) for _ in range(5)]
    assert [answer.status_code for answer in answers] == [200] * 4 + [429]
    assert 900 < int(answers[-1].headers["retry-after"]) <= 1000
    assert answers[-1].json()["type"] == "urn:jointplay:problem:too-many-requests"
    assert httpx.get(f"{strict}/healthz", timeout=300).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:80", "", "[", "localhost.evil.example", "localhost/static/", "x@localhost"]
)
def test_a_host_that_we_are_not_is_refused(client: httpx.Client, host: str) -> None:
    refused = client.get(f"{API}/machines", headers={"Host": host})
    assert refused.status_code == 421
    assert refused.json()["type"] == "urn:jointplay:problem:wrong-host"


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:99", "127.0.0.1:8000", "[::1]:8000"])
def test_a_host_that_we_are_is_answered(client: httpx.Client, host: str) -> None:
    assert client.get(f"{API}/machines", headers={"Host": host}).status_code == 200


@pytest.fixture(scope="module")
def mounted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, dict[str, str]]]:
    """Address of a service that asks for keys, below /plant in another application, and the headers of a reader.

    It forgets a key that did not hold in a thousand seconds.
    """
    folder = tmp_path_factory.mktemp("mounted")
    inner = create_app(ServiceSettings(catalogues=folder / "none", data=folder, workers=1, keys="required"))
    outer = Starlette(routes=[Mount("/plant", inner)], lifespan=lambda _: inner.router.lifespan_context(inner))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(signin, "FAILURES_PER_S", 0.001)
        with running(outer) as address:
            token = inner.state.keys.create("test", frozenset({Scope.READ}), timedelta(days=1))[1]
            yield f"{address}/plant", {"Authorization": f"Bearer {token}"}


def test_keys_that_do_not_hold_are_taken_ever_more_slowly_of_an_address(mounted: tuple[str, dict[str, str]]) -> None:
    address, reader = mounted
    key = reader["Authorization"].removeprefix("Bearer ")

    def enter(key: str, source: str) -> httpx.Response:
        with httpx.Client(transport=httpx.HTTPTransport(local_address=source), timeout=300) as sender:
            return sender.post(f"{address}/sign-in", data={"key": key})

    wrong = [enter("wrong", "127.0.0.3").status_code for _ in range(signin.FAILURES + 1)]
    assert wrong == [401] * signin.FAILURES + [429]
    refused = enter(key, "127.0.0.3")
    assert refused.status_code == 429
    assert 900 < int(refused.headers["retry-after"]) <= 1000
    assert "too many keys that do not hold" in refused.text
    assert enter(key, "127.0.0.4").status_code == 303


def test_a_form_to_sign_in_is_small(mounted: tuple[str, dict[str, str]]) -> None:
    address, _ = mounted
    refused = httpx.post(f"{address}/sign-in", data={"key": "x" * 4000}, timeout=300)
    assert (refused.status_code, refused.json()["detail"]) == (
        413,
        "the request body is larger than 0.004 MB, the limit of this service",
    )


@pytest.mark.parametrize(
    ("path", "alone", "reading"),
    [
        ("/api/v1/machines", 401, 200),
        ("/api/v1/webhooks", 401, 403),
        ("/api/v1/%77ebhooks", 401, 403),
        ("/api/v1/../v1/webhooks", 401, 403),
        # What stands in the address is not what is routed: as a text without its tab it would be open to all.
        ("/%09openapi.json", 401, 404),
        ("/stat%09ic/page.css", 401, 404),
        ("/%3Fopenapi.json", 401, 404),
        ("//static/page.css", 401, 404),
        ("/plant/openapi.json", 401, 404),
        ("/openapi.json", 200, 200),
        ("/%6fpenapi.json", 200, 200),
    ],
)
def test_the_path_that_is_routed_is_the_path_that_is_judged(
    mounted: tuple[str, dict[str, str]], path: str, alone: int, reading: int
) -> None:
    address, reader = mounted
    assert httpx.get(address + path, timeout=300).status_code == alone
    assert httpx.get(address + path, headers=reader, timeout=300).status_code == reading


def test_a_recording_may_be_larger_than_other_bodies_below_a_mount_too(tmp_path: Path) -> None:
    inner = create_app(ServiceSettings(catalogues=tmp_path / "none", data=tmp_path, workers=1, keys="off"))
    outer = Starlette(routes=[Mount("/plant", inner)], lifespan=lambda _: inner.router.lifespan_context(inner))
    body = b'{"channels": "' + b"x" * JSON_BYTES + b'"}'
    with running(outer) as address:
        for path, status in (("measurements", 422), ("webhooks", 413)):
            sent = httpx.post(
                f"{address}/plant{API}/{path}", content=body, headers={"Content-Type": "application/json"}, timeout=300
            )
            assert sent.status_code == status


def test_pages_of_other_sites_send_nothing_here(client: httpx.Client) -> None:
    send = {"json": {"measurement": "x", "catalogue": "x"}}
    for headers in ({"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"}, {"Origin": "http://x.example"}):
        assert client.post(f"{API}/diagnoses", headers=headers, **send).status_code == 403  # type: ignore[arg-type]
    assert client.post(f"{API}/diagnoses", headers={"Sec-Fetch-Site": "same-origin"}, **send).status_code == 404  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("host", "alone"),
    [("127.0.0.1", True), ("127.1.2.3", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("::", False)],
)
def test_loopback(host: str, alone: bool) -> None:
    assert loopback(host) is alone


def test_the_address_listened_at_is_answered_to(tmp_path: Path) -> None:
    settings = ServiceSettings(data=tmp_path, hosts="Jointplay.example")
    assert answering(settings, "192.0.2.7").allowed_hosts == {"jointplay.example", "192.0.2.7"}
    assert answering(settings, "0.0.0.0") is settings
