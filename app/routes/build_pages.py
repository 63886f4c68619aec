"""The pages of builds: asking for a catalogue, and following it while it is computed."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from jointplay.app.errors import BadFieldError, UnknownCatalogueError
from jointplay.app.figures.machine_account import drive_of
from jointplay.app.http import paging
from jointplay.app.http.handlers import is_fragment, note, problem_from, templates
from jointplay.app.jobs.build_orders import order, order_again
from jointplay.app.jobs.forecasts import forecast_text
from jointplay.app.pages.build_view import PLANS, build_view, failures_view
from jointplay.app.pages.page_forms import messages_of, plain_form
from jointplay.app.problems import Problem
from jointplay.app.routes.pages import REFUSALS, context
from jointplay.app.schemas.builds import BuildRequest
from jointplay.app.scopes import Scope
from jointplay.app.service import Service, of_request
from jointplay.app.storage.build_queue import BuildRow
from jointplay.catalogue.errors import CatalogueError

router = APIRouter(prefix="/builds")

FIELDS = ("machine", "plan", "catalogue")
SHOWN_FAILURES = 50
UNNAMED = "not-named-yet"


@router.get("")
async def builds(request: Request) -> Response:
    """Show the form that asks for a build, and the builds there are."""
    try:
        chosen = {name: value for name, value in request.query_params.items() if name in FIELDS}
        return await show_list(request, request.query_params.get("cursor"), chosen)
    except REFUSALS as error:
        return await show_list(request, None, {}, problem_from(error))


@router.post("")
async def ask(request: Request) -> Response:
    """Put a build into the queue, and go to its page."""
    service = of_request(request)
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request))
        row = await run_in_threadpool(
            order, service.builds, service.machines, service.settings.catalogues, read_order(given)
        )
    except REFUSALS as error:
        return await show_list(request, None, given, problem_from(error))
    service.runner.wake()
    return RedirectResponse(f"/builds/{row.id}", status_code=303)


@router.post("/forecast")
async def forecast(request: Request) -> Response:
    """Say what the build that is chosen would take; with a script only that."""
    service = of_request(request)
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request))
        # The name is not yet given, perhaps: what matters is whether there is something of this name.
        text = forecast_text(await service.forecast(read_order({"catalogue": UNNAMED, **given})))
    except REFUSALS as error:
        problem = problem_from(error)
        if not is_fragment(request):
            return await show_list(request, None, given, problem)
        note(request, problem)
        text = problem.detail
    if is_fragment(request):
        return templates.TemplateResponse(request, "_forecast.html", {"forecast": text})
    return await show_list(request, None, given, forecast=text)


@router.get("/{key}")
async def build(request: Request, key: str) -> Response:
    """Show a build and how far it is; to a script that follows it only that."""
    service = of_request(request)
    try:
        row = await run_in_threadpool(service.builds.find, key)
    except REFUSALS as error:
        return await show_list(request, None, {}, problem_from(error))
    return await show_build(request, row)


@router.post("/{key}/cancel")
async def cancel(request: Request, key: str) -> Response:
    """Stop a build."""
    service = of_request(request)
    try:
        await run_in_threadpool(service.builds.cancel, key)
    except REFUSALS as error:
        return await refuse(request, key, problem_from(error))
    return RedirectResponse(f"/builds/{key}", status_code=303)


@router.post("/{key}/resume")
async def resume(request: Request, key: str) -> Response:
    """Go on with a build that ended before it was done: the same one is put into the queue again."""
    service = of_request(request)
    try:
        row = await run_in_threadpool(order_again, service.builds, service.settings.catalogues, key)
    except REFUSALS as error:
        return await refuse(request, key, problem_from(error))
    service.runner.wake()
    return RedirectResponse(f"/builds/{row.id}", status_code=303)


def read_order(given: dict[str, str]) -> BuildRequest:
    """Return what the form asks for.

    Raises
    ------
    BadFieldError
        For a field that was left empty.
    RequestValidationError
        For one that breaks a rule of the HTTP interface.
    """
    for name, rule in (("machine", "choose a machine"), ("plan", "choose a plan"), ("catalogue", "give it a name")):
        if name not in given:
            raise BadFieldError(rule, field=name)
    try:
        return BuildRequest.model_validate(given)
    except ValidationError as error:
        raise RequestValidationError(error.errors()) from None


async def show_list(
    request: Request, cursor: str | None, given: dict[str, str], problem: Problem | None = None, forecast: str = ""
) -> Response:
    """Return the page with the form and the list, and with what was wrong."""
    service = of_request(request)
    size = service.settings.page_size
    rows = await run_in_threadpool(service.builds.list_builds, paging.decode_number(cursor), size + 1)
    cut, following = paging.cut(rows, size)
    members: dict[str, Any] = {
        "builds": [build_view(row) for row in cut],
        "following": following,
        "first": cursor is None,
        "machines": await run_in_threadpool(machine_titles, service),
        "plans": PLANS,
        "chosen": {"plan": "quick", **given},
        "may_build": may_build(request),
        "forecast": forecast,
        "title": "Builds: jointplay",
    }
    if problem is None:
        return templates.TemplateResponse(request, "builds.html", await context(request, **members))
    note(request, problem)
    members["messages"] = messages = refusals(problem)
    members["summary"] = None if messages else {"title": problem.title, "detail": problem.detail}
    whole = await context(request, **members)
    return templates.TemplateResponse(request, "builds.html", whole, problem.status, dict(problem.headers))


def refusals(problem: Problem) -> dict[str, str]:
    """Return the messages of a problem by field of the form; a catalogue of something else is about its name."""
    if problem.type.rpartition(":")[2] == "catalogue-mismatch":
        return {"catalogue": problem.detail}
    return messages_of(problem, FIELDS)


async def refuse(request: Request, key: str, problem: Problem) -> Response:
    """Return the page of a build with what cannot be done to it."""
    service = of_request(request)
    try:
        row = await run_in_threadpool(service.builds.find, key)
    except REFUSALS as error:
        return await show_list(request, None, {}, problem_from(error))
    return await show_build(request, row, problem)


async def show_build(request: Request, row: BuildRow, problem: Problem | None = None) -> Response:
    """Return the page of a build, or the part that changes while it goes on."""
    service = of_request(request)
    members: dict[str, Any] = {"build": build_view(row), "may_build": may_build(request)}
    if not members["build"]["open"]:
        members |= await run_in_threadpool(outcome, service, row)
    if is_fragment(request):
        return templates.TemplateResponse(request, "_build.html", members)
    members["title"] = f"Build of {row.catalogue}: jointplay"
    if problem is None:
        return templates.TemplateResponse(request, "build.html", await context(request, **members))
    note(request, problem)
    members["summary"] = {"title": problem.title, "detail": problem.detail}
    whole = await context(request, **members)
    return templates.TemplateResponse(request, "build.html", whole, problem.status, dict(problem.headers))


def outcome(service: Service, row: BuildRow) -> dict[str, Any]:
    """Return what there is of the catalogue of a build that ended: whether it can be used, and what failed."""
    try:
        offer = service.shelf.find(row.catalogue)
        items, count = service.entries.list_failed(offer, SHOWN_FAILURES)
    except (UnknownCatalogueError, CatalogueError):  # none yet, or one that cannot be opened, which its pages tell
        return {"usable": False, "failures": [], "failure_count": 0}
    return {"usable": True, "failures": failures_view(items), "failure_count": count}


def machine_titles(service: Service) -> dict[str, str]:
    """Return what the machines are called and how they are driven, by the names under which the service has them."""
    found = {name: service.machines.find(name) for name in service.machines.names()}
    return {
        name: f"{each.name}{'' if each.name == name else f' ({name})'}, drive {drive_of(each)}"
        for name, each in found.items()
    }


def may_build(request: Request) -> bool:
    """Return whether the session may ask for builds; without keys everybody may."""
    scopes = getattr(request.state, "scopes", None)
    return scopes is None or Scope.BUILD in scopes
