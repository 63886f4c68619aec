"""Building a catalogue: what is missing is computed in chunks, and each chunk is kept as soon as it is there."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from pathlib import Path

from catalogue.chunk import Chunk, Compute, chunked, simulate_chunk
from catalogue.directory import CatalogueDirectory, publish, sha256_of
from catalogue.entry import Entry
from catalogue.errors import BuildError, CatalogueError, CatalogueFileError
from catalogue.executors import Executor, InProcess, LocalProcesses
from catalogue.hdf5 import decode_shard, encode_shard
from catalogue.index import ChunkRow, ChunkStatus, Index
from catalogue.manifest import Manifest
from catalogue.plan import Plan
from catalogue.shard import OK, Outcome, Shard, ShardHeader
from solver.errors import SolverError
from solver.machines.machine import Machine
from solver.simulation.simulate import check_assembly

__all__ = ["BuildReport", "Progress", "build"]

CHUNK_SIZE = 64
"""Cases of a chunk: what a killed build loses at most for each worker, and what compiling a model is spread over."""

ATTEMPTS = 3
"""How often a chunk whose worker died is begun before it is halved, or given up if it is a single case."""

HOPELESS = 10
"""Attempts that may fail before the first chunk succeeds; after them the reason lies not in single cases."""


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
        Entries a second in this build; 0 before the first.
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
        Entries computed now.
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
) -> BuildReport:
    """Build a catalogue, or go on with one: compute every entry of the plan that is not there yet.

    It may be killed at any moment. What is complete stays, the same call again does the rest; at most the chunks in
    hand are lost. Entries are never computed or stored twice.

    Parameters
    ----------
    machine : Machine
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

    Returns
    -------
    BuildReport

    Raises
    ------
    PlanError
        The plan does not fit the machine.
    CatalogueMismatchError
        The folder holds a catalogue of another machine, schema, solver version or other settings.
    CatalogueBusyError
        Another process builds or verifies there.
    CatalogueFileError
        A file cannot be written.
    SolverError
        The machine cannot be assembled, or the solver refuses a parameter or a setting of the plan.
    """
    started = time.monotonic()
    wanted = plan.entries(machine)
    check_assembly(machine)
    layout = CatalogueDirectory(Path(directory))
    layout.create()
    with layout.locked():
        layout.remove_temporaries()
        manifest, is_new = _manifest(layout, machine, plan)
        with _open_index(layout) as index:
            adopted = _match_files(layout, index)
            statuses = index.statuses()
            missing = [entry for entry in wanted if entry.key not in statuses]
            if is_new or (missing and manifest.plan != plan):
                manifest = replace(manifest, plan=plan)
                manifest.write(layout)
            work = _Work(layout, index, manifest.header(plan), compute, progress, started)
            work.counted(len(wanted), [statuses[entry.key] for entry in wanted if entry.key in statuses])
            chunks = chunked(machine, manifest.recipe, missing, chunk_size)
            if chunks:
                mine = executor or (LocalProcesses(workers) if workers > 0 else InProcess())
                try:
                    work.run(chunks, mine)
                except BaseException:
                    if executor is None:
                        mine.close(at_once=True)
                    raise
                if executor is None:
                    mine.close()
            return work.report(wanted, adopted)


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


def _open_index(layout: CatalogueDirectory) -> Index:
    try:
        return Index(layout.index)
    except CatalogueFileError:
        if not layout.index.exists():
            raise
        layout.move_to_quarantine(layout.index)  # whatever it was, the shards hold all that it should have known
        return Index(layout.index)


def _match_files(layout: CatalogueDirectory, index: Index) -> int:
    """Make the index agree with the shards on the disk; returns the number of entries it did not know."""
    known, there = index.shards(), layout.shard_names()
    index.remove_shards(set(known) - set(there))
    return sum(_adopt(layout, index, name) for name in there if name not in known)


def _adopt(layout: CatalogueDirectory, index: Index, name: str) -> int:
    path = layout.shard(name)
    content = path.read_bytes()
    if sha256_of(content) != name:
        raise CatalogueFileError(path, "does not match its checksum: verify the catalogue first")
    return index.add_shard(name, len(content), decode_shard(content, path))


class _Work:
    """One build under way: hands out chunks, keeps results, counts."""

    def __init__(
        self,
        layout: CatalogueDirectory,
        index: Index,
        header: ShardHeader,
        compute: Compute,
        progress: Callable[[Progress], None] | None,
        started: float,
    ) -> None:
        self._layout, self._index, self._header = layout, index, header
        self._compute, self._progress, self._started = compute, progress, started
        self._attempts: dict[str, int] = {}
        self._queue: deque[Chunk] = deque()
        self._added = self._present = self._total = self._failed = 0
        self._workers_lost = self._failures = 0
        self._lost: list[str] = []
        self._lost_reason = ""

    def counted(self, total: int, present: list[str]) -> None:
        """Take note of the plan's size and of the statuses that are there already."""
        self._total, self._present = total, len(present)
        self._failed = sum(status != OK for status in present)

    def run(self, chunks: list[Chunk], executor: Executor) -> None:
        """Compute and keep all chunks."""
        self._queue.extend(chunks)
        self._index.plan_chunks([_row(chunk) for chunk in chunks])
        self._tell()
        flying: dict[Future[tuple[Outcome, ...]], Chunk] = {}
        while self._queue or flying:
            while self._queue and len(flying) < executor.capacity:
                chunk = self._queue.popleft()
                self._index.begin_chunk(chunk.id)
                self._attempts[chunk.id] = self._attempts.get(chunk.id, 0) + 1
                flying[executor.submit(self._compute, chunk)] = chunk
            finished, _ = wait(flying, return_when=FIRST_COMPLETED)
            for future in finished:
                chunk = flying.pop(future)
                error = future.exception()
                if error is None:
                    self._keep(chunk, future.result())
                elif isinstance(error, (SolverError, CatalogueError)):
                    raise error  # a refusal: it would be the same for every chunk
                else:
                    self._try_again(chunk, error, died=executor.is_loss(error))
                self._tell()

    def _keep(self, chunk: Chunk, outcomes: tuple[Outcome, ...]) -> None:
        shard = Shard.of(self._header, chunk.entries, outcomes)
        content = encode_shard(shard)
        name = sha256_of(content)
        publish(self._layout.shard(name), content)
        self._added += self._index.add_shard(name, len(content), shard, chunk=chunk.id)
        self._failed += sum(status != OK for status in shard.status)

    def _try_again(self, chunk: Chunk, error: BaseException, *, died: bool) -> None:
        """Once more if the worker died; else in halves, until the single case is found that cannot be computed."""
        attempt = self._attempts[chunk.id]
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        if died:
            self._workers_lost += 1
            reason = f"its worker died, in {attempt} {'attempt' if attempt == 1 else 'attempts'}"
        self._failures += 1
        if self._added == 0 and self._failures >= HOPELESS:
            raise BuildError(f"nothing could be computed in {self._failures} attempts, the last: {reason}") from error
        again = died and attempt < ATTEMPTS
        if not again and len(chunk.entries) > 1:
            halves = chunk.halves()
            self._index.split_chunk(chunk.id, [_row(half) for half in halves])
            self._queue.extend(halves)
            return
        self._index.end_attempt(chunk.id, reason, lost=not again)
        if again:
            self._queue.append(chunk)
        else:
            self._lost += [entry.key for entry in chunk.entries]
            self._lost_reason = reason

    def _tell(self) -> None:
        if self._progress is None:
            return
        seconds = time.monotonic() - self._started
        rate = self._added / seconds if seconds > 0 else 0.0
        left = self._total - self._present - self._added - len(self._lost)
        self._progress(
            Progress(
                done=self._present + self._added,
                total=self._total,
                failed=self._failed,
                lost=len(self._lost),
                rate=rate,
                eta=left / rate if rate > 0 else None,
                seconds=seconds,
            )
        )

    def report(self, wanted: tuple[Entry, ...], adopted: int) -> BuildReport:
        """Sum up."""
        statuses = self._index.statuses()
        failed: dict[str, int] = {}
        for entry in wanted:
            status = statuses.get(entry.key, OK)
            if status != OK:
                failed[status] = failed.get(status, 0) + 1
        return BuildReport(
            added=self._added,
            present=self._present,
            adopted=adopted,
            failed=failed,
            lost=tuple(self._lost),
            lost_reason=self._lost_reason,
            workers_lost=self._workers_lost,
            seconds=time.monotonic() - self._started,
            size=sum(row.size for row in self._index.shards().values()),
        )


def _row(chunk: Chunk) -> ChunkRow:
    return ChunkRow(chunk.id, ",".join(chunk.joints), len(chunk.entries), ChunkStatus.PENDING, 0, "")
