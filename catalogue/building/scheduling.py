"""The builder's loop: claims chunks, hands them out, keeps what comes back, and waits for what other builders have.

A part of a chunk that stops its process is halved until the case that cannot be computed is found.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from functools import partial

from jointplay.catalogue.building.chunk import Chunk, Compute
from jointplay.catalogue.building.executors import Executor
from jointplay.catalogue.errors import BuildError, CatalogueError, CatalogueFileError
from jointplay.catalogue.storage.directory import CatalogueDirectory, publish, sha256_of
from jointplay.catalogue.storage.hdf5 import encode_shard
from jointplay.catalogue.storage.index import EntriesPresentError, Index
from jointplay.catalogue.storage.leases import ChunkStatus
from jointplay.catalogue.storage.shard import OK, CaseOutcome, Shard, ShardHeader
from jointplay.solver.errors import SolverError


@dataclass
class Work:
    """A chunk in hand: what is there of it.

    Parameters
    ----------
    chunk : Chunk
    outcomes : dict of str to Outcome
        By key.
    lost : dict of str to str
        What happened to the cases that could not be computed, by key.
    seconds : float
        Of a processor.
    """

    chunk: Chunk
    outcomes: dict[str, CaseOutcome] = field(default_factory=dict)
    lost: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def is_complete(self) -> bool:
        """Whether every case is computed or lost."""
        return len(self.outcomes) + len(self.lost) == len(self.chunk.entries)


@dataclass
class Task:
    """A chunk, or a part of it.

    Parameters
    ----------
    part : Chunk
    work : Work
        Of the chunk.
    whole : Task, optional
        What this is a half of.
    deaths : int
        Times a worker died with it.
    has_failed : bool
    failed_halves : int
    """

    part: Chunk
    work: Work
    whole: Task | None = None
    deaths: int = 0
    has_failed: bool = False
    failed_halves: int = 0

    def halves(self) -> tuple[Task, Task]:
        """Two tasks in its place; only where there are two cases at least."""
        first, second = self.part.halves()
        return Task(first, self.work, self), Task(second, self.work, self)

    def fail(self) -> bool:
        """Note a failure; returns whether it shows one more case that cannot be computed.

        Parts that have no case in common and fail hold such a case each: a chunk, and a half whose other half fails,
        too. A half that fails alone holds the one its whole failed by.
        """
        if self.has_failed:
            return False
        self.has_failed = True
        if self.whole is None:
            return True
        self.whole.failed_halves += 1
        return self.whole.failed_halves == 2


ATTEMPTS = 3
"""How often a task whose worker died is begun before it is halved, or given up if it is a single case."""

HOPELESS = 10
"""Parts with no case in common that may fail before the first task succeeds.

So many cases at least cannot be computed then, and the reason lies not in single ones. Attempts do not tell: two cases
that kill workers fail ten of them in one chunk.
"""

LOOK = 1.0
"""Time between looks at what other builders have done [s]."""


@dataclass
class Tally:
    """Counts of one build.

    Parameters
    ----------
    total, present : int
        Entries of the plan, and those of them that were there before.
    failed : int
        Entries of the plan that are there with a status that is not ok.
    added, others : int
        Entries computed by this build, and by other builders meanwhile.
    workers_lost : int
        Times a worker died with a task.
    lost : dict of str to str
        What happened to the cases that could not be computed, by key.
    """

    total: int
    present: int
    failed: int
    added: int = 0
    others: int = 0
    workers_lost: int = 0
    lost: dict[str, str] = field(default_factory=dict)

    @property
    def done(self) -> int:
        """Entries of the plan that are in the catalogue."""
        return self.present + self.added + self.others


class Scheduler:
    """One builder at work.

    Parameters
    ----------
    layout : CatalogueDirectory
    index : Index
    header : ShardHeader
        Of the shards it writes.
    compute : callable
        What is done with a chunk.
    tally : Tally
        Counted on here.
    tell : callable
        Called in this thread, at the beginning and whenever something is done.
    lease : float
        How long a chunk stays this builder's after a sign of life [s].
    """

    def __init__(
        self,
        layout: CatalogueDirectory,
        index: Index,
        header: ShardHeader,
        compute: Compute,
        tally: Tally,
        tell: Callable[[], None],
        lease: float,
    ) -> None:
        self._layout, self._index, self._header = layout, index, header
        self._compute, self._tally, self._tell, self._lease = compute, tally, tell, lease
        self._owner = f"{socket.gethostname()}:{os.getpid()}:{secrets.token_hex(4)}"
        self._open: deque[Chunk] = deque()
        self._again: deque[Task] = deque()
        self._elsewhere: dict[str, Chunk] = {}
        self._failures = 0  # attempts
        self._bad_parts = 0  # with no case in common
        self._succeeded = False  # a part of a chunk counts: a large one with a deadly case is stored late
        self._looked = 0.0

    def run(self, chunks: Sequence[Chunk], executor: Executor) -> None:
        """Compute and keep all chunks, or see other builders do it.

        Raises
        ------
        BuildError
            Nothing at all can be computed.
        CatalogueFileError
            A file or the index cannot be written.
        SolverError
            The solver refuses a parameter or a setting.
        """
        self._open.extend(chunks)
        self._tell()
        measured = partial(_measure, self._compute)
        flying: dict[Future[tuple[tuple[CaseOutcome, ...], float]], Task] = {}
        with self._alive():
            while self._open or self._again or self._elsewhere or flying:
                for task in self._next(executor.capacity - len(flying)):
                    flying[executor.submit(measured, task.part)] = task
                if flying:
                    finished, _ = wait(flying, timeout=LOOK, return_when=FIRST_COMPLETED)
                else:
                    finished = set()
                    time.sleep(min(LOOK, self._lease / 4))
                for future in finished:
                    self._take(flying.pop(future), future, executor)
                    self._tell()
                self._look()

    def _next(self, room: int) -> Iterator[Task]:
        """Up to `room` tasks: first those that are tried again, then chunks that nobody has.

        Until something succeeds it is the other way round: what else fails tells whether it lies in single cases.
        """
        while room > 0 and (self._open or self._again):
            if self._again and (self._succeeded or not self._open):
                room -= 1
                yield self._again.popleft()
                continue
            asked = [self._open.popleft() for _ in range(min(room, len(self._open)))]
            granted = self._index.leases.claim(self._owner, [chunk.id for chunk in asked], self._lease)
            for chunk in asked:
                if chunk.id in granted:
                    room -= 1
                    yield Task(chunk, Work(chunk))
                else:
                    self._elsewhere[chunk.id] = chunk

    def _look(self) -> None:
        """See what became of the chunks that other builders have."""
        if not self._elsewhere or time.monotonic() - self._looked < min(LOOK, self._lease / 4):
            return
        self._looked = time.monotonic()
        for chunk, status in self._index.leases.states(list(self._elsewhere)).items():
            if status is ChunkStatus.RUNNING:
                continue
            found = self._elsewhere.pop(chunk)
            if status is ChunkStatus.PENDING:
                self._open.append(found)
                continue
            known = self._index.find_known([entry.key for entry in found.entries])
            self._tally.others += len(known)
            self._tally.failed += sum(status != OK for status in known.values())
            missing = [entry.key for entry in found.entries if entry.key not in known]
            self._tally.lost |= dict.fromkeys(missing, "another builder could not compute it")
            self._tell()

    def _take(self, task: Task, future: Future[tuple[tuple[CaseOutcome, ...], float]], executor: Executor) -> None:
        error = future.exception()
        if error is None:
            outcomes, seconds = future.result()
            self._succeeded = True
            keys = [entry.key for entry in task.part.entries]
            task.work.outcomes |= dict(zip(keys, outcomes, strict=True))
            task.work.seconds += seconds
        elif isinstance(error, (SolverError, CatalogueError)):
            raise error  # a refusal: it would be the same for every chunk
        elif executor.is_blameless(error):
            self._again.append(task)
        else:
            self._try_again(task, error, died=executor.is_loss(error))
        if task.work.is_complete:
            self._keep(task.work)

    def _try_again(self, task: Task, error: BaseException, *, died: bool) -> None:
        """Once more if the worker died; else in halves, until the single case is found that cannot be computed.

        The parts stay one chunk with one shard, so that a catalogue does not tell which workers died.
        """
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        if died:
            task.deaths += 1
            self._tally.workers_lost += 1
            reason = f"its worker died, in {task.deaths} {'attempt' if task.deaths == 1 else 'attempts'}"
        self._failures += 1
        self._bad_parts += task.fail()
        if not self._succeeded and self._bad_parts >= HOPELESS:
            raise BuildError(f"nothing could be computed in {self._failures} attempts, the last: {reason}") from error
        if died and task.deaths < ATTEMPTS:
            self._again.append(task)
        elif len(task.part.entries) > 1:
            self._again.extend(task.halves())
        else:
            task.work.lost[task.part.entries[0].key] = reason

    def _keep(self, work: Work) -> None:
        """Store what came of a chunk, each entry once, whatever others have stored meanwhile."""
        entries = [entry for entry in work.chunk.entries if entry.key in work.outcomes]
        message = _message(work.lost)
        self._tally.lost |= work.lost
        while entries:
            outcomes = [work.outcomes[entry.key] for entry in entries]
            shard = Shard.of(self._header, entries, outcomes)
            content = encode_shard(shard)
            name = sha256_of(content)
            publish(self._layout.shard(name), content)
            try:
                new = self._index.add_shard(
                    name, len(content), shard, chunk=work.chunk.id, seconds=work.seconds, message=message
                )
            except EntriesPresentError as error:  # in a shard of another builder, with another plan or other rounding
                self._layout.shard(name).unlink(missing_ok=True)
                self._tally.others += len(error.keys)
                entries = [entry for entry in entries if entry.key not in error.keys]
                continue
            self._tally.added += new
            self._tally.others += shard.count - new
            self._tally.failed += sum(status != OK for status in shard.status)
            return
        self._index.leases.finish(work.chunk.id, message)

    @contextlib.contextmanager
    def _alive(self) -> Iterator[None]:
        """Extend the leases until the end of the block, then give back what is left."""
        end = threading.Event()

        def extend() -> None:
            while not end.wait(self._lease / 3):
                with contextlib.suppress(CatalogueFileError):  # the builder's own thread finds out and says it
                    self._index.leases.extend(self._owner, self._lease)

        heart = threading.Thread(target=extend, name="extend-leases", daemon=True)
        heart.start()
        try:
            yield
        except BaseException:
            end.set()
            heart.join()
            with contextlib.suppress(CatalogueFileError):
                self._index.leases.give_back(self._owner)
            raise
        end.set()
        heart.join()


def _measure(compute: Compute, chunk: Chunk) -> tuple[tuple[CaseOutcome, ...], float]:
    """At a worker: what comes of a chunk, and its processor time [s], compilation and estimates included."""
    began = time.thread_time()
    outcomes = compute(chunk)
    return outcomes, time.thread_time() - began


def _message(lost: Mapping[str, str]) -> str:
    """What went wrong in a chunk, one line; empty if nothing did."""
    return "; ".join(f"{key[:12]}: {reason}" for key, reason in lost.items())
