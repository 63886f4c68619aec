"""Assets: machines that stand somewhere, with their recordings and baseline."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from pydantic import BeforeValidator, TypeAdapter
from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import BadFieldError, DeletedError, UnknownMeasurementError
from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.deleting import DELETED, Why, delete
from jointplay.app.http.gate import name_of
from jointplay.app.http.openapi import problems
from jointplay.app.http.uploads import JSON_TYPE, json_body
from jointplay.app.routes.findings import damaged_out
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.assets import (
    EXTERNAL_ID,
    TEXT,
    Acknowledgement,
    AssetIn,
    AssetOut,
    AssetPage,
    TrendRow,
    check_external_id,
)
from jointplay.app.service import Service, of_request
from jointplay.app.storage.asset_rows import AssetRow
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.idempotency import IdempotencyKey
from jointplay.app.storage.rows import Damaged
from jointplay.app.storage.standings import Standings, standing_out
from jointplay.catalogue.following.standing import StandingName
from jointplay.catalogue.following.state import WearState
from jointplay.solver.machines.joints import LARGEST_LIMIT

router = APIRouter(prefix="/assets", tags=["assets"])

ExternalId = Annotated[
    str,
    Path(pattern=EXTERNAL_ID, description="The asset's name in your own records."),
    BeforeValidator(check_external_id),
]
Order = Annotated[
    Literal["newest", "urgent"],
    Query(
        examples=["urgent"],
        description="urgent: first what needs somebody most, by its standing and the date of reaching a limit.",
    ),
]
State = Annotated[StandingName | None, Query(examples=["alarm"], description="Only what stands so.")]
Search = Annotated[
    str | None, Query(max_length=200, pattern=TEXT, examples=["press"], description="In id, machine or notes.")
]
TREND = TypeAdapter(list[TrendRow])
CREATED: dict[int | str, dict[str, Any]] = {201: {"model": AssetOut, "description": "There was none of this id."}}


@router.put("/{external_id}", responses={**CREATED, **problems(400, 413, 415, 422)}, dependencies=[Depends(json_body)])
def put(request: Request, response: Response, external_id: ExternalId, wanted: AssetIn) -> AssetOut:
    """Say which machine an asset is, what to note of it, and its baselines; what is left out is emptied."""
    service = of_request(request)
    check_baseline(service, wanted)
    check_limits(service, external_id, wanted)
    row, new = Assets(service.store.database).put(external_id, wanted)
    if new:
        response.status_code = 201
        response.headers["Location"] = f"/api/v1/assets/{external_id}"
    return asset_out(row)


@router.get("", responses=problems(400, 422))
def assets(
    request: Request,
    order: Order = "newest",
    state: State = None,
    search: Search = None,
    cursor: Cursor = None,
    limit: Limit = None,
) -> AssetPage:
    """List the assets, the newest first, or first those that need somebody: of a state, or with a text."""
    service = of_request(request)
    size = limit or service.settings.page_size
    rows, damaged, following = list_assets(service, order, cursor, size, state, search)
    return AssetPage(
        items=[asset_out(row) for row in rows], damaged=damaged_out(service, damaged), next_cursor=following
    )


@router.get("/{external_id}", response_model=AssetOut, responses=problems(404, 410, 422))
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


@router.get("/{external_id}/series", response_model=list[TrendRow], responses=problems(404, 422, 503))
async def series(request: Request, external_id: ExternalId) -> Response:
    """Return the courses of `/state` as a plain list, a row a joint and recording: for panels that read flat rows."""
    found = await of_request(request).follow(external_id)
    rows = [
        TrendRow(
            at=point.at,
            joint=name,
            p_worn=point.p_worn,
            clearance_um=point.clearance_um,
            low_um=point.interval_um[0],
            high_um=point.interval_um[1],
            limit_um=joint.limit_um,
        )
        for name, joint in found.joints.items()
        for point in joint.course
    ]
    text = TREND.dump_json(rows)
    return respond(request, Response(text, media_type=JSON_TYPE), hashlib.sha256(text).hexdigest())


@router.put(
    "/{external_id}/acknowledgement", responses=problems(400, 404, 413, 415, 422), dependencies=[Depends(json_body)]
)
def acknowledge(request: Request, external_id: ExternalId, seen: Acknowledgement) -> AssetOut:
    """Say that somebody has seen how the asset stands; it holds until that gets worse or has another reason."""
    database = of_request(request).store.database
    found = Assets(database).asset(external_id)
    Standings(database).acknowledge(found.external_id, seen.state, name_of(request), seen.note)
    return asset_out(Assets(database).asset(external_id))


@router.delete("/{external_id}/acknowledgement", status_code=204, responses=problems(404, 422))
def take_back(request: Request, external_id: ExternalId) -> None:
    """Let what was acknowledged need somebody again."""
    database = of_request(request).store.database
    Standings(database).forget_acknowledgement(Assets(database).asset(external_id).external_id)


@router.put("/{external_id}/measurements/{measurement}", status_code=204, responses=problems(404, 422))
def own(request: Request, external_id: ExternalId, measurement: str) -> None:
    """Note that a stored measurement is of this asset; a diagnosis that names the asset does so, too."""
    service = of_request(request)
    found = Assets(service.store.database)
    found.own(found.asset(external_id).external_id, service.store.measurement(measurement).id)


@router.delete("/{external_id}", status_code=204, responses=DELETED)
async def remove(
    request: Request, external_id: ExternalId, why: Why = "", idempotency_key: IdempotencyKey = None
) -> Response:
    """Delete an asset; its measurements and diagnoses stay, and belong to none. Refused where one is on hold."""
    return await delete(request, idempotency_key, lambda removal: removal.delete_asset(external_id, why), why)


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
        except (UnknownMeasurementError, DeletedError) as error:
            raise BadFieldError(f"{field}: {error}", field=field) from None
        if measured.summary.get("kind") == "spectrum":
            rule = "is a spectrum; a baseline has to be a recording over time"
            raise BadFieldError(f"{field}: {measured.id}: {rule}", field=field)


def list_assets(
    service: Service, order: str, cursor: str | None, size: int, state: str | None, search: str | None
) -> tuple[Sequence[AssetRow], Sequence[Damaged], str | None]:
    """Return a page of assets, those of it that are damaged, and the cursor of the next."""
    found, start = Assets(service.store.database), paging.decode_number(cursor)
    damaged: list[Damaged] = []
    if order == "newest":
        rows = found.page(start, size + 1, state, search, damaged)
        return paging.cut_around(rows, damaged, size)
    rows = found.urgent(start or 0, size + 1, state, search, damaged)
    more = len(rows) + len(damaged) > size
    return rows[:size], damaged, paging.encode(str((start or 0) + size)) if more else None


def check_limits(service: Service, external_id: str, wanted: AssetIn) -> None:
    """Refuse limits of joints that the machine does not have, or that no worn joint can have.

    Raises
    ------
    BadFieldError
    """
    if not wanted.limits_um:
        return
    machine = service.machine_of(wanted.machine, external_id)
    if machine is None:
        raise BadFieldError(f"limits_um: machine {wanted.machine[:80]}: is not known here", field="limits_um")
    wearing = machine.wearing_joints
    for name, limit in wanted.limits_um.items():
        if name not in wearing:
            known = ", ".join(sorted(wearing))
            raise BadFieldError(
                f"limits_um: {name[:80]}: is no joint of {machine.name} that can wear ({known})", field="limits_um"
            )
        low, high = 1e6 * machine.joints[name].play_as_new[1], 1e6 * LARGEST_LIMIT
        if not low < limit <= high:
            rule = f"must be above its play as new, {low:.3g} um, and at most {high:g} um"
            raise BadFieldError(f"limits_um: {name}: {limit:g}: {rule}", field="limits_um")


def asset_out(row: AssetRow) -> AssetOut:
    """Return the outside shape of an asset."""
    return AssetOut(
        external_id=row.external_id,
        machine=row.machine,
        notes=row.notes,
        baseline=row.baseline,
        baselines=list(row.in_order),
        limits_um=row.limits_um,
        silent_after_days=row.silent_after_days,
        warn_within_days=row.warn_within_days,
        created_at=row.created_at,
        updated_at=row.updated_at,
        made_by=row.made_by,
        standing=standing_out(row),
    )
