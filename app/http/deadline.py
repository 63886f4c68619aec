"""One limit of time for every request, whatever it waits for."""

from __future__ import annotations

import asyncio
import logging

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jointplay.app.errors import OverdueError
from jointplay.app.http.handlers import path_of
from jointplay.app.jobs.virtual import LIMITS
from jointplay.app.scopes import API

TURN = 1.0
"""How many times the limit of one task a request may take besides its task: for its turn, and all the rest."""
SIMULATING = (f"{API}/measurements/virtual", "/try")

log = logging.getLogger(__name__)


class Deadline:
    """Middleware that answers a request whose time is over, while whoever works at it is left alone.

    What works sees a client that has gone: workers stop, threads end when what they wait for does, and what they have
    stored by then stays with its Idempotency-Key. The clock begins anew with each part of a body, which has limits of
    its own, and stops when an answer begins: how fast that goes on is for the connection to judge.

    Parameters
    ----------
    app : ASGIApp
        The application behind.
    time_limit : float
        Of one task in a worker [s].
    """

    def __init__(self, app: ASGIApp, time_limit: float) -> None:
        self._app = app
        self._time_limit = time_limit
        self._late: set[asyncio.Task[None]] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on.

        Raises
        ------
        OverdueError
            When no answer has begun in time.
        """
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        path = path_of(scope)
        limit = (TURN + (LIMITS if path in SIMULATING else 1.0)) * self._time_limit
        clock = asyncio.get_running_loop().time
        until, begun, over = clock() + limit, False, False

        async def receiving() -> Message:
            nonlocal until
            message = await receive()
            if message["type"] == "http.request":
                until = clock() + limit
            return message

        async def sending(message: Message) -> None:
            nonlocal begun
            if not over:
                begun = True
                await send(message)

        working = asyncio.ensure_future(self._app(scope, receiving, sending))
        try:
            while not (working.done() or begun) and (left := until - clock()) > 0:
                await asyncio.wait([working], timeout=left)
            if begun:
                await asyncio.wait([working])
        except asyncio.CancelledError:  # the server is ending
            working.cancel()
            await asyncio.wait([working])
            raise
        if working.done():
            return working.result()
        over = True
        self._late.add(working)
        working.add_done_callback(self._forget)
        raise OverdueError(f"no answer within {limit:g} s, the longest time of a request")

    def _forget(self, working: asyncio.Task[None]) -> None:
        self._late.discard(working)
        if not working.cancelled() and (error := working.exception()) is not None:
            log.debug("what nobody waited for ended: %s", error)
