"""Answers about what was recorded: made in a worker, and gone on with behind all others where that takes too long."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import TimeLimitError
from jointplay.app.jobs import tasks
from jointplay.app.jobs.background import Background
from jointplay.app.jobs.workers import WorkerPool
from jointplay.app.storage.uploads import Upload, Uploads

WAIT = 0.5
"""How long a request waits for what goes on in the background, in limits of one task: it may then take another one."""


@dataclass(frozen=True)
class Answers:
    """Makes answers.

    Parameters
    ----------
    pool : WorkerPool
    background : Background
    uploads : Uploads
    time_limit : float
        Of one task in a worker [s].
    """

    pool: WorkerPool
    background: Background
    uploads: Uploads
    time_limit: float

    async def answer(
        self,
        task: Callable[..., Any],
        *recorded: Any,
        question: tasks.DiagnosisTask,
        measurements: Sequence[str],
        upload: Upload | None = None,
    ) -> Any:
        """Run a task that diagnoses what was recorded, and return its value.

        Parameters
        ----------
        task : callable
            Of :mod:`~jointplay.app.jobs.tasks`.
        *recorded
            Its arguments before the question.
        question : DiagnosisTask
        measurements : sequence of str
            What was recorded.
        upload : Upload, optional
            Where that lies only as long as the request lasts.

        Raises
        ------
        TimeLimitError
            When it takes too long; says so where it goes on, and how far it is.
        """
        said = recorded[1:] if upload else ()
        key = repr((task.__name__, list(measurements), said, question))
        if made := await self.background.wait(key, WAIT * self.time_limit):
            return made.result()
        if self.background.is_at_work(key):
            raise self._asked_too_early("it takes longer than a request may", key)
        try:
            return await self.pool.run(task, *recorded, question)
        except TimeLimitError as error:
            if made := await self.background.wait(key, 0.0):  # by the same request, a little earlier
                return made.result()
            # All others take seconds, or something is wrong with what they are about.
            if question.effort != "thorough" or not await self._go_on(key, task, (*recorded, question), upload):
                raise
            raise self._asked_too_early(str(error), key) from None

    async def _go_on(self, key: str, task: Callable[..., Any], args: Sequence[Any], upload: Upload | None) -> bool:
        """Go on with an answer behind all others; return whether that is done."""
        if upload is None:
            return self.background.go_on(key, task, args)
        held = await run_in_threadpool(self.uploads.hold, upload)
        _, *others = args
        return self.background.go_on(key, task, (str(held.path), *others), lambda: self.uploads.settle(held))

    def _asked_too_early(self, why: str, key: str) -> TimeLimitError:
        said = f"{why}; it goes on in the background, ask again later: {self.background.say(key)}"
        return TimeLimitError(said, seconds=math.ceil(self.time_limit))
