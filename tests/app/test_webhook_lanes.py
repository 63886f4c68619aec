"""Webhooks beside each other: who does not answer holds nobody else up, is given up in the end, and can be tried."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from small_service import asking
from webhook_listener import Listener, state, tell

from jointplay.app.errors import BadFieldError, WebhookDisabledError
from jointplay.app.jobs import webhook_sender
from jointplay.app.jobs.webhook_sender import WebhookSender
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage import webhooks as rows
from jointplay.app.storage.audit import AuditLog
from jointplay.app.storage.rows import now
from jointplay.app.storage.store import Store
from jointplay.app.storage.webhooks import GIVEN_UP_AFTER, Webhooks

API = "/api/v1"
EVENTS = ["finding.created"]


@pytest.fixture
def webhooks(store: Store) -> Webhooks:
    return Webhooks(store.database)


@contextmanager
def silent() -> Iterator[str]:
    """Address of somebody who takes connections and says nothing."""
    with socket.create_server(("127.0.0.1", 0), backlog=64) as listening:
        yield f"http://127.0.0.1:{listening.getsockname()[1]}/"


def test_who_does_not_answer_holds_nobody_up(webhooks: Webhooks, listener: Listener) -> None:
    with ExitStack() as stack:
        dead = [webhooks.add(stack.enter_context(silent()), EVENTS) for _ in range(3)]
        good = webhooks.add(listener.url, EVENTS)
        for _ in range(6):
            tell(webhooks)
        sender = WebhookSender(webhooks, private=True)
        sender.start()
        try:
            # A wait at a dead one lasts 10 s, and 18 of them are due: after each other, this would be minutes.
            keys = {listener.told.get(timeout=300).headers["jointplay-delivery"] for _ in range(6)}
            assert len(keys) == 6
            for hook in dead:
                assert [row.attempts for row in webhooks.deliveries(hook.id, None, 10)].count(0) >= 4
        finally:
            stack.close()  # which ends their waits, too
            sender.close()
    assert good.id not in webhooks.troubles([good.id])


def test_nothing_that_goes_wrong_ends_the_sender(
    webhooks: Webhooks, listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    webhooks.add(listener.url, EVENTS)
    tell(webhooks)
    take, start, failures = webhooks.take, threading.Thread.start, iter([True])

    def fail_once(*given: Any, **more: Any) -> Any:
        if next(failures, False):
            raise ValueError("a row that nobody foresaw")
        return take(*given, **more)

    def start_once(thread: threading.Thread) -> None:
        if thread.name.startswith("webhook-") and next(refused, False):
            raise RuntimeError("can't start new thread")
        start(thread)

    refused = iter([True])
    monkeypatch.setattr(webhooks, "take", fail_once)
    monkeypatch.setattr(webhook_sender, "PAUSE_S", 0.01)
    monkeypatch.setattr(rows, "LEASE", timedelta(0))  # what could not be begun is due again at once
    monkeypatch.setattr(threading.Thread, "start", start_once)
    sender = WebhookSender(webhooks, private=True)
    sender.start()
    try:
        assert listener.told.get(timeout=60).headers["jointplay-event"] == "finding.created"
    finally:
        sender.close()
    assert next(refused, None) is None and not sender._busy


def test_a_webhook_gets_one_delivery_at_a_time_and_troubled_ones_come_last(webhooks: Webhooks) -> None:
    bad, good = webhooks.add("http://127.0.0.1:9/", EVENTS), webhooks.add("http://127.0.0.1:10/", EVENTS)
    for _ in range(2):
        tell(webhooks)
    first = webhooks.take(now())
    assert first is not None and first.webhook == bad.id and not first.troubled
    second = webhooks.take(now(), [bad.id])
    assert second is not None and second.webhook == good.id
    assert webhooks.take(now(), [bad.id, good.id]) is None
    webhooks.settle(first, now(), "nobody there")
    third = webhooks.take(now())  # that of `bad` is due for as long
    assert third is not None and third.webhook == good.id
    assert webhooks.take(now(), troubled=False) is None
    fourth = webhooks.take(now())
    assert fourth is not None and fourth.webhook == bad.id and fourth.troubled


def test_what_fails_for_days_is_disabled_and_others_hear_of_it(webhooks: Webhooks) -> None:
    other = webhooks.add("http://127.0.0.1:10/", ["webhook.disabled"])
    hook = webhooks.add("http://127.0.0.1:9/", EVENTS)
    tell(webhooks)
    tell(webhooks)
    begun = now()
    taken = webhooks.take(begun)
    assert taken is not None
    assert webhooks.settle(taken, begun, "nobody there") is False
    (trouble,) = webhooks.troubles([hook.id, other.id]).values()
    assert (trouble.webhook, trouble.since, trouble.disabled_at) == (hook.id, begun, None)
    end = begun + GIVEN_UP_AFTER
    taken = webhooks.take(end - timedelta(seconds=1))
    assert taken is not None
    assert webhooks.settle(taken, end - timedelta(seconds=1), "still nobody") is False
    taken = webhooks.take(end)
    assert taken is not None
    assert webhooks.settle(taken, end, "nobody at all") is True
    trouble = webhooks.troubles([hook.id])[hook.id]
    assert (trouble.error, trouble.disabled_at) == ("nobody at all", end)
    assert [row.action for row in AuditLog(webhooks._database).page(None, 10, object=hook.id)] == ["disabled", "made"]
    assert {row.state for row in webhooks.deliveries(hook.id, None, 10)} == {"failed"}
    (told,) = webhooks.deliveries(other.id, None, 10)
    assert (told.event, hook.id in told.body, "nobody at all" in told.body) == ("webhook.disabled", True, True)
    tell(webhooks)  # of which it hears nothing
    assert len(webhooks.deliveries(hook.id, None, 10)) == 2
    backlog = webhooks.backlog(told.created_at + timedelta(minutes=1))
    assert (backlog.waiting, backlog.age_s, backlog.disabled) == (1, 60.0, 1)
    with pytest.raises(WebhookDisabledError, match="a test that succeeds enables it"):
        webhooks.redeliver(hook.id, webhooks.deliveries(hook.id, None, 10)[0].id)
    tried = webhooks.test(hook.id)
    taken = webhooks.take(now(), [other.id])
    assert taken is not None and taken.id == tried.id and taken.is_last
    webhooks.settle(taken, now())
    assert webhooks.troubles([hook.id]) == {}
    (enabled, *_) = AuditLog(webhooks._database).page(None, 1)
    assert (enabled.action, enabled.object) == ("enabled", hook.id)


def test_what_was_given_up_is_delivered_again_on_request(webhooks: Webhooks, listener: Listener) -> None:
    hook = webhooks.add(listener.url, EVENTS)
    tell(webhooks)
    sender = WebhookSender(webhooks, private=True)
    assert sender.step()
    first = listener.told.get(timeout=300)
    assert state(webhooks, hook) == ("delivered", 1, "")
    again = webhooks.redeliver(hook.id, first.headers["jointplay-delivery"])
    assert (again.state, again.attempts) == ("waiting", 0)
    assert sender.step()
    second = listener.told.get(timeout=300)
    assert (second.body, second.headers["webhook-id"]) == (first.body, first.headers["webhook-id"])


def test_there_are_not_more_than_told(webhooks: Webhooks, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "MOST", 1)
    webhooks.add("http://127.0.0.1:9/", EVENTS)
    with pytest.raises(BadFieldError, match="url: there are 1 webhooks, which are all there may be"):
        webhooks.add("http://127.0.0.1:9/", EVENTS)


@pytest.fixture
def client(tmp_path: Path) -> Iterator[httpx.Client]:
    settings = ServiceSettings(catalogues=tmp_path / "none", data=tmp_path, workers=1, builds=0, keys="off")
    with asking(settings) as found:
        yield found


def test_a_test_and_a_redelivery_over_http(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    # Nobody is sent to: what is to be seen is what is said of an attempt that failed.
    monkeypatch.setattr(webhook_sender, "address_of", refused)
    made = client.post(f"{API}/webhooks", json={"url": "https://example.org/hook", "events": EVENTS})
    place = made.headers["location"]
    assert client.get(place).json()["state"] == "active"
    tag = client.get(place).headers["etag"]
    asked = client.post(f"{place}/test")
    assert asked.status_code == 202
    assert (asked.json()["event"], asked.json()["state"]) == ("webhook.test", "waiting")
    for _ in range(600):
        (row,) = client.get(f"{place}/deliveries").json()["items"]
        if row["state"] != "waiting":
            break
        time.sleep(0.1)
    assert (row["state"], row["attempts"], row["error"]) == ("failed", 1, "example.org: has no address")
    found = client.get(place)
    assert (found.json()["state"], found.json()["error"]) == ("failing", row["error"])
    assert found.headers["etag"] != tag
    again = client.post(f"{place}/deliveries/{row['id']}/redelivery")
    assert (again.status_code, again.json()["state"]) == (202, "waiting")
    unknown = client.post(f"{place}/deliveries/{'0' * 32}/redelivery")
    assert (unknown.status_code, unknown.json()["type"]) == (404, "urn:jointplay:problem:unknown-delivery")
    assert client.post(f"{API}/webhooks/{'0' * 32}/test").status_code == 404
    assert "jointplay_webhooks_disabled 0.0" in client.get("/metrics").text
    assert client.delete(place).status_code == 204


def refused(host: str, port: int, private: bool) -> str:
    raise webhook_sender.NotDeliveredError(f"{host}: has no address")
