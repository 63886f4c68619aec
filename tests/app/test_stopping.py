"""SIGTERM: what runs may end, what may not is told so, nothing new begins, and the exit status says all is well."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import httpx
import psutil
import pytest
from service_process import ServiceProcess, client_of, service_process
from small_service import PLAN

from jointplay.app.jobs import housekeeper
from jointplay.app.storage.pruning import Pruner

API = "/api/v1"
BUILD = {"machine": "slider-crank", "plan": PLAN, "catalogue": "made"}


@contextmanager
def held(running: ServiceProcess, worn: bytes) -> Iterator[tuple[psutil.Process, Future[httpx.Response]]]:
    """A diagnosis that is with a worker, which is held: gives the worker, and the answer to come."""

    def busy() -> float:
        with client_of(running) as client:
            lines = client.get("/metrics").text.splitlines()
        return float(next(line for line in lines if line.startswith("jointplay_workers_busy ")).split()[1])

    def ask() -> httpx.Response:
        question = {"catalogue": "slider-crank", "effort": "fast"}
        with client_of(running) as client:
            return client.post(f"{API}/diagnoses", files={"file": ("w.csv", worn)}, data=question)

    running.wait_for("task warm has ended")
    worker = psutil.Process(running.worker())
    worker.suspend()
    try:
        with ThreadPoolExecutor(1) as thread:
            answer = thread.submit(ask)
            while not busy():
                pass
            yield worker, answer
    finally:
        if worker.is_running():
            worker.resume()


@pytest.fixture
def folder(tmp_path: Path, shelf: Path) -> Path:
    (tmp_path / "catalogues").mkdir()
    (tmp_path / "catalogues" / "slider-crank").symlink_to(shelf / "slider-crank")
    return tmp_path


@pytest.mark.long
def test_what_runs_is_answered_and_streams_end(folder: Path, worn: bytes) -> None:
    with service_process(folder, builds="0", log_level="debug") as running, client_of(running) as client:
        place = client.post(f"{API}/builds", json=BUILD).headers["location"]
        with held(running, worn) as (worker, answer), client.stream("GET", f"{place}/events") as stream:
            lines = stream.iter_lines()
            assert next(lines) == "event: state"
            running.process.send_signal(signal.SIGTERM)
            rest = list(lines)  # it ends, though the build has not
            running.wait_for("Waiting for (connections to close|background tasks)")
            with pytest.raises(httpx.ConnectError):
                httpx.get(f"{running.address}/healthz", timeout=300)
            assert not answer.done()
            worker.resume()
            response = answer.result(300)
        assert (response.status_code, rest[-1]) == (201, "")
        assert running.process.wait(300) == 0
    assert not psutil.pid_exists(worker.pid)


@pytest.mark.long
def test_what_takes_longer_than_the_limit_is_told(folder: Path, worn: bytes) -> None:
    with (
        service_process(folder, builds="0", log_level="debug", stop_limit_s="1") as running,
        held(running, worn) as (worker, answer),
    ):
        running.process.send_signal(signal.SIGTERM)
        response = answer.result(300)
        assert running.process.wait(300) == 0
    assert response.status_code == 503, response.text
    assert response.headers["retry-after"] == "5"
    assert response.json()["type"] == "urn:jointplay:problem:not-ready"
    assert "stopping" in response.json()["detail"]
    assert not psutil.pid_exists(worker.pid)


@pytest.mark.long
def test_a_build_is_given_back(folder: Path) -> None:
    with service_process(folder) as running, client_of(running) as client:
        place = client.post(f"{API}/builds", json=BUILD).headers["location"]
        with client.stream("GET", f"{place}/events") as stream:
            next(line for line in stream.iter_lines() if '"running"' in line)
            children = psutil.Process(running.process.pid).children(recursive=True)
            os.kill(running.process.pid, signal.SIGTERM)
            assert running.process.wait(300) == 0
        assert psutil.wait_procs(children, 300)[1] == []
    with service_process(folder, builds="0") as running, client_of(running) as client:
        found = client.get(place).json()
    assert (found["state"], found["attempts"]) == ("queued", 0)


def test_a_transaction_that_lasts_does_not_keep_the_server_from_ending(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, over = threading.Event(), threading.Event()

    class Slow:
        def why_apart(self) -> str:
            return ""

        def prune(self) -> Iterator[Any]:
            begun.set()
            over.wait(300)
            yield from ()

    monkeypatch.setattr(housekeeper, "CLOSE_S", 0.05)
    keeper = housekeeper.Housekeeper(cast(Pruner, Slow()))
    keeper.start()
    assert begun.wait(300)
    closing_it = threading.Thread(target=keeper.close)
    closing_it.start()
    closing_it.join(60)
    ended = not closing_it.is_alive()
    over.set()
    closing_it.join()
    assert ended
