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
from jointplay.app.pages.page_forms import UPLOAD, moment_of, plain_form, quantity_of
from jointplay.app.routes.asset_pages import answer_page
from jointplay.app.routes.pages import REFUSALS, refuse
from jointplay.app.schemas.assets import FindingIn
from jointplay.app.service import Service, of_request
from jointplay.app.storage.findings import Findings, wearing_in
from jointplay.app.storage.rows import now
from jointplay.solver.machines.units import LENGTH

router = APIRouter(prefix="/diagnoses/{key}/finding")

PLAY, REPAIRED = "play-", "repaired-"
FIELDS = ("joints", "text", "at")
LARGEST = 0.2
"""Largest play that can be entered [m]: of the largest clearance that can."""


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
        await run_in_threadpool(Findings(store.database).add, row, read_finding(given))
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
    """Return what a form says was found, by the rules of the HTTP interface: of the play across a pin, half.

    Raises
    ------
    BadFieldError
        For a play that is none.
    RequestValidationError
        For a field that breaks a rule.
    """
    joints: dict[str, Any] = {}
    for field, value in given.items():
        if field.startswith(PLAY):
            name = field.removeprefix(PLAY)
            joints[name] = {"clearance_um": clearance_of(name, value), "repaired": f"{REPAIRED}{name}" in given}
    for field in given:
        if field.startswith(REPAIRED):
            joints.setdefault(field.removeprefix(REPAIRED), {"repaired": True})
    at = moment_of(given.get("at", spell_now()))
    return validate(FindingIn, {"text": given.get("text", ""), "joints": joints, "at": at})


def clearance_of(joint: str, text: str) -> float:
    """Return the radial clearance of a joint [µm] of the play that was typed, in µm unless it has a unit.

    Raises
    ------
    BadFieldError
    """
    what = f"joint {joint[:80]}"
    play = quantity_of(text, what, "joints", LENGTH, "um")
    if not 0.0 <= play <= LARGEST:
        raise BadFieldError(f"{what}: {text[:80]}: must be 0 to {1e3 * LARGEST:g} mm", field="joints")
    return round(0.5e6 * play, 6)


def spell_now() -> str:
    """Return the moment that it is, as forms send it."""
    return f"{now():%Y-%m-%dT%H:%M:%SZ}"


def asked_after(service: Service, key: str, given: dict[str, str]) -> dict[str, Any]:
    """Return what the form shows.

    Raises
    ------
    UnknownDiagnosisError
        When there is no diagnosis of this id.
    """
    row = service.store.diagnosis(key)
    chosen = {"at": spell_now()} | given
    return {
        "key": row.id,
        "asset": row.request.get("asset"),
        "after": words.short(row.answer),
        "diagnosed": words.spell_moment(row.created_at),
        "joints": sorted(wearing_in(row.machine)),
        "chosen": chosen,
        "title": "What was found: jointplay",
    }
