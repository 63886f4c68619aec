"""What the service counts, read by the parser of Prometheus' own client."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path
from typing import Any
from unittest import mock

import httpx
import psutil
import pytest
from cachetools import TTLCache
from prometheus_client import Metric
from prometheus_client.parser import text_string_to_metric_families
from small_service import asking, running, spoiled
from sqlalchemy import event
from sqlalchemy.exc import OperationalError
from webhook_listener import listening, tell

from jointplay.app.http import stored
from jointplay.app.jobs.webhook_sender import WebhookSender
from jointplay.app.main import create_app
from jointplay.app.metrics import Metrics
from jointplay.app.scopes import Scope
from jointplay.app.settings import ServiceSettings
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.store import Store
from jointplay.app.storage.webhooks import WAITS, Webhooks

API = "/api/v1"


def families(text: str) -> dict[str, Metric]:
    """Everything that is counted, by name; names occur once."""
    found = list(text_string_to_metric_families(text))
    assert len({family.name for family in found}) == len(found)
    assert all(family.documentation for family in found)
    return {family.name: family for family in found}


def value(found: dict[str, Metric], name: str, suffix: str = "", **labels: str) -> float:
    """The sum of all samples that have these labels."""
    samples = [each for each in found[f"jointplay_{name}"].samples if each.name == f"jointplay_{name}{suffix}"]
    return sum(each.value for each in samples if labels.items() <= each.labels.items())


def asked(client: httpx.Client) -> dict[str, Metric]:
    response = client.get("/metrics")
    assert response.status_code == 200, response.text
    assert response.headers["content-type"].startswith("text/plain; version=0.0.4")
    return families(response.text)


def test_what_happens_is_counted(client: httpx.Client, worn: bytes) -> None:
    before = asked(client)
    question = {"catalogue": "slider-crank", "effort": "fast"}
    result = client.post(f"{API}/diagnoses", files={"file": ("w.csv", worn)}, data=question).json()
    refused = client.post(f"{API}/measurements", files={"file": ("w.csv", spoiled(worn, "infinite"))})
    assert refused.status_code == 422
    client.get(f"{API}/machines/slider-crank")
    client.get(f"{API}/machines/no-such-machine")
    client.get("/nowhere/at/all")
    client.request("BREW", "/nowhere")
    after = asked(client)

    def more(name: str, suffix: str = "", **labels: str) -> float:
        return value(after, name, suffix, **labels) - value(before, name, suffix, **labels)

    labels = {"effort": "fast", "mode": result["mode"]["used"], "verdict": result["verdict"]}
    assert more("diagnoses", "_total", **labels) == 1
    assert more("uploads_refused", "_total", reason="measurement") == 1
    route = f"{API}/machines/{{name}}"
    assert more("http_requests", "_total", route=route, method="GET", status="200") == 1
    assert more("http_requests", "_total", route=route, method="GET", status="404") == 1
    assert more("http_request_duration_seconds", "_count", route=route, method="GET") == 2
    assert more("http_requests", "_total", route="none", method="GET", status="404") == 1
    assert more("http_requests", "_total", route="none", method="other") == 1
    for name in ("task_queue_seconds", "task_worker_seconds"):
        assert more(name, "_count", task="summarise_and_diagnose") == 1
        assert more(name, "_count", task="summarise") == 1
    assert more("task_worker_seconds", "_count", task="summarise", outcome="refused") == 1
    assert more("task_worker_seconds", "_sum", task="summarise_and_diagnose", outcome="ok") > 0
    assert value(after, "queue_length") == value(after, "workers_busy") == 0
    assert value(after, "queue_limit") == 32
    assert value(after, "database_up") == 1
    (offered,) = client.get(f"{API}/catalogues").json()["items"]
    assert value(after, "catalogues") == 1
    assert value(after, "catalogue_entries", catalogue="slider-crank") == offered["entries"]
    workers = [each for each in psutil.Process().children() if "spawn_main" in " ".join(each.cmdline())]
    shown = value(after, "memory_bytes", process="worker-0")
    assert any(shown == pytest.approx(worker.memory_info().rss, rel=0.1) for worker in workers)
    assert value(after, "memory_bytes", process="server") > 1e7


def test_labels_are_of_the_service_not_of_its_clients(client: httpx.Client) -> None:
    for number in range(30):
        client.get(f"{API}/machines/m{number}")
        client.get(f"/m{number}")
        client.request(f"M{number}", "/healthz")
        client.post(f"{API}/measurements", files={f"f{number}": ("x.csv", b"x")})
    text = client.get("/metrics").text
    assert "m7" not in text
    assert "M7" not in text
    assert "f7" not in text
    assert len(text.splitlines()) < 3000


def test_builds_are_counted_by_state(url: str, tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path, data=tmp_path / "data", database=url, builds=0, workers=1)
    store = Store(settings.data, url)
    queue = BuildQueue(store.database)
    for name in ("a", "b", "c"):
        queue.add({"name": "m"}, {"name": "p"}, "h" * 64, name, None)
    for name in ("a", "b"):
        row = queue.claim(name, 60)
        assert row is not None
        queue.beat(row.id, name, 60, {"cases_done": 3, "cases_total": 12, "rate_per_s": 0.5})
    with asking(settings) as client:
        found = asked(client)
    store.close()
    counts = {sample.labels["state"]: sample.value for sample in found["jointplay_builds"].samples}
    assert counts == {"queued": 1, "running": 2, "done": 0, "failed": 0, "cancelled": 0, "worker_lost": 0}
    for name, expected in (("cases_done", 6), ("cases", 24)):
        assert value(found, f"builds_running_{name}") == expected
    assert value(found, "builds_cases_per_second") == 1.0


def test_a_database_that_is_gone_is_counted_as_such(tmp_path: Path) -> None:
    application = create_app(ServiceSettings(catalogues=tmp_path, data=tmp_path / "data", builds=0))

    def gone(*_arguments: object) -> None:
        raise OperationalError("SELECT", {}, OSError("gone"))

    with running(application) as address, httpx.Client(base_url=address, timeout=300) as client:
        event.listen(application.state.service.store.database.engine, "before_cursor_execute", gone)
        found = asked(client)
    assert value(found, "database_up") == 0
    assert "jointplay_builds" not in found


def test_what_is_stored_is_kept_by_one_thread_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    class Guarded(TTLCache[str, Any]):
        def __getitem__(self, name: str) -> Any:
            assert kept._lock.locked()
            return super().__getitem__(name)

        def __setitem__(self, name: str, usage: Any, *more: Any) -> None:
            assert kept._lock.locked()
            super().__setitem__(name, usage, *more)

    measured = iter(["once", "twice"])
    monkeypatch.setattr(stored, "measure", lambda _store: next(measured))
    kept = stored.Stored(mock.Mock())
    kept._kept = Guarded(1, 60.0)
    assert [kept._usage(), kept._usage()] == ["once", "once"]


def test_attempts_of_webhooks_are_counted(tmp_path: Path) -> None:
    store = Store(tmp_path)
    webhooks, metrics = Webhooks(store.database), Metrics()
    sender = WebhookSender(webhooks, True, metrics.count_delivery)
    with listening() as listener:
        hook = webhooks.add(f"{listener.url}/hook", ["finding.created"])
        tell(webhooks)
        assert sender.step()
        listener.status = 500
        tell(webhooks)
        assert sender.step()
        taken = webhooks.deliveries(hook.id, None, 1)[0]
        with store.database.writing() as session:
            row = session.merge(taken)
            row.attempts, row.due_at = len(WAITS), row.created_at
        assert sender.step()
    found = families(metrics.text().decode())
    outcomes = {
        sample.labels["outcome"]: sample.value
        for sample in found["jointplay_webhook_attempts"].samples
        if sample.name.endswith("_total")
    }
    assert outcomes == {"delivered": 1, "failed": 1, "given_up": 1}
    store.close()


def test_counts_need_a_key_that_may_read(tmp_path: Path) -> None:
    settings = ServiceSettings(catalogues=tmp_path, data=tmp_path / "data", builds=0, workers=1, keys="required")
    store = Store(settings.data)
    keys = Keys(store.database)
    tokens = [keys.create("k", frozenset({scope}), timedelta(hours=1))[1] for scope in (Scope.READ, Scope.MATCH)]
    keys.create("holds on", frozenset({Scope.READ}), timedelta(days=15))
    keys.create("is over", frozenset({Scope.READ}), timedelta(days=-1))
    keys.revoke(keys.create("is taken back", frozenset({Scope.READ}), timedelta(days=1))[0].id)
    store.close()
    with asking(settings) as client:
        answers = [
            client.get("/metrics", headers={} if token is None else {"Authorization": f"Bearer {token}"})
            for token in (None, *tokens)
        ]
    assert [answer.status_code for answer in answers] == [401, 200, 403]
    assert value(families(answers[1].text), "keys_expiring") == 2
