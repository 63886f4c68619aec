"""Answers that take longer than a request may: work at them goes on in a process behind all others.

Whoever asks again is told how far it is, and then has the answer. Nothing of that outlives the server but the cases of
a known machine, which are kept in the folder of the catalogue: what is asked again goes on from there.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from ctypes import Array, c_longlong
from functools import partial, wraps
from http import HTTPStatus
from typing import Any

from cachetools import TTLCache

from jointplay.app.jobs.clients import client_here
from jointplay.app.jobs.workers import WorkerOutcome, attempt_for, end, prepare, run_in
from jointplay.app.logs import DEFAULT_LOG, LogSettings
from jointplay.catalogue.processes import OneProcess

log = logging.getLogger(__name__)

MOST, MOST_OF_ONE = 8, 2
"""Answers that are worked at, or wait for that, and those of one client: with the usual limit of time the last waits
for less than a day, for which copies of uploads are left alone."""

KEPT, KEPT_S = 64, 86_400.0
"""Answers that are kept for whoever asks again, and for how long [s]."""

LIMITS = 60.0
"""How many times the limit of one task in a worker an answer may take here: two hours, where that is 120 s."""

UNFIT = HTTPStatus.UNPROCESSABLE_ENTITY
"""Status of a refusal that stays: what was sent breaks a rule."""

NICE = 10
"""By how much this process stands behind those that answer requests."""


class Background:
    """Goes on with answers, one after the other.

    Parameters
    ----------
    time_limit : float
        Of one task in a worker [s].
    log_settings : LogSettings
        How the process writes its log.
    """

    def __init__(self, time_limit: float, log_settings: LogSettings = DEFAULT_LOG) -> None:
        self._limit = LIMITS * time_limit
        # Without a lock: a process that is ended while it holds one would never give it back.
        self._counts = multiprocessing.get_context("spawn").Array("q", 2, lock=False)
        self._process = OneProcess(stand_behind, log_settings, self._counts)
        self._turn = asyncio.Lock()
        self._at_work: dict[str, tuple[str, asyncio.Task[None]]] = {}
        self._current = ""
        self._made: TTLCache[str, WorkerOutcome] = TTLCache(KEPT, KEPT_S)

    def go_on(
        self, key: str, task: Callable[..., Any], args: Sequence[Any], done: Callable[[], None] = lambda: None
    ) -> bool:
        """Begin to work at an answer, after those before it.

        Parameters
        ----------
        key : str
            What it is called; nothing is begun twice.
        task : callable
            One of :mod:`~jointplay.app.jobs.tasks` that takes `progress`.
        args : sequence
            Its arguments.
        done : callable, optional
            Called once when it has ended, however it did, and at once where there is nothing to begin.

        Returns
        -------
        bool
            Whether it is worked at: too many others may be.
        """
        name = client_here().name
        of_one = sum(client == name for client, _ in self._at_work.values())
        if key in self._at_work or len(self._at_work) >= MOST or of_one >= MOST_OF_ONE:
            done()
            return key in self._at_work
        working = asyncio.create_task(self._work(key, task, args))
        self._at_work[key] = name, working

        def end_of(_: asyncio.Task[None]) -> None:
            del self._at_work[key]
            done()

        working.add_done_callback(end_of)
        return True

    async def wait(self, key: str, seconds: float) -> WorkerOutcome | None:
        """Return what came of an answer; wait for it, where it is worked at, for so long [s] at most."""
        if key in self._at_work:
            _, working = self._at_work[key]
            await asyncio.wait([working], timeout=seconds)
        return self._made.get(key)

    def is_at_work(self, key: str) -> bool:
        """Return whether an answer is worked at, or waits for that."""
        return key in self._at_work

    def say(self, key: str) -> str:
        """Say in a few words how far the work at an answer is."""
        if self._current not in ("", key):
            return "others are before it"
        done, total = self._counts if self._current else (0, 0)
        return f"{done} of {total} cases of this machine are simulated" if total else "it has begun"

    async def _work(self, key: str, task: Callable[..., Any], args: Sequence[Any]) -> None:
        async with self._turn:
            self._current, self._counts[:] = key, (0, 0)
            try:
                async with asyncio.timeout(self._limit):
                    outcome = await run_in(self._process, task, args, attempt_in_sight)
                if outcome.problem is None or outcome.problem.status == UNFIT:
                    self._made[key] = outcome
                else:  # a disk that is full, a file that is missing: it may be mended when it is asked again
                    log.warning("an answer is not gone on with: %s", outcome.problem.detail)
                if len(self._at_work) == 1:  # none waits: to start one takes seconds, this one would keep its memory
                    end(self._process)
            except (TimeoutError, BrokenProcessPool, OSError) as error:
                log.warning("an answer is not gone on with: %s", str(error) or type(error).__name__)
                end(self._process)
            except asyncio.CancelledError:
                end(self._process)
                raise
            finally:
                self._current = ""

    def processes(self) -> list[tuple[str, int]]:
        """Return name and id of the process, where it was started."""
        return [] if self._process.pid is None else [("background", self._process.pid)]

    async def close(self) -> None:
        """End the work, and the process."""
        working = [task for _, task in self._at_work.values()]
        for task in working:
            task.cancel()
        await asyncio.gather(*working, return_exceptions=True)
        end(self._process)


_counts: Array[c_longlong] | None = None
"""In the process behind: cases done, and their total, seen by who started it."""


def stand_behind(log_settings: LogSettings, counts: Array[c_longlong]) -> None:
    """Set the process up, behind all others."""
    global _counts
    _counts = counts
    if hasattr(os, "nice"):
        os.nice(NICE)
    prepare(log_settings)


def attempt_in_sight(request: str | None, task: Callable[..., Any], args: Sequence[Any]) -> WorkerOutcome:
    """Run a task for the request of an id, and let who started this process see how far it is."""
    return attempt_for(request, wraps(task)(partial(task, progress=_tell)), args)


def _tell(done: int, total: int) -> None:
    if _counts is not None:
        _counts[:] = [done, total]
