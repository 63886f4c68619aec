"""Builds that are followed: one look at each for however many listen, and what it shows goes to all of them."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import threading
import time
from collections import Counter
from collections.abc import AsyncGenerator, Iterator
from contextlib import contextmanager

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import AppError, RateLimitedError
from jointplay.app.storage.build_queue import ENDED, BuildQueue, BuildRow, build_out

log = logging.getLogger(__name__)

LOOK_S = 0.5
HEARTBEAT_S = 15.0
MOST_OF_ONE = 50
"""Streams that one key, or one address without key, may listen to at a time."""


class Watched:
    """One build that somebody follows.

    Attributes
    ----------
    text : str
        How it was when it was last looked at.
    over : bool
        Whether there is nothing more to come.
    listeners : int
    news : asyncio.Event
        Set with the next change, and then another.
    """

    def __init__(self) -> None:
        self.text, self.over, self.listeners = "", False, 0
        self._looked = 0.0
        self.news = asyncio.Event()

    def tell(self, row: BuildRow, moment: float) -> None:
        """Take what a look has shown that began at a moment; one that began before the last that counted is late."""
        text = build_out(row).model_dump_json()
        if moment >= self._looked and text != self.text:
            self.text, self.over, self._looked = text, row.state in ENDED, moment
            self._wake()

    def end(self) -> None:
        """Let all listeners end."""
        self.over = True
        self._wake()

    def _wake(self) -> None:
        news, self.news = self.news, asyncio.Event()
        news.set()


class BuildWatch:
    """Looks at builds that are followed.

    Parameters
    ----------
    queue : BuildQueue
    stopping : threading.Event
        When it is set, nothing is followed any longer.
    """

    def __init__(self, queue: BuildQueue, stopping: threading.Event) -> None:
        self._queue = queue
        self._stopping = stopping
        self._watched: dict[str, Watched] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._streams: Counter[str] = Counter()

    def enter(self, client: str) -> None:
        """Count a stream of a client; `leave` has to follow.

        Raises
        ------
        RateLimitedError
            When they listen to as many as they may.
        """
        if self._streams[client] >= MOST_OF_ONE:
            raise RateLimitedError(f"{MOST_OF_ONE} streams of events are open already", 5)
        self._streams[client] += 1

    def leave(self, client: str) -> None:
        """Take note that a stream of a client has ended."""
        self._streams[client] -= 1
        if not self._streams[client]:
            del self._streams[client]

    async def follow(self, row: BuildRow, moment: float) -> AsyncGenerator[str, None]:
        """Give server-sent events: how a build is, then every change, and a sign of life in between.

        Parameters
        ----------
        row : BuildRow
            As it was found by a look.
        moment : float
            When that began, as ``time.monotonic`` tells [s].
        """
        with self._listening(row.id) as watched:
            watched.tell(row, moment)
            shown = ""
            while not self._stopping.is_set():
                news, over = watched.news, watched.over
                if watched.text != shown:
                    shown = watched.text
                    yield f"event: state\nid: {event_id(shown)}\ndata: {shown}\n\n"
                if over:
                    return
                try:
                    async with asyncio.timeout(HEARTBEAT_S):
                        await news.wait()
                except TimeoutError:
                    yield ": alive\n\n"

    @contextmanager
    def _listening(self, key: str) -> Iterator[Watched]:
        watched = self._watched.get(key)
        if watched is None:
            watched = self._watched[key] = Watched()
            self._tasks[key] = asyncio.create_task(self._keep_looking(key, watched))
        watched.listeners += 1
        try:
            yield watched
        finally:
            watched.listeners -= 1
            if not watched.listeners:
                self._tasks.pop(key).cancel()
                del self._watched[key]

    async def _keep_looking(self, key: str, watched: Watched) -> None:
        try:
            while not self._stopping.is_set() and not watched.over:
                await asyncio.sleep(LOOK_S)
                moment = time.monotonic()
                try:
                    watched.tell(await run_in_threadpool(self._queue.find, key), moment)
                except SQLAlchemyError as error:  # whoever listens learns more when it is back
                    log.warning("build %s cannot be followed: %s", key, str(error).partition("\n")[0])
        except AppError as error:
            log.warning("build %s is followed no longer: %s", key, error)
        finally:
            watched.end()


def event_id(text: str) -> str:
    """Return the id of an event: the same state has the same."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]
