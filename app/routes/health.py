"""Whether the process lives, and whether it can work."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool

from app.openapi import problems
from app.schemas import Health, Readiness
from app.service import of_request

router = APIRouter(tags=["health"])


@router.get("/healthz")
async def health() -> Health:
    """Say that the process answers."""
    return Health(status="ok")


@router.get("/readyz", responses=problems(500, 503))
async def readiness(request: Request) -> Readiness:
    """Say that the data base and the catalogue directory answer, and how many catalogues there are."""
    service = of_request(request)
    await run_in_threadpool(service.store.ready)
    return Readiness(status="ready", catalogues=len(await run_in_threadpool(service.shelf.offers)))
