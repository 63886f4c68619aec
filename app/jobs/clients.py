"""Who a task is for: its share of the workers is counted by that, and it stops when they have gone."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


async def stay() -> None:
    """Never go."""
    await asyncio.get_running_loop().create_future()


@dataclass(frozen=True)
class Client:
    """Whoever waits for a task.

    Parameters
    ----------
    name : str
        Id of a key, or an address; the service itself has none.
    leave : callable
        Waits until they have gone.
    """

    name: str = ""
    leave: Callable[[], Awaitable[None]] = stay


NOBODY = Client()
_CLIENT: ContextVar[Client] = ContextVar("client", default=NOBODY)


def client_here() -> Client:
    """Return for whom this is worked."""
    return _CLIENT.get()


@contextmanager
def working_for(client: Client) -> Iterator[None]:
    """Let the tasks of a block be for a client."""
    token = _CLIENT.set(client)
    try:
        yield
    finally:
        _CLIENT.reset(token)
