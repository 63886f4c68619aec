"""The pages of machines: all of them with their drawings, and each as a text that is edited beside its drawing."""

from __future__ import annotations

import re
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from jointplay.app.errors import BadFieldError, PreconditionError, UnknownMachineError
from jointplay.app.etags import Conditions, tag
from jointplay.app.http import paging
from jointplay.app.http.handlers import is_fragment, note, problem_from, templates
from jointplay.app.jobs import tasks
from jointplay.app.pages.machine_view import SOURCE, START, card, look_view, users_of, version_row
from jointplay.app.pages.page_forms import messages_of, plain_form
from jointplay.app.problems import Problem
from jointplay.app.routes.build_pages import may_build
from jointplay.app.routes.pages import KNOWN_ASSETS, REFUSALS, context
from jointplay.app.service import Service, of_request
from jointplay.app.storage.asset_rows import AssetRow
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.machine_store import check_name
from jointplay.solver.machines.machine import Machine, shipped_machine_names

router = APIRouter(prefix="/machines")

FIELDS = ("name", "text")
SHOWN_VERSIONS = 20


@router.get("")
async def machines(request: Request) -> Response:
    """Show all machines, with their drawings and who uses them."""
    service = of_request(request)
    try:
        found = await run_in_threadpool(cards, service, request.query_params.get("cursor"))
    except REFUSALS as error:
        return await refuse_list(request, problem_from(error))
    members = await context(request, **found, may_build=may_build(request), title="Machines: jointplay")
    return templates.TemplateResponse(request, "machines.html", members)


@router.get("/new")
async def new(request: Request) -> Response:
    """Show the form for a new machine, with the text of another one to start from where one is named."""
    service = of_request(request)
    start = request.query_params.get("start")
    try:
        text = START if start is None else (await run_in_threadpool(service.machines.version, start)).text
    except REFUSALS as error:
        return await refuse_list(request, problem_from(error))
    return await show(request, None, {"text": text, "start": start or ""})


@router.post("/new")
async def add(request: Request) -> Response:
    """Store a machine under a new name, and go to its page."""
    return await save(request, None)


@router.post("/check")
async def check(request: Request) -> Response:
    """Show what is made of a text: for the script beside the text alone, else the whole page again."""
    try:
        given = await plain_form(request, "text")
    except REFUSALS as error:
        return await refuse_list(request, problem_from(error))
    if not is_fragment(request):
        return await show(request, given.get("known"), given)
    look = await of_request(request).pool.run(tasks.look_at_machine, given.get("text", ""), SOURCE)
    return templates.TemplateResponse(request, "_machine_look.html", {"look": look_view(look), "live": True})


@router.get("/{name}")
async def machine(request: Request, name: str) -> Response:
    """Show a machine: its text, its drawing, what is made of it, its versions."""
    number = request.query_params.get("version")
    try:
        if number is not None and not re.fullmatch(r"[0-9]{1,9}", number):
            raise UnknownMachineError(f"version: {number[:80]}: machine {name[:80]} has none of this number")
        found = await run_in_threadpool(
            of_request(request).machines.version, name, None if number is None else int(number)
        )
    except REFUSALS as error:
        return await refuse_list(request, problem_from(error))
    return await show(request, name, {"text": found.text, "version": number or ""})


@router.post("/{name}")
async def put(request: Request, name: str) -> Response:
    """Store a machine in the place of the one that the form was filled with."""
    return await save(request, name)


async def save(request: Request, name: str | None) -> Response:
    """Store what the form holds, by the rules of `PUT /api/v1/machines/NAME`."""
    service = of_request(request)
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request, "text"))
        if name is None and "name" not in given:
            raise BadFieldError("give it a name", field="name")
        if "text" not in given:
            raise BadFieldError("write or load a machine file", field="text")
        target = given["name"] if name is None else name
        check_name(target)
        content = await service.pool.run(tasks.check_machine, given["text"], SOURCE)
        known = Conditions(none_match=("*",)) if name is None else Conditions(match=(given.get("etag", ""),))
        await run_in_threadpool(service.machines.put, target, content, known, given["text"])
    except PreconditionError as error:
        problem = problem_from(error)
        field = "name" if name is None else "text"
        return await show(request, name, given, problem, {field: taken(name)})
    except REFUSALS as error:
        problem = problem_from(error)
        return await show(request, name, given, problem, messages_of(problem, FIELDS))
    return RedirectResponse(f"/machines/{target}", status_code=303)


def taken(name: str | None) -> str:
    """Return why a machine is not stored over another one."""
    if name is None:
        return "There is a machine of this name already; take another one."
    return "Somebody else has saved this machine meanwhile. Nothing was stored: open it in another tab and compare."


async def show(
    request: Request,
    name: str | None,
    given: dict[str, str],
    problem: Problem | None = None,
    messages: dict[str, str] | None = None,
) -> Response:
    """Return the page of a machine, or of one that is to be, with what was wrong."""
    service = of_request(request)
    shipped = name is not None and service.machines.ships(name)
    try:
        stored = None if name is None else await run_in_threadpool(service.machines.find, name)
        look = look_view(await service.pool.run(tasks.look_at_machine, given.get("text", ""), SOURCE))
    except REFUSALS as error:
        return await refuse_list(request, problem_from(error))
    members: dict[str, Any] = {
        "name": name,
        "given": given,
        "look": look,
        "shipped": shipped,
        "editable": may_build(request) and (name is None or name not in shipped_machine_names()),
        "may_build": may_build(request),
        "title": f"{name or 'New machine'}: jointplay",
    }
    if name is not None and stored is not None:
        members |= await run_in_threadpool(about, service, name, stored)
        # What a form was filled with stays: whoever saves over another one's work is told.
        members["etag"] = given.get("etag", tag(stored.content_key))
    if problem is None:
        return templates.TemplateResponse(request, "machine.html", await context(request, **members))
    note(request, problem)
    told = messages or {}
    # What is wrong with the text is told beside its line.
    shown = told or look["refusal"]
    whole = await context(request, **members)
    whole["messages"] = told
    whole["summary"] = None if shown else {"title": problem.title, "detail": problem.detail}
    return templates.TemplateResponse(request, "machine.html", whole, problem.status, dict(problem.headers))


def about(service: Service, name: str, stored: Machine) -> dict[str, Any]:
    """Return who uses a machine, and its versions."""
    numbers = service.machines.versions(name)
    rows = [version_row(service.machines.version(name, each), stored.content_key) for each in numbers[:SHOWN_VERSIONS]]
    return {
        "machine_title": stored.name,
        "versions": rows,
        "more_versions": len(numbers) > SHOWN_VERSIONS,
        "users": users_of(stored, service.shelf.offers(), known_assets(service)),
    }


def cards(service: Service, cursor: str | None) -> dict[str, Any]:
    """Return one page of the list of machines: those that were put there first."""
    after = paging.decode(cursor) if cursor is not None else ""
    places = {f"{int(service.machines.ships(name))}{name}": name for name in service.machines.names()}
    left = sorted(place for place in places if place > after)
    size = service.settings.page_size
    offers, assets = service.shelf.offers(), known_assets(service)
    shown = [(places[place], place.startswith("1")) for place in left[:size]]
    return {
        "cards": [card(name, service.machines.find(name), ships, offers, assets) for name, ships in shown],
        "following": paging.encode(left[size - 1]) if len(left) > size else None,
    }


def known_assets(service: Service) -> list[AssetRow]:
    """Return the assets that the page speaks of."""
    return Assets(service.store.database).page(None, KNOWN_ASSETS, damaged=[])


async def refuse_list(request: Request, problem: Problem) -> Response:
    """Return the list of machines with what was wrong."""
    note(request, problem)
    summary = {"title": problem.title, "detail": problem.detail}
    found = await run_in_threadpool(cards, of_request(request), None)
    members = await context(
        request, **found, summary=summary, may_build=may_build(request), title="Machines: jointplay"
    )
    return templates.TemplateResponse(request, "machines.html", members, problem.status, dict(problem.headers))
