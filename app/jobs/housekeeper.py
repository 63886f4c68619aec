"""Deleting what is kept no longer, in the background; each server of a database does it, and finds what others left."""

from __future__ import annotations

import logging
import threading

from sqlalchemy.exc import SQLAlchemyError

from jointplay.app.storage.pruning import Pruner

log = logging.getLogger(__name__)

EVERY_S, CLOSE_S = 3600.0, 10.0
"""From the end of one time to the next, and the longest wait for the transaction that is being made [s]."""


class Housekeeper:
    """A thread that tidies up at once and then every hour.

    Parameters
    ----------
    pruner : Pruner
    """

    def __init__(self, pruner: Pruner) -> None:
        self._pruner = pruner
        self._apart = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="housekeeper", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def close(self) -> None:
        """End, after the transaction that is being made; one that lasts too long is left to the database."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_S)

    def _run(self) -> None:
        while not self._stop.is_set():
            self.step()
            self._stop.wait(EVERY_S)

    def step(self) -> None:
        """Tidy up, and log what has gone."""
        gone: dict[tuple[str, str], list[int]] = {}
        try:
            if (apart := self._pruner.why_apart()) and apart != self._apart:
                log.warning("%s", apart)
            self._apart = apart
            for each in self._pruner.prune():
                counted = gone.setdefault((each.what, each.why), [0, 0])
                counted[0] += len(each.ids)
                counted[1] += each.size_bytes
                if self._stop.is_set():
                    break
        except SQLAlchemyError as error:
            log.warning("tidying up waits for the database: %s", type(error).__name__)
        except Exception:
            # Whatever it is, it must not end the thread; in an hour it is tried again.
            log.exception("not everything could be tidied up")
        for (what, why), (count, size) in gone.items():
            log.info("tidied up %d %s, %.3g MB: %s", count, what, size / 1e6, why)
