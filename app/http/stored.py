"""How much is stored, how fast that grows and when there is no space left, for Prometheus."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator

from cachetools import TTLCache, cachedmethod
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from sqlalchemy.exc import SQLAlchemyError

from jointplay.app.http.middleware import gauge
from jointplay.app.service import Service
from jointplay.app.storage.rows import now
from jointplay.app.storage.usage import Usage, measure

log = logging.getLogger(__name__)

HOLDS_S = 60.0
"""How long what was measured holds: all rows of recordings are looked at for it."""


class Stored(Collector):
    """What a service stores.

    Parameters
    ----------
    service : Service
    """

    def __init__(self, service: Service) -> None:
        self._service = service
        self._kept: TTLCache[str, Usage] = TTLCache(1, HOLDS_S)
        self._lock = threading.Lock()

    def describe(self) -> list[Metric]:
        """Return nothing: names are known when they are asked for."""
        return []

    @cachedmethod(lambda self: self._kept, key=lambda _self: "usage", lock=lambda self: self._lock)
    def _usage(self) -> Usage:
        return measure(self._service.store)

    def collect(self) -> Iterator[Metric]:
        """Give what is measured; nothing while the database does not answer."""
        try:
            usage = self._usage()
        except SQLAlchemyError as error:
            log.warning("metrics without what is stored: %s", str(error).partition("\n")[0])
            return
        count, size, oldest, daily = (
            GaugeMetricFamily(f"jointplay_{name}", says, labels=["class"])
            for name, says in (
                ("recordings", "Recordings that are stored."),
                ("recordings_bytes", "Size of the recordings that are stored."),
                ("recordings_oldest_seconds", "Time since the first of them came."),
                ("recordings_bytes_per_day", "Recordings that come in a day, by those of the last week."),
            )
        )
        for of, held in usage.classes.items():
            count.add_metric([of], held.count)
            size.add_metric([of], held.size_bytes)
            oldest.add_metric([of], 0.0 if held.oldest is None else (now() - held.oldest).total_seconds())
            daily.add_metric([of], held.per_day)
        yield from (count, size, oldest, daily)
        yield gauge("diagnoses_stored", "Diagnoses that are stored.", usage.diagnoses)
        yield gauge("database_bytes", "Size of the database.", usage.database_bytes)
        yield gauge("uploads_partial", "Uploads that are on their way, or broke off.", usage.partials.count)
        yield gauge("uploads_partial_bytes", "Size of those.", usage.partials.size_bytes)
        yield gauge("disk_free_bytes", "Free space of the disk of recordings.", usage.free_bytes)
        yield gauge("disk_bytes", "Size of that disk.", usage.disk_bytes)
        days = usage.days_until_full(self._service.settings.keep_days)
        yield gauge("disk_full_days", "Days until that disk is full, if all goes on as in the last week.", days)
