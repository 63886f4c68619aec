"""``Idempotency-Key``: done once, answered the same; other requests, failures, two at once."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import Context
from datetime import timedelta
from pathlib import Path
from time import sleep
from typing import Any

import httpx
import psutil
import pytest
from databases import KINDS, database
from service_process import ServiceProcess, client_of, service_process
from sqlalchemy import update
from sqlalchemy.exc import OperationalError
from starlette.requests import Request
from starlette.responses import Response

import jointplay.app.storage.idempotency
from jointplay.app.errors import KeyInUseError, KeyReusedError
from jointplay.app.storage.audit import AuditLog, note
from jointplay.app.storage.idempotency import KEPT, LEASE_S, Claim, Claims, IdempotencyRow, forget, once
from jointplay.app.storage.rows import now
from jointplay.app.storage.store import Store

API = "/api/v1"


class Work:
    """Something that is done; counts how often."""

    def __init__(self, status: int = 201) -> None:
        self.done = 0
        self.status = status

    async def __call__(self) -> Response:
        self.done += 1
        return Response(f"number {self.done}", self.status, {"Location": f"/things/{self.done}"})


def ask(store: Store, work: Any, content: object = "a", key: str | None = "k", client: str = "") -> Response:
    scope = {"type": "http", "method": "POST", "path": "/things", "headers": [], "state": {"key": client or None}}
    scope |= {"scheme": "http", "server": ("127.0.0.1", 80), "query_string": b""}
    return asyncio.run(once(Request(scope), key, store.claims, content, work))


def test_done_once_and_answered_the_same(store: Store) -> None:
    work = Work()
    first, again = ask(store, work), ask(store, work)
    assert work.done == 1
    assert (again.status_code, again.raw_headers, again.body) == (201, first.raw_headers, first.body)
    assert ask(store, work, key=None).body == b"number 2"
    assert ask(store, work, key="other").body == b"number 3"
    assert ask(store, work, client="another client").body == b"number 4"


def test_another_request_is_refused(store: Store) -> None:
    work = Work()
    ask(store, work, {"x": 1, "y": 2})
    assert ask(store, work, {"y": 2, "x": 1}).body == b"number 1"
    with pytest.raises(KeyReusedError):
        ask(store, work, {"x": 1})
    assert work.done == 1


def test_two_at_once(store: Store) -> None:
    inner = Work()

    async def outer() -> Response:
        with pytest.raises(KeyInUseError):
            await elsewhere(ask, store, inner)
        return Response("whole", 201)

    assert ask(store, outer).body == b"whole"
    assert inner.done == 0


def test_a_failure_frees_the_key(store: Store) -> None:
    async def fails() -> Response:
        raise RuntimeError

    with pytest.raises(RuntimeError):
        ask(store, fails)
    assert ask(store, Work(422)).status_code == 422
    assert ask(store, Work()).status_code == 201


def test_a_key_that_cannot_be_freed_hides_no_failure_and_holds_nobody_up(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads: list[threading.Thread] = []

    def fail(*_given: object) -> None:
        threads.append(threading.current_thread())
        raise OperationalError("DELETE", {}, Exception("the database is gone"))

    def failing(error: BaseException) -> Callable[[], Awaitable[Response]]:
        async def act() -> Response:
            raise error

        return act

    monkeypatch.setattr(store.claims, "settle", fail)
    with pytest.raises(KeyReusedError, match="why it failed"):
        ask(store, failing(KeyReusedError("why it failed")))
    with pytest.raises(asyncio.CancelledError):
        ask(store, failing(asyncio.CancelledError()), key="other")
    here = threading.current_thread()
    assert [thread is here for thread in threads] == [False, True], (
        "other requests go on while the database is waited for"
    )


def test_keys_end(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    work = Work()
    ask(store, work)
    for later, done in ((KEPT - timedelta(seconds=60), 1), (KEPT + timedelta(seconds=60), 2)):
        monkeypatch.setattr(jointplay.app.storage.idempotency, "now", lambda later=later: now() + later)
        ask(store, work)
        assert work.done == done


async def elsewhere(act: Callable[..., Any], *given: Any) -> Any:
    """Do something as another server would: in a thread, and for no claim of this one."""
    return await asyncio.to_thread(Context().run, act, *given)


def be_silent(store: Store) -> None:
    """Let the servers of all claims have given no sign of life for longer than a lease."""
    with store.database.writing() as session:
        session.execute(update(IdempotencyRow).values(lease_until=IdempotencyRow.lease_until - LEASE_S - 1))


def claim(claims: Claims) -> Claim:
    taken = claims.take("place", "print")
    assert isinstance(taken, Claim)
    return taken


def test_a_key_is_free_when_its_server_gives_no_sign_of_life(store: Store) -> None:
    here, other = store.claims, Claims(store.database)
    claim(here)
    for _ in range(3):
        with pytest.raises(KeyInUseError):
            other.take("place", "print")
        be_silent(store)
        here.beat()
    be_silent(store)
    claim(other)


def test_who_took_too_long_settles_nothing_of_another(store: Store) -> None:
    early = claim(store.claims)
    be_silent(store)
    late = claim(store.claims)
    for answer in (None, Response("early", 201)):
        store.claims.settle(early, answer)
        with pytest.raises(KeyInUseError):
            store.claims.take("place", "print")
    store.claims.settle(late, Response("late", 201))
    kept = store.claims.take("place", "print")
    assert isinstance(kept, Response) and kept.body == b"late"


def test_who_took_too_long_commits_nothing_beside_another(store: Store) -> None:
    """A server that was stopped for a while goes on, when another has done the request."""

    def write(name: str) -> None:
        with store.database.writing() as session:
            note(session, "made", "thing", name)

    async def other() -> Response:
        await asyncio.to_thread(write, "other")
        return Response("other", 201)

    async def slow() -> Response:
        await elsewhere(be_silent, store)
        assert (await elsewhere(ask, store, other)).body == b"other"
        await asyncio.to_thread(write, "slow")
        return Response("slow", 201)

    with pytest.raises(KeyInUseError, match="another request with it was let in"):
        ask(store, slow)
    assert ask(store, slow).body == b"other"
    assert [row.object for row in AuditLog(store.database).page(None, 9)] == ["other"]


def test_who_was_slow_alone_commits(store: Store) -> None:
    """Until another request with the key comes, nobody is in the way; and from the commit on a lease begins anew."""

    async def slow() -> Response:
        await elsewhere(be_silent, store)
        with store.database.writing() as session:
            note(session, "made", "thing", "slow")
        with pytest.raises(KeyInUseError):
            await elsewhere(ask, store, Work())
        return Response("slow", 201)

    assert ask(store, slow).body == b"slow"


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_server_that_is_killed_holds_no_key_for_long(kind: str, shelf: Path, worn: bytes, tmp_path: Path) -> None:
    """Killed in the midst of a write; the next server of the database does it, once."""
    with database(kind, tmp_path) as url:
        (tmp_path / "catalogues").symlink_to(shelf)
        headers = {"Idempotency-Key": "k-1"}

        def send(running: ServiceProcess) -> httpx.Response:
            with client_of(running) as asking:
                return asking.post(f"{API}/measurements", files={"file": ("held.csv", worn)}, headers=headers)

        with service_process(tmp_path, "--no-keys", database=url) as first, ThreadPoolExecutor() as threads:
            with client_of(first) as asking:
                assert asking.post(f"{API}/measurements", files={"file": ("a.csv", worn)}).status_code == 201
                worker = psutil.Process(first.worker())
                worker.suspend()
                held = threads.submit(send, first)
                while "jointplay_workers_busy 1.0" not in asking.get("/metrics").text:
                    sleep(0.1)
            assert send(first).status_code == 409
            first.process.kill()
            worker.kill()
            assert isinstance(held.exception(), httpx.TransportError)
        with service_process(tmp_path, "--no-keys", database=url) as second:
            answers = [send(second)]
            while answers[-1].status_code == 409 and len(answers) < 10 * LEASE_S:
                sleep(0.2)
                answers.append(send(second))
            assert answers[-1].status_code == 201, "within seconds, or two leases"
            assert send(second).content == answers[-1].content
            with client_of(second) as asking:
                items = asking.get(f"{API}/measurements").json()["items"]
        assert [item["name"] for item in items] == ["held.csv", "a.csv"]


def test_over_http(client: httpx.Client, worn: bytes) -> None:
    def send(key: str, content: bytes = worn, name: str = "twice.csv") -> httpx.Response:
        return client.post(f"{API}/measurements", files={"file": (name, content)}, headers={"Idempotency-Key": key})

    first, again = send("m-1"), send("m-1")
    assert (first.status_code, again.status_code) == (201, 201)
    assert (again.content, again.headers["location"]) == (first.content, first.headers["location"])
    other = send("m-1", worn + b"\n")
    assert (other.status_code, other.json()["type"]) == (422, "urn:jointplay:problem:idempotency-key-reused")
    assert send("m-2", b"nothing").status_code == 422
    assert send("m-2").status_code == 201  # the refusal was not kept
    assert send("").status_code == 422
    assert send("with blank").status_code == 422

    wanted = {"measurement": first.json()["id"], "catalogue": "slider-crank", "effort": "fast", "speed": "606.8 rpm"}

    def diagnose(**more: str) -> httpx.Response:
        return client.post(f"{API}/diagnoses", json={**wanted, **more}, headers={"Idempotency-Key": "d-1"})

    one, two = diagnose(), diagnose()
    assert (one.status_code, two.content, two.headers["location"]) == (201, one.content, one.headers["location"])
    assert client.get(one.headers["location"]).content == one.content
    assert diagnose(effort="standard").status_code == 422


def test_an_answer_is_kept_until_what_it_names_is_forgotten(store: Store) -> None:
    work = Work()
    first, other = ask(store, work), ask(store, work, key="other")
    with store.database.writing() as session:
        forget(session, [first.headers["location"]])
    assert ask(store, work, key="other").body == other.body
    assert ask(store, work).body == b"number 3"


def test_a_webhook_that_was_forgotten_is_not_answered_again(client: httpx.Client) -> None:
    def send() -> httpx.Response:
        body = {"url": "https://example.org/short", "events": ["finding.created"]}
        return client.post(f"{API}/webhooks", json=body, headers={"Idempotency-Key": "w-1"})

    first = send()
    assert client.delete(first.headers["location"]).status_code == 204
    second = send()
    assert second.json()["id"] != first.json()["id"]
    assert client.get(second.headers["location"]).status_code == 200


def test_findings_and_webhooks_over_http(client: httpx.Client, worn: bytes) -> None:
    form = {"catalogue": "slider-crank", "effort": "fast"}
    diagnosis = client.post(f"{API}/diagnoses", files={"file": ("worn.csv", worn)}, data=form).json()["id"]
    finding = {"text": "bush worn", "at": "2026-03-01T08:00:00Z"}
    other_finding = {**finding, "text": "nothing found"}
    webhook: dict[str, Any] = {"url": "https://example.org/hook", "events": ["finding.created"]}
    other_webhook = {**webhook, "url": "https://example.org/other"}
    for place, body, other in (
        (f"diagnoses/{diagnosis}/finding", finding, other_finding),
        ("webhooks", webhook, other_webhook),
    ):

        def send(body: dict[str, Any], key: str, place: str = place) -> httpx.Response:
            return client.post(f"{API}/{place}", json=body, headers={"Idempotency-Key": key})

        first, again = send(body, "f-1"), send(body, "f-1")
        assert (first.status_code, again.status_code) == (201, 201), first.text
        assert (again.content, again.headers["location"]) == (first.content, first.headers["location"])
        changed = send(other, "f-1")
        assert (changed.status_code, changed.json()["type"]) == (422, "urn:jointplay:problem:idempotency-key-reused")
        assert send(other, "f-2").json()["id"] != first.json()["id"]
    kept = [hook["url"] for hook in client.get(f"{API}/webhooks").json()["items"]]
    assert [kept.count(hook["url"]) for hook in (webhook, other_webhook)] == [1, 1]
    assert send(body, "f-3").json()["id"] != again.json()["id"], "without the key it is another webhook"
