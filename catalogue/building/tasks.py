"""What a builder has in hand: chunks, and parts of those that are searched for the case that cannot be computed."""

from __future__ import annotations

from dataclasses import dataclass, field

from jointplay.catalogue.building.chunk import Chunk
from jointplay.catalogue.storage.shard import Outcome

__all__ = ["Task", "Work"]


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
    outcomes: dict[str, Outcome] = field(default_factory=dict)
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
