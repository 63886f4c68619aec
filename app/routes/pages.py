"""The web page: a recording is sent, what was understood is confirmed, the result is shown.

Everything it does goes through the same service as the HTTP interface.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any
from urllib.parse import urlencode

from fastapi import APIRouter, Request
from fastapi.exceptions import RequestValidationError
from sqlalchemy import select
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.responses import RedirectResponse, Response

from jointplay.app.errors import AppError, BadFieldError, DeletedError, UnknownDiagnosisError
from jointplay.app.etags import respond
from jointplay.app.fields import FILE_FIELDS, PROFILE
from jointplay.app.http.handlers import is_fragment, note, problem_from, templates
from jointplay.app.http.uploads import receive_form
from jointplay.app.jobs.workers import TaskFailedError
from jointplay.app.pages import understanding
from jointplay.app.pages.build_view import build_view
from jointplay.app.pages.page_forms import (
    CONFIRM,
    NUMBERS,
    SAID,
    UPLOAD,
    Beside,
    messages_of,
    plain_form,
    read_form,
    with_point,
)
from jointplay.app.pages.understood import confirmation
from jointplay.app.pages.views import same_place, view
from jointplay.app.problems import Problem
from jointplay.app.questions import columns_of
from jointplay.app.service import Service, of_request
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.app.storage.told import read_told
from jointplay.app.words import recorded, spell_moment
from jointplay.catalogue.errors import CatalogueError
from jointplay.solver.errors import SolverError
from jointplay.solver.machines.drawing import machine_svg

router = APIRouter()

NEWEST = 5
KEPT = ("catalogue", "asset", "beside")  # of what is asked with a file, for when it has been read
KNOWN_ASSETS = 500  # that a field offers; others can be typed
REFUSALS = (AppError, SolverError, CatalogueError, TaskFailedError, RequestValidationError, HTTPException)


@router.get("/")
async def form(request: Request) -> Response:
    """Show the form that takes a recording."""
    chosen = {name: value for name, value in request.query_params.items() if name in UPLOAD}
    members = await context(request, chosen=chosen, told_open=any(name in chosen for name in SAID))
    return templates.TemplateResponse(request, "index.html", members)


@router.post("/recordings")
async def upload(request: Request) -> Response:
    """Store a recording and go on to what was understood of it."""
    service = of_request(request)
    given: dict[str, str] = {}
    try:
        async with receive_form(request, service.store, frozenset(UPLOAD) - {"file"}) as form:
            given.update(form.fields)
            given |= {name: with_point(given[name], name) for name in NUMBERS if name in given}
            if "catalogue" not in given:
                raise BadFieldError("choose a catalogue", field="catalogue")
            if form.file is None:
                raise BadFieldError("choose a recording", field="file")
            await run_in_threadpool(beside_of, service, given)
            offer = await run_in_threadpool(service.shelf.find, given["catalogue"])
            await run_in_threadpool(service.questions.asset_of, given.get("asset"), offer.machine.name)
            told = await run_in_threadpool(read_told, given)
            told = await service.recall(form.file, form.file_name, told, given.get("asset"))
            measurement = await service.add_measurement(form.file, form.file_name, told)
    except REFUSALS as error:
        return await refuse(request, problem_from(error), UPLOAD, "index.html", given)
    asked = {"measurement": measurement.id} | {name: given[name] for name in KEPT if name in given}
    place = f"/confirm?{urlencode(asked)}"
    if is_fragment(request):  # the script goes there by itself: it has shown how far the upload is
        return Response(status_code=201, headers={"Location": place})
    return RedirectResponse(place, status_code=303)


@router.get("/confirm")
async def confirm(request: Request) -> Response:
    """Show what was understood of a recording, to be confirmed or put right."""
    given = dict(request.query_params)
    try:
        members = await understood(request, given)
    except REFUSALS as error:
        return await refuse(request, problem_from(error), UPLOAD, "index.html", given)
    return templates.TemplateResponse(request, "confirm.html", members)


@router.post("/diagnose")
async def ask(request: Request) -> Response:
    """Diagnose a confirmed recording; answer with a fragment for htmx, or with whole pages without it."""
    service = of_request(request)
    given: dict[str, str] = {}
    try:
        given.update(await plain_form(request))
        row = await diagnose(service, given)
    except REFUSALS as error:
        return await refuse(request, problem_from(error), CONFIRM, "confirm.html", given)
    place = f"/diagnoses/{row.id}"
    if not is_fragment(request):
        return RedirectResponse(place, status_code=303)
    shown = await run_in_threadpool(result_of, service, row)
    members = {"result": shown, "fields": CONFIRM, "messages": {}}
    return templates.TemplateResponse(request, "fragment.html", members, headers={"HX-Push-Url": place})


@router.get("/diagnoses/{key}")
async def diagnosis(request: Request, key: str) -> Response:
    """Show a result again."""
    service = of_request(request)
    try:
        row = await run_in_threadpool(service.store.diagnosis, key)
    except AppError as error:
        return await refuse(request, problem_from(error), UPLOAD, "index.html", {})
    shown = await run_in_threadpool(result_of, service, row)
    asked = {"measurement": row.measurement} | same_place(row)
    members = await context(
        request,
        result=shown,
        title=f"{shown['short']}: jointplay",
        again="" if shown["recordings"] or shown["deleted"] else urlencode(asked),
    )
    return templates.TemplateResponse(request, "result.html", members)


@router.get("/diagnoses/{key}/motion")
async def motion(request: Request, key: str) -> Response:
    """Return how the drawing of a result moves in one revolution, and the first hypothesis' pins in their sockets."""
    service = of_request(request)
    row = await run_in_threadpool(service.store.diagnosis, key)
    sizes = row.answer.hypotheses[0].joints if row.answer.verdict == "worn" else {}
    worn = tuple((name, size.clearance_um * 1e-6) for name, size in sizes.items())
    moving = await service.pool.run(understanding.motion, json.dumps(row.machine), worn)
    return respond(request, Response(json.dumps(moving), media_type="application/json"), f"motion-{row.id}")


async def diagnose(service: Service, given: Mapping[str, str]) -> DiagnosisRow:
    """Do what a confirmed form asks for, together with the recordings of the diagnosis that it is to stand beside."""
    for name in ("measurement", "catalogue"):
        if name not in given:
            raise BadFieldError(f"choose a {name}", field=name)
    measurement = await run_in_threadpool(service.store.measurement, given["measurement"])
    offer = await run_in_threadpool(service.shelf.find, given["catalogue"])
    columns = columns_of(measurement.summary)
    first = await run_in_threadpool(beside_of, service, given)
    return await service.diagnose(read_form(given, columns, offer.machine, first))


async def understood(request: Request, given: Mapping[str, str]) -> dict[str, Any]:
    """Return what the page of confirmation shows.

    Raises
    ------
    AppError
        When recording or catalogue are not there, or the recording cannot be read any more.
    """
    service = of_request(request)
    measurement = await run_in_threadpool(service.store.measurement, given.get("measurement", ""))
    offer = await run_in_threadpool(service.shelf.find, given.get("catalogue", ""))
    known = await run_in_threadpool(remembered_sensors, service, measurement, given.get("asset"))
    recording = (str(service.store.path_of(measurement.sha256)), measurement.name, measurement.told)
    found = await service.pool.run(understanding.understand, *recording, str(offer.path), offer.stamp, known)
    messages = {found["field"]: found["message"]} if found["field"] else {}
    shown = confirmation(measurement, offer, found, given, known)
    # The result comes below it, with a drawing of the same machine: names within them are told apart.
    shown["drawing"] = (
        machine_svg(offer.machine)
        .replace("drawing-", "places-")
        .replace("-title places-", '-title" aria-describedby="places-')  # names of sensors label the selects
    )
    return await context(request, confirm=shown, chosen=dict(given), messages=messages, title="Confirm: jointplay")


def remembered_sensors(service: Service, measurement: MeasurementRow, asset: str | None) -> dict[str, str]:
    """Return which column is which sensor by what was confirmed for the asset before; nothing where nothing was."""
    if not asset:
        return {}
    return service.questions.remembered_sensors(asset, measurement.id, columns_of(measurement.summary))


async def refuse(
    request: Request, problem: Problem, fields: Sequence[str], page: str, given: Mapping[str, str]
) -> Response:
    """Answer a problem with its message beside the field at fault."""
    note(request, problem)
    messages = messages_of(problem, fields)
    summary = {"title": problem.title, "detail": "" if messages else problem.detail}
    headers = dict(problem.headers)
    if is_fragment(request):
        members = {"summary": summary, "fields": fields, "messages": messages}
        return templates.TemplateResponse(request, "fragment.html", members, problem.status, headers)
    whole = await context(
        request, chosen=dict(given), told_open=any(name in messages or name in given for name in SAID)
    )
    if page == "confirm.html":
        try:
            whole = await understood(request, given)
        except REFUSALS:
            page = "index.html"
            summary["detail"] = problem.detail
    whole.update(summary=summary, messages={**whole["messages"], **messages})
    return templates.TemplateResponse(request, page, whole, problem.status, headers)


async def context(request: Request, **more: Any) -> dict[str, Any]:
    """Return what every page needs."""
    service = of_request(request)
    offers = await run_in_threadpool(service.shelf.offers)
    known = await run_in_threadpool(Assets(service.store.database).page, None, KNOWN_ASSETS, None, None, [])
    settings = service.settings
    steps = {} if offers else await run_in_threadpool(first_steps, service)
    page: dict[str, Any] = {
        "title": "jointplay",
        "catalogues": [offer.description for offer in offers],
        "known_assets": [(asset.external_id, asset.machine) for asset in known],
        "steps": steps,
        "chosen": {},
        "beside": await run_in_threadpool(show_beside, service, more.get("chosen", {})),
        "messages": {},
        "told_open": False,
        "file_fields": FILE_FIELDS,
        "profile_says": PROFILE,
        "result": None,
        "summary": None,
        "max_bytes": settings.max_upload_bytes,
        "max_text": f"{settings.max_upload_mb:g} MB",
        # Reading and diagnosing are limited each by itself, and may wait for a worker before.
        "timeout_ms": int(3 * settings.time_limit_s * 1000),
    }
    return {**page, **more}


def first_steps(service: Service) -> dict[str, Any]:
    """Return how far somebody is who has no catalogue yet: machines that were put there, builds that go on."""
    own = [name for name in service.machines.names() if not service.machines.ships(name)]
    builds = [build_view(row) for row in service.builds.list_builds(None, NEWEST)]
    return {"own": own, "builds": [each for each in builds if each["open"]]}


def beside_of(service: Service, given: Mapping[str, str]) -> Beside | None:
    """Return what a further recording is diagnosed together with, where a form says that.

    Raises
    ------
    BadFieldError
        When it is not there any more.
    """
    if "beside" not in given:
        return None
    try:
        row = service.store.diagnosis(given["beside"])
    except (UnknownDiagnosisError, DeletedError) as error:
        raise BadFieldError(f"beside: {error}", field="beside") from None
    among = select(MeasurementRow.id).where(MeasurementRow.id.in_(row.measurements))
    found = service.store.measurements(None, len(row.measurements), among, [], gone=True)
    return Beside(row, {each.id: columns_of(each.summary) for each in found})


def show_beside(service: Service, given: Mapping[str, str]) -> dict[str, Any] | None:
    """Return what pages show of that, and how it was asked; None of what is not there any more."""
    with suppress(BadFieldError):
        if found := beside_of(service, given):
            row, first = found.row, service.store.measurement_of(found.row)
            weights = row.request.get("prior", {}).get("joints", {})
            return {
                "id": row.id,
                "recording": recorded(row.answer, first.name),
                "measured": spell_moment(first.measured_at) if len(row.measurements) == 1 else "",
                "effort": row.request["effort"],
                "mode": row.request["mode"],
                "prior": ", ".join(f"{joint}={weight:g}" for joint, weight in weights.items()),
            }
    return None


def result_of(service: Service, row: DiagnosisRow) -> dict[str, Any]:
    """Return everything the page shows of a diagnosis."""
    return view(row, service.store.measurement_of(row), service.store.deleted_of(row))
