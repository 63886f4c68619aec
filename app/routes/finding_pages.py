"""The page on which is entered what an inspection found after a diagnosis, and what was repaired."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from jointplay.app import words
from jointplay.app.errors import BadFieldError
from jointplay.app.http.handlers import problem_from
from jointplay.app.http.validation import validate
from jointplay.app.pages.page_forms import UPLOAD, number_of, plain_form
from jointplay.app.routes.asset_pages import answer_page
from jointplay.app.routes.pages import REFUSALS, refuse
from jointplay.app.schemas.assets import FindingIn
from jointplay.app.service import Service, of_request
from jointplay.app.storage.assets import Assets, wearing_in
from jointplay.app.storage.rows import now

router = APIRouter(prefix="/diagnoses/{key}/finding")

CLEARANCE, REPAIRED = "clearance-", "repaired-"
FIELDS = ("joints", "text", "at")


@router.get("")
async def form(request: Request, key: str) -> Response:
    """Show the form."""
    try:
        members = await run_in_threadpool(asked_after, of_request(request), key, {})
    except REFUSALS as error:
        return await refuse(request, problem_from(error), UPLOAD, "index.html", {})
    return await answer_page(request, "finding.html", members, None)


@router.post("")
async def enter(request: Request, key: str) -> Response:
    """Store what was found, and go to the asset, or back to the diagnosis where it is of none."""
    store = of_request(request).store
    given: dict[str, str] = {}
    try:
        row = await run_in_threadpool(store.diagnosis, key)
        given.update(await plain_form(request))
        await run_in_threadpool(Assets(store.database).add_finding, row, read_finding(given))
    except REFUSALS as error:
        problem = problem_from(error)
        try:
            members = await run_in_threadpool(asked_after, of_request(request), key, given)
        except REFUSALS:
            return await refuse(request, problem, UPLOAD, "index.html", {})
        return await answer_page(request, "finding.html", members, problem, FIELDS)
    asset = row.request.get("asset")
    return RedirectResponse(f"/assets/{asset}" if asset else f"/diagnoses/{key}", status_code=303)


def read_finding(given: dict[str, str]) -> FindingIn:
    """Return what a form says was found, by the rules of the HTTP interface.

    Raises
    ------
    BadFieldError
        For a clearance that is no number, or a joint that was repaired and has none.
    RequestValidationError
        For a field that breaks a rule.
    """
    joints: dict[str, Any] = {}
    for field, value in given.items():
        if field.startswith(CLEARANCE):
            name = field.removeprefix(CLEARANCE)
            repaired = f"{REPAIRED}{name}" in given
            joints[name] = {"clearance_um": float(number_of(value, "joints")), "repaired": repaired}
    for field in given:
        name = field.removeprefix(REPAIRED)
        if field.startswith(REPAIRED) and name not in joints:
            raise BadFieldError(f"joints: {name[:80]}: write the clearance that was found, too", field="joints")
    said = {name: given[name] for name in ("text", "at") if name in given}
    return validate(FindingIn, said | {"joints": joints})


def asked_after(service: Service, key: str, given: dict[str, str]) -> dict[str, Any]:
    """Return what the form shows.

    Raises
    ------
    UnknownDiagnosisError
        When there is no diagnosis of this id.
    """
    row = service.store.diagnosis(key)
    chosen = {"at": now().isoformat(timespec="seconds").replace("+00:00", "Z")} | given
    return {
        "key": row.id,
        "asset": row.request.get("asset"),
        "after": words.short(row.answer),
        "diagnosed": words.spell_moment(row.created_at),
        "joints": sorted(wearing_in(row.machine)),
        "chosen": chosen,
        "title": "What was found: jointplay",
    }
