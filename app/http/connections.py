"""Connections of the server: how many there may be, how long one may wait, and which goes when there are too many.

A connection without a request costs its client nothing, so it is the first to go: where all places are taken, the one
that has waited longest makes room for the next. Only where every place has a request in progress is a client refused.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any, cast

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from jointplay.app.errors import AddressError
from jointplay.app.settings import ServiceSettings

log = logging.getLogger(__name__)

HEAD_S = 10.0
"""Longest time without a whole head of a request, from the beginning of a connection or its last answer on [s]."""

NEW_S = 1.0
"""Time for which a connection is new [s]."""

STALL_S, STEP_BYTES = 30.0, 48_000
"""Longest time in which a client may take less of its answer than so many bytes [s]."""

HALF_OPEN_S = 60
"""Time after which the system ends a connection whose other end acknowledges nothing any more [s]."""

EXHAUSTED = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})
REST_S = 0.9
"""Time without a try when the system has no descriptor left [s]; the event loop tries again after 1 s."""

OWN_DESCRIPTORS, DESCRIPTORS_A_WORKER, DESCRIPTORS_A_CONNECTION = 100, 10, 2
"""What the service needs besides connections (libraries, database, catalogues), a worker (pipes), a connection (itself,
and a file that is received over it)."""


def most_connections(settings: ServiceSettings) -> int:
    """Return how many connections there may be, so that descriptors are left for everything else.

    Raises
    ------
    AddressError
        When this process may have so few descriptors that there could be none.
    """
    if sys.platform == "win32":
        return settings.connections
    import resource

    allowed, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if allowed == resource.RLIM_INFINITY:
        return settings.connections
    own = OWN_DESCRIPTORS + DESCRIPTORS_A_WORKER * settings.workers
    most = (allowed - own) // DESCRIPTORS_A_CONNECTION
    if most < 2:
        needed = own + 2 * DESCRIPTORS_A_CONNECTION
        raise AddressError(f"open files: {allowed} (ulimit -n): must be at least {needed} with so many workers")
    return min(settings.connections, most)


class Connections:
    """All connections of a server.

    Parameters
    ----------
    most : int
        How many there may be.
    most_of_one : int
        How many of one address.
    """

    def __init__(self, most: int, most_of_one: int) -> None:
        self._most = most
        self._most_of_one = most_of_one
        self._open: Counter[str] = Counter()
        self._arriving: dict[int, Accepted] = {}  # by descriptor
        self._waiting: dict[Connection, float] = {}  # since when; the longest first
        self._leaving: set[Connection] = set()

    def __len__(self) -> int:
        """Return the number of connections."""
        return self._open.total()

    def has_room(self) -> bool:
        """Return whether one more may be accepted; False where all have a request in progress.

        Raises
        ------
        BlockingIOError
            When there is going to be room in a moment.
        """
        if len(self) < self._most:
            return True
        if not self._leaving:
            self._make_room()
        if self._leaving or self._arriving or any(each.has_sent_all for each in self._waiting):
            raise BlockingIOError
        return False

    def accepted(self, connection: socket.socket, address: str) -> Accepted:
        """Count an accepted connection, until its socket is closed."""
        descriptor = connection.fileno()
        self._open[address] += 1

        def closed() -> None:
            self._arriving.pop(descriptor, None)
            self._open[address] -= 1
            if not self._open[address]:
                del self._open[address]

        counted = self._arriving[descriptor] = Accepted(connection, closed)
        return counted

    def begin(self, connection: Connection, moment: float) -> None:
        """Take note that a connection can be talked over; one too many of its address costs that the oldest waiting."""
        connection.accepted = self._arriving.pop(connection.transport.get_extra_info("socket").fileno())
        self.wait(connection, moment)
        # Those that leave are counted until their sockets are closed, which of many at once is after all have begun.
        leaving = sum(each.address == connection.address for each in self._leaving)
        if self._open[connection.address] - leaving > self._most_of_one:
            self._make_room(connection.address)

    def wait(self, connection: Connection, moment: float) -> None:
        """Take note that a connection waits for a request, from a moment on [s]."""
        self._waiting.pop(connection, None)
        self._waiting[connection] = moment

    def work(self, connection: Connection) -> None:
        """Take note that a connection has a request."""
        self._waiting.pop(connection, None)

    def end(self, connection: Connection) -> None:
        """Take note that a connection has ended."""
        self._waiting.pop(connection, None)
        self._leaving.discard(connection)

    def sweep(self, connections: list[Connection], moment: float) -> None:
        """Close what waits for too long, for a request or for its client to take an answer.

        What has arrived may be the request: a server that is behind reads it first, and has as long again for that.
        """
        stalled = [each for each in connections if each.is_stalled(moment)]
        late = [
            each
            for each, since in self._waiting.items()
            if moment - since > HEAD_S and each.has_sent_all and (moment - since > 2 * HEAD_S or not each.has_more)
        ]
        for each in stalled + late:
            self._close(each)

    def _make_room(self, address: str | None = None) -> None:
        """Close the connection that has waited longest, of an address where it is given, if there is one.

        What has just been sent over a new one may be a request; in a rush it was not looked at yet.
        """
        moment = time.monotonic()
        for each, since in self._waiting.items():
            idle = each.has_sent_all and (moment - since > NEW_S or not each.has_more)
            if idle and address in (None, each.address):
                self._close(each)
                return

    def _close(self, connection: Connection) -> None:
        self._waiting.pop(connection, None)
        if connection not in self._leaving:
            self._leaving.add(connection)
            connection.transport.abort()


class Accepted(socket.socket):
    """The socket of a connection, which tells when it is closed."""

    def __init__(self, connection: socket.socket, closed: Callable[[], None]) -> None:
        super().__init__(connection.family, connection.type, connection.proto, connection.detach())
        self._tell: Callable[[], None] | None = closed

    def close(self) -> None:
        """Close it."""
        super().close()
        tell, self._tell = self._tell, None
        if tell is not None:
            tell()


class Listener(socket.socket):
    """A socket that accepts connections as long as there is room for them.

    Attributes
    ----------
    connections : Connections
        Counts them.
    """

    connections: Connections
    _rest_until = 0.0

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection; one that there is no room for is closed at once."""
        while True:
            has_room = self.connections.has_room()
            try:
                connection, client = super().accept()
            except OSError as error:
                if error.errno not in EXHAUSTED:
                    raise
                # The event loop would try, and log, as often as connections may be in its queue.
                moment = time.monotonic()
                if moment < self._rest_until:
                    raise BlockingIOError from None
                self._rest_until = moment + REST_S
                raise
            if has_room:
                return self.connections.accepted(connection, str(client[0])), client
            connection.close()


class Connection(H11Protocol):
    """One connection, as the server talks over it.

    Parameters
    ----------
    connections : Connections
        All of them.
    **given
        What the server gives.

    Attributes
    ----------
    accepted : Accepted
        Its socket.
    """

    accepted: Accepted

    def __init__(self, connections: Connections, **given: Any) -> None:
        super().__init__(**given)
        self._all = connections
        self._unsent: tuple[int, float] | None = None  # bytes, and since when there are about so many

    @property
    def address(self) -> str:
        """Address of the other end."""
        return self.client[0] if self.client is not None else ""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as the server's own
        """Begin to wait for a request."""
        super().connection_made(transport)
        self._all.begin(self, self.loop.time())

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._all.end(self)
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Take what has arrived; with a request the waiting is over."""
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete:
            self._all.work(self)

    def on_response_complete(self) -> None:
        """Begin to wait for the next request, or for the rest of one that was answered before it was whole."""
        self._all.wait(self, self.loop.time())
        super().on_response_complete()

    def resume_writing(self) -> None:
        """Go on: the client has taken most of what was to be sent."""
        self._unsent = None
        super().resume_writing()

    @property
    def has_more(self) -> bool:
        """Whether something has arrived that was not looked at yet."""
        try:
            return bool(self.accepted.recv(1, socket.MSG_PEEK))
        except OSError:
            return False

    @property
    def has_sent_all(self) -> bool:
        """Whether the system has taken everything that was to be sent."""
        return self.transport.get_write_buffer_size() == 0

    def is_stalled(self, moment: float) -> bool:
        """Return whether the client does not take its answer; to be asked again and again."""
        size = self.transport.get_write_buffer_size()
        before, since = self._unsent or (size, moment)
        if before - size >= STEP_BYTES:
            before, since = size, moment
        self._unsent = (max(before, size), since) if size else None
        return bool(size) and moment - since > STALL_S


class Server(uvicorn.Server):
    """The server with limits of connections.

    Parameters
    ----------
    application : ASGIApp
    listener : Listener
        Already bound to its address.
    most, most_of_one : int
        How many connections there may be, and how many of one address.
    before_stop : callable
        Called when it is to stop, before it waits for answers to end.
    **given
        Further settings of the server's own.
    """

    def __init__(
        self,
        application: ASGIApp,
        listener: Listener,
        most: int,
        most_of_one: int,
        before_stop: Callable[[], None] = lambda: None,
        **given: Any,
    ) -> None:
        self._guarded = listener.connections = Connections(most, most_of_one)
        protocol = cast("type[asyncio.Protocol]", partial(Connection, listener.connections))
        # Another loop would not ask this listener whether there is room; an upgrade would leave the limits behind.
        super().__init__(uvicorn.Config(application, http=protocol, loop="asyncio", ws="none", **given))
        self._listener = listener
        self._before_stop = before_stop

    def run(self, sockets: list[socket.socket] | None = None) -> None:
        """Serve until a signal."""
        super().run(sockets or [self._listener])

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to listen."""
        asyncio.get_running_loop().set_exception_handler(tell)
        await super().startup(sockets)

    async def on_tick(self, counter: int) -> bool:
        """Look at all connections once a second."""
        if counter % 10 == 0:
            connections = [each for each in self.server_state.connections if isinstance(each, Connection)]
            self._guarded.sweep(connections, asyncio.get_running_loop().time())
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop."""
        self._before_stop()
        await super().shutdown(sockets)


def tell(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log what went wrong in the event loop; that no connection can be accepted is one line."""
    error = context.get("exception")
    if isinstance(error, OSError) and error.errno in EXHAUSTED:
        log.error("no connection can be accepted: %s", error.strerror)
    else:
        loop.default_exception_handler(context)


def listen(host: str, port: int) -> Listener:
    """Return a socket that listens at an address; one that is taken is refused in one line.

    Raises
    ------
    AddressError
        When the address cannot be had.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # Without its protocol's name, asyncio would not switch delays off (TCP_NODELAY) on connections.
    listener = Listener(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # Connections inherit these: whoever has gone without a word is noticed while an answer is made, too.
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, HALF_OPEN_S // 2)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, HALF_OPEN_S // 6)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, HALF_OPEN_S * 1000)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise AddressError(f"{host}:{port}: {error.strerror or error}") from None
    return listener
