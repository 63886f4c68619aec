"""Webhooks: signed deliveries that outlive a restart, and addresses that must not be reached."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import socket
import threading
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
from small_service import serving
from webhook_listener import Listener, state, tell

from jointplay.app.errors import BadFieldError
from jointplay.app.jobs import webhook_sender
from jointplay.app.jobs.webhook_sender import NotDeliveredError, WebhookSender, address_of, check_url, is_public
from jointplay.app.schemas.webhooks import EVENTS
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.rows import now
from jointplay.app.storage.store import Store
from jointplay.app.storage.webhooks import LEASE, WAITS, Taken, Webhooks, standard_signature

API = "/api/v1"


@pytest.fixture
def webhooks(store: Store) -> Webhooks:
    return Webhooks(store.database)


# --- deliveries


def test_a_delivery_is_signed_over_time_and_body(webhooks: Webhooks, listener: Listener) -> None:
    hook = webhooks.add(f"{listener.url}/hook?x=1", ["finding.created"])
    tell(webhooks)
    sender = WebhookSender(webhooks, private=True)
    assert sender.step() is True
    told = listener.told.get(timeout=300)
    assert told.path == "/hook?x=1"
    stamp, value = (part.partition("=")[2] for part in told.headers["jointplay-signature"].split(","))
    wanted = hmac.new(hook.secret.encode(), f"{stamp}.".encode() + told.body, hashlib.sha256).hexdigest()
    assert value == wanted
    assert abs(int(stamp) - now().timestamp()) < 300
    assert told.headers["webhook-timestamp"] == stamp
    said = json.loads(told.body)
    assert (said["event"], said["data"]) == ("finding.created", {"finding": "f1"})
    assert told.headers["jointplay-delivery"] == said["id"]
    assert told.headers["jointplay-event"] == "finding.created"
    key = base64.b64decode(hook.secret.removeprefix("whsec_"))
    assert len(key) == 32
    signed = f"{said['id']}.{stamp}.".encode() + told.body
    standard = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    assert (told.headers["webhook-id"], told.headers["webhook-signature"]) == (said["id"], f"v1,{standard}")
    assert state(webhooks, hook) == ("delivered", 1, "")
    assert sender.step() is False


def test_the_example_of_the_standard_is_signed_as_it_says() -> None:
    body = b'{"test": 2432232314}'
    secret, key = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "msg_p5jXN8AQM9LWM0D4loKWxJek"
    wanted = "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="
    assert standard_signature(secret, key, 1614265330, body) == wanted
    hexadecimal = "ab" * 32  # as secrets of version 1.0 are, which are base64 as well
    assert standard_signature(hexadecimal, key, 1614265330, body).startswith("v1,")


def test_only_what_was_asked_for_is_told(webhooks: Webhooks) -> None:
    hook = webhooks.add("http://127.0.0.1:9/", ["diagnosis.created"])
    tell(webhooks)
    assert webhooks.deliveries(hook.id, None, 10) == []


@pytest.mark.parametrize("status", [500, 404, 302, 307])
def test_what_is_no_success_is_tried_again_and_no_redirect_is_followed(
    webhooks: Webhooks, listener: Listener, status: int
) -> None:
    hook = webhooks.add(listener.url, ["finding.created"])
    tell(webhooks)
    listener.status = status
    sender = WebhookSender(webhooks, private=True)
    before = now()
    assert sender.step() is True
    assert state(webhooks, hook) == ("waiting", 1, f"answered {status}")
    assert sender.step() is False, "it is not due yet"
    assert listener.told.get(timeout=300).path == "/"
    assert listener.told.empty()
    (row,) = webhooks.deliveries(hook.id, None, 10)
    assert before + WAITS[0] <= row.due_at <= now() + WAITS[0]


def test_it_is_given_up_after_the_last_attempt(webhooks: Webhooks) -> None:
    hook = webhooks.add("http://127.0.0.1:9/", ["finding.created"])
    tell(webhooks)
    moment = now()
    waits = []
    for _ in range(len(WAITS) + 1):
        taken = webhooks.take(moment)
        assert taken is not None
        webhooks.settle(taken, moment, "nobody there")
        (row,) = webhooks.deliveries(hook.id, None, 10)
        waits.append(row.due_at - moment)
        moment = row.due_at
    assert waits[:-1] == list(WAITS)
    assert state(webhooks, hook) == ("failed", len(WAITS) + 1, "nobody there")
    assert webhooks.take(moment + timedelta(days=30)) is None


def test_a_delivery_outlives_its_server(url: str, tmp_path: Path, listener: Listener) -> None:
    first = Store(tmp_path, url)
    before = Webhooks(first.database)
    hook = before.add(listener.url, ["finding.created"])
    tell(before)
    moment = now()
    lost = before.take(moment)
    assert lost is not None
    first.close()  # in the middle of the attempt
    second = Store(tmp_path, url)
    after = Webhooks(second.database)
    assert after.take(moment + LEASE - timedelta(seconds=1)) is None, "the first server may be alive"
    again = after.take(moment + LEASE)
    assert again is not None
    assert (again.id, again.attempts) == (lost.id, 2)
    webhook_sender.send(again, private=True)
    after.settle(again, now())
    assert state(after, hook) == ("delivered", 2, "")
    second.close()


def test_a_connection_that_was_cut_took_too_long_however_that_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    def reset(connection: webhook_sender.GuardedConnection) -> None:
        connection.cut()
        raise ConnectionResetError(104, "Connection reset by peer")

    monkeypatch.setattr(webhook_sender.GuardedConnection, "getresponse", reset)
    monkeypatch.setattr(webhook_sender.GuardedConnection, "request", lambda *_: None)
    taken = Taken("1", "http://127.0.0.1:9/", "whsec_c2VjcmV0", "finding.created", "{}", 1)
    with pytest.raises(NotDeliveredError, match=r"took longer than 30 s"):
        webhook_sender.send(taken, private=True)


def test_whoever_answers_without_end_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(webhook_sender, "DEADLINE_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        stop = threading.Event()

        def drip() -> None:
            connection, _ = listening.accept()
            with connection:
                try:
                    connection.sendall(b"HTTP/1.1 200 OK\r\n")
                    while not stop.wait(0.02):
                        connection.sendall(b"a")
                except OSError:
                    return

        thread = threading.Thread(target=drip, daemon=True)
        thread.start()
        taken = Taken(
            "1", f"http://127.0.0.1:{listening.getsockname()[1]}/", "whsec_c2VjcmV0", "finding.created", "{}", 1
        )
        try:
            # What ends it is the deadline: the header line would go on for ever, and no single wait is long.
            with pytest.raises(NotDeliveredError, match=r"took longer than 0\.3 s"):
                webhook_sender.send(taken, private=True)
        finally:
            stop.set()
            thread.join(10)
        assert not thread.is_alive()


# --- addresses


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1",
        "10.0.0.5",
        "192.168.1.1",
        "172.16.0.1",
        "169.254.169.254",
        "100.64.0.1",
        "0.0.0.0",
        "224.0.0.1",
        "::1",
        "::",
        "fe80::1%eth0",
        "fc00::1",
        "::ffff:127.0.0.1",
        "::ffff:10.0.0.1",
        "2002:7f00:1::",
        "64:ff9b::7f00:1",
    ],
)
def test_addresses_inside_are_not_public(address: str) -> None:
    assert not is_public(address)


@pytest.mark.parametrize("address", ["8.8.8.8", "193.0.6.139", "2606:4700:4700::1111"])
def test_addresses_outside_are_public(address: str) -> None:
    assert is_public(address)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.1", "2130706433", "0x7f.0.0.1"])
def test_no_spelling_of_this_computer_is_sent_to(webhooks: Webhooks, listener: Listener, host: str) -> None:
    hook = webhooks.add(f"http://{host}:{listener.server_port}/", ["finding.created"])
    tell(webhooks)
    WebhookSender(webhooks, private=False).step()
    assert state(webhooks, hook) == ("waiting", 1, f"{host}: leads to an address that is not public")
    assert listener.told.empty()


def test_a_name_with_one_address_inside_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, 80)) for address in ("8.8.8.8", "10.0.0.1")]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *args, **kwargs: found)
    with pytest.raises(NotDeliveredError, match="not public"):
        address_of("mixed.example", 80, private=False)
    assert address_of("mixed.example", 80, private=True) == "8.8.8.8"


def test_the_judged_address_is_the_one_connected_to(
    monkeypatch: pytest.MonkeyPatch, listener: Listener, webhooks: Webhooks
) -> None:
    hook = webhooks.add(f"http://hooks.example:{listener.server_port}/", ["finding.created"])
    tell(webhooks)
    asked = []

    def judged(host: str, port: int, private: bool) -> str:
        asked.append(host)
        return "127.0.0.1"

    monkeypatch.setattr(webhook_sender, "address_of", judged)
    WebhookSender(webhooks, private=False).step()
    assert state(webhooks, hook) == ("delivered", 1, "")
    assert asked == ["hooks.example"]
    assert listener.told.get(timeout=300).headers["host"] == f"hooks.example:{listener.server_port}"


@pytest.mark.parametrize(
    "url",
    [
        "ftp://example.org/",
        "file:///etc/passwd",
        "http://",
        "http://user:pw@example.org/",
        "http://example.org/#x",
        "http://example.org:99999/",
        "http://exa mple.org/",
        "http://example.org/\r\nX: y",
        "//example.org",
        "http://[::1",
    ],
)
def test_what_is_no_address_of_a_webhook_is_refused(url: str) -> None:
    with pytest.raises(BadFieldError) as caught:
        check_url(url)
    assert caught.value.field == "url"


# --- over HTTP


def test_a_webhook_is_made_listed_and_forgotten(client: httpx.Client) -> None:
    body = {"url": "https://example.org/hook", "events": ["finding.created"] * (len(EVENTS) + 1)}
    answer = client.post(f"{API}/webhooks", json=body)
    assert answer.status_code == 422, "more events than there are may not be named"
    answer = client.post(f"{API}/webhooks", json={**body, "events": ["finding.created"]})
    assert answer.status_code == 201, answer.text
    made = answer.json()
    assert made.pop("secret").startswith("whsec_")
    place = answer.headers["location"]
    read = client.get(place)
    assert read.json() == made
    assert client.get(place, headers={"If-None-Match": read.headers["etag"]}).status_code == 304
    assert made in client.get(f"{API}/webhooks").json()["items"]
    assert client.get(f"{place}/deliveries").json() == {"items": [], "next_cursor": None}
    assert client.delete(place).status_code == 204
    for gone in (client.get(place), client.delete(place), client.get(f"{place}/deliveries")):
        assert gone.status_code == 404


@pytest.mark.parametrize("url", ["http://127.0.0.1:1/", "http://localhost/", "http://[::1]/", "gopher://example.org/"])
def test_an_address_inside_is_refused_at_once(client: httpx.Client, url: str) -> None:
    answer = client.post(f"{API}/webhooks", json={"url": url, "events": ["finding.created"]})
    assert answer.status_code == 422
    assert [entry["field"] for entry in answer.json()["errors"]] == ["url"]


def test_a_diagnosis_and_its_finding_are_told(shelf: Path, tmp_path: Path, worn: bytes, listener: Listener) -> None:
    settings = ServiceSettings(catalogues=shelf, data=tmp_path, workers=1, webhooks_private=True, keys="off")
    with serving(settings) as address, httpx.Client(base_url=f"{address}{API}", timeout=300) as client:
        events = ["diagnosis.created", "finding.created"]
        assert client.post("/webhooks", json={"url": listener.url, "events": events}).status_code == 201
        form = {"catalogue": "slider-crank", "effort": "fast"}
        made = client.post("/diagnoses", files={"file": ("a.csv", worn)}, data=form).json()
        told = json.loads(listener.told.get(timeout=300).body)
        assert told["event"] == "diagnosis.created"
        assert told["data"]["diagnosis"] == made["id"]
        assert told["data"]["verdict"] == made["verdict"]
        body = {"text": "bush worn", "at": "2026-03-01T08:00:00Z"}
        for _ in range(2):
            found = client.post(f"/diagnoses/{made['id']}/finding", json=body).json()
        told = json.loads(listener.told.get(timeout=300).body)
        assert told["data"] == {"finding": found["id"], "diagnosis": made["id"], "asset": None}
    assert listener.told.empty()
