"""Deleting over HTTP: the same for everything that can be deleted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from jointplay.app.http.openapi import problems
from jointplay.app.schemas.assets import TEXT
from jointplay.app.service import of_request
from jointplay.app.storage.idempotency import once
from jointplay.app.storage.removal import Removal

Why = Annotated[
    str,
    Query(max_length=200, pattern=TEXT, examples=["the customer has left"], description="Kept, and told to who asks."),
]
DELETED: dict[int | str, dict[str, Any]] = {
    204: {"description": "It is deleted.", "model": None},
    **problems(404, 409, 410, 422),
}


async def delete(request: Request, key: str | None, act: Callable[[Removal], None], why: str) -> Response:
    """Let something be deleted, once under an ``Idempotency-Key``."""
    store = of_request(request).store

    async def answered() -> Response:
        await run_in_threadpool(act, Removal(store))
        return Response(status_code=204)

    return await once(request, key, store.claims, why, answered)
