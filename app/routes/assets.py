"""Assets: machines that stand somewhere, with their recordings and baseline."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request, Response
from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import BadFieldError, UnknownMeasurementError
from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.openapi import problems
from jointplay.app.http.uploads import JSON_TYPE, json_body
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.assets import EXTERNAL_ID, AssetIn, AssetOut, AssetPage
from jointplay.app.service import Service, of_request
from jointplay.app.storage.assets import AssetRow, Assets
from jointplay.catalogue.following.state import WearState

router = APIRouter(prefix="/assets", tags=["assets"])

ExternalId = Annotated[str, Path(pattern=EXTERNAL_ID, description="The asset's name in your own records.")]
CREATED: dict[int | str, dict[str, Any]] = {201: {"model": AssetOut, "description": "There was none of this id."}}


@router.put("/{external_id}", responses={**CREATED, **problems(400, 413, 415, 422)}, dependencies=[Depends(json_body)])
def put(request: Request, response: Response, external_id: ExternalId, wanted: AssetIn) -> AssetOut:
    """Say which machine an asset is, what to note of it, and its baselines; what is left out is emptied."""
    service = of_request(request)
    check_baseline(service, wanted)
    row, new = Assets(service.store.database).put(external_id, wanted)
    if new:
        response.status_code = 201
        response.headers["Location"] = f"/api/v1/assets/{external_id}"
    return asset_out(row)


@router.get("", responses=problems(400, 422))
def assets(request: Request, cursor: Cursor = None, limit: Limit = None) -> AssetPage:
    """List the assets, the newest first."""
    service = of_request(request)
    size = limit or service.settings.page_size
    rows = Assets(service.store.database).page(paging.decode_number(cursor), size + 1)
    shown, following = paging.cut(rows, size)
    return AssetPage(items=[asset_out(row) for row in shown], next_cursor=following)


@router.get("/{external_id}", response_model=AssetOut, responses=problems(404, 422))
async def asset(request: Request, external_id: ExternalId) -> Response:
    """Return one asset."""
    row = await run_in_threadpool(Assets(of_request(request).store.database).asset, external_id)
    text = asset_out(row).model_dump_json()
    return respond(request, Response(text, media_type=JSON_TYPE), hashlib.sha256(text.encode()).hexdigest())


@router.get("/{external_id}/state", response_model=WearState, responses=problems(404, 422, 503))
async def state(request: Request, external_id: ExternalId) -> Response:
    """Say how worn the asset is by all its recordings in the order they were made, by findings and by repairs.

    It follows from what is stored, whatever the order in which that came.
    """
    text = (await of_request(request).follow(external_id)).model_dump_json()
    return respond(request, Response(text, media_type=JSON_TYPE), hashlib.sha256(text.encode()).hexdigest())


@router.put("/{external_id}/measurements/{measurement}", status_code=204, responses=problems(404, 422))
def own(request: Request, external_id: ExternalId, measurement: str) -> None:
    """Note that a stored measurement is of this asset; a diagnosis that names the asset does so, too."""
    service = of_request(request)
    found = Assets(service.store.database)
    found.own(found.asset(external_id).external_id, service.store.measurement(measurement).id)


def check_baseline(service: Service, wanted: AssetIn) -> None:
    """Refuse baselines that are no stored recordings over time."""
    field = "baselines" if wanted.baselines else "baseline"
    if wanted.baseline not in (None, *wanted.baselines[:1]) and wanted.baselines:
        raise BadFieldError(
            f"baseline: {wanted.baseline}: must be the first of baselines, or left out", field="baseline"
        )
    for key in wanted.in_order:
        try:
            measured = service.store.measurement(key)
        except UnknownMeasurementError as error:
            raise BadFieldError(f"{field}: {error}", field=field) from None
        if measured.summary.get("kind") == "spectrum":
            rule = "is a spectrum; a baseline has to be a recording over time"
            raise BadFieldError(f"{field}: {measured.id}: {rule}", field=field)


def asset_out(row: AssetRow) -> AssetOut:
    """Return the outside shape of an asset."""
    return AssetOut(
        external_id=row.external_id,
        machine=row.machine,
        notes=row.notes,
        baseline=row.baseline,
        baselines=list(row.in_order),
        created_at=row.created_at,
        updated_at=row.updated_at,
    )
