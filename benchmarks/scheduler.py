"""A build with up to a thousand workers, simulated event by event from task times that were measured.

``python -m benchmarks.scheduler --index CATALOGUE/index.sqlite`` takes the processor times of chunks from a catalogue
that was built here, and prints how long a build takes, how busy workers and builders are, and what the database has to
bear, for numbers of workers that this computer does not have.

A *cell* is a builder with its own Dask scheduler and workers, as ``jointplay build --scheduler`` makes it. All cells
share one database. The builder is one server with a queue: it takes a result from the wire, writes the shard, enters
it, claims the next chunk, and sends it out. A worker has one chunk in hand and one waiting; it compiles a model when it
first meets one.
"""

from __future__ import annotations

import argparse
import heapq
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from jointplay.catalogue.storage.index import Index


@dataclass(frozen=True)
class Costs:
    """What the parts of a build cost: those of chunks are measured, the others assumed (docs/measured/scale.md).

    Parameters
    ----------
    chunks : tuple of float
        Processor times of chunks, to be drawn from [s].
    compile : float
        First chunk of a model on a worker [s].
    start : float
        Start of a worker [s].
    store : float
        Builder: unpacking a result, writing its shard, and handing out the next chunk [s].
    transaction : float
        One transaction of the database [s]; the builder waits for it.
    wire : float
        A result, or a chunk, on its way [s].
    """

    chunks: tuple[float, ...] = (0.4,)
    compile: float = 0.6
    start: float = 3.0
    store: float = 0.014
    transaction: float = 0.003
    wire: float = 0.004


@dataclass(frozen=True)
class Fleet:
    """How a build is set up.

    Parameters
    ----------
    workers : int
        In all.
    cells : int
        Builders, each with an equal part of the workers.
    chunks : int
        To be computed by each cell.
    models : int
        Different models among them.
    deaths : float
        Of a worker, an hour.
    slots : int
        Transactions that the database works on at the same time.
    """

    workers: int
    cells: int = 1
    chunks: int = 3036
    models: int = 34
    deaths: float = 0.0
    slots: int = 8


@dataclass(frozen=True)
class Outcome:
    """What a simulated build comes to.

    Parameters
    ----------
    seconds : float
        Until the last chunk is stored [s].
    busy : float
        Part of the workers' time spent with cases (not compiling, waiting, starting, or lost with a death).
    builder : float
        Part of their time that builders were busy.
    transactions : float
        Of the database, a second.
    begun : int
        Chunks begun, those begun again included.
    """

    seconds: float
    busy: float
    builder: float
    transactions: float
    begun: int


_Chunk = tuple[int, float]
"""Its model and its time."""


@dataclass
class _Worker:
    cell: _Cell
    queue: deque[_Chunk] = field(default_factory=deque)
    arrived: int = 0
    models: set[int] = field(default_factory=set)
    life: int = 0
    working: bool = False


@dataclass
class _Cell:
    left: deque[_Chunk]
    jobs: deque[tuple[float, Callable[[], None]]] = field(default_factory=deque)
    working: bool = False
    busy: float = 0.0


class _Simulation:
    """Events in the order of time; every number drawn comes from one generator."""

    def __init__(self, fleet: Fleet, costs: Costs, seed: int) -> None:
        self._fleet, self._costs = fleet, costs
        self._random = np.random.default_rng(seed)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._now, self._number = 0.0, 0
        self._slots, self._asking = fleet.slots, deque[Callable[[], None]]()
        self._transactions = self._begun = self._stored = 0
        self._worked = 0.0
        cells = [_Cell(self._chunks()) for _ in range(fleet.cells)]
        self._workers = [_Worker(cells[k % fleet.cells]) for k in range(fleet.workers)]
        self._cells = cells

    def run(self) -> Outcome:
        for worker in self._workers:
            self._after(self._costs.start, partial(self._started, worker))
        while self._stored < self._fleet.cells * self._fleet.chunks:
            self._now, _, event = heapq.heappop(self._events)
            event()
        return Outcome(
            seconds=self._now,
            busy=self._worked / (self._now * self._fleet.workers),
            builder=sum(cell.busy for cell in self._cells) / (self._now * self._fleet.cells),
            transactions=self._transactions / self._now,
            begun=self._begun,
        )

    def _chunks(self) -> deque[_Chunk]:
        """Chunks of a cell; the models take turns, as in a plan."""
        times = self._random.choice(np.asarray(self._costs.chunks), self._fleet.chunks)
        return deque((k % self._fleet.models, float(seconds)) for k, seconds in enumerate(times))

    def _after(self, seconds: float, event: Callable[[], None]) -> None:
        self._number += 1
        heapq.heappush(self._events, (self._now + seconds, self._number, event))

    # A worker.

    def _started(self, worker: _Worker) -> None:
        if self._fleet.deaths > 0:
            self._after(self._random.exponential(3600.0 / self._fleet.deaths), partial(self._died, worker))
        for _ in range(2):
            self._hand_out(worker)

    def _arrived(self, worker: _Worker, life: int) -> None:
        if life == worker.life:
            worker.arrived += 1
            self._begin(worker)

    def _begin(self, worker: _Worker) -> None:
        if worker.working or not worker.arrived:
            return
        worker.working = True
        worker.arrived -= 1
        self._begun += 1
        model, seconds = worker.queue[0]
        compiling = 0.0 if model in worker.models else self._costs.compile
        worker.models.add(model)
        self._after(compiling + seconds, partial(self._computed, worker, worker.life))

    def _computed(self, worker: _Worker, life: int) -> None:
        if life != worker.life:
            return
        _, seconds = worker.queue.popleft()
        worker.working = False
        self._worked += seconds
        self._after(self._costs.wire, partial(self._returned, worker, life))
        self._begin(worker)

    def _died(self, worker: _Worker) -> None:
        """What it had goes back to the builder; another one is started in its place."""
        worker.cell.left.extend(worker.queue)
        worker.queue.clear()
        worker.models.clear()
        worker.arrived, worker.working = 0, False
        worker.life += 1
        self._after(self._costs.start, partial(self._started, worker))

    # Its builder: a third of the work of a chunk is before the worker's, two thirds are after it.

    def _hand_out(self, worker: _Worker) -> None:
        if worker.cell.left:
            worker.queue.append(worker.cell.left.popleft())
            sent = partial(self._after, self._costs.wire, partial(self._arrived, worker, worker.life))
            self._enqueue(worker.cell, self._costs.store / 3, sent)

    def _returned(self, worker: _Worker, life: int) -> None:
        self._enqueue(worker.cell, 2 * self._costs.store / 3, partial(self._kept, worker, life))

    def _kept(self, worker: _Worker, life: int) -> None:
        self._stored += 1
        if life == worker.life:
            self._hand_out(worker)

    def _enqueue(self, cell: _Cell, work: float, then: Callable[[], None]) -> None:
        """A job for a builder: work, a transaction, and what follows."""
        cell.jobs.append((work, then))
        if not cell.working:
            self._next_job(cell)

    def _next_job(self, cell: _Cell) -> None:
        cell.working = bool(cell.jobs)
        if cell.jobs:
            work, then = cell.jobs.popleft()
            self._after(work, partial(self._ask, partial(self._job_done, cell, self._now, then)))

    def _job_done(self, cell: _Cell, begun: float, then: Callable[[], None]) -> None:
        cell.busy += self._now - begun
        then()
        self._next_job(cell)

    # The database, which works on some transactions at the same time.

    def _ask(self, then: Callable[[], None]) -> None:
        self._asking.append(then)
        self._serve()

    def _serve(self) -> None:
        while self._slots and self._asking:
            self._slots -= 1
            self._after(self._costs.transaction, partial(self._committed, self._asking.popleft()))

    def _committed(self, then: Callable[[], None]) -> None:
        self._slots += 1
        self._transactions += 1
        then()
        self._serve()


def simulated(fleet: Fleet, costs: Costs, seed: int = 1) -> Outcome:
    """Simulate one build."""
    return _Simulation(fleet, costs, seed).run()


def table(costs: Costs, fleets: Sequence[Fleet], cases: int) -> str:
    """Rows of a page: one a fleet."""
    heads = ["workers", "cells", "deaths an hour", "seconds", "cases a second", "workers busy", "builders busy"]
    heads.append("transactions a second")
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for fleet in fleets:
        found = simulated(fleet, costs)
        rate = fleet.cells * fleet.chunks * cases / found.seconds
        lines.append(
            f"| {fleet.workers} | {fleet.cells} | {fleet.deaths * fleet.workers:.0f} | {found.seconds:.0f} "
            f"| {rate:.0f} | {found.busy:.0%} | {found.builder:.0%} | {found.transactions:.0f} |"
        )
    return "\n".join(lines)


FLEETS = (
    *(Fleet(workers) for workers in (2, 8, 16, 24, 32, 64, 1000)),
    *(Fleet(1000, cells, 30_360, models=34) for cells in (20, 40, 60)),  # ten catalogues each, one after the other
    Fleet(1000, 40, 30_360, deaths=1.0),
)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--index", help="of a catalogue built here: its chunks' times; a file or a URL")
    parser.add_argument("--store", type=float, default=Costs.store)
    parser.add_argument("--transaction", type=float, default=Costs.transaction)
    options = parser.parse_args()
    chunks, cases = Costs().chunks, 33
    if options.index:
        source = options.index if "://" in options.index else Path(options.index)
        with Index(source) as index:
            rows = [row for row in index.chunks() if row.seconds > 0]
        chunks, cases = tuple(row.seconds for row in rows), round(sum(row.entries for row in rows) / len(rows))
    costs = Costs(chunks=chunks, store=options.store, transaction=options.transaction)
    mean, p90 = np.mean(chunks), np.quantile(chunks, 0.9)
    print(f"{len(chunks)} chunks of {cases} cases, {mean:.3f} s on average (p90 {p90:.3f} s)")
    print(table(costs, FLEETS, cases))


if __name__ == "__main__":
    main()
