"""Builds in the queue: done once, taken up again when somebody dies, given back, given up, cancelled."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import build_tasks
import pytest
from sqlalchemy import update

from jointplay.app.errors import BuildEndedError, UnknownBuildError
from jointplay.app.jobs.build_runner import BuildRunner
from jointplay.app.storage.build_queue import ATTEMPTS, BuildQueue, BuildRow
from jointplay.app.storage.store import Store

GIVEN_UP = f"given up after {ATTEMPTS} attempts without progress"


class Server:
    """One server's part of a database."""

    def __init__(self, folder: Path, url: str) -> None:
        self.folder, self.store = folder, Store(folder / "data", url)
        self.queue = BuildQueue(self.store.database)

    @contextmanager
    def running(self, task: Callable[..., None], lease_s: float = 20.0) -> Iterator[BuildRunner]:
        runner = BuildRunner(self.queue, self.folder, 1, lease_s, task)
        runner.start()
        try:
            yield runner
        finally:
            runner.close()

    def add(self, catalogue: str, workers: int | None = None) -> str:
        return self.queue.add({"name": "m"}, {"name": "p"}, "h" * 64, catalogue, workers).id

    def until(self, key: str, **wanted: Any) -> BuildRow:
        deadline = time.monotonic() + 300
        while True:
            row = self.queue.find(key)
            if all(getattr(row, name) == value for name, value in wanted.items()):
                return row
            assert time.monotonic() < deadline, (wanted, row.state, row.message, row.attempts)
            time.sleep(0.02)


@pytest.fixture
def server(url: str, tmp_path: Path) -> Iterator[Server]:
    made = Server(tmp_path, url)
    yield made
    made.store.close()


def gone(pid: int) -> bool:
    for _ in range(6000):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def test_two_servers_do_each_build_once(server: Server, url: str, tmp_path: Path) -> None:
    keys = [server.add(f"c{number}") for number in range(4)]
    other = Server(tmp_path, url)
    with server.running(build_tasks.quick), other.running(build_tasks.quick):
        rows = [server.until(key, state="done") for key in keys]
    other.store.close()
    assert [len(build_tasks.noted(tmp_path, row.catalogue)) for row in rows] == [1, 1, 1, 1]
    assert {(row.attempts, row.cases_done, row.cases_total, row.catalogue_id) for row in rows} == {
        (1, 12, 12, "c" * 64)
    }


def test_a_killed_process_is_replaced_and_in_the_end_given_up(server: Server, tmp_path: Path) -> None:
    key = server.add("c")
    with server.running(build_tasks.deadly):
        row = server.until(key, state="worker_lost")
    assert row.attempts == len(build_tasks.noted(tmp_path, "c")) == ATTEMPTS
    assert (
        row.message == f"its process ended early (exit status -9); given up after {ATTEMPTS} attempts without progress"
    )
    assert row.ended_at is not None


def test_deaths_are_forgiven_when_there_was_progress(server: Server) -> None:
    key = server.add("c")

    def dies(cases_done: int) -> str:
        claimed = server.queue.claim("a", 60.0)
        assert claimed is not None
        server.queue.beat(key, "a", 60.0, {"cases_done": cases_done})
        server.queue.lose(key, "a", "died")
        return server.queue.find(key).state

    assert [dies(3 * number) for number in range(1, 2 * ATTEMPTS)] == ["queued"] * (2 * ATTEMPTS - 1)
    most = 3 * (2 * ATTEMPTS - 1)
    assert [dies(most) for _ in range(ATTEMPTS)] == ["queued"] * (ATTEMPTS - 1) + ["worker_lost"]
    row = server.queue.find(key)
    assert (row.attempts, row.message) == (
        3 * ATTEMPTS - 1,
        f"died; given up after {ATTEMPTS} attempts without progress",
    )


def test_kill_in_the_middle_cancel_and_stop(server: Server, tmp_path: Path) -> None:
    """One process is killed, its successor stopped with the server in good order, the next one cancelled."""
    key = server.add("c")
    with server.running(build_tasks.endless):
        assert server.until(key, cases_done=3).state == "running"
        os.kill(build_tasks.noted(tmp_path, "c")[0], signal.SIGKILL)
        server.until(key, state="running", attempts=2, cases_total=12)
    row = server.queue.find(key)
    assert (row.state, row.attempts, row.owner) == ("queued", 1, "")
    with server.running(build_tasks.endless):
        server.until(key, state="running", attempts=2, cases_done=3)
        assert server.queue.cancel(key).state == "running"
        row = server.until(key, state="cancelled")
    assert row.cases_done == 3
    assert server.queue.cancel(key).state == "cancelled"
    assert all(gone(pid) for pid in build_tasks.noted(tmp_path, "c"))


def test_a_build_whose_server_died_is_taken_up_by_the_next(server: Server, tmp_path: Path) -> None:
    """The dead one had claimed it, and says no more; what it still says later changes nothing."""
    key = server.add("c")
    claimed = server.queue.claim("dead", 0.0)
    assert claimed is not None and claimed.id == key
    with server.running(build_tasks.quick):
        row = server.until(key, state="done")
    assert row.attempts == 2
    assert not server.queue.beat(key, "dead", 60.0, {"cases_done": 1}).owned
    server.queue.end(key, "dead", "failed", {"message": "late"})
    server.queue.lose(key, "dead", "late")
    server.queue.release(key, "dead")
    assert (server.queue.find(key).state, server.queue.find(key).cases_done) == ("done", 12)


def test_a_server_that_has_lost_its_build_lets_go(server: Server, tmp_path: Path) -> None:
    key = server.add("c")
    with server.running(build_tasks.endless):
        server.until(key, cases_done=3)
        with server.store.database.writing() as session:
            session.execute(update(BuildRow).values(owner="another", lease_until=1e12))
        assert gone(build_tasks.noted(tmp_path, "c")[0])
    assert server.queue.find(key).owner == "another"


def test_builds_of_one_catalogue_wait_for_each_other(server: Server) -> None:
    first, second, third = server.add("c"), server.add("c", workers=2), server.add("d")
    claims = [server.queue.claim("a", 60.0), server.queue.claim("b", 60.0), server.queue.claim("b", 60.0)]
    assert [row.id if row else None for row in claims] == [first, third, None]
    server.queue.end(first, "a", "done", {})
    found = server.queue.claim("b", 60.0)
    assert found is not None and found.id == second


def test_cancelling_what_waits_what_is_dead_and_what_has_ended(server: Server) -> None:
    waiting, dead = server.add("c"), server.add("d")
    assert server.queue.cancel(waiting).state == "cancelled"
    claimed = server.queue.claim("dead", 0.0)
    assert claimed is not None and claimed.id == dead
    assert server.queue.cancel(dead).state == "running"
    assert server.queue.claim("b", 60.0) is None
    assert server.queue.find(dead).state == "cancelled"
    with server.running(build_tasks.refused):
        key = server.add("e")
        assert server.until(key, state="failed").message == "plan: breaks a rule"
    with pytest.raises(BuildEndedError, match="is failed already"):
        server.queue.cancel(key)
    with pytest.raises(UnknownBuildError):
        server.queue.cancel("0" * 32)
    assert [row.id for row in server.queue.list_builds(None, 5)] == [key, dead, waiting]
