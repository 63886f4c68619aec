"""How a service is at the moment it is asked, for Prometheus."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import psutil
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from sqlalchemy.exc import SQLAlchemyError

from jointplay.app.service import Service

log = logging.getLogger(__name__)


class State(Collector):
    """How a service is at the moment it is asked.

    Parameters
    ----------
    service : Service
    """

    def __init__(self, service: Service) -> None:
        self._service = service

    def describe(self) -> list[Metric]:
        """Return nothing: names are known when they are asked for."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Give what is measured."""
        service = self._service
        yield gauge("queue_length", "Tasks that wait for a worker.", service.pool.waiting)
        yield gauge("queue_limit", "Tasks that may wait for a worker.", service.settings.queue_limit)
        yield gauge("workers_busy", "Workers that have a task.", service.pool.busy)
        offers = service.shelf.offers()
        yield gauge("catalogues", "Catalogues that are offered.", len(offers))
        entries = GaugeMetricFamily(
            "jointplay_catalogue_entries", "Simulated cases in a catalogue that is offered.", labels=["catalogue"]
        )
        for offer in offers:
            entries.add_metric([offer.description.name], offer.description.entries)
        yield entries
        yield from self._builds()
        yield self._memory()

    def _builds(self) -> Iterator[Metric]:
        try:
            counts, running = self._service.builds.counts()
        except SQLAlchemyError as error:
            log.warning("metrics without builds: %s", str(error).partition("\n")[0])
            yield gauge("database_up", "Whether the database answers.", 0)
            return
        yield gauge("database_up", "Whether the database answers.", 1)
        states = GaugeMetricFamily("jointplay_builds", "Builds of all servers of the database.", labels=["state"])
        for state, count in counts.items():
            states.add_metric([state], count)
        yield states
        yield gauge("builds_running_cases_done", "Cases done, of builds that run.", running.done)
        yield gauge("builds_running_cases", "All cases of builds that run.", running.total)
        yield gauge("builds_cases_per_second", "Cases a second, of builds that run.", running.rate)

    def _memory(self) -> Metric:
        family = GaugeMetricFamily("jointplay_memory_bytes", "Resident memory of a process.", labels=["process"])
        for name, pid in (("server", None), *self._service.pool.processes()):
            try:
                family.add_metric([name], psutil.Process(pid).memory_info().rss)
            except psutil.Error:  # it ended just now
                continue
        return family


def gauge(name: str, says: str, value: float) -> Metric:
    """Return a number that goes up and down."""
    return GaugeMetricFamily(f"jointplay_{name}", says, value=value)
