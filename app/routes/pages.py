"""The web page: one form, one result; everything it does goes through the same service as the HTTP interface."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request
from fastapi.exceptions import RequestValidationError
from fastapi.templating import Jinja2Templates
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.responses import RedirectResponse, Response

from app.errors import AppError, BadFieldError
from app.handlers import problem_from
from app.problems import Problem
from app.schemas import DiagnosisRequest
from app.service import Service, of_request, rate_of, speed_of
from app.storage import DiagnosisRow
from app.uploads import received_form
from app.views import view
from app.workers import TaskFailedError
from catalogue.errors import CatalogueError
from solver.errors import SolverError

router = APIRouter()
templates = Jinja2Templates(directory=Path(__file__).parent.parent / "templates")

FIELDS = ("catalogue", "file", "speed", "effort", "mapping", "sample_rate")
REFUSALS = (AppError, SolverError, CatalogueError, TaskFailedError, RequestValidationError, HTTPException)


@router.get("/")
async def form(request: Request) -> Response:
    """Show the empty form."""
    return templates.TemplateResponse(request, "index.html", await context(request))


@router.post("/diagnose")
async def ask(request: Request) -> Response:
    """Diagnose the file of the form; answer with a fragment for htmx, or with whole pages without it."""
    service = of_request(request)
    fragment = request.headers.get("hx-request") == "true"
    given: dict[str, str] = {}
    try:
        row = await diagnose(request, service, given)
    except REFUSALS as error:
        return await refuse(request, problem_from(error), given, fragment)
    place = f"/diagnoses/{row.id}"
    if not fragment:
        return RedirectResponse(place, status_code=303)
    shown = await run_in_threadpool(result_of, service, row)
    members = {"result": shown, "fields": FIELDS, "messages": {}}
    return templates.TemplateResponse(request, "fragment.html", members, headers={"HX-Push-Url": place})


@router.get("/diagnoses/{key}")
async def diagnosis(request: Request, key: str) -> Response:
    """Show a result again, with the form for the next one."""
    service = of_request(request)
    try:
        row = await run_in_threadpool(service.store.diagnosis, key)
    except AppError as error:
        return await refuse(request, problem_from(error), {}, fragment=False)
    shown = await run_in_threadpool(result_of, service, row)
    chosen = {"catalogue": row.catalogue, "effort": row.request["effort"]}
    members = await context(request, result=shown, title=f"{shown['short']}: jointplay", chosen=chosen)
    return templates.TemplateResponse(request, "index.html", members)


async def diagnose(request: Request, service: Service, given: dict[str, str]) -> DiagnosisRow:
    """Do what the form asks for; `given` is filled with its fields as soon as they are read."""
    async with received_form(request, service.store, frozenset(FIELDS) - {"file"}) as form:
        given.update(form.fields)
        members: dict[str, Any] = {name: given[name] for name in ("catalogue", "effort") if name in given}
        if "speed" in given:
            # The page asks for revolutions per minute; whoever writes a unit is believed.
            members["speed"] = f"{given['speed']} rpm" if plain_number(given["speed"]) else given["speed"]
            speed_of(members["speed"])
        if "catalogue" not in given:
            raise BadFieldError("choose a catalogue", field="catalogue")
        if form.file is None:
            raise BadFieldError("choose a recording", field="file")
        wanted = checked({**members, "measurement": "file", "mapping": pairs(given.get("mapping", ""))})
        await run_in_threadpool(service.shelf.find, wanted.catalogue)
        rate = rate_of(given.get("sample_rate"))
        measurement = await service.add_measurement(form.file, form.file_name, rate)
    return await service.diagnose(wanted.model_copy(update={"measurement": measurement.id}))


def checked(members: Mapping[str, Any]) -> DiagnosisRequest:
    """Return a request whose members keep the rules."""
    try:
        return DiagnosisRequest.model_validate(members)
    except ValidationError as error:
        raise RequestValidationError(error.errors()) from None


def pairs(text: str) -> dict[str, str]:
    """Return the mapping in lines of ``column = sensor``.

    Raises
    ------
    BadFieldError
        For a line without both sides, or a column given twice.
    """
    found: dict[str, str] = {}
    for line in filter(None, map(str.strip, text.splitlines())):
        column, _, sensor = (part.strip() for part in line.rpartition("="))
        if not column or not sensor:
            raise BadFieldError(f"{line}: must be column = sensor", field="mapping")
        if column in found:
            raise BadFieldError(f"{column}: is given twice", field="mapping")
        found[column] = sensor
    return found


def plain_number(text: str) -> bool:
    """Return whether a text is a number without a unit."""
    try:
        float(text)
    except ValueError:
        return False
    return True


async def refuse(request: Request, problem: Problem, given: Mapping[str, str], fragment: bool) -> Response:
    """Answer a problem with its message beside the field at fault."""
    messages = dict.fromkeys(fields_of(problem), problem.detail)
    summary = {"title": problem.title, "detail": "" if messages else problem.detail}
    headers = dict(problem.headers)
    if fragment:
        members = {"summary": summary, "fields": FIELDS, "messages": messages}
        return templates.TemplateResponse(request, "fragment.html", members, problem.status, headers)
    page = await context(request, summary=summary, messages=messages, chosen=dict(given))
    return templates.TemplateResponse(request, "index.html", page, problem.status, headers)


def fields_of(problem: Problem) -> list[str]:
    """Return the fields of the form that a problem is about; what is wrong with a recording is about the file."""
    named = [entry["field"] for entry in problem.errors if entry["field"] in FIELDS]
    about_file = problem.type.rpartition(":")[2] in ("measurement", "too-large", "diagnosis")
    return named or (["file"] if about_file else [])


async def context(request: Request, **more: Any) -> dict[str, Any]:
    """Return what the whole page needs."""
    service = of_request(request)
    offers = await run_in_threadpool(service.shelf.offers)
    settings = service.settings
    page: dict[str, Any] = {
        "title": "jointplay",
        "catalogues": [offer.description for offer in offers],
        "chosen": {},
        "messages": {},
        "result": None,
        "summary": None,
        "max_bytes": settings.max_upload_bytes,
        "max_text": f"{settings.max_upload_mb:g} MB",
        # Reading and diagnosing are limited each by itself, and may wait for a worker before.
        "timeout_ms": int(3 * settings.time_limit_s * 1000),
    }
    return {**page, **more}


def result_of(service: Service, row: DiagnosisRow) -> dict[str, Any]:
    """Return everything the page shows of a diagnosis."""
    return view(row, service.store.measurement(row.measurement))
