"""Whether the process lives, and whether it can work."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable

from anyio import to_thread
from fastapi import APIRouter, Request
from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.responses import PlainTextResponse, Response

from jointplay.app.errors import AppError, DatabaseGoneError, NotReadyError
from jointplay.app.http.openapi import problems
from jointplay.app.problems import is_gone
from jointplay.app.schemas.resources import Health, Readiness
from jointplay.app.service import Service, of_request

router = APIRouter(tags=["health"])
START_S = 10.0
"""Longest time that a worker may take to start [s]."""
LOOK_S = 1.5
"""Longest time that database and disk may take to answer [s]; what is stalled is not waited for."""


@router.get("/healthz")
async def health() -> Health:
    """Say that the process answers."""
    return Health(status="ok")


@router.get("/readyz", responses=problems(500, 503))
async def readiness(request: Request) -> Readiness:
    """Say that the database answers, recordings can be stored, a worker works, and how many catalogues there are."""
    service = of_request(request)
    await check(service)
    return Readiness(status="ready", catalogues=len(await run_in_threadpool(service.shelf.offers)))


@router.get(
    "/metrics",
    response_class=PlainTextResponse,
    responses={
        200: {"description": "Counters and measures.", "content": {"text/plain": {"schema": {"type": "string"}}}}
    },
)
def metrics(request: Request) -> Response:
    """Count what the service does, for Prometheus: its text format."""
    return Response(of_request(request).metrics.text(), media_type=CONTENT_TYPE_PLAIN_0_0_4)


async def check(service: Service) -> None:
    """Try everything that requests need; what is stalled is told as such within two seconds.

    Raises
    ------
    DatabaseGoneError
        When the database does not answer; whatever else is wrong is named with it.
    NotReadyError
        When something else is wrong, all of which is named.
    """
    workers = asyncio.ensure_future(service.pool.check(START_S))
    database, data = await asyncio.gather(
        look(service, "database", service.store.database.try_writing),
        look(service, "data", service.store.uploads.try_writing),
    )
    faults = [text for text in (database, data) if text]
    # What is wrong is said at once; a worker that starts is not ended by that.
    await asyncio.wait([workers], timeout=LOOK_S / 5 if faults else None)
    if workers.done() and not workers.result():
        faults.append("workers: none can be started")
    if service.stopping.is_set():
        faults.append("the service is stopping")
    if faults:
        raise (DatabaseGoneError if database else NotReadyError)("; ".join(faults))


async def look(service: Service, name: str, attempt: Callable[[], object]) -> str:
    """Return why an attempt failed, or that it takes too long, after a name; nothing where it did not."""
    try:
        async with asyncio.timeout(LOOK_S):
            return await to_thread.run_sync(fault, name, attempt, abandon_on_cancel=True, limiter=service.looks)
    except TimeoutError:
        return f"{name}: does not answer within {LOOK_S:g} s"


def fault(name: str, attempt: Callable[[], object]) -> str:
    """Return why an attempt failed, after a name; nothing where it did not."""
    try:
        attempt()
    except SQLAlchemyError as error:
        driver = getattr(error, "orig", None)
        if isinstance(driver, AppError):
            return f"{name}: {driver}"
        mine = isinstance(driver, sqlite3.Error) or not is_gone(error)
        return f"{name}: {'cannot be written to' if mine else 'does not answer'}"
    except OSError as error:
        return f"{name}: {error.strerror or type(error).__name__}"
    return ""
