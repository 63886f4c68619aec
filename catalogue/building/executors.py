"""Where chunks are computed: in processes of this computer, or in this process; a cluster fits the same shape."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, TypeVar

_STARTING = threading.Lock()

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

    Every worker is a pool of one, so that a death concerns exactly the task it had; the next task in its place gets a
    new process. Workers end when this process ends, however it ends.

    Parameters
    ----------
    workers : int
        Number of processes, >= 1.
    """

    def __init__(self, workers: int) -> None:
        self._slots = [_Slot() for _ in range(workers)]

    @property
    def capacity(self) -> int:
        """One task a worker."""
        return len(self._slots)

    def submit(self, task: Callable[[A], R], argument: A) -> Future[R]:
        """Begin a task on a free worker, or queue it where there is none."""
        slot = next((slot for slot in self._slots if slot.is_free), self._slots[0])
        return slot.submit(task, argument)

    def is_loss(self, error: BaseException) -> bool:
        """Whether the worker died: killed, out of memory, crashed."""
        return isinstance(error, BrokenProcessPool)

    def is_blameless(self, error: BaseException) -> bool:
        """Never: a worker that dies may have died of its task."""
        return False

    def close(self, *, at_once: bool = False) -> None:
        """End the workers: after their tasks, or now."""
        for slot in self._slots:
            slot.close(at_once)


class _Slot:
    """Place for one worker process, started when it is first needed."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._processes: set[BaseProcess] = set()
        self._last: Future[Any] | None = None

    @property
    def is_free(self) -> bool:
        return self._last is None or self._last.done()

    def submit(self, task: Callable[[A], R], argument: A) -> Future[R]:
        with _interrupts_held():  # the worker inherits that: Ctrl-C is for the builder, which ends the workers
            try:
                future = self._started().submit(task, argument)
            except BrokenProcessPool:  # it died after its last task, or with it
                self._pool = None
                future = self._started().submit(task, argument)
        self._last = future
        return future

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(1, context, initializer=_become_worker)
            with _STARTING:  # the pool keeps its process to itself: it is the one that is new after the first task
                others = set(multiprocessing.active_children())
                self._pool.submit(os.getpid)
                self._processes = set(multiprocessing.active_children()) - others
        return self._pool

    def close(self, at_once: bool) -> None:
        if self._pool is None:
            return
        if at_once:
            for process in self._processes:
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = None


@contextlib.contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold SIGINT back until the end of the block, here and in processes started meanwhile.

    A blocked signal still reaches Python through any other thread of the process (those of linear algebra libraries do
    not block it), so that the main thread would be interrupted between a worker's start and the sending of its orders;
    hence the handler that only takes note.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # or starting it with the first worker would let the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    held: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    mine = threading.current_thread() is threading.main_thread() and handler is not None
    try:
        if mine:
            signal.signal(signal.SIGINT, lambda number, frame: held.append(number))
        yield
    finally:
        if mine:
            signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if held:
            signal.raise_signal(signal.SIGINT)


def _become_worker() -> None:
    """First act of a worker process: one thread of arithmetic, no ear for Ctrl-C, and an end with the builder's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    from threadpoolctl import threadpool_limits  # for libraries that are loaded already

    threadpool_limits(1)
    threading.Thread(target=_end_with_builder, name="end-with-builder", daemon=True).start()


def _end_with_builder() -> None:
    """Wait for the death of the builder, which a blocked worker would not notice by itself."""
    builder = multiprocessing.parent_process()
    if builder is not None:
        builder.join()
        os._exit(1)
