"""Threads of the server that take builds from the queue, each in a process of its own, and watch over it."""

from __future__ import annotations

import atexit
import logging
import multiprocessing
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any

from sqlalchemy.exc import SQLAlchemyError

from jointplay.app.jobs.build_process import BuildProgress, Order, work
from jointplay.app.logs import DEFAULT_LOG, LogSettings, of_request
from jointplay.app.storage.build_queue import BuildQueue, BuildRow

log = logging.getLogger(__name__)

LOOK_S = 1.0
"""Time between looks into the queue: another server may have been asked."""


class BuildRunner:
    """Does the builds of a queue, a few at a time.

    Parameters
    ----------
    queue : BuildQueue
    folder : Path
        Where the catalogues are.
    count : int
        Builds at a time; 0 leaves them to other servers of the same database.
    lease_s : float
        How long a build stays with a server that gives no sign of life.
    task : callable, optional
        What is done in a build's process.
    log : LogSettings
        How such a process writes its log.
    scheduler : str
        Of the Dask cluster that computes; without one, processes here do.
    """

    def __init__(
        self,
        queue: BuildQueue,
        folder: Path,
        count: int,
        lease_s: float,
        task: Callable[[Order, Connection], None] = work,
        log: LogSettings = DEFAULT_LOG,
        scheduler: str = "",
    ) -> None:
        self._scheduler = scheduler
        self._log_settings = log
        self._task = task
        self._queue, self._folder, self._lease_s = queue, folder, lease_s
        self._beat_s = min(0.5, lease_s / 4)
        self._stop = threading.Event()
        self._wake = threading.Event()
        self._threads = [
            threading.Thread(target=self._serve, name=f"build-{number}", daemon=True) for number in range(count)
        ]

    def start(self) -> None:
        """Begin to look for builds."""
        atexit.register(self.close)  # a server that is forced to end would wait for the processes otherwise
        for thread in self._threads:
            thread.start()

    def wake(self) -> None:
        """Look into the queue at once."""
        self._wake.set()

    def stop(self) -> None:
        """Let the threads end; they end the processes, and give their builds back to the queue."""
        self._stop.set()
        self._wake.set()

    def close(self) -> None:
        """Stop, and wait until that is done."""
        atexit.unregister(self.close)
        self.stop()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()

    def _serve(self) -> None:
        while not self._stop.is_set():
            # A new name each time: what a former attempt of this server still writes must not pass for this one.
            owner = f"{socket.gethostname()}:{os.getpid()}:{secrets.token_hex(4)}"
            self._wake.clear()
            try:
                row = self._queue.claim(owner, self._lease_s)
                if row is not None:
                    with of_request(row.request_id):
                        self._run(row, owner)
                    continue
            except SQLAlchemyError as error:
                log.warning("builds wait for the database: %s", str(error).partition("\n")[0])
            except Exception:
                log.exception("a build could not be begun")
            self._wake.wait(LOOK_S)

    def _run(self, row: BuildRow, owner: str) -> None:
        log.info("build %s of catalogue %s: attempt %d", row.id, row.catalogue, row.attempts)
        context = multiprocessing.get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        order = Order(
            row.machine,
            row.plan,
            self._folder / row.catalogue,
            row.workers,
            self._log_settings,
            self._scheduler,
            row.request_id,
        )
        process = context.Process(target=self._task, args=(order, sender), name=f"build-{row.id}")
        try:
            process.start()
            sender.close()
            note = self._watch(row, owner, process, receiver)
        finally:
            if process.pid is not None:
                process.kill()
                process.join()
            receiver.close()
        self._persist(note)

    def _watch(
        self, row: BuildRow, owner: str, process: SpawnProcess, receiver: Connection
    ) -> Callable[[], None] | None:
        """Follow a build to its end; returns what is to be written down of it."""
        queue, told = self._queue, dict[str, Any]()
        held_until = time.monotonic() + self._lease_s
        while not self._stop.is_set():
            word, ended = receive(receiver, self._beat_s, told)
            if word is not None and word.kind != "progress":
                return partial(queue.end, row.id, owner, word.kind, told)
            if ended:
                process.join()
                message = f"its process ended early (exit status {process.exitcode})"
                log.error("build %s: %s", row.id, message)
                return lambda: queue.lose(row.id, owner, message)
            asked = time.monotonic()
            try:
                beat = queue.beat(row.id, owner, self._lease_s, told)
            except SQLAlchemyError as error:
                log.warning("build %s: no sign of life can be given: %s", row.id, str(error).partition("\n")[0])
                if time.monotonic() < held_until:
                    continue
                return None  # it may be another server's by now
            if not beat.owned:
                log.warning("build %s: another server has it now", row.id)
                return None
            if beat.cancel:
                return lambda: queue.end(row.id, owner, "cancelled", {"message": ""})
            held_until = asked + self._lease_s
            told.clear()
        return lambda: queue.release(row.id, owner)

    def _persist(self, note: Callable[[], None] | None) -> None:
        """Write down how a build ended, as soon as the database can be had.

        What is not written before the server stops is found out by the next: it takes the build up, and finds it done.
        """
        while note is not None:
            try:
                return note()
            except SQLAlchemyError as error:
                log.warning("the end of a build cannot be noted: %s", str(error).partition("\n")[0])
            if self._stop.wait(LOOK_S):
                with suppress(SQLAlchemyError):
                    note()
                return None
        return None


def receive(receiver: Connection, seconds: float, told: dict[str, Any]) -> tuple[BuildProgress | None, bool]:
    """Add what a process tells within some time to `told`; returns its last word, and whether it went without one."""
    try:
        while receiver.poll(seconds):
            word: BuildProgress = receiver.recv()
            told.update(word.values)
            if word.kind != "progress":
                return word, False
            seconds = 0.0
    except (EOFError, OSError):
        return None, True
    return None, False
