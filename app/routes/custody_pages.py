"""The pages that say how long recordings are kept, and let administrators delete them and what speaks of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from jointplay.app.errors import BadFieldError
from jointplay.app.http.handlers import note, problem_from, templates
from jointplay.app.http.validation import validate
from jointplay.app.pages.page_forms import plain_form
from jointplay.app.problems import Problem
from jointplay.app.routes.asset_pages import answer_page, may_match
from jointplay.app.routes.measurements import retain, retention
from jointplay.app.routes.pages import REFUSALS, context
from jointplay.app.schemas.retention import Reason, RetentionIn
from jointplay.app.scopes import Scope
from jointplay.app.service import Service, of_request
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.removal import Removal
from jointplay.app.words import short, spell_moment

router = APIRouter()

CLASSES = (
    ("", "as what speaks of it says"),
    ("routine", "routine"),
    ("baseline", "baseline"),
    ("evidence", "evidence"),
)
FIELDS = ("why", "sure", "keep_as", "hold")


@dataclass(frozen=True)
class Going:
    """What is deleted on a page.

    Parameters
    ----------
    what : str
        In a word.
    shown : callable
        Gives the name of one and the page that shows it; raises when there is none.
    lasting : str
        What becomes of what belongs to it.
    delete : callable
        Deletes one, for a reason.
    """

    what: str
    shown: Callable[[Service, str], tuple[str, str]]
    lasting: str
    delete: Callable[[Removal, str, str], None]


def show_recording(service: Service, key: str) -> tuple[str, str]:
    """Return what a recording is called and when it was made, and its page."""
    row = service.store.measurement(key)
    return f"{row.name}, {spell_moment(row.measured_at)} UTC", f"/measurements/{key}"


def show_diagnosis(service: Service, key: str) -> tuple[str, str]:
    """Return what a diagnosis says and when, and its page."""
    row = service.store.diagnosis(key)
    return f"{short(row.answer)}, {spell_moment(row.created_at)} UTC", f"/diagnoses/{key}"


def show_finding(service: Service, key: str) -> tuple[str, str]:
    """Return when something was found and where, and the page of the diagnosis before it."""
    row = Findings(service.store.database).finding(key)
    return f"{spell_moment(row.at)} UTC, {row.asset or 'of no asset'}", f"/diagnoses/{row.diagnosis}"


def show_asset(service: Service, key: str) -> tuple[str, str]:
    """Return the name of an asset, and its page."""
    return Assets(service.store.database).asset(key).external_id, f"/assets/{key}"


GOING: Mapping[str, Going] = {
    "measurements": Going(
        "recording",
        show_recording,
        "Its file and samples go. Diagnoses of it stay, and say that it was deleted.",
        Removal.delete_measurement,
    ),
    "diagnoses": Going(
        "diagnosis",
        show_diagnosis,
        "Its recording stays. Trend and state of its asset follow.",
        Removal.delete_diagnosis,
    ),
    "findings": Going(
        "finding",
        show_finding,
        "It teaches nothing any more; the diagnosis before it stays.",
        Removal.delete_finding,
    ),
    "assets": Going(
        "asset",
        show_asset,
        "Its notes, limits and baselines go. Its recordings and diagnoses stay, and belong to none.",
        Removal.delete_asset,
    ),
}


async def ask(request: Request, folder: str, key: str) -> Response:
    """Ask whether somebody is sure."""
    return await show(request, folder, key, {})


async def remove(request: Request, folder: str, key: str) -> Response:
    """Delete what was named, for whoever is sure."""
    service, going = of_request(request), GOING[folder]
    given: dict[str, str] = {}
    try:
        name, _ = await run_in_threadpool(going.shown, service, key)
        given.update(await plain_form(request))
        if given.get("sure") != "yes":
            raise BadFieldError(f"say that this {going.what} is to go", field="sure")
        why = validate(Reason, {"why": given.get("why", "")}).why
        await run_in_threadpool(going.delete, Removal(service.store), key, why)
    except REFUSALS as error:
        return await show(request, folder, key, given, problem_from(error))
    members = {"going": going, "name": name, "gone": True, "title": "Deleted: jointplay"}
    return await answer_page(request, "delete.html", members, None)


def add_pages(folder: str) -> None:
    """Add the page of one kind of what can be deleted."""

    async def asked(request: Request, key: str) -> Response:
        return await ask(request, folder, key)

    async def removed(request: Request, key: str) -> Response:
        return await remove(request, folder, key)

    router.add_api_route(f"/{folder}/{{key}}/delete", asked, methods=["GET"])
    router.add_api_route(f"/{folder}/{{key}}/delete", removed, methods=["POST"])


for each in GOING:
    add_pages(each)


@router.post("/measurements/{key}/retention")
async def keep(request: Request, key: str) -> Response:
    """Say of what class a recording is, and whether it is on hold."""
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request))
        await run_in_threadpool(retain, request, key, validate(RetentionIn, given))
    except REFUSALS as error:
        return await show(request, "measurements", key, given, problem_from(error))
    return RedirectResponse(f"/measurements/{key}/delete", status_code=303)


async def show(
    request: Request, folder: str, key: str, given: Mapping[str, str], problem: Problem | None = None
) -> Response:
    """Return the page that asks, with what was wrong."""
    service, going = of_request(request), GOING[folder]
    members: dict[str, Any] = {"folder": folder, "key": key, "going": going, "chosen": given, "classes": CLASSES}
    try:
        members["name"], members["place"] = await run_in_threadpool(going.shown, service, key)
        if folder == "measurements":
            kept = await run_in_threadpool(retention, request, key)
            members["kept"] = kept
            members["until"] = "" if kept.keep_until is None else f"{spell_moment(kept.keep_until)} UTC"
            said = {"keep_as": kept.keep_as if kept.said else "", "hold": kept.hold or ""}
            members["chosen"] = said | dict(given)
    except REFUSALS as error:
        gone = problem_from(error)
        note(request, gone)
        summary = {"title": gone.title, "detail": gone.detail}
        return templates.TemplateResponse(request, "refused.html", await context(request, summary=summary), gone.status)
    members |= {"may_administer": may_match(request, Scope.ADMIN), "title": f"Delete {members['name']}: jointplay"}
    return await answer_page(request, "delete.html", members, problem, FIELDS)
