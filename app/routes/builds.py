"""Builds of catalogues: asking for one, following it, stopping it."""

from __future__ import annotations

import hashlib
import time
from collections.abc import AsyncGenerator
from functools import partial
from typing import Any

from fastapi import APIRouter, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from jointplay.app.errors import UnsupportedMediaError
from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.deleting import DELETED, Why, delete
from jointplay.app.http.openapi import problems
from jointplay.app.http.uploads import media_type
from jointplay.app.http.validation import validate
from jointplay.app.jobs.build_orders import order
from jointplay.app.jobs.build_watch import BuildWatch, event_id
from jointplay.app.jobs.clients import client_here
from jointplay.app.routes.diagnoses import JSON_TYPE, parse
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.builds import BuildOut, BuildPage, BuildRequest
from jointplay.app.service import of_request
from jointplay.app.storage.build_queue import ENDED, build_out
from jointplay.app.storage.idempotency import IdempotencyKey, once

router = APIRouter(prefix="/builds", tags=["builds"])

STREAM_TYPE = "text/event-stream"
EVENT: dict[str, Any] = {
    "type": "object",
    "description": "One event of the stream.",
    "required": ["event", "id", "data"],
    "properties": {
        "event": {"const": "state"},
        "id": {"type": "string"},
        "data": {"type": "string", "contentMediaType": JSON_TYPE},
    },
}


def body() -> dict[str, Any]:
    """Return the description of the body that a build is asked for with."""
    schema = BuildRequest.model_json_schema(ref_template="#/components/schemas/{model}")
    return {"required": True, "content": {JSON_TYPE: {"schema": schema}}}


async def read_wanted(request: Request) -> BuildRequest:
    """Return what a body asks for."""
    kind = media_type(request)
    if kind != JSON_TYPE:
        raise UnsupportedMediaError(f"Content-Type: {kind or 'none'}: must be {JSON_TYPE}")
    return validate(BuildRequest, parse(await request.body()))


@router.post(
    "",
    status_code=202,
    response_model=BuildOut,
    responses=problems(400, 409, 413, 415, 422, 500, 503, 507),
    openapi_extra={"requestBody": body()},
)
async def ask(request: Request, idempotency_key: IdempotencyKey = None) -> Response:
    """Build a catalogue, or go on with one; it is stored before this is answered, and outlives the server."""
    service, wanted = of_request(request), await read_wanted(request)

    async def answered() -> Response:
        row = await run_in_threadpool(order, service.builds, service.machines, service.settings.catalogues, wanted)
        service.runner.wake()
        headers = {"Location": f"/api/v1/builds/{row.id}"}
        return Response(build_out(row).model_dump_json(), 202, headers, JSON_TYPE)

    content = wanted.model_dump(mode="json")
    return await once(request, idempotency_key, service.store.claims, content, answered)


@router.get("", responses=problems(400, 422))
def builds(request: Request, cursor: Cursor = None, limit: Limit = None) -> BuildPage:
    """List the builds, the newest first."""
    service = of_request(request)
    size = limit or service.settings.page_size
    rows = service.builds.list_builds(paging.decode_number(cursor), size + 1)
    shown, following = paging.cut(rows, size)
    return BuildPage(items=[build_out(row) for row in shown], next_cursor=following)


@router.get("/{key}", response_model=BuildOut, responses=problems(404, 410))
def build(request: Request, key: str) -> Response:
    """Return a build, and how far it is."""
    document = Response(build_out(of_request(request).builds.find(key)).model_dump_json(), media_type=JSON_TYPE)
    return respond(request, document, hashlib.sha256(document.body).hexdigest())


@router.post("/{key}/cancel", status_code=202, responses=problems(404, 409))
def cancel(request: Request, key: str) -> BuildOut:
    """Stop a build: one that is queued at once, one that runs within a second or so. What was computed is kept."""
    return build_out(of_request(request).builds.cancel(key))


@router.delete("/{key}", status_code=204, responses=DELETED)
async def remove(request: Request, key: str, why: Why = "", idempotency_key: IdempotencyKey = None) -> Response:
    """Delete what is known of a build that has ended; its catalogue stays."""
    return await delete(request, idempotency_key, lambda removal: removal.delete_build(key, why), why)


@router.get(
    "/{key}/events",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "Events `state`, whose data is the build as JSON: how it is now, then every change. The"
            " stream ends with the build; asked again with the `Last-Event-ID` of then, 204 tells that no more comes.",
            "content": {STREAM_TYPE: {"schema": EVENT}},
        },
        204: {"description": "The build has ended, and the client knows."},
        **problems(404),
    },
)
async def events(request: Request, key: str) -> Response:
    """Follow a build: server-sent events."""
    service, moment = of_request(request), time.monotonic()
    row = await run_in_threadpool(service.builds.find, key)
    if row.state in ENDED and request.headers.get("last-event-id") == event_id(build_out(row).model_dump_json()):
        return Response(status_code=204)
    watch: BuildWatch = request.app.state.watch
    return Stream(watch, client_here().name, watch.follow(row, moment))


class Stream(StreamingResponse):
    """Events for a client, who may listen to so many at a time."""

    def __init__(self, watch: BuildWatch, client: str, events: AsyncGenerator[str, None]) -> None:
        super().__init__(events, media_type=STREAM_TYPE, headers={"Cache-Control": "no-store"})
        watch.enter(client)
        self._left = partial(watch.leave, client)
        self._events = events

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send them, until there are no more or nobody listens."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._left()
            await self._events.aclose()
