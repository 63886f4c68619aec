"""Webhooks: addresses that are told when something happens."""

from __future__ import annotations

import hashlib

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
from jointplay.app.storage.webhooks import DeliveryRow, TroubleRow, WebhookRow, Webhooks, place_of

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

    return await once(request, idempotency_key, service.store.claims, [wanted.url, events], answered)


@router.get("", responses=problems(400, 422))
def webhooks(request: Request, cursor: Cursor = None, limit: Limit = None) -> WebhookPage:
    """List the webhooks, the newest first."""
    service = of_request(request)
    size = limit or service.settings.page_size
    found = Webhooks(service.store.database)
    rows = found.page(paging.decode_number(cursor), size + 1)
    shown, following = paging.cut(rows, size)
    troubles = found.troubles([row.id for row in shown])
    return WebhookPage(items=[webhook_out(row, troubles.get(row.id)) for row in shown], next_cursor=following)


@router.get("/{key}", response_model=WebhookOut, responses=problems(404))
def webhook(request: Request, key: str) -> Response:
    """Return one webhook, without its secret, and how it goes with it."""
    found = Webhooks(of_request(request).store.database)
    row = found.webhook(key)
    document = Response(webhook_out(row, found.troubles([row.id]).get(row.id)).model_dump_json(), media_type=JSON_TYPE)
    return respond(request, document, hashlib.sha256(document.body).hexdigest())


@router.post("/{key}/test", status_code=202, responses=problems(404))
def test(request: Request, key: str) -> DeliveryOut:
    """Send an event `webhook.test`, once; where it succeeds, a webhook that was disabled is enabled again."""
    return delivery_out(Webhooks(of_request(request).store.database).test(key))


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
    return DeliveryPage(items=[delivery_out(row) for row in shown], next_cursor=following)


@router.post("/{key}/deliveries/{delivery}/redelivery", status_code=202, responses=problems(404, 409))
def redeliver(request: Request, key: str, delivery: str) -> DeliveryOut:
    """Make a delivery again, now, with the id and the body that it had."""
    return delivery_out(Webhooks(of_request(request).store.database).redeliver(key, delivery))


def delivery_out(row: DeliveryRow) -> DeliveryOut:
    """Return the outside shape of a delivery."""
    return DeliveryOut(
        id=row.id,
        event=row.event,
        state=row.state,
        attempts=row.attempts,
        error=row.error,
        created_at=row.created_at,
        due_at=row.due_at if row.state == "waiting" else None,
    )


def webhook_out(row: WebhookRow, trouble: TroubleRow | None = None) -> WebhookOut:
    """Return the outside shape of a webhook."""
    said = {"id": row.id, "url": row.url, "events": list(row.events), "created_at": row.created_at}
    if trouble is None:
        return WebhookOut(**said, state="active")
    return WebhookOut(
        **said,
        state="failing" if trouble.disabled_at is None else "disabled",
        failing_since=trouble.since,
        disabled_at=trouble.disabled_at,
        error=trouble.error,
    )
