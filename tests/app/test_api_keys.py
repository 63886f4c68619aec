"""Keys: what they open, what they do not, and that their secrets are nowhere but with their owners."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Iterator
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import httpx
import pytest
from cachetools import TTLCache
from command_line import invoke
from small_service import serving
from sqlalchemy import event
from sqlalchemy.exc import OperationalError

from jointplay.app.errors import KeyRevokedError, UnauthorizedError, UnknownKeyError
from jointplay.app.jobs.key_uses import store_uses
from jointplay.app.scopes import Scope, scope_of
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.rows import now
from jointplay.app.storage.store import Store

API = "/api/v1"
# Whatever else the computer does.
get, post, ask = (partial(each, timeout=300) for each in (httpx.get, httpx.post, httpx.request))


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
        ("GET", "/api/v1/keys", Scope.ADMIN),
        ("POST", "/api/v1/keys/7/rotate", Scope.ADMIN),
        ("POST", "/diagnose", Scope.MATCH),
        ("GET", "/", Scope.READ),
        ("GET", "/metrics", Scope.READ),
        ("GET", "/nowhere", Scope.READ),
        ("GET", "/static/page.css", None),
        ("GET", "/healthz", None),
        ("GET", "/healthz/x", Scope.READ),
        ("DELETE", f"{API}/assets/press-7/acknowledgement", Scope.MATCH),
        # Things that are called like it.
        ("DELETE", f"{API}/catalogues/acknowledgement", Scope.ADMIN),
        ("DELETE", f"{API}/assets/acknowledgement", Scope.ADMIN),
        ("PUT", f"{API}/measurements/0a/retention", Scope.ADMIN),
        ("PUT", f"{API}/assets/retention", Scope.MATCH),
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


def test_a_new_secret_leaves_the_old_one_a_while(keys: Keys) -> None:
    first = make(keys, Scope.READ, days=100)
    key = keys.find(first)
    session = keys.open_session(key)
    renewed, second, until = keys.rotate(key.id, timedelta(hours=24), timedelta(days=30))
    assert (renewed.id, renewed.scopes, renewed.name) == (key.id, key.scopes, key.name)
    assert renewed.expires_at < key.expires_at
    assert timedelta(hours=23) < until - now() <= timedelta(hours=24)
    assert {keys.find(token).id for token in (first, second)} == {keys.of_session(session).id} == {key.id}
    assert (keys.find(first).expires_at, keys.find(second).expires_at) == (until, renewed.expires_at)
    _, third, _ = keys.rotate(key.id, timedelta(0), timedelta(days=30))
    for token in (first, second):  # all that were before
        with pytest.raises(UnauthorizedError, match="not known"):
            keys.find(token)
    with pytest.raises(UnauthorizedError, match="session is over"):
        keys.of_session(session)
    assert keys.find(third).id == key.id
    keys.rotate(key.id, timedelta(hours=24), timedelta(days=30))
    keys.revoke(key.id)
    with pytest.raises(UnauthorizedError):
        keys.find(third)
    with pytest.raises(KeyRevokedError, match="was revoked"):
        keys.rotate(key.id, timedelta(0), timedelta(days=1))
    with pytest.raises(UnknownKeyError):
        keys.rotate("nobody", timedelta(0), timedelta(days=1))


def test_a_session_ends_with_the_secret_that_opened_it(keys: Keys) -> None:
    first = make(keys, Scope.READ, days=100)
    _, second, _ = keys.rotate(keys.find(first).id, timedelta(hours=1), timedelta(days=30))
    sessions = [keys.open_session(keys.find(token)) for token in (first, second)]
    with mock.patch("jointplay.app.storage.keys.now", return_value=now() + timedelta(hours=2)):
        with pytest.raises(UnauthorizedError, match="session is over"):
            keys.of_session(sessions[0])
        assert keys.of_session(sessions[1]).scopes == {Scope.READ}


def test_a_key_that_was_renewed_while_it_was_looked_at_opens_no_session(keys: Keys) -> None:
    first = make(keys, Scope.READ, days=100)
    found = keys.find(first)
    _, second, _ = keys.rotate(found.id, timedelta(0), timedelta(days=30))
    with pytest.raises(UnauthorizedError, match="another secret"):
        keys.open_session(found)
    found = keys.find(second)
    keys.revoke(found.id)
    with pytest.raises(UnauthorizedError, match="was revoked"):
        keys.open_session(found)


def test_refusals_are_counted_by_one_thread_at_a_time(keys: Keys) -> None:
    class Guarded(TTLCache[str, bool]):
        def __contains__(self, address: object) -> bool:
            assert keys._lock.locked()
            return super().__contains__(address)

        def __setitem__(self, address: str, known: bool, *more: Any) -> None:
            assert keys._lock.locked()
            super().__setitem__(address, known, *more)

    keys._refused = Guarded(10, 60.0)
    keys.note_refusal("192.0.2.9")
    assert list(keys._refused) == ["192.0.2.9"]


def test_a_secret_that_has_expired_is_not_revived_by_a_new_one(keys: Keys) -> None:
    first = make(keys, Scope.READ, days=-1)
    (key,) = keys.all()
    _, second, until = keys.rotate(key.id, timedelta(hours=24), timedelta(days=30))
    assert until == key.expires_at < now()
    assert keys.find(second).state == "valid"
    with pytest.raises(UnauthorizedError, match="not known"):
        keys.find(first)


def test_a_former_secret_is_of_its_own_key_alone(keys: Keys) -> None:
    first, other = make(keys, Scope.READ), make(keys, Scope.ADMIN)
    keys.rotate(keys.find(first).id, timedelta(hours=1), timedelta(days=1))
    with pytest.raises(UnauthorizedError):
        keys.find("_".join([*other.split("_")[:2], first.split("_", 2)[2]]))


def test_last_uses_are_written_once_for_many(url: str, tmp_path: Path) -> None:
    store = Store(tmp_path, url)
    here, there = Keys(store.database), Keys(store.database)
    token = make(here, Scope.READ)
    assert [key.used_at for key in here.all()] == [None]
    statements: list[str] = []
    event.listen(store.database.engine, "before_cursor_execute", lambda *each: statements.append(each[2]))
    for _ in range(5):
        used = here.find(token)
    assert not any("api_key_uses" in each for each in statements)
    first = here.key(used.id).used_at
    assert first is not None and there.key(used.id).used_at is None
    here.write_uses()
    here.write_uses()
    assert sum("INSERT INTO api_key_uses" in each for each in statements) == 1
    assert there.key(used.id).used_at == first
    there.find(token)
    there.write_uses()
    last = here.key(used.id).used_at
    assert last is not None and last > first
    # A server that was slow to write takes nothing back.
    here._used = {used.id: first}
    here.write_uses()
    assert there.key(used.id).used_at == last
    store.close()


def test_a_use_that_cannot_be_written_is_written_later(keys: Keys, caplog: pytest.LogCaptureFixture) -> None:
    token = make(keys, Scope.READ)
    used = keys.find(token)
    with mock.patch.object(ServiceDatabase, "writing", side_effect=OperationalError("x", {}, OSError("locked"))):
        asyncio.run(store_uses(keys))
    assert "wait for the database: OperationalError" in caplog.text
    asyncio.run(store_uses(keys))
    assert Keys(keys._database).key(used.id).used_at == keys.key(used.id).used_at is not None


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
        refused = get(address + path)
        assert refused.status_code == 401, path
        assert refused.headers["content-type"] == "application/problem+json"
        assert refused.headers["www-authenticate"] == 'Bearer realm="jointplay"'
        assert refused.headers["x-content-type-options"] == "nosniff"
    for path in ("/healthz", "/openapi.json", "/static/page.css"):
        assert get(address + path).status_code == 200, path


def test_a_key_opens_what_its_scopes_say(guarded: tuple[str, Keys]) -> None:
    address, keys = guarded
    reader = {"Authorization": f"Bearer {make(keys, Scope.READ)}"}
    assert get(f"{address}{API}/machines", headers=reader).status_code == 200
    assert get(f"{address}{API}/machines", headers={"X-API-Key": make(keys, Scope.READ)}).status_code == 200
    refused = post(f"{address}{API}/diagnoses", headers=reader, json={})
    assert refused.status_code == 403
    assert 'error="insufficient_scope", scope="match"' in refused.headers["www-authenticate"]
    assert "match" in refused.json()["detail"]
    matcher = {"Authorization": f"Bearer {make(keys, Scope.MATCH)}"}
    assert post(f"{address}{API}/diagnoses", headers=matcher, json={}).status_code == 422
    assert get(f"{address}{API}/machines", headers=matcher).status_code == 403


def test_keys_over_the_interface(guarded: tuple[str, Keys]) -> None:
    address, keys = guarded
    admin = {"Authorization": f"Bearer {make(keys, Scope.ADMIN, Scope.READ)}"}
    place = f"{address}{API}/keys"
    made = post(place, headers=admin, json={"name": "historian", "scopes": ["read"], "days": 90})
    assert made.status_code == 201
    document = made.json()
    token = document.pop("key")
    assert made.headers["location"] == f"{API}/keys/{document['id']}"
    assert (document["state"], document["used_at"], document["scopes"]) == ("valid", None, ["read"])
    reader = {"Authorization": f"Bearer {token}"}
    assert get(f"{address}{API}/machines", headers=reader).status_code == 200
    shown = get(f"{place}/{document['id']}", headers=admin)
    assert shown.json() == {**document, "used_at": shown.json()["used_at"]} and shown.json()["used_at"] is not None
    newest = get(place, headers=admin, params={"limit": 1}).json()
    assert [each["id"] for each in newest["items"]] == [document["id"]]
    rest = get(place, headers=admin, params={"cursor": newest["next_cursor"], "limit": 500}).json()
    assert len(rest["items"]) == len(keys.all()) - 1 and rest["next_cursor"] is None
    assert token.split("_", 2)[2] not in shown.text + json.dumps(rest) + json.dumps(newest)
    rotated = post(f"{place}/{document['id']}/rotate", headers=admin, json={"grace_hours": 1})
    assert rotated.status_code == 200
    renewed = {"Authorization": f"Bearer {rotated.json()['key']}"}
    for headers in (reader, renewed):
        assert get(f"{address}{API}/machines", headers=headers).status_code == 200
    assert post(f"{place}/{document['id']}/revoke", headers=admin).json()["state"] == "revoked"
    for headers in (reader, renewed):
        assert get(f"{address}{API}/machines", headers=headers).status_code == 401
    gone = post(f"{place}/{document['id']}/rotate", headers=admin, json={})
    assert (gone.status_code, gone.json()["type"]) == (409, "urn:jointplay:problem:key-revoked")
    assert get(f"{place}/unknown", headers=admin).status_code == 404
    assert get(place, headers=renewed).status_code == 401


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"name": "", "scopes": ["read"]}, "name"),
        ({"name": "a\x00b", "scopes": ["read"]}, "name"),
        ({"name": "x", "scopes": []}, "scopes"),
        ({"name": "x", "scopes": ["root"]}, "scopes.0"),
        ({"name": "x", "scopes": ["read"], "days": 0}, "days"),
        ({"name": "x", "scopes": ["read"], "days": 3651}, "days"),
    ],
)
def test_keys_that_cannot_be(guarded: tuple[str, Keys], body: dict[str, object], field: str) -> None:
    address, keys = guarded
    admin = {"Authorization": f"Bearer {make(keys, Scope.ADMIN, Scope.READ)}"}
    refused = post(f"{address}{API}/keys", headers=admin, json=body)
    assert (refused.status_code, refused.json()["errors"][0]["field"]) == (422, field)


def test_nobody_hands_out_more_than_they_have(guarded: tuple[str, Keys]) -> None:
    address, keys = guarded
    admin = {"Authorization": f"Bearer {make(keys, Scope.ADMIN)}"}
    other = keys.find(make(keys, Scope.MATCH))
    for path, body in (("", {"name": "x", "scopes": ["admin", "match"]}), (f"/{other.id}/rotate", {})):
        refused = post(f"{address}{API}/keys{path}", headers=admin, json=body)
        assert refused.status_code == 403
        assert refused.json()["detail"].startswith("scopes: match: ")
    assert post(f"{address}{API}/keys/{other.id}/revoke", headers=admin).status_code == 200


def test_a_browser_signs_in_and_out(guarded: tuple[str, Keys]) -> None:
    address, keys = guarded
    token = make(keys, Scope.READ, Scope.MATCH)
    with httpx.Client(base_url=address, timeout=300, headers={"Accept": "text/html", "Origin": address}) as browser:
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
    refused = ask(method, address + path, headers={"Accept": "text/html", **sent})
    script = "HX-Request" in headers
    assert refused.status_code == (401 if script else 303)
    leads = httpx.URL(refused.headers["hx-redirect" if script else "location"])
    assert (leads.host, leads.path) == ("", "/sign-in")
    assert leads.params["next"] == (place or path)
    entered = post(f"{address}/sign-in", data={"key": make(keys, Scope.READ), "next": leads.params["next"]})
    assert entered.headers["location"] == (place or path)


@pytest.mark.parametrize("place", ["//evil.example", "https://evil.example", "/\\evil.example", "/\tx"])
def test_signing_in_leads_to_no_other_site(guarded: tuple[str, Keys], place: str) -> None:
    address, keys = guarded
    entered = post(f"{address}/sign-in", data={"key": make(keys, Scope.READ), "next": place})
    assert (entered.status_code, entered.headers["location"]) == (303, "/")


def test_secrets_are_not_logged(guarded: tuple[str, Keys], caplog: pytest.LogCaptureFixture) -> None:
    address, keys = guarded
    token = make(keys, Scope.READ)
    with caplog.at_level(logging.DEBUG):
        session = post(f"{address}/sign-in", data={"key": token}).cookies["jointplay_session"]
        get(f"{address}{API}/machines", headers={"X-API-Key": token})
        get(f"{address}{API}/machines", headers={"Authorization": f"Bearer {token}x"})
        get(address, cookies={"jointplay_session": session})
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
    assert listed[0]["used_at"] is None
    assert "never" in invoke("keys", "list", *data).stdout
    renewed = invoke("keys", "rotate", listed[0]["id"], "--grace-hours", "2", *data)
    assert renewed.stdout.strip() != token and renewed.stdout.startswith(f"jp_{listed[0]['id']}_")
    assert "the secret before it until" in renewed.stderr
    also = json.loads(invoke("keys", "rotate", listed[0]["id"], "--grace-hours", "0", "--json", *data).stdout)
    assert also["key"].startswith(f"jp_{listed[0]['id']}_") and also["former_until"] <= now().isoformat()
    assert invoke("keys", "revoke", listed[0]["id"], *data).stdout == ""
    assert "revoked" in invoke("keys", "list", *data).stdout
    refused = invoke("keys", "revoke", "nobody", *data)
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)


def test_without_keys_only_this_computer_may_ask(tmp_path: Path) -> None:
    refused = invoke("serve", "--no-keys", "--host", "0.0.0.0", "--port", "0", "--data", str(tmp_path))
    assert refused.exit_code == 1
    assert "without keys" in refused.stderr and refused.stderr.count("\n") == 1
