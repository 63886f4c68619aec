"""Worker processes for everything that computes longer than a moment, each task under a time limit.

A thread cannot be stopped, a process can: a recording that takes too long or eats the memory costs one
worker, which is replaced, and never the service. So does a task whose client has gone, if it is not done soon.
"""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any, Protocol

from jointplay.app import logs
from jointplay.app.errors import ClientGoneError, TimeLimitError, WorkerDiedError
from jointplay.app.jobs.clients import client_here
from jointplay.app.jobs.turns import Turns
from jointplay.app.logs import DEFAULT_LOG, LogSettings
from jointplay.app.problems import Problem, problem_of
from jointplay.catalogue.processes import OneProcess, become_worker

log = logging.getLogger(__name__)

PATIENCE_S, MOST_PATIENCE_S = 5.0, 30.0
"""Time that a task goes on without its client [s]: as long as the last new process took, within these bounds."""


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


def attempt(task: Callable[..., Any], args: Sequence[Any]) -> WorkerOutcome:
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


def attempt_for(request: str | None, task: Callable[..., Any], args: Sequence[Any]) -> WorkerOutcome:
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
    """A fixed number of workers and a queue of limited length in front of them, with a lane for each client.

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
        self._time_limit = time_limit
        self._turns: Turns[OneProcess] = Turns(queue_limit)
        self._workers = [OneProcess(prepare, log_settings) for _ in range(workers)]
        self._free = list(self._workers)
        self._count, self._missing = workers, 0
        self._spare = OneProcess(prepare, log_settings)
        self._ready: list[OneProcess] = []
        self._price = 0.0
        self._first: tuple[Callable[..., Any], tuple[Any, ...]] | None = None
        self._behind: set[asyncio.Task[None]] = set()

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
        ClientGoneError
            When whoever asked has gone; the task has a little time to be done, and then its process is ended.
        """
        client, asked = client_here(), time.perf_counter()
        place = self._turns.join(client.name)
        self._hand_out()
        leaving = asyncio.ensure_future(client.leave())
        leaving.add_done_callback(lambda each: each.cancelled() or each.exception())  # perhaps nobody asks for it
        working: asyncio.Task[WorkerOutcome] | None = None
        try:
            await first_of(place, leaving)
            if not place.done():
                raise gone(leaving)
            working = asyncio.create_task(self._work(place.result(), client.name, asked, times, task, args))
            await first_of(working, leaving)
            if not working.done():
                patience = min(max(PATIENCE_S, self._price), MOST_PATIENCE_S)
                self._keep(asyncio.create_task(let_end(working, patience)))
                raise gone(leaving)
            return working.result().result()
        except asyncio.CancelledError:
            if working is not None:
                working.cancel()
                await asyncio.wait([working])
            raise
        finally:
            leaving.cancel()
            if working is None:
                self._give_up(client.name, place)

    async def _work(
        self,
        worker: OneProcess,
        client: str,
        asked: float,
        times: float,
        task: Callable[..., Any],
        args: tuple[Any, ...],
    ) -> WorkerOutcome:
        """Run a task in a worker that was got for it, and give the worker back."""
        limit, said = times * self._time_limit, "" if times == 1.0 else " for this"
        began = time.perf_counter()
        came_to = "failed"
        try:
            async with asyncio.timeout(limit):
                outcome = await run_in(worker, task, args)
            came_to = outcome.kind
        except TimeoutError:
            came_to = "time-limit"
            raise TimeLimitError(f"stopped after {limit:g} s, the time limit of this service{said}") from None
        except (BrokenProcessPool, OSError):
            came_to = "worker-died"
            raise WorkerDiedError("the process that computed this ended early, perhaps for want of memory") from None
        except asyncio.CancelledError:
            came_to = "cancelled"
            raise
        finally:
            self._turns.end(client)
            if came_to in ("time-limit", "worker-died", "cancelled"):
                end(worker)
                self._replace(worker)
            else:
                self._put_back(worker)
            if self._watch is not None:
                self._watch.count_wait(task.__name__, began - asked)
                self._watch.count_work(task.__name__, came_to, time.perf_counter() - began)
        return outcome

    async def warm(self, task: Callable[..., Any], *args: Any) -> None:
        """Run a task in every worker that is free, and from now on in every new process before it gets another."""
        self._first = (task, args)
        self._missing, free, self._free = self._missing + len(self._free), self._free, []
        await asyncio.gather(*(self._refill(worker) for worker in free))

    def _replace(self, worker: OneProcess) -> None:
        """Put a process that is ready in the place of one that was ended, and let that one load behind."""
        if self._ready:
            self._put_back(self._ready.pop())
        elif self._first is None:
            self._put_back(worker)
            return
        else:
            self._missing += 1
        self._keep(asyncio.create_task(self._recover(worker)))

    async def _recover(self, worker: OneProcess) -> None:
        """Let a process load; from the first that was ended on there is one more than work."""
        await self._refill(worker)
        if self._spare not in self._workers:
            self._workers.append(self._spare)
            await self._refill(self._spare)

    async def _refill(self, worker: OneProcess) -> None:
        """Let a process load what tasks need, and then have tasks where one is missing."""
        assert self._first is not None
        (task, args), began = self._first, time.perf_counter()
        try:
            async with asyncio.timeout(self._time_limit):
                await run_in(worker, task, args)
            self._price = time.perf_counter() - began
        except (TimeoutError, BrokenProcessPool, OSError) as error:
            log.warning("a new worker could not be made ready: %s", str(error) or type(error).__name__)
            end(worker)
        except asyncio.CancelledError:
            end(worker)
            raise
        finally:
            if self._missing:
                self._missing -= 1
                self._put_back(worker)
            else:
                self._ready.append(worker)

    def _keep(self, task: asyncio.Task[None]) -> None:
        """Hold a task that nobody waits for until it is done."""
        self._behind.add(task)
        task.add_done_callback(self._behind.discard)

    def _put_back(self, worker: OneProcess) -> None:
        self._free.append(worker)
        self._hand_out()

    def _hand_out(self) -> None:
        while self._free and self._turns.serve(self._free[0]):
            del self._free[0]

    def _give_up(self, client: str, place: asyncio.Future[OneProcess]) -> None:
        """Leave the queue, or give a worker back that was got too late."""
        self._turns.leave(client, place)
        if place.done() and not place.cancelled() and place.exception() is None:
            self._turns.end(client)
            self._put_back(place.result())

    @property
    def waiting(self) -> int:
        """Number of tasks that wait for a worker."""
        return len(self._turns)

    @property
    def busy(self) -> int:
        """Number of workers that have a task."""
        return self._count - len(self._free)

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
            if not self._free:
                return True  # all of them are at work, and each under its time limit
            worker = self._free.pop(0)
            try:
                async with asyncio.timeout(seconds):
                    await run_in(worker, os.getpid, ())
                return True
            except (TimeoutError, BrokenProcessPool, OSError) as error:
                log.warning("a worker does not answer: %s", str(error) or type(error).__name__)
                end(worker)
            except asyncio.CancelledError:
                end(worker)
                raise
            finally:
                self._put_back(worker)
        return False

    def close(self) -> None:
        """End all processes."""
        self._first = None
        for task in self._behind:
            task.cancel()
        for worker in self._workers:
            end(worker)


async def first_of(wanted: asyncio.Future[Any], leaving: asyncio.Future[None]) -> None:
    """Wait for what is wanted, or for the client to go."""
    await asyncio.wait({wanted, leaving}, return_when=asyncio.FIRST_COMPLETED)


def gone(leaving: asyncio.Future[None]) -> Exception:
    """Return why nobody waits for an answer any more."""
    return leaving.exception() or ClientGoneError("the client has gone")  # type: ignore[return-value]


async def let_end(working: asyncio.Task[WorkerOutcome], patience: float) -> None:
    """Give a task that nobody waits for the time that a new process would take [s], and then stop it."""
    try:
        await asyncio.wait([working], timeout=patience)
    finally:
        working.cancel()
        await asyncio.gather(working, return_exceptions=True)


async def run_in(
    worker: OneProcess,
    task: Callable[..., Any],
    args: Sequence[Any],
    attempted: Callable[..., WorkerOutcome] = attempt_for,
) -> WorkerOutcome:
    """Run one task in a process, for the request that this is about."""
    # Whoever no longer waits does not cancel it: of a process that died, the pool reports to every future, and ends at
    # one that is cancelled (Python 3.11.7), so that the process is never waited for. What it was at ends with it.
    return await asyncio.shield(asyncio.wrap_future(worker.submit(attempted, logs.request_id(), task, args)))


def end(worker: OneProcess) -> None:
    """Stop a process now; the next task gets a new one."""
    worker.close(at_once=True, wait=False)
