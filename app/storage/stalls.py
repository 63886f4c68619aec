"""PostgreSQL that stalls: its connections stay, nothing comes through them, its own limits of time do not run.

A wait is given up when a server is silent, not when a statement is slow: while somebody waits, a thread asks by
connections of its own whether the server answers anybody. Of a stalled server everybody hears at once, without a wait,
until the same thread has had an answer.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Generator
from contextlib import closing
from typing import Any, TypeVar

import psycopg

log = logging.getLogger(__name__)

R = TypeVar("R")

SILENCE_S = 2.0
"""Longest silence of a server for which anybody waits; a request may wait once."""

LOOK_S = 0.5
"""Time between two looks at a server, and before the first."""

STATEMENT_S = 10.0
"""Longest time of a statement, which the server itself ends; a second later it is given up here."""

LOCK_S = 2.5
"""Longest wait for a lock that another connection holds."""

LIMITS = (
    f"SET statement_timeout = {STATEMENT_S * 1000:.0f}; SET lock_timeout = {LOCK_S * 1000:.0f};"
    f" SET idle_in_transaction_session_timeout = {STATEMENT_S * 1000:.0f}"
)


class Pulse:
    """Whether a server answers.

    Parameters
    ----------
    connect : callable
        Makes a plain connection to it; gives up within `SILENCE_S`.
    """

    def __init__(self, connect: Callable[[], psycopg.Connection[Any]]) -> None:
        self._connect = connect
        self._lock = threading.Lock()
        self._listening = False
        self._wanted = 0.0
        self._heard = 0.0
        self.stalled = False

    def judge(self, began: float) -> str:
        """Return why a wait that began then is to be given up; nothing where it is not."""
        present = time.monotonic()
        if present - began > LOOK_S:
            self._listen(present)
        if present - max(began, self._heard) > SILENCE_S:
            self.stall()
        if self.stalled:
            return f"the server has been silent for {SILENCE_S:g} s"
        return f"no answer within {STATEMENT_S + 1:g} s" if present - began > STATEMENT_S + 1 else ""

    def stall(self) -> None:
        """Note that the server does not answer; asked again until it does."""
        if not self.stalled:
            log.warning("the database does not answer")
        self.stalled = True
        self._listen(time.monotonic())

    def _listen(self, present: float) -> None:
        with self._lock:
            self._wanted = present
            if self._listening:
                return
            self._listening = True
        threading.Thread(target=self._ask, name="database-pulse", daemon=True).start()

    def _ask(self) -> None:
        """Ask as long as the server is stalled, or somebody has waited for it just now."""
        while True:
            began = time.monotonic()
            try:
                with closing(self._connect()) as connection:
                    connection.execute("SELECT 1")
            except psycopg.Error as error:
                # One that refuses connections is no longer silent: whoever asks hears it from the server.
                answered = not isinstance(error, psycopg.errors.ConnectionTimeout)
            else:
                answered = True
            if answered:
                self._heard = time.monotonic()
                if self.stalled:
                    log.warning("the database answers again")
                self.stalled = False
            with self._lock:
                if not self.stalled and time.monotonic() - self._wanted > 2 * LOOK_S:
                    self._listening = False
                    return
            time.sleep(max(0.0, LOOK_S - (time.monotonic() - began)))


class LimitedConnection(psycopg.Connection[Any]):
    """A connection whose waits are given up when the server stalls; without a pulse it is as any other."""

    pulse: Pulse | None = None

    def wait(self, gen: Generator[Any, Any, R], *args: Any, **kwargs: Any) -> R:
        """Do what psycopg does, and look every tenth of a second whether to go on."""
        return super().wait(gen if self.pulse is None else self._limited(gen, self.pulse), *args, **kwargs)

    def _limited(self, gen: Generator[Any, Any, R], pulse: Pulse) -> Generator[Any, Any, R]:
        began = time.monotonic()
        try:
            wanted = next(gen)
            while True:
                ready = yield wanted
                if not ready and (why := pulse.judge(began)):
                    self.pgconn.finish()  # else giving it back would wait as well
                    raise psycopg.OperationalError(why)
                wanted = gen.send(ready)
        except StopIteration as ended:
            result: R = ended.value
            return result


def connect_plain(*arguments: Any, **options: Any) -> psycopg.Connection[Any]:
    """Return a new connection without limits, made within `SILENCE_S`."""
    return psycopg.connect(*arguments, **{**options, "connect_timeout": round(SILENCE_S)})


def connect_limited(pulse: Pulse, *arguments: Any, **options: Any) -> LimitedConnection:
    """Return a new connection with all limits.

    Raises
    ------
    psycopg.OperationalError
        The server does not answer, or refuses.
    """
    if pulse.stalled:
        raise psycopg.OperationalError("the server does not answer")
    try:
        connection = LimitedConnection.connect(*arguments, **{**options, "connect_timeout": round(SILENCE_S)})
    except psycopg.errors.ConnectionTimeout:
        pulse.stall()
        raise
    connection.pulse = pulse
    connection.autocommit = True
    connection.execute(LIMITS)
    connection.autocommit = False
    return connection
