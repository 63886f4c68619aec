"""Keys: what they open, what they do not, and that their secrets are nowhere but with their owners."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
from command_line import invoke
from small_service import serving

from jointplay.app.errors import UnauthorizedError, UnknownKeyError
from jointplay.app.scopes import Scope, scope_of
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.store import Store

API = "/api/v1"


@pytest.fixture
def keys(tmp_path: Path) -> Iterator[Keys]:
    store = Store(tmp_path / "data")
    yield Keys(store.database)
    store.close()


def make(keys: Keys, *scopes: Scope, days: float = 1) -> str:
    return keys.create("test", frozenset(scopes), timedelta(days=days))[1]


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Keys]]:
    """Address of a service that asks for keys, and its keys; it has no catalogue."""
    folder = tmp_path_factory.mktemp("guarded")
    settings = ServiceSettings(catalogues=folder / "none", data=folder / "data", workers=1, keys="required")
    with serving(settings) as address:
        store = Store(settings.data)
        yield address, Keys(store.database)
        store.close()


@pytest.mark.parametrize(
    ("method", "path", "scope"),
    [
        ("GET", "/api/v1/machines", Scope.READ),
        ("PUT", "/api/v1/machines/my-press", Scope.BUILD),
        ("POST", "/api/v1/builds", Scope.BUILD),
        ("POST", "/api/v1/builds/7/cancel", Scope.BUILD),
        ("GET", "/api/v1/builds/7/events", Scope.READ),
        ("POST", "/api/v1/measurements", Scope.MATCH),
        ("POST", "/api/v1/diagnoses/7/finding", Scope.MATCH),
        ("PUT", "/api/v1/assets/press-7", Scope.MATCH),
        ("GET", "/api/v1/webhooks", Scope.ADMIN),
        ("GET", "/api/v1/audit", Scope.ADMIN),
        ("DELETE", "/api/v1/webhooks/7", Scope.ADMIN),
        ("POST", "/diagnose", Scope.MATCH),
        ("GET", "/", Scope.READ),
        ("GET", "/metrics", Scope.READ),
        ("GET", "/nowhere", Scope.READ),
        ("GET", "/static/page.css", None),
        ("GET", "/healthz", None),
        ("GET", "/healthz/x", Scope.READ),
    ],
)
def test_scope_of_an_address(method: str, path: str, scope: Scope | None) -> None:
    assert scope_of(method, path) is scope


def test_a_key_is_found_by_its_whole_token_alone(keys: Keys) -> None:
    token = make(keys, Scope.READ)
    assert keys.find(token).scopes == {Scope.READ}
    for wrong in (
        token[:-1],
        token + "x",
        token.swapcase(),
        "",
        "jp_",
        token.split("_", 2)[2],
        "jp_" + "0" * 12 + "_x",
    ):
        with pytest.raises(UnauthorizedError) as refusal:
            keys.find(wrong)
        assert len(wrong) < 5 or wrong not in str(refusal.value)


def test_an_expired_key_opens_nothing(keys: Keys) -> None:
    token = make(keys, Scope.READ, days=-1)
    with pytest.raises(UnauthorizedError, match="has expired"):
        keys.find(token)
    assert [key.state for key in keys.all()] == ["expired"]


def test_a_revoked_key_takes_its_sessions_along(keys: Keys) -> None:
    token = make(keys, Scope.READ)
    key = keys.find(token)
    session = keys.open_session(key)
    assert keys.of_session(session) == key
    assert keys.revoke(key.id).state == "revoked"
    with pytest.raises(UnauthorizedError, match="was revoked"):
        keys.find(token)
    with pytest.raises(UnauthorizedError, match="session is over"):
        keys.of_session(session)
    with pytest.raises(UnknownKeyError):
        keys.revoke("000000000000")


def test_secrets_are_not_in_the_database(keys: Keys, tmp_path: Path) -> None:
    token = make(keys, Scope.READ)
    session = keys.open_session(keys.find(token))
    stored = b"".join(path.read_bytes() for path in (tmp_path / "data").glob("service.sqlite*"))
    assert token.split("_")[1].encode() in stored
    assert token.split("_", 2)[2].encode() not in stored
    assert session.encode() not in stored


def test_without_a_key_nothing_is_told(guarded: tuple[str, Keys]) -> None:
    address, keys = guarded
    token = make(keys, Scope.READ)
    for path in (f"{API}/machines", f"{API}/diagnoses", "/metrics", "/nowhere", f"{API}/machines?key={token}"):
        refused = httpx.get(address + path)
        assert refused.status_code == 401, path
        assert refused.headers["content-type"] == "application/problem+json"
        assert refused.headers["www-authenticate"] == 'Bearer realm="jointplay"'
        assert refused.headers["x-content-type-options"] == "nosniff"
    for path in ("/healthz", "/openapi.json", "/static/page.css"):
        assert httpx.get(address + path).status_code == 200, path


def test_a_key_opens_what_its_scopes_say(guarded: tuple[str, Keys]) -> None:
    address, keys = guarded
    reader = {"Authorization": f"Bearer {make(keys, Scope.READ)}"}
    assert httpx.get(f"{address}{API}/machines", headers=reader).status_code == 200
    assert httpx.get(f"{address}{API}/machines", headers={"X-API-Key": make(keys, Scope.READ)}).status_code == 200
    refused = httpx.post(f"{address}{API}/diagnoses", headers=reader, json={})
    assert refused.status_code == 403
    assert 'error="insufficient_scope", scope="match"' in refused.headers["www-authenticate"]
    assert "match" in refused.json()["detail"]
    matcher = {"Authorization": f"Bearer {make(keys, Scope.MATCH)}"}
    assert httpx.post(f"{address}{API}/diagnoses", headers=matcher, json={}).status_code == 422
    assert httpx.get(f"{address}{API}/machines", headers=matcher).status_code == 403


def test_a_browser_signs_in_and_out(guarded: tuple[str, Keys]) -> None:
    address, keys = guarded
    token = make(keys, Scope.READ, Scope.MATCH)
    with httpx.Client(base_url=address, headers={"Accept": "text/html", "Origin": address}) as browser:
        sent = browser.get("/diagnoses/7")
        assert (sent.status_code, sent.headers["location"]) == (303, "/sign-in?next=%2Fdiagnoses%2F7")
        shown = browser.get(sent.headers["location"])
        assert 'name="next" value="/diagnoses/7"' in shown.text
        wrong = browser.post("/sign-in", data={"key": "<b>wrong", "next": "/"})
        assert wrong.status_code == 401
        assert "<b>" not in wrong.text and "not of the form" in wrong.text
        right = browser.post("/sign-in", data={"key": token, "next": "/"})
        assert (right.status_code, right.headers["location"]) == (303, "/")
        cookie = right.headers["set-cookie"]
        assert "HttpOnly" in cookie and "SameSite=strict" in cookie and token not in cookie
        assert "Sign out" in browser.get("/").text
        # A page of another site that posts with this cookie is refused, and so is one that hides where it is.
        for headers in ({"Origin": "https://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}):
            assert browser.post("/diagnose", data={"speed": ""}, headers=headers).status_code == 403
        assert browser.post("/diagnose", data={"speed": ""}).status_code == 422
        assert browser.post("/sign-out").headers["location"] == "/sign-in"
        assert browser.get("/").status_code == 303


@pytest.mark.parametrize(
    ("method", "path", "headers", "place"),
    [
        ("GET", "/confirm?measurement=a&catalogue=b%20c", {}, "/confirm?measurement=a&catalogue=b%20c"),
        ("GET", "//evil.example/x?y", {}, "/"),
        ("GET", "/a%3Fb%0Ac", {}, "/a%3Fb%0Ac"),
        ("GET", "/api/v1/diagnoses/7/report?format=pdf", {"Sec-Fetch-Mode": "navigate"}, None),
        ("POST", "/diagnose", {"Referer": "{address}/confirm?measurement=a"}, "/confirm?measurement=a"),
        ("POST", "/diagnose", {"Referer": "{address}//evil.example/"}, "/"),
        ("POST", "/diagnose", {"Referer": "https://evil.example/confirm"}, "/"),
        ("POST", "/diagnose", {"Referer": "http://[/confirm"}, "/"),
        ("POST", "/diagnose", {}, "/"),
        ("POST", "/diagnose", {"HX-Request": "true", "HX-Current-URL": "{address}/confirm?a=b"}, "/confirm?a=b"),
    ],
)
def test_signing_in_leads_back(
    guarded: tuple[str, Keys], method: str, path: str, headers: dict[str, str], place: str | None
) -> None:
    address, keys = guarded
    sent = {name: value.format(address=address) for name, value in headers.items()}
    refused = httpx.request(method, address + path, headers={"Accept": "text/html", **sent})
    script = "HX-Request" in headers
    assert refused.status_code == (401 if script else 303)
    leads = httpx.URL(refused.headers["hx-redirect" if script else "location"])
    assert (leads.host, leads.path) == ("", "/sign-in")
    assert leads.params["next"] == (place or path)
    entered = httpx.post(f"{address}/sign-in", data={"key": make(keys, Scope.READ), "next": leads.params["next"]})
    assert entered.headers["location"] == (place or path)


@pytest.mark.parametrize("place", ["//evil.example", "https://evil.example", "/\\evil.example", "/\tx"])
def test_signing_in_leads_to_no_other_site(guarded: tuple[str, Keys], place: str) -> None:
    address, keys = guarded
    entered = httpx.post(f"{address}/sign-in", data={"key": make(keys, Scope.READ), "next": place})
    assert (entered.status_code, entered.headers["location"]) == (303, "/")


def test_secrets_are_not_logged(guarded: tuple[str, Keys], caplog: pytest.LogCaptureFixture) -> None:
    address, keys = guarded
    token = make(keys, Scope.READ)
    with caplog.at_level(logging.DEBUG):
        session = httpx.post(f"{address}/sign-in", data={"key": token}).cookies["jointplay_session"]
        httpx.get(f"{address}{API}/machines", headers={"X-API-Key": token})
        httpx.get(f"{address}{API}/machines", headers={"Authorization": f"Bearer {token}x"})
        httpx.get(address, cookies={"jointplay_session": session})
    ours = [record.getMessage() for record in caplog.records if not record.name.startswith(("httpcore", "httpx"))]
    assert not any(token.split("_", 2)[2] in line or session in line for line in ours)


def test_keys_by_the_command(tmp_path: Path) -> None:
    data = ("--data", str(tmp_path / "data"))
    made = invoke("keys", "create", "historian", "--scope", "read", "--days", "30", *data)
    token = made.stdout.strip()
    assert token.startswith("jp_")
    listed = json.loads(invoke("keys", "list", "--json", *data).stdout)
    assert [(key["name"], key["scopes"], key["state"]) for key in listed] == [("historian", ["read"], "valid")]
    assert token.split("_", 2)[2] not in json.dumps(listed)
    assert invoke("keys", "revoke", listed[0]["id"], *data).stdout == ""
    assert "revoked" in invoke("keys", "list", *data).stdout
    refused = invoke("keys", "revoke", "nobody", *data)
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)


def test_without_keys_only_this_computer_may_ask(tmp_path: Path) -> None:
    refused = invoke("serve", "--no-keys", "--host", "0.0.0.0", "--port", "0", "--data", str(tmp_path))
    assert refused.exit_code == 1
    assert "without keys" in refused.stderr and refused.stderr.count("\n") == 1
