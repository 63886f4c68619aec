"""Whether the process lives, and whether it can work."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from fastapi import APIRouter, Request
from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool
from starlette.responses import PlainTextResponse, Response

from jointplay.app.errors import AppError, DatabaseGoneError, NotReadyError
from jointplay.app.http.openapi import problems
from jointplay.app.schemas.resources import Health, Readiness
from jointplay.app.service import Service, of_request

router = APIRouter(tags=["health"])
START_S = 10.0
"""Longest time that a worker may take to start [s]."""


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
