"""Who is acting: whoever sent the request that is worked on here, typed a command, or the program by itself."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

COMMAND_LINE = "command line"
"""Stands in place of an address where somebody typed a command."""


@dataclass(frozen=True)
class Actor:
    """Who is acting; nobody is named where the program does something by itself.

    Parameters
    ----------
    key : str, optional
        Id of the API key.
    person : str, optional
        Name of a person, where something that authenticates people says it; at the prompt, the user's.
    address : str
        Where the request came from.
    request_id : str, optional
        As in the lines of the log.
    """

    key: str | None = None
    person: str | None = None
    address: str = ""
    request_id: str | None = None

    @property
    def name(self) -> str:
        """What tells who it was, in one word: the person, else the key, else the address."""
        return self.person or (f"key {self.key}" if self.key else self.address) or "system"


_ACTOR: ContextVar[Actor] = ContextVar("actor", default=Actor())  # noqa: B039, it is frozen


def actor() -> Actor:
    """Return who is acting here."""
    return _ACTOR.get()


@contextmanager
def acting(who: Actor) -> Iterator[None]:
    """Let what is done in a block be somebody's doing."""
    token = _ACTOR.set(who)
    try:
        yield
    finally:
        _ACTOR.reset(token)


@contextmanager
def acting_at_prompt() -> Iterator[None]:
    """Let what is done in a block be the doing of whoever typed the command."""
    import getpass

    try:
        person = getpass.getuser()
    except (KeyError, OSError):  # a container may run as a number that has no name
        import os

        person = f"user {os.getuid()}"
    with acting(Actor(person=person, address=COMMAND_LINE)):
        yield
