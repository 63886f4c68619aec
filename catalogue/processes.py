"""Processes that work for this one: one task at a time, one thread of arithmetic, and an end with ours."""

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
from typing import Any, TypeVar, cast

#: Environment of a process whose libraries of linear algebra shall not start threads: others compute beside it.
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}

R = TypeVar("R")


class OneProcess:
    """A pool of one process, started with the first task; after a death the next task gets a new one.

    Parameters
    ----------
    prepare : callable
        First act of the process: :func:`become_worker`, or what calls it.
    *arguments
        Its arguments; they must be picklable.
    """

    def __init__(self, prepare: Callable[..., None] | None = None, *arguments: Any) -> None:
        self._prepare = (prepare or become_worker, arguments)
        self._pool: ProcessPoolExecutor | None = None
        self._last: Future[Any] | None = None

    @property
    def is_free(self) -> bool:
        """Whether it has no task."""
        return self._last is None or self._last.done()

    @property
    def pid(self) -> int | None:
        """Id of the process; ``None`` where there is none."""
        return next(iter(self._processes()), None)

    def submit(self, task: Callable[..., R], *arguments: Any) -> Future[R]:
        """Begin ``task(*arguments)``, after the tasks before it; all of it, and the result, must be picklable."""
        try:
            future = self._started().submit(task, *arguments)
        except BrokenProcessPool:  # it died after its last task, or with it
            self._pool = None
            future = self._started().submit(task, *arguments)
        self._last = future
        return future

    def close(self, *, at_once: bool = False, wait: bool = True) -> None:
        """End the process, after its tasks or in the middle of one; the next task would get a new one.

        Parameters
        ----------
        at_once : bool
            Whether it is killed, even while it starts.
        wait : bool
            Whether this call waits for its end.
        """
        if self._pool is None:
            return
        pool, self._pool, self._last = self._pool, None, None
        if not at_once:
            pool.shutdown(wait=wait, cancel_futures=True)
            return
        processes, manager = dict(pool._processes), cast("threading.Thread | None", pool._executor_manager_thread)
        results = pool._result_queue._writer  # type: ignore[attr-defined]  # no other way to it
        # The pool's thread has to know first: of a process whose death it sees before, it reports to every future, ends
        # at one that was cancelled (seen in Python 3.11.7), and the process is never waited for.
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes.values():  # kill_workers() from Python 3.14 on
            process.kill()
        # Of a process that is killed while it sends a result, the pool would wait for the rest of it for ever: the pipe
        # has no end as long as this process could write into it, too.
        results.close()
        if wait and manager is not None:
            manager.join()

    def _processes(self) -> dict[int, Any]:
        return dict((self._pool and self._pool._processes) or {})

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            prepare, arguments = self._prepare
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(1, context, initializer=prepare, initargs=arguments)
            with _interrupts_held():  # the process inherits that: Ctrl-C is for us, who end it
                self._pool.submit(os.getpid)  # a pool starts its process with the first task
        return self._pool


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


def become_worker() -> None:
    """Make this process a worker: one thread of arithmetic, no ear for Ctrl-C, and an end with who started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(ONE_THREAD)
    from threadpoolctl import threadpool_limits  # for libraries that are loaded already

    threadpool_limits(1)
    threading.Thread(target=_end_with_parent, name="end-with-parent", daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the death of who started this process, which a blocked worker would not notice by itself."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
