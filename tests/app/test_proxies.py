"""What is believed of a proxy that is trusted, and of nobody else."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from command_line import invoke
from http_answers import line_of
from small_service import running

from jointplay.app.errors import BadFieldError
from jointplay.app.main import create_app
from jointplay.app.scopes import API, Scope, parse_people
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.keys import Keys

PROXY, STRANGER = "127.0.0.2", "127.0.0.3"
ADDRESSES = itertools.count(1)


@pytest.fixture(scope="module")
def behind(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Keys]]:
    """A service that trusts one address and a network, and its keys; three requests of an address, then no more."""
    folder = tmp_path_factory.mktemp("behind")
    settings = ServiceSettings(
        catalogues=folder / "none",
        data=folder,
        workers=1,
        keys="required",
        hosts="127.0.0.1,localhost,press.example",
        proxies=f"{PROXY}, 10.7.0.0/16",
        people="*=read; fitters=match read; chiefs=admin",
        rate_limit_per_s=0.001,
        rate_burst=3,
    )
    application = create_app(settings)
    with running(application) as address:
        yield address, application.state.keys


def ask(service: str, source: str, headers: Any = None, path: str = f"{API}/machines", **sent: Any) -> httpx.Response:
    """Send a request from an address of this computer."""
    with httpx.Client(transport=httpx.HTTPTransport(local_address=source), timeout=300) as client:
        return client.request(sent.pop("method", "GET"), service + path, headers=headers, **sent)


@pytest.mark.parametrize(
    ("source", "forwarded", "address"),
    [
        (STRANGER, {"X-Forwarded-For": "192.0.2.1"}, STRANGER),
        (PROXY, {}, PROXY),
        (PROXY, {"X-Forwarded-For": "192.0.2.1"}, "192.0.2.1"),
        (PROXY, {"X-Forwarded-For": "2001:db8::7"}, "2001:db8::7"),
        # What stands before the last address that is no proxy's is the client's own invention.
        (PROXY, {"X-Forwarded-For": "192.0.2.9, 192.0.2.2, 10.7.1.1"}, "192.0.2.2"),
        (PROXY, {"X-Forwarded-For": "what a client says"}, PROXY),
        (PROXY, {"X-Forwarded-For": ""}, PROXY),
        (PROXY, {"Forwarded": "for=192.0.2.1", "X-Real-IP": "192.0.2.1"}, PROXY),
    ],
)
def test_whose_request_it_is(
    behind: tuple[str, Keys],
    source: str,
    forwarded: dict[str, str],
    address: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    path = f"/static/{next(ADDRESSES)}"
    with caplog.at_level(logging.INFO, "jointplay.app.http.middleware"):
        ask(behind[0], source, forwarded, path)
        assert line_of(caplog, path)["address"] == address


def test_the_scheme_of_the_outside(behind: tuple[str, Keys]) -> None:
    service, keys = behind
    token = keys.create("test", frozenset({Scope.READ}), timedelta(days=1))[1]
    for number, (source, host, secure, kept) in enumerate(
        (
            (PROXY, "press.example", True, "max-age=31536000"),
            (PROXY, "localhost:8443", True, None),  # a name of every other service of the computer
            ("127.0.0.6", "press.example", False, None),
        )
    ):
        forwarded = {"X-Forwarded-Proto": "https", "X-Forwarded-For": f"192.0.2.{21 + number}", "Host": host}
        answer = ask(service, source, forwarded, "/sign-in", method="POST", data={"key": token})
        assert ("; Secure" in answer.headers["set-cookie"]) is secure
        assert answer.headers.get("strict-transport-security") == kept


def test_each_client_behind_a_proxy_has_a_limit_of_its_own(behind: tuple[str, Keys]) -> None:
    def statuses(source: str, clients: list[str]) -> list[int]:
        return [ask(behind[0], source, {"X-Forwarded-For": client}).status_code for client in clients]

    assert statuses(PROXY, ["192.0.2.31"] * 4) == [401, 401, 401, 429]
    assert statuses(PROXY, [f"192.0.2.{number}" for number in range(41, 45)]) == [401] * 4
    # One that is not trusted does not get around it by inventing addresses.
    assert statuses("127.0.0.4", [f"192.0.2.{number}" for number in range(51, 55)]) == [401, 401, 401, 429]


def person(name: str, groups: str | None = None) -> list[tuple[str, str]]:
    """Headers of somebody who signed in, each time at an address of its own."""
    given = [("X-Forwarded-User", name), ("X-Forwarded-For", f"198.51.100.{next(ADDRESSES)}")]
    return given + ([] if groups is None else [("X-Forwarded-Groups", groups)])


def test_a_person_may_what_their_groups_may(behind: tuple[str, Keys], caplog: pytest.LogCaptureFixture) -> None:
    service, _ = behind

    def status(path: str, name: str, groups: str | None, **sent: Any) -> int:
        origin = [("Origin", service)] if sent else []
        return ask(service, PROXY, [*person(name, groups), *origin], path, **sent).status_code

    path = f"{API}/machines/{next(ADDRESSES)}"
    with caplog.at_level(logging.INFO, "jointplay.app.http.middleware"):
        assert status(path, "anna", None) == 404
        line = line_of(caplog, path)
    assert (line["person"], line["key"]) == ("anna", None)
    assert status(f"{API}/diagnoses", "bert", "office", method="POST", json={}) == 403
    assert status(f"{API}/diagnoses", "cora", "office, fitters", method="POST", json={}) == 422
    assert status(f"{API}/keys", "dora", "fitters") == 403
    assert status(f"{API}/keys", "emil", "chiefs") == 200
    assert status(f"{API}/keys", "fred", "*") == 403
    assert ask(service, "127.0.0.5", person("anna", "chiefs")).status_code == 401
    assert ask(service, PROXY, person("")).status_code == 401


def test_what_a_person_does_bears_their_name(behind: tuple[str, Keys]) -> None:
    service, _ = behind
    headers = [*person("karl", "fitters"), ("Origin", service)]
    place, asset = f"{API}/assets/press-8", {"machine": "slider-crank"}
    assert ask(service, PROXY, headers, place, method="PUT", json=asset).json()["made_by"] == "karl"
    chief = [*person("lena", "chiefs"), ("Origin", service)]
    assert ask(service, PROXY, chief, f"{place}?why=sold", method="DELETE").status_code == 204
    assert "by lena: sold" in ask(service, PROXY, person("karl"), place).json()["detail"]
    noted = ask(service, PROXY, chief, f"{API}/audit?kind=asset&object=press-8").json()["items"]
    assert [(each["person"], each["key"]) for each in noted] == [("lena", None), ("karl", None)]


def test_a_person_hands_out_no_more_than_they_have(behind: tuple[str, Keys]) -> None:
    service, _ = behind
    headers = [*person("gina", "chiefs"), ("Origin", service)]
    for scopes, status in ((["admin"], 201), (["build"], 403)):
        body = {"name": "x", "scopes": scopes}
        assert ask(service, PROXY, headers, f"{API}/keys", method="POST", json=body).status_code == status


@pytest.mark.parametrize(
    "headers",
    [
        [("X-Forwarded-User", "anna"), ("X-Forwarded-User", "chief")],
        [("X-Forwarded-User", "anna"), ("X-Forwarded-Groups", "office"), ("X-Forwarded-Groups", "chiefs")],
        [("X-Forwarded-User", "a" * 129)],
        [("X-Forwarded-User", "an\tna")],
        [("X-Forwarded-User", "{http.auth.user.id}")],
    ],
)
def test_names_that_clients_may_have_sent_along_are_refused(
    behind: tuple[str, Keys], headers: list[tuple[str, str]]
) -> None:
    service, _ = behind
    answer = ask(service, PROXY, [*headers, ("X-Forwarded-For", f"198.51.100.{next(ADDRESSES)}")])
    assert answer.status_code == 401
    assert answer.json()["detail"].startswith("X-Forwarded-")


def test_pages_of_other_sites_use_nobody_who_signed_in(behind: tuple[str, Keys]) -> None:
    service, _ = behind
    for headers in ([], [("Origin", "https://evil.example")], [("Sec-Fetch-Site", "cross-site")]):
        given = [*person("hans", "fitters"), *headers]
        assert ask(service, PROXY, given, f"{API}/diagnoses", method="POST", json={}).status_code == 403


def test_a_key_that_is_sent_counts_before_the_person(behind: tuple[str, Keys]) -> None:
    service, keys = behind
    key, token = keys.create("builder", frozenset({Scope.BUILD}), timedelta(days=1))
    headers = [*person("inge", "chiefs"), ("X-API-Key", token)]
    assert ask(service, PROXY, headers).status_code == 403
    keys.revoke(key.id)
    assert ask(service, PROXY, headers).status_code == 401


def test_a_person_needs_no_form_to_sign_in(behind: tuple[str, Keys]) -> None:
    service, _ = behind
    page = ask(service, PROXY, [*person("jutta"), ("Accept", "text/html")], "/machines")
    assert "Signed in as jutta" in page.text
    answer = ask(service, PROXY, person("jutta"), "/sign-in?next=/machines")
    assert (answer.status_code, answer.headers["location"]) == (303, "/machines")


def test_people_are_said_by_group() -> None:
    assert parse_people(" *=read ; cn=fitters=match  read;") == {
        "*": {Scope.READ},
        "cn=fitters": {Scope.MATCH, Scope.READ},
    }
    assert parse_people("") == {}


@pytest.mark.parametrize("given", ["read", "=read", "*=", "*=root", "*=read; *=match", "*=read,match"])
def test_people_who_cannot_be(given: str, tmp_path: Path) -> None:
    with pytest.raises(BadFieldError, match=r"JOINTPLAY_PEOPLE: .*must be a group"):
        create_app(ServiceSettings(data=tmp_path, proxies=PROXY, people=given))


@pytest.mark.parametrize(
    ("name", "given", "text"),
    [
        ("PROXIES", "*", "JOINTPLAY_PROXIES: "),
        ("PROXIES", "proxy.example", "JOINTPLAY_PROXIES: "),
        ("PROXIES", "10.0.0.1/8", "has host bits set"),
        ("PEOPLE", "*=read", "JOINTPLAY_PROXIES must name its address"),
    ],
)
def test_settings_that_are_refused(
    name: str, given: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(f"JOINTPLAY_{name}", given)
    result = invoke("serve", "--port", "0", "--data", str(tmp_path))
    assert result.exit_code == 2 and text in result.stderr


def test_forwarded_headers_are_ignored_where_no_proxy_is_named(tmp_path: Path) -> None:
    settings = ServiceSettings(data=tmp_path, catalogues=tmp_path, workers=1, keys="required")
    with running(create_app(settings)) as service:
        answer = ask(service, "127.0.0.1", [*person("anna"), ("X-Forwarded-Proto", "https")])
    assert answer.status_code == 401
    assert "strict-transport-security" not in answer.headers
