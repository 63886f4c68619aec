"""Whether the service can do its work: database, folder of data and workers are tried, not believed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import AppError, DatabaseGoneError, NotReadyError
from jointplay.app.service import Service

START_S = 10.0
"""Longest time that a worker may take to start [s]."""


async def check(service: Service) -> None:
    """Try everything that requests need.

    Raises
    ------
    DatabaseGoneError
        When the database does not answer; whatever else is wrong is named with it.
    NotReadyError
        When something else is wrong, all of which is named.
    """
    database, data, workers = await asyncio.gather(
        run_in_threadpool(fault, "database", service.store.ready),
        run_in_threadpool(fault, "data", service.store.try_writing),
        service.pool.check(START_S),
    )
    faults = [text for text in (database, data) if text]
    if not workers:
        faults.append("workers: none can be started")
    if service.stopping.is_set():
        faults.append("the service is stopping")
    if faults:
        raise (DatabaseGoneError if database else NotReadyError)("; ".join(faults))


def fault(name: str, attempt: Callable[[], object]) -> str:
    """Return why an attempt failed, after a name; nothing where it did not."""
    try:
        attempt()
    except SQLAlchemyError:
        return f"{name}: does not answer"
    except AppError as error:
        return f"{name}: {error}"
    except OSError as error:
        return f"{name}: {error.strerror or type(error).__name__}"
    return ""
