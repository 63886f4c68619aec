"""Several servers on one database: a delivery is one server's at a time, and nothing is left over by a race."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, closing
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from answers import diagnosis
from uploaded import uploaded
from webhook_listener import Listener, state, tell

import jointplay.app.storage.webhooks
from jointplay.app.jobs.webhook_sender import WebhookSender
from jointplay.app.schemas.assets import AssetIn, FindingIn
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.rows import now
from jointplay.app.storage.store import NewDiagnosis, Store
from jointplay.app.storage.webhooks import LEASE, Taken, Webhooks

SERVERS = 2
DELIVERIES = 12
MACHINE = {"name": "m", "joints": {"B": {"kind": "turning"}}}


@pytest.fixture
def stores(url: str, tmp_path: Path) -> Iterator[list[Store]]:
    """What two servers of one database have."""
    with ExitStack() as stack:
        yield [stack.enter_context(closing(Store(tmp_path, url))) for _ in range(SERVERS)]


def at_once(acts: list[Callable[[], Any]]) -> list[Any]:
    """Do several things from the same moment on."""
    begin = threading.Barrier(len(acts))

    def act(number: int) -> Any:
        begin.wait(300)
        return acts[number]()

    with ThreadPoolExecutor(len(acts)) as pool:
        return list(pool.map(act, range(len(acts))))


def test_each_delivery_is_taken_by_one(stores: list[Store]) -> None:
    servers = [Webhooks(store.database) for store in stores]
    hook = servers[0].add("http://127.0.0.1:9/", ["finding.created"])
    for _ in range(DELIVERIES):
        tell(servers[0])
    moment = now()

    def take_all(webhooks: Webhooks) -> list[Taken]:
        found = []
        while (taken := webhooks.take(moment)) is not None:
            found.append(taken)
        return found

    def taker(webhooks: Webhooks) -> Callable[[], list[Taken]]:
        return lambda: take_all(webhooks)

    taken = [each for found in at_once([taker(server) for server in servers]) for each in found]
    # Who met a delivery that the other was just taking may have stopped early; nothing is left after that.
    taken += take_all(servers[0])
    assert Counter(each.id for each in taken) == {row.id: 1 for row in servers[0].deliveries(hook.id, None, 99)}
    assert [each.attempts for each in taken] == [1] * DELIVERIES


def test_two_senders_tell_everything_once(stores: list[Store], listener: Listener) -> None:
    servers = [Webhooks(store.database) for store in stores]
    hook = servers[0].add(listener.url, ["finding.created"])
    for _ in range(DELIVERIES):
        tell(servers[0])
    senders = [WebhookSender(server, private=True) for server in servers]
    for sender in senders:
        sender.start()
    told = [listener.told.get(timeout=3000).headers["jointplay-delivery"] for _ in range(DELIVERIES)]
    for sender in senders:
        sender.close()
    rows = servers[0].deliveries(hook.id, None, 99)
    assert sorted(told) == sorted(row.id for row in rows)
    assert listener.told.empty()
    assert {(row.state, row.attempts, row.error) for row in rows} == {("delivered", 1, "")}


def test_who_took_longer_than_the_lease_has_not_the_last_word(stores: list[Store]) -> None:
    first, second = (Webhooks(store.database) for store in stores)
    hook = first.add("http://127.0.0.1:9/", ["finding.created"])
    tell(first)
    moment = now()
    slow, quick = first.take(moment), second.take(moment + LEASE)
    assert slow is not None and quick is not None
    second.settle(quick, moment + LEASE)
    first.settle(slow, moment + LEASE, "took too long")
    assert state(first, hook) == ("delivered", 2, "")


def test_a_webhook_that_is_forgotten_while_something_is_told(
    stores: list[Store], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = (Webhooks(store.database) for store in stores)
    hook = first.add("http://127.0.0.1:9/", ["finding.created"])
    with ThreadPoolExecutor(1) as pool:
        removals = []

        def between() -> datetime:
            """Forget the webhook when it is known whom to tell, and nothing is written yet."""
            removals.append(pool.submit(second.remove, hook.id))
            wait(removals, timeout=1.0)  # it has to wait for the transaction that is under way
            return now()

        monkeypatch.setattr(jointplay.app.storage.webhooks, "now", between)
        tell(first)
        for removal in removals:
            removal.result(timeout=300)
    assert len(removals) == 1
    assert first.deliveries(hook.id, None, 99) == []
    assert first.take(now()) is None


def test_the_same_finding_sent_to_both_is_told_once(stores: list[Store]) -> None:
    hook = Webhooks(stores[0].database).add("http://127.0.0.1:9/", ["finding.created"])
    measurement = stores[0].add_measurement(uploaded(stores[0]), "a.csv", None, {})
    row = stores[0].add_diagnosis(NewDiagnosis(measurement.id, "c" * 64, MACHINE, {}, diagnosis()))

    def finder(store: Store, text: str) -> Callable[[], str]:
        said = FindingIn.model_validate({"text": text, "at": "2026-03-01T08:00:00Z"})
        return lambda: Findings(store.database).add(row, said).id

    for number in range(8):
        assert len(set(at_once([finder(store, f"bush {number}") for store in stores]))) == 1
    assert len(Webhooks(stores[0].database).deliveries(hook.id, None, 99)) == 8


def test_the_same_new_asset_sent_to_both_is_made_once(stores: list[Store]) -> None:
    def putter(store: Store, name: str) -> Callable[[], bool]:
        return lambda: Assets(store.database).put(name, AssetIn(machine="m", notes="", baseline=None))[1]

    for number in range(8):
        made = at_once([putter(store, f"press-{number}") for store in stores])
        assert sorted(made) == [False, True]
        assert Assets(stores[0].database).asset(f"press-{number}").machine == "m"
