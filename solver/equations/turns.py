"""Threads take turns at equations: CasADi counts references to what they share without a lock.

Two threads that build models at the same time crash the process now and then, wherever the one frees what the other
reads (https://github.com/casadi/casadi/issues/3518). Compiled code knows nothing of CasADi, so that it runs aside.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

_turn = threading.Lock()
_own = threading.local()


@contextmanager
def alone() -> Iterator[None]:
    """Let no other thread work at equations; a thread whose turn it is goes on."""
    if getattr(_own, "turn", False):
        yield
        return
    with _turn:
        _own.turn = True
        try:
            yield
        finally:
            _own.turn = False


@contextmanager
def aside() -> Iterator[None]:
    """Let other threads have their turn, while this one does nothing with equations; it waits for its own after."""
    if not getattr(_own, "turn", False):
        yield
        return
    _own.turn = False
    _turn.release()
    try:
        yield
    finally:
        _turn.acquire()
        _own.turn = True
