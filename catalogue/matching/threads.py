"""One thread for linear algebra, where matrices are small."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

from threadpoolctl import ThreadpoolController

__all__ = ["one_thread"]


def one_thread() -> AbstractContextManager[Any]:
    """Return a context in which linear algebra takes one thread.

    The matrices of a diagnosis are small, and threads that wait for each other cost eleven times the time of the sums
    they share (measured on two busy cores: 11 s against 1 s).
    """
    limits: AbstractContextManager[Any] = _libraries().limit(limits=1, user_api="blas")
    return limits


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """The libraries of linear algebra, loaded with this module; looking for them takes 2 ms, a fifth of an answer."""
    return ThreadpoolController()
