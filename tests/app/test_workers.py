"""Workers end what takes too long or dies, and go on with the next task."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest

from jointplay.app.errors import BusyError, ClientGoneError, SlowRequestError, TimeLimitError, WorkerDiedError
from jointplay.app.jobs import workers
from jointplay.app.jobs.clients import Client, working_for
from jointplay.app.jobs.workers import TaskFailedError, WorkerPool
from jointplay.app.logs import DEFAULT_LOG
from jointplay.catalogue.processes import OneProcess
from jointplay.solver.errors import MachineError


def double(value: int) -> int:
    return 2 * value


def sleep(seconds: float) -> None:
    time.sleep(seconds)


def wait_for(flag: Path) -> None:
    while not flag.exists():
        time.sleep(0.01)


def fail() -> None:
    raise MachineError("m.yaml", "joints.A", "x", "must be a joint")


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def pid() -> int:
    return os.getpid()


def mark(folder: Path) -> None:
    while (folder / "held").exists():
        time.sleep(0.01)
    (folder / str(os.getpid())).touch()


async def gone(process: int) -> bool:
    for _ in range(6000):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        await asyncio.sleep(0.05)
    return False


def test_values_and_exceptions_come_back() -> None:
    async def story() -> None:
        pool = WorkerPool(1, 4, 300.0)
        try:
            assert await pool.run(double, 21) == 42
            with pytest.raises(TaskFailedError) as caught:
                await pool.run(fail)
            assert caught.value.problem.status == 422
            assert caught.value.problem.detail == "m.yaml: joints.A: x: must be a joint"
        finally:
            pool.close()

    asyncio.run(story())


def test_a_task_over_the_limit_is_ended_and_its_worker_replaced() -> None:
    async def story() -> None:
        pool = WorkerPool(1, 4, 300.0)
        try:
            first = await pool.run(pid)
            pool._time_limit = 1.0  # now that its process has started
            with pytest.raises(TimeLimitError, match=r"stopped after 1 s, the time limit of this service$"):
                await pool.run(sleep, 6000.0)
            with pytest.raises(TimeLimitError, match="stopped after 2 s, the time limit of this service for this"):
                await pool.run(sleep, 6000.0, times=2.0)
            pool._time_limit = 300.0
            assert await pool.run(pid) != first
            assert await gone(first)
        finally:
            pool.close()

    asyncio.run(story())


def test_a_worker_that_dies_is_replaced() -> None:
    async def story() -> None:
        pool = WorkerPool(1, 4, 300.0)
        try:
            with pytest.raises(WorkerDiedError):
                await pool.run(die)
            assert await pool.run(double, 1) == 2
        finally:
            pool.close()

    asyncio.run(story())


def test_a_process_that_dies_when_nobody_waits_for_it_any_more_is_waited_for() -> None:
    """Its pool may see its death before it hears that it is to end."""

    async def story() -> None:
        worker = OneProcess(workers.prepare, DEFAULT_LOG)
        try:
            for _ in range(3):  # more than its pool hands on at a time
                worker.submit(pid)
            process = worker.pid
            assert process is not None
            os.kill(process, signal.SIGSTOP)
            starting = asyncio.create_task(workers.run_in(worker, pid, ()))
            await asyncio.sleep(0)
            starting.cancel()
            await asyncio.wait([starting])
            os.kill(process, signal.SIGKILL)
            assert await gone(process)
            assert (await workers.run_in(worker, double, (1,))).value == 2
        finally:
            workers.end(worker)

    asyncio.run(story())


def test_a_process_that_does_not_even_start_is_ended() -> None:
    async def story() -> None:
        before = set(multiprocessing.active_children())  # workers of services that other tests share
        pool = WorkerPool(1, 4, 300.0)
        try:
            starting = asyncio.create_task(pool.run(pid))
            while not (started := set(multiprocessing.active_children()) - before):
                await asyncio.sleep(0)
            (process,) = (each.pid for each in started if each.pid is not None)
            os.kill(process, signal.SIGSTOP)
            starting.cancel()
            await asyncio.wait([starting])
            assert await gone(process)
            assert await pool.run(double, 1) == 2
        finally:
            pool.close()

    asyncio.run(story())


def test_too_many_waiting_tasks_are_refused(tmp_path: Path) -> None:
    async def story() -> None:
        pool = WorkerPool(1, 1, 300.0)
        try:
            await pool.run(pid)
            running = asyncio.create_task(pool.run(wait_for, tmp_path / "flag"))
            waiting = asyncio.create_task(pool.run(double, 3))
            while pool.waiting < 1:
                await asyncio.sleep(0)
            with pytest.raises(BusyError, match="wait for a worker"):
                await pool.run(double, 4)
            (tmp_path / "flag").touch()
            await running
            assert await waiting == 6
        finally:
            pool.close()

    asyncio.run(story())


class Leaving:
    """A client that goes when it is told to, or whose request turns out to be wrong."""

    def __init__(self, why: Exception | None = None) -> None:
        self.gone = asyncio.Event()
        self.why = why

    async def leave(self) -> None:
        await self.gone.wait()
        if self.why is not None:
            raise self.why


@pytest.mark.parametrize("why", [ClientGoneError("the client has gone"), SlowRequestError("too slow")])
def test_a_task_whose_client_has_gone_is_stopped_and_the_next_worker_is_ready(
    why: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(workers, "PATIENCE_S", 0.0)

    async def story() -> None:
        pool = WorkerPool(1, 4, 300.0)
        client = Leaving(why if isinstance(why, SlowRequestError) else None)
        try:
            await pool.warm(mark, tmp_path)
            first = await pool.run(pid)
            with working_for(Client("a", client.leave)):
                task = asyncio.create_task(pool.run(wait_for, tmp_path / "never"))
                behind = asyncio.create_task(pool.run(double, 1))
            while not (pool.busy and pool.waiting):
                await asyncio.sleep(0.01)
            client.gone.set()
            for each in (task, behind):
                with pytest.raises(type(why), match=str(why)):
                    await each
            second = await pool.run(pid)
            assert await gone(first)
            assert {str(first), str(second)} <= {each.name for each in tmp_path.iterdir()}
            assert (pool.busy, pool.waiting) == (0, 0)
        finally:
            pool.close()

    asyncio.run(story())


def test_after_the_first_that_was_ended_another_is_ready_at_once(tmp_path: Path) -> None:
    async def story() -> None:
        pool = WorkerPool(1, 4, 300.0)
        try:
            await pool.warm(mark, tmp_path)
            with pytest.raises(WorkerDiedError):
                await pool.run(die)
            while not pool._ready:  # the spare one
                await asyncio.sleep(0.01)
            loaded = {int(each.name) for each in tmp_path.iterdir()}
            (tmp_path / "held").touch()  # whatever is started now is never ready
            with pytest.raises(WorkerDiedError):
                await pool.run(die)
            assert await pool.run(pid) in loaded
            assert (pool.busy, len(loaded), len(pool.processes())) == (0, 3, 2)
        finally:
            pool.close()

    asyncio.run(story())


def test_a_task_that_is_done_soon_costs_no_worker_though_its_client_has_gone(tmp_path: Path) -> None:
    async def story() -> None:
        pool = WorkerPool(1, 4, 300.0)
        client = Leaving()
        try:
            first = await pool.run(pid)
            with working_for(Client("a", client.leave)):
                task = asyncio.create_task(pool.run(wait_for, tmp_path / "flag"))
            while not pool.busy:
                await asyncio.sleep(0.01)
            client.gone.set()
            with pytest.raises(ClientGoneError):
                await task
            (tmp_path / "flag").touch()
            assert await pool.run(pid) == first
        finally:
            pool.close()

    asyncio.run(story())


def test_a_queue_that_is_full_of_one_has_a_place_for_another(tmp_path: Path) -> None:
    async def story() -> None:
        pool = WorkerPool(1, 3, 300.0)
        try:
            await pool.run(pid)
            with working_for(Client("first")):
                first = [asyncio.create_task(pool.run(wait_for, tmp_path / "flag")) for _ in range(4)]
            while pool.waiting < 3:
                await asyncio.sleep(0)
            with working_for(Client("second")):
                second = asyncio.create_task(pool.run(double, 2))
            with pytest.raises(BusyError):
                await first[3]
            ended: list[asyncio.Task[object]] = []
            for each in (*first[:3], second):
                each.add_done_callback(ended.append)
            (tmp_path / "flag").touch()
            assert await second == 4
            await asyncio.gather(*first[:3])
            assert ended == [first[0], second, first[1], first[2]]
        finally:
            pool.close()

    asyncio.run(story())
