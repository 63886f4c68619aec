"""Judging assets anew, one at a time: when something has changed, or time has passed; by each server of a database."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from datetime import timedelta
from http import HTTPStatus

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import (
    BusyError,
    DamagedRowError,
    DeletedError,
    NothingToFollowError,
    TimeLimitError,
    UnknownAssetError,
    WorkerDiedError,
)
from jointplay.app.jobs import following
from jointplay.app.jobs.workers import TaskFailedError, WorkerPool
from jointplay.app.storage.rows import now
from jointplay.app.storage.standings import Due, Standings
from jointplay.app.storage.store import Store
from jointplay.app.words import named_joints
from jointplay.catalogue.following.standing import LIKELY, JointKnown, Known
from jointplay.catalogue.following.state import WearState

log = logging.getLogger(__name__)

PAUSE_S = 1.0
BUSY = timedelta(seconds=10)

LATER, MOST_FAILURES = timedelta(minutes=5), 12
"""When an asset is followed again after a failure that may pass, and how many of them in a row do not: an hour's."""


class StandingKeeper:
    """Keeps how assets stand up to date, in the background.

    Parameters
    ----------
    store : Store
    pool : WorkerPool
        Follows their wear; half of the time of one of its workers at most.
    """

    def __init__(self, store: Store, pool: WorkerPool) -> None:
        self._store = store
        self._standings = Standings(store.database)
        self._pool = pool
        self._failures: Counter[str] = Counter()

    async def run(self) -> None:
        """Judge what is due, and what will be, until this is cancelled."""
        while True:
            began = time.monotonic()
            try:
                busy = await self.step()
            except SQLAlchemyError as error:
                log.warning("standings of assets wait for the database: %s", type(error).__name__)
                busy = False
            except Exception:
                # Whatever it is, it must not end this; the asset is due again after its lease.
                log.exception("the standing of an asset could not be judged")
                busy = False
            await asyncio.sleep(time.monotonic() - began if busy else PAUSE_S)

    async def step(self) -> bool:
        """Judge the asset that is due for longest; return whether there was one."""
        due = await run_in_threadpool(self._standings.take, now())
        if due is None:
            return False
        try:
            known = due.known or await self._learn(due)
            await run_in_threadpool(self._standings.settle, due, known, now())
        except BusyError:
            await run_in_threadpool(self._standings.postpone, due, now() + BUSY)
            return False
        except (TaskFailedError, TimeLimitError, WorkerDiedError) as error:  # it stands as it stood
            log.warning("asset %s is followed again in %s: %s", due.external_id, LATER, error)
            await run_in_threadpool(self._standings.postpone, due, now() + LATER)
            return True
        except (UnknownAssetError, DeletedError):  # while it was being judged
            self._failures.pop(due.external_id, None)
            return True
        return True

    async def _learn(self, due: Due) -> Known:
        """Return what is known of an asset.

        Raises
        ------
        TaskFailedError, TimeLimitError, WorkerDiedError
            When its wear could not be followed, and may be soon.
        """
        try:
            heard, last, at = await run_in_threadpool(self._standings.last_heard, due.external_id)
        except DamagedRowError as error:
            return Known.model_validate(due.last).model_copy(update={"failure": str(error)[:200]})
        told = Known(heard_at=heard)
        if last is None:
            return told
        told = told.model_copy(update={"verdict": last.result["verdict"], "verdict_at": at, "diagnosis": last.id})
        try:
            life = await run_in_threadpool(following.gather, self._store, due.external_id)
            state: WearState = await self._pool.run(following.follow_life, life)
        except (DamagedRowError, NothingToFollowError, TaskFailedError, TimeLimitError, WorkerDiedError) as error:
            return self._after_failure(due, told, error)
        self._failures.pop(due.external_id, None)
        joints = {name: JointKnown.of(each) for name, each in state.joints.items()}
        worn = set(named_joints(last.answer))
        # What is told of the moment of a recording was mended, or found in order, after it.
        mended = [repair for repair in state.repairs if at and (repair.at > at or (repair.at == at and repair.is_told))]
        since = {repair.joint for repair in mended}
        if since:
            looked_at = {name for found_at, _, told in life.findings if at and found_at >= at for name in told}
            since |= {name for name in looked_at if name in joints and joints[name].p_worn < LIKELY}
        repaired = bool(worn) and worn <= since
        return told.model_copy(update={"joints": joints, "causes": state.causes, "repaired": repaired})

    def _after_failure(self, due: Due, told: Known, error: Exception) -> Known:
        """Return what is known of an asset whose wear could not be followed; what may pass is raised, at first.

        Parameters
        ----------
        due : Due
        told : Known
            By its last recording.
        error : Exception
        """
        if may_pass(error):
            self._failures[due.external_id] += 1
            if self._failures[due.external_id] < MOST_FAILURES:
                raise error
        self._failures.pop(due.external_id, None)
        failure = str(error)[:200]
        if isinstance(error, NothingToFollowError):  # but perhaps an answer across a repair: that is of no state
            return Known(heard_at=told.heard_at, failure=failure)
        if not may_pass(error) and not isinstance(error, DamagedRowError):
            return told.model_copy(update={"failure": failure})
        last = Known.model_validate(due.last)  # it is no better for that
        kept = {"joints": last.joints, "causes": last.causes, "failure": failure}
        return told.model_copy(update={**kept, "repaired": last.repaired and last.diagnosis == told.diagnosis})


def may_pass(error: Exception) -> bool:
    """Return whether a failure may be one of the moment, rather than of what was to be done."""
    if isinstance(error, TaskFailedError):
        return error.problem.status >= HTTPStatus.INTERNAL_SERVER_ERROR
    return isinstance(error, (TimeLimitError, WorkerDiedError))
