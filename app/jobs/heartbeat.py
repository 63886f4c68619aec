"""A sign of life from long work that has nothing to tell for a while."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType

EVERY_S = 10.0


class Heartbeat:
    """Calls a function from a thread of its own whenever nothing was heard for a while.

    Parameters
    ----------
    beat : callable
        Called with the seconds since the work began.
    every : float
        Longest silence [s].
    """

    def __init__(self, beat: Callable[[float], None], every: float | None = None) -> None:
        self._beat, self._every = beat, EVERY_S if every is None else every
        self._ended = threading.Event()
        self._begun = self._heard = time.monotonic()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def heard(self) -> None:
        """Note that the work itself has told something."""
        self._heard = time.monotonic()

    def __enter__(self) -> Heartbeat:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ended.wait(max(0.01, self._heard + self._every - time.monotonic())):
            if time.monotonic() - self._heard >= self._every:
                self.heard()
                self._beat(time.monotonic() - self._begun)
