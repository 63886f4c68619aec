"""Whether the process lives, and whether it can work."""

from __future__ import annotations

from fastapi import APIRouter, Request
from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4
from starlette.concurrency import run_in_threadpool
from starlette.responses import PlainTextResponse, Response

from jointplay.app.http.openapi import problems
from jointplay.app.http.readiness import check
from jointplay.app.schemas.resources import Health, Readiness
from jointplay.app.service import of_request

router = APIRouter(tags=["health"])


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
