"""Where chunks are computed: in processes of this computer, or in this process; a cluster fits the same shape."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from typing import Protocol, TypeVar

from jointplay.catalogue.processes import OneProcess

A = TypeVar("A")
R = TypeVar("R")


def count_processors() -> int:
    """Return the number of processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Executor(Protocol):
    """Computes tasks somewhere."""

    @property
    def capacity(self) -> int:
        """Tasks worth having in flight; more would only wait."""
        ...

    def submit(self, task: Callable[[A], R], argument: A) -> Future[R]:
        """Begin ``task(argument)``; both, and the result, must be picklable."""
        ...

    def is_loss(self, error: BaseException) -> bool:
        """Whether a future's exception means that the place of work was lost, not that the task failed."""
        ...

    def is_blameless(self, error: BaseException) -> bool:
        """Whether the loss had nothing to do with the task, so that it is begun again without counting."""
        ...

    def close(self, *, at_once: bool = False) -> None:
        """Give everything back; `at_once` ends tasks in flight."""
        ...


class InProcess:
    """Computes in this process, one task after the other, each within :meth:`submit`."""

    capacity = 1

    def submit(self, task: Callable[[A], R], argument: A) -> Future[R]:
        """Compute ``task(argument)`` now."""
        future: Future[R] = Future()
        try:
            future.set_result(task(argument))
        except Exception as error:
            future.set_exception(error)
        return future

    def is_loss(self, error: BaseException) -> bool:
        """Never: with this process the build ends, too."""
        return False

    def is_blameless(self, error: BaseException) -> bool:
        """Never."""
        return False

    def close(self, *, at_once: bool = False) -> None:
        """Nothing to give back."""


class LocalProcesses:
    """Worker processes on this computer, each with one thread of arithmetic.

    A death concerns exactly the task that the worker had. Workers end when this process ends, however it ends.

    Parameters
    ----------
    workers : int
        Number of processes, >= 1.
    """

    def __init__(self, workers: int) -> None:
        self._workers = [OneProcess() for _ in range(workers)]

    @property
    def capacity(self) -> int:
        """One task a worker."""
        return len(self._workers)

    def submit(self, task: Callable[[A], R], argument: A) -> Future[R]:
        """Begin a task on a free worker, or queue it where there is none."""
        worker = next((worker for worker in self._workers if worker.is_free), self._workers[0])
        return worker.submit(task, argument)

    def is_loss(self, error: BaseException) -> bool:
        """Whether the worker died: killed, out of memory, crashed."""
        return isinstance(error, BrokenProcessPool)

    def is_blameless(self, error: BaseException) -> bool:
        """Never: a worker that dies may have died of its task."""
        return False

    def close(self, *, at_once: bool = False) -> None:
        """End the workers: after their tasks, or now."""
        for worker in self._workers:
            worker.close(at_once=at_once)
