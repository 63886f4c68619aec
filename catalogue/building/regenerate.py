"""Simulating stored cases again, to see whether a catalogue is what it says it is."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.building.chunk import Chunk, Compute, cut_chunks, simulate_chunk
from jointplay.catalogue.building.executors import Executor, InProcess, LocalProcesses
from jointplay.catalogue.errors import CatalogueMismatchError
from jointplay.catalogue.plans.entry import Entry
from jointplay.catalogue.storage.cross_power import pack
from jointplay.catalogue.storage.manifest import package_versions, this_platform
from jointplay.catalogue.storage.shard import CaseOutcome
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.spectra.bands import LEAST_POWER

TOLERANCE_DB = 1.0
"""Mean difference over all cases compared that another processor may make. Machines with play are chaotic: where sums
round differently, a case takes another course with the same statistics. Measured with clearances changed by 1e-12 of
themselves: 0.07 dB on average for slider-crank, 0.28 for quick-return, 1.7 for the worst of sixty cases."""

_CHUNK = 16


@dataclass(frozen=True)
class Compared:
    """One case, as it is stored and as it is now.

    Parameters
    ----------
    key, hypothesis : str
    stored, now : str
        Status.
    difference_db : float
        Mean over feature bands and motions of the differences of the levels, without sign; 0 if either has no spectrum.
    identical : bool
        Whether every bit that is stored is the same.
    """

    key: str
    hypothesis: str
    stored: str
    now: str
    difference_db: float
    identical: bool


@dataclass(frozen=True)
class RegenerateReport:
    """What came out.

    Parameters
    ----------
    cases : tuple of Compared
        In the order of the catalogue.
    same_program : bool
        Whether solver, packages, system and processor are those of the first build.
    seconds : float
    """

    cases: tuple[Compared, ...]
    same_program: bool
    seconds: float

    @property
    def identical(self) -> int:
        """Cases of which every bit is the same."""
        return sum(case.identical for case in self.cases)

    @property
    def changed(self) -> tuple[Compared, ...]:
        """Cases whose status is another one."""
        return tuple(case for case in self.cases if case.stored != case.now)

    @property
    def mean_db(self) -> float:
        """Mean difference [dB]."""
        return float(np.mean([case.difference_db for case in self.cases])) if self.cases else 0.0

    @property
    def worst(self) -> Compared | None:
        """The case that differs most; None if there is none."""
        return max(self.cases, key=lambda case: case.difference_db, default=None)

    @property
    def agrees(self) -> bool:
        """Whether no status has changed and the mean difference is within :data:`TOLERANCE_DB`."""
        return not self.changed and self.mean_db <= TOLERANCE_DB


def regenerate(
    catalogue: Catalogue,
    sample: int,
    *,
    seed: int = 0,
    workers: int = 0,
    progress: Callable[[int, int], None] | None = None,
    compute: Compute = simulate_chunk,
) -> RegenerateReport:
    """Simulate some cases of a catalogue again, as they are described in their shards, and compare.

    Parameters
    ----------
    catalogue : Catalogue
    sample : int
        Number of cases, >= 1, those that failed included; all if there are not so many.
    seed : int, optional
        Which ones.
    workers : int, optional
        Processes on this computer; 0 computes in this process.
    progress : callable, optional
        Called with the number of cases done and of all.
    compute : callable, optional
        What is done with a chunk.

    Raises
    ------
    CatalogueMismatchError
        It holds numbers of another version, which need not be the same.
    CatalogueFileError
        A shard is damaged.
    """
    started = time.monotonic()
    manifest = catalogue.manifest
    if manifest.other_numbers:
        raise CatalogueMismatchError(catalogue.path, f"{manifest.other_numbers}: nothing to compare")
    every = catalogue.matrix.every_row
    rows = np.sort(np.random.default_rng(seed).choice(every, min(sample, len(every)), replace=False))
    stored = {entry.key: (entry, outcome) for entry, outcome in catalogue.cases(rows)}
    chunks = cut_chunks(catalogue.machine, catalogue.recipe, [entry for entry, _ in stored.values()], _CHUNK)
    executor: Executor = LocalProcesses(workers) if workers > 0 else InProcess()
    now: dict[str, CaseOutcome] = {}
    try:
        for chunk, outcomes in _compute(chunks, executor, compute):
            now |= {entry.key: outcome for entry, outcome in zip(chunk.entries, outcomes, strict=True)}
            if progress is not None:
                progress(len(now), len(stored))
    finally:
        executor.close(at_once=True)
    cuts = catalogue.matrix.cuts
    return RegenerateReport(
        cases=tuple(_compare(entry, outcome, now[key], cuts) for key, (entry, outcome) in stored.items()),
        same_program=dict(manifest.versions) == package_versions() and manifest.platform == this_platform(),
        seconds=time.monotonic() - started,
    )


def _compute(
    chunks: Sequence[Chunk], executor: Executor, compute: Compute
) -> Iterator[tuple[Chunk, tuple[CaseOutcome, ...]]]:
    """Chunks and what became of them, in the order in which they are done."""
    flying: dict[Future[tuple[CaseOutcome, ...]], Chunk] = {}
    left = list(reversed(chunks))
    while left or flying:
        while left and len(flying) < executor.capacity:
            chunk = left.pop()
            flying[executor.submit(compute, chunk)] = chunk
        for future in wait(flying, return_when=FIRST_COMPLETED).done:
            yield flying.pop(future), future.result()


def _compare(entry: Entry, stored: CaseOutcome, now: CaseOutcome, cuts: tuple[int, ...]) -> Compared:
    difference = 0.0
    compared = ("status", "message", "drive_speed", "transient", "segments", "period")
    same = all(getattr(stored, name) == getattr(now, name) for name in compared)
    if stored.power is not None and now.power is not None:
        before, after = pack(stored.power), pack(now.power)
        levels = [
            10.0 * np.log10(np.maximum(np.add.reduceat(packed[:, :3], cuts[:-1], axis=0), LEAST_POWER))
            for packed in (before, after)
        ]
        difference = float(np.mean(np.abs(levels[1] - levels[0])))
        spreads = (np.asarray(stored.spread_db), np.asarray(now.spread_db))
        cyclic = (np.asarray(stored.cyclic), np.asarray(now.cyclic))
        same = same and np.array_equal(before, after) and np.array_equal(*spreads) and np.array_equal(*cyclic)
    return Compared(entry.key, entry.hypothesis.label, stored.status, now.status, difference, same)
