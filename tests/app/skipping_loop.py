"""An event loop whose time passes only where all wait: what is to happen first happens first on any machine."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Coroutine
from typing import Any


class Skipping(selectors.DefaultSelector):
    """Instead of waiting, moves the time on."""

    moment = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return what is ready now."""
        self.moment += timeout or 0.0
        return super().select(0.0)


class SkippingLoop(asyncio.SelectorEventLoop):
    """Runs on the time of its selector."""

    def __init__(self) -> None:
        self.skipping = Skipping()
        super().__init__(self.skipping)

    def time(self) -> float:
        """Return the time that has passed [s]."""
        return self.skipping.moment


def run_skipping(work: Coroutine[Any, Any, Any]) -> Any:
    """Run what waits for nothing but time, without waiting for it."""
    with asyncio.Runner(loop_factory=SkippingLoop) as runner:
        return runner.run(work)
