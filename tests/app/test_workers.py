"""Workers end what takes too long or dies, and go on with the next task."""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest

from jointplay.app.errors import BusyError, TimeLimitError, WorkerDiedError
from jointplay.app.jobs.workers import TaskFailedError, WorkerPool
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
