"""Worker processes for everything that computes longer than a moment, each task under a time limit.

A thread cannot be stopped, a process can: a recording that takes too long or eats the memory costs one
worker, which is replaced, and never the service.
"""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol

from jointplay.app import logs
from jointplay.app.errors import BusyError, TimeLimitError, WorkerDiedError
from jointplay.app.logs import DEFAULT_LOG, LogSettings
from jointplay.app.problems import Problem, problem_of
from jointplay.catalogue.processes import OneProcess, become_worker

log = logging.getLogger(__name__)


class TaskFailedError(Exception):
    """A task raised; the answer to its exception was made in the worker, where the exception was whole."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.detail)
        self.problem = problem


@dataclass(frozen=True)
class WorkerOutcome:
    """What comes back from a worker: a value or a problem."""

    value: Any = None
    problem: Problem | None = None

    @property
    def kind(self) -> str:
        """Return whether it is a value (ok), or the fault of who asked (refused) or of the program (failed)."""
        if self.problem is None:
            return "ok"
        return "refused" if self.problem.status < 500 else "failed"

    def result(self) -> Any:
        """Return the value.

        Raises
        ------
        TaskFailedError
            When there is a problem in its place.
        """
        if self.problem is not None:
            raise TaskFailedError(self.problem)
        return self.value


def prepare(log_settings: LogSettings) -> None:
    """Set a fresh worker up, and its log."""
    logs.configure(log_settings)
    become_worker()


def attempt(task: Callable[..., Any], args: tuple[Any, ...]) -> WorkerOutcome:
    """Run a task in the worker and send its exception back as a problem, because not every exception can be sent."""
    log.debug("task %s begins", task.__name__)
    try:
        return WorkerOutcome(value=task(*args))
    except Exception as error:
        problem = problem_of(error)
        if problem.status >= 500:
            log.exception("task %s failed", task.__name__)
        return WorkerOutcome(problem=problem)
    finally:
        log.debug("task %s has ended", task.__name__)


def attempt_for(request: str | None, task: Callable[..., Any], args: tuple[Any, ...]) -> WorkerOutcome:
    """Run a task for the request of an id."""
    with logs.of_request(request):
        return attempt(task, args)


class Watch(Protocol):
    """Is told how long tasks wait and work."""

    def count_wait(self, task: str, seconds: float) -> None:
        """A task has got a worker."""

    def count_work(self, task: str, outcome: str, seconds: float) -> None:
        """A worker is done with a task: ok, refused, failed, time-limit, worker-died, cancelled."""


class WorkerPool:
    """A fixed number of workers and a queue of limited length in front of them.

    Parameters
    ----------
    workers : int
        Number of processes.
    queue_limit : int
        Number of tasks that may wait.
    time_limit : float
        Longest time of one task [s]; waiting in the queue does not count.
    log_settings : LogSettings
        How the processes write their log.
    watch : Watch, optional
    """

    def __init__(
        self,
        workers: int,
        queue_limit: int,
        time_limit: float,
        log_settings: LogSettings = DEFAULT_LOG,
        watch: Watch | None = None,
    ) -> None:
        self._watch = watch
        self._queue_limit = queue_limit
        self._time_limit = time_limit
        self._waiting = 0
        self._workers = [OneProcess(prepare, log_settings) for _ in range(workers)]
        self._free: asyncio.Queue[OneProcess] = asyncio.Queue()
        for worker in self._workers:
            self._free.put_nowait(worker)

    async def run(self, task: Callable[..., Any], *args: Any, times: float = 1.0) -> Any:
        """Run a task in a worker and return its value.

        Parameters
        ----------
        task : callable
            A function at the top of a module.
        *args
            Its arguments; they must be picklable.
        times : float, optional
            How many times the limit of time it may take.

        Raises
        ------
        BusyError
            When too many tasks wait already.
        TimeLimitError
            When the task takes too long; its process is ended.
        TaskFailedError
            When the task raised.
        WorkerDiedError
            When the process ended early.
        """
        if self._waiting >= self._queue_limit:
            raise BusyError(f"{self._waiting} requests wait for a worker already; try again in a few seconds")
        self._waiting += 1
        asked = time.perf_counter()
        try:
            worker = await self._free.get()
        finally:
            self._waiting -= 1
        limit, said = times * self._time_limit, "" if times == 1.0 else " for this"
        began = time.perf_counter()
        came_to = "failed"
        try:
            async with asyncio.timeout(limit):
                outcome = await run_in(worker, task, args)
            came_to = outcome.kind
        except TimeoutError:
            came_to = "time-limit"
            end(worker)
            raise TimeLimitError(f"stopped after {limit:g} s, the time limit of this service{said}") from None
        except (BrokenProcessPool, OSError):
            came_to = "worker-died"
            end(worker)
            raise WorkerDiedError("the process that computed this ended early, perhaps for want of memory") from None
        except asyncio.CancelledError:
            came_to = "cancelled"
            end(worker)
            raise
        finally:
            self._free.put_nowait(worker)
            if self._watch is not None:
                self._watch.count_wait(task.__name__, began - asked)
                self._watch.count_work(task.__name__, came_to, time.perf_counter() - began)
        return outcome.result()

    @property
    def waiting(self) -> int:
        """Number of tasks that wait for a worker."""
        return self._waiting

    @property
    def busy(self) -> int:
        """Number of workers that have a task."""
        return len(self._workers) - self._free.qsize()

    def processes(self) -> list[tuple[str, int]]:
        """Return names and ids of the processes that were started."""
        started = ((number, worker.pid) for number, worker in enumerate(self._workers))
        return [(f"worker-{number}", pid) for number, pid in started if pid is not None]

    async def check(self, seconds: float) -> bool:
        """Return whether there is a worker that works; one that died meanwhile is replaced.

        Parameters
        ----------
        seconds : float
            Longest time that a process may take to start.
        """
        for _ in range(2):  # the second time with a fresh one
            try:
                worker = self._free.get_nowait()
            except asyncio.QueueEmpty:
                return True  # all of them are at work, and each under its time limit
            try:
                async with asyncio.timeout(seconds):
                    await run_in(worker, os.getpid, ())
                return True
            except (TimeoutError, BrokenProcessPool, OSError) as error:
                log.warning("a worker does not answer: %s", error or type(error).__name__)
                end(worker)
            except asyncio.CancelledError:
                end(worker)
                raise
            finally:
                self._free.put_nowait(worker)
        return False

    def close(self) -> None:
        """End all processes."""
        for worker in self._workers:
            end(worker)


async def run_in(worker: OneProcess, task: Callable[..., Any], args: tuple[Any, ...]) -> WorkerOutcome:
    """Run one task in a process, for the request that this is about."""
    return await asyncio.wrap_future(worker.submit(attempt_for, logs.request_id(), task, args))


def end(worker: OneProcess) -> None:
    """Stop a process now; the next task gets a new one."""
    worker.close(at_once=True, wait=False)
