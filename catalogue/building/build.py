"""Building a catalogue: what is missing is computed in chunks, and each chunk is kept as soon as it is there."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from jointplay.catalogue.building.chunk import Chunk, Compute, cut_chunks, simulate_chunk
from jointplay.catalogue.building.executors import Executor, InProcess, LocalProcesses
from jointplay.catalogue.building.scheduling import Scheduler, Tally
from jointplay.catalogue.errors import CatalogueFileError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.entry import Entry
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.storage.database import IndexDatabase
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.index import Index
from jointplay.catalogue.storage.leases import BuilderLock, ChunkRow
from jointplay.catalogue.storage.location import IndexLocation, match_files, open_index
from jointplay.catalogue.storage.manifest import Manifest
from jointplay.catalogue.storage.sealing import seal
from jointplay.catalogue.storage.shard import OK
from jointplay.solver.machines.machine import Machine
from jointplay.solver.simulation.simulate import check_assembly

CHUNK_SIZE = 512
"""Cases of a chunk: what a killed build loses at most for each worker, and what compiling a model is spread over."""

LEASE = 60.0
"""How long other builders wait for a sign of life before they begin a chunk of this one again [s]."""


@dataclass(frozen=True)
class Progress:
    """How far a build is.

    Parameters
    ----------
    done, total : int
        Entries of the plan that are in the catalogue, and all of them.
    failed : int
        Of those done, the ones whose status is not ok.
    lost : int
        Entries given up in this build because their worker died again and again; not among those done.
    rate : float
        Entries a second since this build began, of all builders; 0 before the first.
    eta : float or None
        Seconds to go at this rate; None before the first entry.
    seconds : float
        Since the build began.
    """

    done: int
    total: int
    failed: int
    lost: int
    rate: float
    eta: float | None
    seconds: float


@dataclass(frozen=True)
class BuildReport:
    """What a build did.

    Parameters
    ----------
    added : int
        Entries computed now, by this builder.
    others : int
        Entries computed meanwhile by other builders of the same catalogue.
    present : int
        Entries of the plan that were there before.
    adopted : int
        Of those present, the ones found in shards that an interrupted build had not entered into the index.
    failed : mapping of str to int
        Entries of the plan whose status is not ok, by status, old and new.
    lost : tuple of str
        Keys of the entries that could not be computed; the next build tries them again.
    lost_reason : str
        What happened to the last of them; empty if there are none.
    workers_lost : int
        Times a worker died and its chunk was begun again.
    seconds : float
        Time it took.
    size : int
        Bytes of all shards of the catalogue.
    """

    added: int
    others: int
    present: int
    adopted: int
    failed: Mapping[str, int]
    lost: tuple[str, ...]
    lost_reason: str
    workers_lost: int
    seconds: float
    size: int


def build(
    machine: Machine,
    plan: Plan,
    directory: str | Path,
    *,
    workers: int = 2,
    progress: Callable[[Progress], None] | None = None,
    executor: Executor | None = None,
    compute: Compute = simulate_chunk,
    chunk_size: int = CHUNK_SIZE,
    index: str | None = None,
    lease: float = LEASE,
) -> BuildReport:
    """Build a catalogue, or go on with one: compute every entry of the plan that is not there yet.

    It may be killed at any moment. What is complete stays, the same call again does the rest; at most the chunks in
    hand are lost. Several builders may work on one catalogue at the same time; each entry is stored exactly once.

    Parameters
    ----------
    machine : Machine
        Held without the clearances that its file gives to joints: the plan says what is worn.
    plan : Plan
    directory : str or Path
        The catalogue's folder; made where there is none.
    workers : int
        Processes on this computer; 0 computes in this process.
    progress : callable, optional
        Called in this thread, at the beginning and after each chunk.
    executor : Executor, optional
        Where to compute, in place of `workers`; it stays open.
    compute : callable, optional
        What is done with a chunk.
    chunk_size : int, optional
        Most cases of a chunk.
    index : str, optional
        URL of the database for the index, remembered with the catalogue; by default the one remembered, or a file of
        SQLite in the folder.
    lease : float, optional
        How long a chunk stays with a builder that gives no sign of life [s].

    Returns
    -------
    BuildReport

    Raises
    ------
    PlanError
        The plan does not fit the machine.
    CatalogueMismatchError
        The folder holds a catalogue of another machine, layout, version of numbers or other settings.
    CatalogueBusyError
        Another process verifies there.
    CatalogueFileError
        A file or the index cannot be written.
    BuildError
        Nothing at all can be computed.
    SolverError
        The machine cannot be assembled, or the solver refuses a parameter or a setting of the plan.
    """
    started = time.monotonic()
    machine = machine.without_clearances()
    plan = plan.resolve(machine)
    wanted = entries_of(plan, machine)
    check_assembly(machine)
    layout = CatalogueDirectory(Path(directory))
    if index is not None:
        IndexDatabase(index).close()  # refused before there is a folder
    layout.create()
    with BuilderLock(layout) as lock:
        if lock.alone:
            layout.remove_temporaries()
        manifest, is_new = _manifest(layout, machine, plan)
        location = IndexLocation.choose(layout, index, alone=lock.alone)
        every = cut_chunks(machine, manifest.recipe, wanted, chunk_size)
        if is_new:
            manifest.write(layout)
        adopted = 0
        if lock.alone:
            with open_index(layout, location) as opened:
                adopted = match_files(layout, opened)
                opened.leases.plan([_row(chunk) for chunk in _missing(every, opened.statuses())], alone=True)
            lock.share()
        with location.open() as opened:  # only now: another process may have had the lock before it was shared
            statuses = opened.statuses()
            there = [statuses[entry.key] for entry in wanted if entry.key in statuses]
            if len(there) < len(wanted) and manifest.plan != plan:
                manifest = replace(manifest, plan=plan)
                manifest.write(layout)
            chunks = _missing(every, statuses)
            opened.leases.plan([_row(chunk) for chunk in chunks], alone=lock.alone)
            tally = Tally(len(wanted), len(there), sum(status != OK for status in there))

            def tell() -> None:
                if progress is not None:
                    progress(_progress(tally, time.monotonic() - started))

            if chunks:
                mine = executor or (LocalProcesses(workers) if workers > 0 else InProcess())
                scheduler = Scheduler(layout, opened, manifest.header(plan), compute, tally, tell, lease)
                try:
                    scheduler.run(chunks, mine)
                except BaseException:
                    if executor is None:
                        mine.close(at_once=True)
                    raise
                if executor is None:
                    mine.close()
            seal(layout, manifest, lambda: tuple(sorted(opened.shards())))
            return _report(opened, wanted, tally, adopted, time.monotonic() - started)


def _manifest(layout: CatalogueDirectory, machine: Machine, plan: Plan) -> tuple[Manifest, bool]:
    """The manifest of the folder, or a new one, not written yet; refuses what does not fit it."""
    if layout.manifest.exists():
        manifest = Manifest.read(layout)
    elif layout.shard_names():
        raise CatalogueFileError(layout.manifest, "is missing, but there are shards: verify the catalogue first")
    else:
        return Manifest.of(machine, plan), True
    manifest.check_accepts(machine, plan, layout.root)
    return manifest, False


def _missing(chunks: list[Chunk], statuses: Mapping[str, str]) -> list[Chunk]:
    """Chunks without the entries that are there.

    The chunks are those of the whole plan, so that what a chunk holds does not depend on which others are done.
    """
    left: list[Chunk] = []
    for chunk in chunks:
        entries = tuple(entry for entry in chunk.entries if entry.key not in statuses)
        if entries:
            left.append(chunk if len(entries) == len(chunk.entries) else replace(chunk, entries=entries))
    return left


def _progress(tally: Tally, seconds: float) -> Progress:
    now = tally.added + tally.others
    rate = now / seconds if seconds > 0 else 0.0
    left = tally.total - tally.done - len(tally.lost)
    return Progress(
        done=tally.done,
        total=tally.total,
        failed=tally.failed,
        lost=len(tally.lost),
        rate=rate,
        eta=left / rate if rate > 0 else None,
        seconds=seconds,
    )


def _report(index: Index, wanted: tuple[Entry, ...], tally: Tally, adopted: int, seconds: float) -> BuildReport:
    statuses = index.statuses()
    failed: dict[str, int] = {}
    for entry in wanted:
        status = statuses.get(entry.key, OK)
        if status != OK:
            failed[status] = failed.get(status, 0) + 1
    return BuildReport(
        added=tally.added,
        others=tally.others,
        present=tally.present,
        adopted=adopted,
        failed=failed,
        lost=tuple(tally.lost),
        lost_reason=next(reversed(tally.lost.values()), ""),
        workers_lost=tally.workers_lost,
        seconds=seconds,
        size=sum(row.size for row in index.shards().values()),
    )


def _row(chunk: Chunk) -> ChunkRow:
    return ChunkRow(chunk.id, chunk.entries[0].hypothesis.label, len(chunk.entries))
