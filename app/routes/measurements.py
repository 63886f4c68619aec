"""Recordings that people upload."""

from __future__ import annotations

import hashlib
from datetime import timedelta
from typing import Any

from fastapi import APIRouter, Depends, Request, Response
from starlette.concurrency import run_in_threadpool

from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.deleting import DELETED, Why, delete
from jointplay.app.http.file_fields import ASSET, FILE, SAID
from jointplay.app.http.openapi import COMPUTING, problems
from jointplay.app.http.sent_measurements import JSON_TYPE, MeasurementIn, receive_measurement
from jointplay.app.http.uploads import MULTIPART, json_body
from jointplay.app.routes.findings import Only, damaged_out
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.resources import MeasurementChange, MeasurementOut, MeasurementPage
from jointplay.app.schemas.retention import RetentionIn, RetentionOut
from jointplay.app.schemas.virtual import BuiltInRequest, VirtualRequest
from jointplay.app.service import Service, of_request
from jointplay.app.storage.assets import measurements_of
from jointplay.app.storage.idempotency import IdempotencyKey, once
from jointplay.app.storage.removal import baseline_of
from jointplay.app.storage.retention import Kept, kept_of, say
from jointplay.app.storage.rows import Damaged, MeasurementRow

router = APIRouter(prefix="/measurements", tags=["measurements"])

FORM = {"type": "object", "required": ["file"], "properties": {"file": FILE, **SAID, "asset": ASSET}}


def body() -> dict[str, Any]:
    """Return the description of the two bodies that a measurement may be sent as."""
    schema = MeasurementIn.model_json_schema(ref_template="#/components/schemas/{model}")
    return {"required": True, "content": {MULTIPART: {"schema": FORM}, JSON_TYPE: {"schema": schema}}}


@router.post(
    "",
    status_code=201,
    response_model=MeasurementOut,
    responses=problems(*COMPUTING),
    openapi_extra={"requestBody": body()},
)
async def upload(request: Request, idempotency_key: IdempotencyKey = None) -> Response:
    """Store a recording or a spectrum; the same bytes, of which the same is said, are the same measurement again."""
    service = of_request(request)
    async with receive_measurement(request, service.store) as sent:

        async def answered() -> Response:
            row = await service.add_measurement(sent.file, sent.name, sent.told, sent.asset)
            return created(row)

        return await once(request, idempotency_key, service.store.claims, sent.content, answered)


@router.post(
    "/virtual",
    status_code=201,
    response_model=MeasurementOut,
    responses=problems(404, 413, 415, 422, 500, 503, 504, 507),
    dependencies=[Depends(json_body)],
)
async def simulate(request: Request, wanted: VirtualRequest) -> Response:
    """Simulate a recording of a catalogue's machine with chosen wear, and store it: to try what an answer looks like.

    It is a measurement like any other, says in `virtual` and in its name what it was made with, and belongs to no
    asset. The same request is the same measurement again.
    """
    return created(await of_request(request).add_virtual(wanted))


@router.post(
    "/built-in",
    status_code=201,
    response_model=MeasurementOut,
    responses=problems(413, 415, 422, 500, 503, 504, 507),
    dependencies=[Depends(json_body)],
)
async def take_built_in(request: Request, wanted: BuiltInRequest) -> Response:
    """Store a recording that ships with the program, to try what an answer looks like."""
    return created(await of_request(request).add_built_in(wanted.name))


@router.get("", responses=problems(400, 422))
def measurements(request: Request, asset: Only = None, cursor: Cursor = None, limit: Limit = None) -> MeasurementPage:
    """List the measurements, the newest first; of one asset where it is named."""
    service = of_request(request)
    size = limit or service.settings.page_size
    found: list[Damaged] = []
    among = None if asset is None else measurements_of(asset)
    rows = service.store.measurements(paging.decode_number(cursor), size + 1, among, found)
    shown, damaged, following = paging.cut_around(rows, found, size)
    items = [measurement_out(row) for row in shown]
    return MeasurementPage(items=items, damaged=damaged_out(service, damaged), next_cursor=following)


@router.get("/{key}", response_model=MeasurementOut, responses=problems(404, 410))
async def measurement(request: Request, key: str) -> Response:
    """Return what is known about one measurement."""
    row = await run_in_threadpool(of_request(request).store.measurement, key)
    text = measurement_out(row).model_dump_json()
    return respond(request, Response(text, media_type=JSON_TYPE), hashlib.sha256(text.encode()).hexdigest())


@router.patch("/{key}", responses=problems(404, 410, 413, 415, 422), dependencies=[Depends(json_body)])
def correct(request: Request, key: str, wanted: MeasurementChange) -> MeasurementOut:
    """Correct when a measurement was made; diagnoses of it stay as they are."""
    return measurement_out(of_request(request).store.correct_moment(key, wanted.measured_at))


@router.get("/{key}/retention", responses=problems(404, 410))
def retention(request: Request, key: str) -> RetentionOut:
    """Say how long a recording is kept, and why."""
    service = of_request(request)
    row = service.store.measurement(key)
    with service.store.database.reading() as session:
        return retention_out(service, row, kept_of(session, key))


@router.put("/{key}/retention", responses=problems(400, 404, 410, 413, 415, 422), dependencies=[Depends(json_body)])
def retain(request: Request, key: str, wanted: RetentionIn) -> RetentionOut:
    """Say of what class a recording is, or put it on hold; what is left out is taken back."""
    service = of_request(request)
    row = service.store.measurement(key)
    return retention_out(service, row, say(service.store.database, key, wanted.keep_as, wanted.hold))


@router.delete("/{key}", status_code=204, responses=DELETED)
async def remove(request: Request, key: str, why: Why = "", idempotency_key: IdempotencyKey = None) -> Response:
    """Delete a recording; diagnoses of it stay, and say so. Its bytes sent again are the same measurement again.

    Refused for one on hold, a baseline of an asset and evidence.
    """
    return await delete(request, idempotency_key, lambda removal: removal.delete_measurement(key, why), why)


def retention_out(service: Service, row: MeasurementRow, kept: Kept) -> RetentionOut:
    """Return the outside shape of how a recording is kept."""
    days = service.settings.keep_days[kept.of]
    until = None if days is None or kept.hold is not None else row.created_at + timedelta(days=days)
    with service.store.database.reading() as session:
        used = baseline_of(session, row.id) is not None
    return RetentionOut(
        keep_as=kept.of,
        said=kept.said,
        hold=kept.hold,
        changed_by=kept.changed_by,
        changed_at=kept.changed_at,
        keep_until=None if used else until,
    )


def created(row: MeasurementRow) -> Response:
    """Return a measurement that was stored, with its address."""
    headers = {"Location": f"/api/v1/measurements/{row.id}"}
    return Response(measurement_out(row).model_dump_json(), 201, headers, JSON_TYPE)


def measurement_out(row: MeasurementRow) -> MeasurementOut:
    """Return the outside shape of a stored measurement."""
    return MeasurementOut(
        id=row.id,
        name=row.name,
        sha256=row.sha256,
        size_bytes=row.size_bytes,
        created_at=row.created_at,
        made_by=row.made_by,
        measured_at=row.measured_at,
        measured_at_source=row.measured_at_source,
        told=row.told.shown,
        **row.summary,
    )
