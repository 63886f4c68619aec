"""What the process of a build does: it builds, trains, and tells the server how far it is."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock
from typing import Any, Literal

from jointplay.app.jobs.forecasts import duration_text
from jointplay.app.jobs.heartbeat import Heartbeat
from jointplay.app.jobs.quality_cards import made_card
from jointplay.app.jobs.workers import prepare
from jointplay.app.logs import DEFAULT_LOG, LogSettings, of_request
from jointplay.app.problems import problem_of

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Order:
    """A build as the process needs it."""

    machine: Mapping[str, Any]
    plan: Mapping[str, Any]
    folder: Path
    workers: int | None
    log: LogSettings = DEFAULT_LOG
    scheduler: str = ""
    """Address of a Dask scheduler whose workers compute; without one, processes here do."""
    request: str | None = None
    """Id of the request that asked for it."""


@dataclass(frozen=True)
class BuildProgress:
    """What the process tells the server: how far it is (columns of the build's row), or how it ended."""

    kind: Literal["progress", "done", "failed"]
    values: Mapping[str, Any]


def work(order: Order, sender: Connection) -> None:
    """Build a catalogue in this process, which ends with the server, and send how it goes."""
    prepare(order.log)
    # A signal to all processes of a server is for the server, which ends this one and gives the build back. A handler
    # is not passed on to the builder's workers, as an ignored signal would be.
    signal.signal(signal.SIGTERM, lambda _number, _frame: None)
    with of_request(order.request):
        try:
            log.info("the build of %s begins", order.folder.name)
            with Telling(sender) as tell:
                ended = run_build(order, tell)
            sender.send(ended)
            log.info("the build of %s has ended", order.folder.name)
        except Exception as error:
            problem = problem_of(error)
            if problem.status >= 500:
                log.exception("the build of %s failed", order.folder.name)
            sender.send(BuildProgress("failed", {"message": problem.detail}))


class Telling:
    """Tells the server how far a build is, and that it goes on where there is nothing else to tell."""

    def __init__(self, sender: Connection) -> None:
        self._sender, self._lock = sender, Lock()
        self._message = ""
        self._heartbeat = Heartbeat(self._still)

    def __enter__(self) -> Callable[[dict[str, Any]], None]:
        self._heartbeat.__enter__()
        return self._tell

    def __exit__(self, *error: Any) -> None:
        self._heartbeat.__exit__(*error)

    def _tell(self, values: dict[str, Any]) -> None:
        self._heartbeat.heard()
        self._message = values.get("message", self._message)
        self._send(values)

    def _still(self, seconds: float) -> None:
        with suppress(OSError):  # the server has gone, and this process goes with it
            self._send({"message": "; ".join(filter(None, [self._message, f"at work for {duration_text(seconds)}"]))})

    def _send(self, values: dict[str, Any]) -> None:
        with self._lock:
            self._sender.send(BuildProgress("progress", values))


def run_build(order: Order, tell: Callable[[dict[str, Any]], None]) -> BuildProgress:
    """Build, train, and return how it ended."""
    from jointplay.catalogue.building.build import Progress, build
    from jointplay.catalogue.building.executors import count_processors
    from jointplay.catalogue.building.network_building import train_networks
    from jointplay.catalogue.plans.plan import parse_plan
    from jointplay.catalogue.storage.store import Catalogue
    from jointplay.solver.machines.machine import parse_machine

    workers = order.workers or count_processors()

    def cases(state: Progress) -> None:
        values = {
            "cases_done": state.done,
            "cases_total": state.total,
            "rate_per_s": state.rate,
            "seconds_left": state.eta,
            "message": "",
        }
        tell(values)

    def networks(done: int, total: int) -> None:
        tell({"seconds_left": None, "message": f"{done} of {total} networks are trained"})

    def said(text: str) -> None:
        tell({"message": text})

    machine, plan = parse_machine(order.machine), parse_plan(order.plan)
    with ExitStack() as stack:
        executor = None
        if order.scheduler:
            from jointplay.catalogue.building.cluster import DaskCluster

            executor = DaskCluster(order.scheduler, tell=said)
            stack.callback(executor.close, at_once=True)
        report = build(machine, plan, order.folder, workers=workers, progress=cases, executor=executor)
    found = {"catalogue_id": Catalogue.open(order.folder).id}
    if report.lost:
        message = f"{len(report.lost)} cases could not be computed: {report.lost_reason}; a further build tries them"
        return BuildProgress("failed", {**found, "message": message})
    train_networks(order.folder, workers=workers, progress=networks)
    said("the quality card is made")
    made_card(order.folder)
    failed = ", ".join(f"{count} {status}" for status, count in sorted(report.failed.items()))
    return BuildProgress("done", {**found, "message": f"cases without a spectrum: {failed}" if failed else ""})
