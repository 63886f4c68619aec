"""Looking through everything that is kept, slowly, again and again, while the server works."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from jointplay.app.metrics import Metrics
from jointplay.app.storage.custody import KINDS, look_through
from jointplay.app.storage.store import Store

log = logging.getLogger(__name__)

RATE = 5_000_000
"""Bytes a second at most: a small part of what a disk gives."""

FIRST_S, PAUSE_S, RETRY_S = 60.0, 86_400.0, 300.0
"""From the start of the server to the first look, from the end of one to the next, and from one that broke off [s]."""


class Scrubber:
    """Looks for damage in the background.

    Parameters
    ----------
    store : Store
    metrics : Metrics
        Say what was found, and when.
    rate : float
        Bytes a second.
    """

    def __init__(self, store: Store, metrics: Metrics, rate: float = RATE) -> None:
        self._store, self._metrics, self._rate = store, metrics, rate

    async def run(self) -> None:
        """Look, and look again a day later, or soon where it broke off, until this is cancelled."""
        await asyncio.sleep(FIRST_S)
        while True:
            pause = RETRY_S
            try:
                await self.look()
                pause = PAUSE_S
            except SQLAlchemyError as error:
                log.warning("looking for damage waits for the database: %s", type(error).__name__)
            except Exception:
                log.exception("looking for damage broke off")
            await asyncio.sleep(pause)

    async def look(self) -> None:
        """Look through everything once."""
        found: Counter[str] = Counter()
        steps = look_through(self._store)
        while (step := await run_in_threadpool(next, steps, None)) is not None:
            for said in step.damage:
                log.error("damage: %s", said)
            found[step.kind] += len(step.damage)
            self._metrics.count_scrubbed(step.bytes)
            await asyncio.sleep(step.bytes / self._rate)
        self._metrics.tell_damage({kind: found[kind] for kind in KINDS}, time.time())
