"""Findings: what an inspection found after a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.deleting import DELETED, Why, delete
from jointplay.app.http.openapi import problems
from jointplay.app.http.uploads import JSON_TYPE, json_body
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.assets import FindingIn, FindingOut, FindingPage, JointFound
from jointplay.app.schemas.resources import DamagedItem
from jointplay.app.service import Service, of_request
from jointplay.app.storage.asset_rows import FindingRow
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.idempotency import IdempotencyKey, once
from jointplay.app.storage.rows import Damaged
from jointplay.app.words import Moment

router = APIRouter(tags=["findings"])

Since = Annotated[
    Moment | None,
    Query(examples=["2026-11-21T00:00:00Z"], description="Only what came at this moment or later (RFC 3339)."),
]
Only = Annotated[str | None, Query(min_length=1, max_length=128, pattern=r"^[A-Za-z0-9._:-]+$")]


@router.post(
    "/diagnoses/{key}/finding",
    status_code=201,
    response_model=FindingOut,
    responses=problems(400, 404, 409, 413, 415, 422),
    dependencies=[Depends(json_body)],
)
async def report_back(request: Request, key: str, found: FindingIn, idempotency_key: IdempotencyKey = None) -> Response:
    """Report what an inspection found after a diagnosis; the same finding sent twice is kept once."""
    store = of_request(request).store

    def kept() -> FindingRow:
        return Findings(store.database).add(store.diagnosis(key), found)

    async def answered() -> Response:
        row = await run_in_threadpool(kept)
        headers = {"Location": f"/api/v1/findings/{row.id}"}
        return Response(finding_out(row).model_dump_json(), 201, headers, JSON_TYPE)

    return await once(request, idempotency_key, store.claims, found.model_dump(mode="json"), answered)


@router.get("/findings", responses=problems(400, 422))
def findings(
    request: Request,
    diagnosis: Only = None,
    asset: Only = None,
    since: Since = None,
    cursor: Cursor = None,
    limit: Limit = None,
) -> FindingPage:
    """List the findings, the newest first; of one diagnosis or asset where it is named."""
    service = of_request(request)
    size = limit or service.settings.page_size
    only = {"diagnosis": diagnosis, "asset": asset}
    found: list[Damaged] = []
    rows = Findings(service.store.database).page(paging.decode_number(cursor), size + 1, since, only, found)
    shown, damaged, following = paging.cut_around(rows, found, size)
    items = [finding_out(row) for row in shown]
    return FindingPage(items=items, damaged=damaged_out(service, damaged), next_cursor=following)


@router.get("/findings/{key}", response_model=FindingOut, responses=problems(404, 410))
async def finding(request: Request, key: str) -> Response:
    """Return a finding again."""
    row = await run_in_threadpool(Findings(of_request(request).store.database).finding, key)
    return respond(request, Response(finding_out(row).model_dump_json(), media_type=JSON_TYPE), row.id)


@router.delete("/findings/{key}", status_code=204, responses=DELETED)
async def remove(request: Request, key: str, why: Why = "", idempotency_key: IdempotencyKey = None) -> Response:
    """Delete a finding: it teaches nothing any more. Refused where the measurement that it is about is on hold."""
    return await delete(request, idempotency_key, lambda removal: removal.delete_finding(key, why), why)


def damaged_out(service: Service, rows: Sequence[Damaged]) -> list[DamagedItem]:
    """Return the outside shape of rows that are damaged, and count them."""
    service.metrics.count_damage("row-damaged", len(rows))
    return [DamagedItem(id=row.id, problem=row.problem) for row in rows]


def finding_out(row: FindingRow) -> FindingOut:
    """Return the outside shape of a finding."""
    return FindingOut(
        id=row.id,
        diagnosis=row.diagnosis,
        asset=row.asset,
        created_at=row.created_at,
        made_by=row.made_by,
        at=row.at,
        joints={name: JointFound.model_validate(found) for name, found in row.joints.items()},
        text=row.text,
    )
