"""Webhooks: addresses that are told when something happens."""

from __future__ import annotations

from fastapi import APIRouter, Depends, Request, Response
from starlette.concurrency import run_in_threadpool

from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.openapi import problems
from jointplay.app.http.uploads import JSON_TYPE, json_body
from jointplay.app.jobs.webhook_sender import check_url
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.webhooks import DeliveryOut, DeliveryPage, WebhookIn, WebhookMade, WebhookOut, WebhookPage
from jointplay.app.service import of_request
from jointplay.app.storage.idempotency import IdempotencyKey, once
from jointplay.app.storage.webhooks import WebhookRow, Webhooks, place_of

router = APIRouter(prefix="/webhooks", tags=["webhooks"])


@router.post(
    "",
    status_code=201,
    response_model=WebhookMade,
    responses=problems(400, 409, 413, 415, 422),
    dependencies=[Depends(json_body)],
)
async def add(request: Request, wanted: WebhookIn, idempotency_key: IdempotencyKey = None) -> Response:
    """Name an address that is told of events; the answer holds the secret that signs, which is not shown again."""
    service = of_request(request)
    check_url(wanted.url, service.settings.webhooks_private)
    database, events = service.store.database, sorted(set(wanted.events))

    async def answered() -> Response:
        row = await run_in_threadpool(Webhooks(database).add, wanted.url, events)
        made = WebhookMade(**webhook_out(row).model_dump(), secret=row.secret)
        headers = {"Location": place_of(row.id)}
        return Response(made.model_dump_json(), 201, headers, JSON_TYPE)

    return await once(request, idempotency_key, database, [wanted.url, events], answered)


@router.get("", responses=problems(400, 422))
def webhooks(request: Request, cursor: Cursor = None, limit: Limit = None) -> WebhookPage:
    """List the webhooks, the newest first."""
    service = of_request(request)
    size = limit or service.settings.page_size
    rows = Webhooks(service.store.database).page(paging.decode_number(cursor), size + 1)
    shown, following = paging.cut(rows, size)
    return WebhookPage(items=[webhook_out(row) for row in shown], next_cursor=following)


@router.get("/{key}", response_model=WebhookOut, responses=problems(404))
async def webhook(request: Request, key: str) -> Response:
    """Return one webhook, without its secret."""
    row = await run_in_threadpool(Webhooks(of_request(request).store.database).webhook, key)
    return respond(request, Response(webhook_out(row).model_dump_json(), media_type=JSON_TYPE), row.id)


@router.delete("/{key}", status_code=204, responses=problems(404))
def remove(request: Request, key: str) -> None:
    """Forget a webhook; what it was still to be told is not sent."""
    Webhooks(of_request(request).store.database).remove(key)


@router.get("/{key}/deliveries", responses=problems(400, 404, 422))
def deliveries(request: Request, key: str, cursor: Cursor = None, limit: Limit = None) -> DeliveryPage:
    """List what a webhook was told and is to be told, the newest first."""
    service = of_request(request)
    found = Webhooks(service.store.database)
    size = limit or service.settings.page_size
    rows = found.deliveries(found.webhook(key).id, paging.decode_number(cursor), size + 1)
    shown, following = paging.cut(rows, size)
    items = [
        DeliveryOut(
            id=row.id,
            event=row.event,
            state=row.state,
            attempts=row.attempts,
            error=row.error,
            created_at=row.created_at,
            due_at=row.due_at if row.state == "waiting" else None,
        )
        for row in shown
    ]
    return DeliveryPage(items=items, next_cursor=following)


def webhook_out(row: WebhookRow) -> WebhookOut:
    """Return the outside shape of a webhook."""
    return WebhookOut(id=row.id, url=row.url, events=list(row.events), created_at=row.created_at)
