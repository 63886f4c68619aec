"""Recordings that people upload."""

from __future__ import annotations

import hashlib
from typing import Any

from fastapi import APIRouter, Depends, Request, Response
from starlette.concurrency import run_in_threadpool

from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.file_fields import ASSET, FILE, SAID
from jointplay.app.http.openapi import COMPUTING, problems
from jointplay.app.http.sent_measurements import JSON_TYPE, MeasurementIn, receive_measurement
from jointplay.app.http.uploads import MULTIPART, json_body
from jointplay.app.routes.findings import Only
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.resources import MeasurementChange, MeasurementOut, MeasurementPage
from jointplay.app.service import of_request
from jointplay.app.storage.assets import measurements_of
from jointplay.app.storage.idempotency import IdempotencyKey, once
from jointplay.app.storage.rows import MeasurementRow

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
            headers = {"Location": f"/api/v1/measurements/{row.id}"}
            return Response(measurement_out(row).model_dump_json(), 201, headers, "application/json")

        return await once(request, idempotency_key, service.store.database, sent.content, answered)


@router.get("", responses=problems(400, 422))
def measurements(request: Request, asset: Only = None, cursor: Cursor = None, limit: Limit = None) -> MeasurementPage:
    """List the measurements, the newest first; of one asset where it is named."""
    service = of_request(request)
    size = limit or service.settings.page_size
    rows = service.store.measurements(
        paging.decode_number(cursor), size + 1, None if asset is None else measurements_of(asset)
    )
    shown, following = paging.cut(rows, size)
    return MeasurementPage(items=[measurement_out(row) for row in shown], next_cursor=following)


@router.get("/{key}", response_model=MeasurementOut, responses=problems(404))
async def measurement(request: Request, key: str) -> Response:
    """Return what is known about one measurement."""
    row = await run_in_threadpool(of_request(request).store.measurement, key)
    text = measurement_out(row).model_dump_json()
    return respond(request, Response(text, media_type=JSON_TYPE), hashlib.sha256(text.encode()).hexdigest())


@router.patch("/{key}", responses=problems(404, 413, 415, 422), dependencies=[Depends(json_body)])
def correct(request: Request, key: str, wanted: MeasurementChange) -> MeasurementOut:
    """Correct when a measurement was made; diagnoses of it stay as they are."""
    return measurement_out(of_request(request).store.correct_moment(key, wanted.measured_at))


def measurement_out(row: MeasurementRow) -> MeasurementOut:
    """Return the outside shape of a stored measurement."""
    return MeasurementOut(
        id=row.id,
        name=row.name,
        sha256=row.sha256,
        size_bytes=row.size_bytes,
        created_at=row.created_at,
        measured_at=row.measured_at,
        measured_at_source=row.measured_at_source,
        told=row.told.shown,
        **row.summary,
    )
