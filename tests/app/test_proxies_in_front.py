"""The service behind Caddy and nginx, as the files of docker/proxy set them up."""

from __future__ import annotations

import logging
import socket
import ssl
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import httpx
import pytest
from http_answers import line_of
from proxy_processes import FOLDER, caddy, certificates, nginx, oauth2_proxy, program
from small_service import running

from jointplay.app.main import create_app
from jointplay.app.scopes import API, Scope
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.build_queue import BuildQueue

CLIENT = "127.0.0.9"
MADE_UP = [
    ("X-Forwarded-For", "192.0.2.66"),
    ("X-Forwarded-Proto", "http"),
    ("X-Forwarded-User", "chief"),
    ("X-Forwarded-Groups", "chiefs"),
]
WAYS = ("keys", "basic", "oauth2", "nginx")


@dataclass(frozen=True)
class Front:
    """A service with all proxies before it.

    Parameters
    ----------
    places : dict of str to str
        Address by the way to sign in; that of nginx, and its plain one.
    trust : ssl.SSLContext
    token : str
        A key for reading.
    build : str
        Id of a build that nobody begins.
    """

    places: dict[str, str]
    trust: ssl.SSLContext
    token: str
    build: str

    def client(self) -> httpx.Client:
        """A client at an address that is none of a proxy."""
        return httpx.Client(transport=httpx.HTTPTransport(verify=self.trust, local_address=CLIENT), timeout=300)

    def ask(self, way: str, path: str, headers: Any = (), method: str = "GET", **sent: Any) -> httpx.Response:
        """Send a request."""
        with self.client() as client:
            return client.request(method, self.places[way] + path, headers=list(headers), **sent)


@pytest.fixture(scope="module")
def front(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Front]:
    folder = tmp_path_factory.mktemp("front")
    found = program("caddy")
    made = [found, "hash-password", "--plaintext", "bush and pin"]
    hashed = subprocess.run(made, capture_output=True, text=True, check=True).stdout.strip()
    certificate, key, authority = certificates(folder)
    settings = ServiceSettings(
        catalogues=folder / "none",
        data=folder / "data",
        workers=1,
        keys="required",
        proxies="127.0.0.1",
        people="*=read; fitters=match",
        builds=0,
    )
    people = {
        "anna": {"X-Auth-Request-User": "anna", "X-Auth-Request-Groups": "office,fitters"},
        "bert": {"X-Auth-Request-User": "bert"},
        "nobody": {},
    }
    application = create_app(settings)
    tls = (certificate, key)
    (folder / "caddy").mkdir()
    (folder / "nginx").mkdir()
    with (
        running(application) as service,
        oauth2_proxy(people) as oauth2,
        caddy(service, folder / "caddy", f"anna {hashed}\n", oauth2, tls) as by_way,
        nginx(service, folder / "nginx", tls) as (secure, plain),
    ):
        token = application.state.keys.create("test", frozenset({Scope.READ}), timedelta(days=1))[1]
        queue = BuildQueue(application.state.service.store.database)
        build = queue.add({"name": "m"}, {"name": "p"}, "h" * 64, "c", None).id
        trust = ssl.create_default_context(cafile=str(authority))
        yield Front({**by_way, "nginx": secure, "plain": plain}, trust, token, build)


@pytest.mark.parametrize("way", WAYS)
def test_a_program_with_a_key(front: Front, way: str, caplog: pytest.LogCaptureFixture) -> None:
    path = f"{API}/machines/for-{way}"
    with caplog.at_level(logging.INFO, "jointplay.app.http.middleware"):
        answer = front.ask(way, path, [("Authorization", f"Bearer {front.token}"), *MADE_UP])
        line = line_of(caplog, path)
    assert answer.status_code == 404
    assert (line["address"], line["person"]) == (CLIENT, None)
    assert line["key"] == front.token.split("_")[1]
    assert front.ask(way, f"{API}/keys", [("X-API-Key", front.token), *MADE_UP]).status_code == 403


@pytest.mark.parametrize("way", ["keys", "nginx"])
def test_a_browser_with_a_key_signs_in(front: Front, way: str) -> None:
    place = front.places[way]
    sent = [("Origin", place), *MADE_UP]
    entered = front.ask(way, "/sign-in", sent, "POST", data={"key": front.token, "next": "/machines"})
    assert (entered.status_code, entered.headers["location"]) == (303, "/machines")
    cookie = entered.headers["set-cookie"]
    assert "; Secure" in cookie and "HttpOnly" in cookie
    session = [("Cookie", cookie.partition(";")[0]), ("Accept", "text/html")]
    assert "Sign out" in front.ask(way, "/machines", session).text
    assert front.ask(way, "/sign-out", [*session, ("Origin", place)], "POST").status_code == 303
    assert front.ask(way, "/machines", session).headers["location"] == "/sign-in?next=%2Fmachines"
    assert front.ask(way, f"{API}/machines", MADE_UP).status_code == 401


def test_a_person_with_a_password(front: Front, caplog: pytest.LogCaptureFixture) -> None:
    path = f"{API}/machines/for-anna"
    with caplog.at_level(logging.INFO, "jointplay.app.http.middleware"):
        answer = front.ask("basic", path, MADE_UP, auth=("anna", "bush and pin"))
        line = line_of(caplog, path)
    assert answer.status_code == 404
    assert (line["address"], line["key"], line["person"]) == (CLIENT, None, "anna")
    assert "Signed in as anna" in front.ask("basic", "/machines", auth=("anna", "bush and pin")).text
    for refused in (("anna", "bush"), ("chief", "bush and pin")):
        assert front.ask("basic", path, MADE_UP, auth=refused).status_code == 401
    assert front.ask("basic", path, MADE_UP).status_code == 401


def test_a_person_known_to_oauth2_proxy(front: Front, caplog: pytest.LogCaptureFixture) -> None:
    def status(who: str, method: str = "GET", path: str = f"{API}/machines", **sent: Any) -> int:
        headers = [("Cookie", f"_oauth2_proxy={who}"), ("Origin", front.places["oauth2"]), *MADE_UP]
        return front.ask("oauth2", path, headers, method, **sent).status_code

    path = f"{API}/machines/for-bert"
    with caplog.at_level(logging.INFO, "jointplay.app.http.middleware"):
        assert status("bert", path=path) == 404
        assert line_of(caplog, path)["person"] == "bert"
    assert status("bert", "POST", f"{API}/diagnoses", json={}) == 403  # of no group, whatever is sent along
    assert status("anna", "POST", f"{API}/diagnoses", json={}) == 422
    assert status("nobody") == 401
    away = front.ask("oauth2", "/machines", MADE_UP)
    assert away.status_code == 302
    assert away.headers["location"].startswith("/oauth2/sign_in?rd=https://localhost")


@pytest.mark.parametrize("way", ["keys", "nginx"])
def test_events_come_when_they_happen(front: Front, way: str) -> None:
    place = f"{front.places[way]}{API}/builds/{front.build}/events"
    with front.client() as client, client.stream("GET", place, headers={"X-API-Key": front.token}) as answer:
        assert answer.status_code == 200
        first = next(line for line in answer.iter_lines() if line.startswith("data: "))
    assert '"queued"' in first


def test_browsers_are_told_to_keep_to_tls(front: Front) -> None:
    answer = front.ask("nginx", "/healthz", [("Host", "jointplay.example")])
    assert answer.headers["strict-transport-security"] == "max-age=31536000"
    assert "strict-transport-security" not in front.ask("nginx", "/healthz").headers  # of localhost


def test_plain_http_leads_to_tls(front: Front) -> None:
    answer = front.ask("plain", "/machines?a=b")
    assert (answer.status_code, answer.headers["location"]) == (308, "https://localhost/machines?a=b")


@pytest.mark.long
def test_headers_that_do_not_come_are_not_waited_for(front: Front) -> None:
    """Ten seconds by both files, and both at once."""
    with ExitStack() as opened:
        for way in ("keys", "nginx"):
            url = httpx.URL(front.places[way])
            plain = opened.enter_context(socket.create_connection((url.host, url.port or 0), 300))
            secure = opened.enter_context(front.trust.wrap_socket(plain, server_hostname="localhost"))
            secure.sendall(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: ")
            opened.callback(ended, secure)


def ended(connection: ssl.SSLSocket) -> None:
    """Wait until the other side has closed a connection; whoever never does fails by the clock."""
    while connection.recv(4096):
        pass


def test_the_files_name_what_the_others_do() -> None:
    text = (FOLDER / "Caddyfile").read_text(encoding="utf-8")
    compose = (FOLDER.parent / "compose.yaml").read_text(encoding="utf-8")
    readme = (FOLDER.parent / "README.md").read_text(encoding="utf-8")
    for name in ("JOINTPLAY_SITE", "JOINTPLAY_TLS", "JOINTPLAY_SIGN_IN"):
        assert name in text and name in compose and name in readme, name
