"""What a build will take before it begins: its cases counted, a few of them computed here and now, nothing written."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from statistics import mean

from jointplay.catalogue.building.build import CHUNK_SIZE
from jointplay.catalogue.building.chunk import Chunk, Compute, cut_chunks, simulate_chunk
from jointplay.catalogue.matching.network import CASE_ROWS, NetworkTraining
from jointplay.catalogue.plans.cases import entries_of, sequences_of
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.storage.cross_power import COLUMNS
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.hdf5 import encode_shard
from jointplay.catalogue.storage.location import IndexLocation
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.shard import CaseOutcome, Shard, ShardHeader
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.simulate import check_assembly

PLACES = (0.5, 0.1, 0.9, 0.3, 0.7)
"""Where in the plan cases are tried: parts of its cases, in the order of trying."""

CASES = 16
"""Tried at each place: two vectors of lanes."""

ENOUGH_S = 15.0
"""After this time no further place is tried, but a second one."""

STARTING_S = 6.0
"""Processor time of processes that begin."""

TRAINING_S = 2.5e-5
"""Processor time of a recording in a pass of a network's training; making it takes as long."""

BESIDE_PAST = 1.5
"""The same of networks that hear two recordings, as a factor: making these takes twice as long."""


@dataclass(frozen=True)
class Forecast:
    """What a build will take.

    Parameters
    ----------
    cases : int
        Of the plan.
    present : int
        Of these, in the catalogue already.
    tried : int
        Computed for this forecast.
    seconds : float
        Time of the build, as busy as this computer is now.
    seconds_idle : float
        Time of the build on it with nothing else to do.
    size_bytes : int
        Of the files of the cases that are missing.
    workers : int
        Processes that it was made for.
    """

    cases: int
    present: int
    tried: int
    seconds: float
    seconds_idle: float
    size_bytes: int
    workers: int


def forecast(
    machine: Machine,
    plan: Plan,
    workers: int,
    folder: Path | None = None,
    *,
    compute: Compute = simulate_chunk,
    enough: float = ENOUGH_S,
) -> Forecast:
    """Say how long a build will take, and how large its files will be.

    Parameters
    ----------
    machine : Machine
    plan : Plan
    workers : int
        Processes that will compute, >= 1.
    folder : Path, optional
        Of the catalogue: what is there already is not computed again.
    compute : callable, optional
        What is done with a chunk.
    enough : float, optional
        After this time [s] no further cases are tried, but those of a second place.

    Raises
    ------
    PlanError
        The plan does not fit the machine.
    CatalogueMismatchError
        The folder holds a catalogue of something else.
    SolverError
        The machine cannot be assembled, or the solver refuses a parameter or a setting of the plan.
    """
    machine = machine.without_clearances()
    plan = plan.resolve(machine)
    wanted = entries_of(plan, machine)
    check_assembly(machine)
    there = _present(machine, plan, folder)
    missing = [entry for entry in wanted if entry.key not in there]
    chunks = cut_chunks(machine, plan.recipe(machine), missing, CHUNK_SIZE)
    begun, worked, tried, spent = time.perf_counter(), time.process_time(), 0, 0.0
    compiling: list[float] = []
    size = _Size()
    for place in PLACES if chunks else ():
        some = _some_of(chunks, place)
        start = time.process_time()
        outcomes = compute(some)
        took = time.process_time() - start
        size.add(Manifest.of(machine, plan).header(plan), some, outcomes)
        alone = min(took, sum(outcome.seconds for outcome in outcomes))
        tried += len(outcomes)
        spent += alone
        compiling.append(took - alone)
        if len(compiling) > 1 and time.perf_counter() - begun >= enough:
            break
    models = len({(chunk.entries[0].variant, chunk.joints) for chunk in chunks})
    each = spent / tried if tried else 0.0
    # The first of all models may take longer: what all of them share becomes a program with it.
    model = min(compiling, default=0.0)
    seconds = (each * len(missing) + model * models) / workers + (compiling[0] - model if compiling else 0.0)
    if missing:
        seconds += STARTING_S + sum(sorted(_networks(plan, machine, len(wanted)))[::-workers])
    # Whatever else the computer does now stretches the build as it has stretched this.
    busy = (time.perf_counter() - begun) / max(time.process_time() - worked, 1e-9)
    return Forecast(
        cases=len(wanted),
        present=len(wanted) - len(missing),
        tried=tried,
        seconds=seconds * max(1.0, busy),
        seconds_idle=seconds,
        size_bytes=size.of(len(missing), len(chunks)),
        workers=workers,
    )


class _Size:
    """Bytes of a shard, of each case in it, and of its row of the matrix, as cases that were tried have them."""

    def __init__(self) -> None:
        self._shards: list[float] = []
        self._cases: list[float] = []

    def add(self, header: ShardHeader, chunk: Chunk, outcomes: Sequence[CaseOutcome]) -> None:
        one, all_of_them = (len(encode_shard(Shard.of(header, chunk.entries[:n], outcomes[:n]))) for n in (1, None))
        bands = max((outcome.cyclic.shape[0] for outcome in outcomes if outcome.cyclic is not None), default=0)
        each = (all_of_them - one) / (len(outcomes) - 1) if len(outcomes) > 1 else 0.0
        self._shards.append(one - each)
        self._cases.append(each + 4 * COLUMNS * bands)

    def of(self, cases: int, shards: int) -> int:
        if not cases:
            return 0
        return round(shards * mean(self._shards) + cases * mean(self._cases))


def _present(machine: Machine, plan: Plan, folder: Path | None) -> frozenset[str]:
    """Keys of the entries that a catalogue holds."""
    layout = CatalogueDirectory(folder) if folder is not None else None
    if layout is None or not layout.manifest.exists():
        return frozenset()
    Manifest.read(layout).check_accepts(machine, plan, layout.root)
    with IndexLocation.of(layout).open() as opened:
        return frozenset(opened.statuses())


def _some_of(chunks: Sequence[Chunk], place: float) -> Chunk:
    """A few cases, evenly spread, of the chunk at a part of all cases."""
    reached = list(accumulate(len(chunk.entries) for chunk in chunks))
    chunk = next(chunk for chunk, end in zip(chunks, reached, strict=True) if end >= place * reached[-1])
    step = max(1, len(chunk.entries) // CASES)
    return replace(chunk, entries=chunk.entries[::step][:CASES])


def _networks(plan: Plan, machine: Machine, cases: int) -> list[float]:
    """Seconds of training each network: of both modes, beside a machine's past, too, and of strata where there are two.

    None of too few cases.
    """
    training, counts = NetworkTraining(), [each.count for each in sequences_of(plan, machine) if each.hypothesis.joints]
    if min(counts, default=0) < training.least_cases:
        return []
    own = min(training.rows, CASE_ROWS * cases // len(plan.speeds)) * (1 + sum(training.epochs))
    strata = training.rows * (1 + sum(training.strata_epochs)) if plan.wide.draws else 0
    since = BESIDE_PAST * own if plan.draws.again else 0
    return [TRAINING_S * each for each in (own, own, since, since, strata) if each] * len(plan.speeds)
