"""The page on which a recording is looked at; its charts come by the HTTP interface."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from jointplay.app.errors import AppError, BadFieldError
from jointplay.app.http.handlers import note, problem_from, templates
from jointplay.app.http.validation import validate
from jointplay.app.pages.page_forms import moment_of, plain_form
from jointplay.app.pages.signal_view import signal_view
from jointplay.app.problems import Problem
from jointplay.app.routes.asset_pages import answer_page, may_match
from jointplay.app.routes.pages import REFUSALS, context
from jointplay.app.routes.signals import look
from jointplay.app.schemas.resources import MeasurementChange
from jointplay.app.schemas.signals import SignalOut, SignalQuery
from jointplay.app.service import of_request

router = APIRouter(prefix="/measurements")

CHOICES = {
    "of": (("sensors", "sensors"), ("frame", "motion of the frame")),
    "unit": (("m/s2", "m/s²"), ("g", "g"), ("mm/s", "mm/s"), ("um", "µm")),
    "axis": (("order", "order of the drive"), ("hz", "Hz")),
    "levels": (("db", "dB"), ("log", "logarithmic"), ("lin", "linear")),
    "harmonics": (("", "none"), ("drive", "of the drive"), ("cursor", "of where I click")),
}
MOMENT = "measured_at"
JSON_TYPE = "application/json"
FIELDS = (*CHOICES, "channel", "speed", "diagnosis", "with")


@router.get("/{key}")
async def signal(request: Request, key: str) -> Response:
    """Show a recording: over time, by frequency, over revolutions, by the angle of the drive. Or a spectrum."""
    return await show(request, key)


@router.get("/{key}/overall")
async def overall(request: Request, key: str) -> Response:
    """Show how much each channel shakes in all, as the form of the page asks for it."""
    fields = set(SignalQuery.model_fields)
    asked = {name: value for name, value in request.query_params.items() if name in fields and value}
    try:
        query = validate(SignalQuery, asked | {"view": "overall", "axis": "hz"})
        found = SignalOut.model_validate_json(await look(of_request(request), key, query, JSON_TYPE))
    except REFUSALS as error:
        problem = problem_from(error)
        note(request, problem)
        return templates.TemplateResponse(request, "_overall.html", {"refused": problem.detail}, problem.status)
    return templates.TemplateResponse(request, "_overall.html", {"seen": found})


@router.post("/{key}")
async def correct(request: Request, key: str) -> Response:
    """Correct when a measurement was made."""
    try:
        given = await plain_form(request)
        if MOMENT not in given:
            raise BadFieldError(f"{MOMENT}: say when it was measured", field=MOMENT)
        wanted = validate(MeasurementChange, given | {MOMENT: moment_of(given[MOMENT])})
        await run_in_threadpool(of_request(request).store.correct_moment, key, wanted.measured_at)
    except REFUSALS as error:
        return await show(request, key, problem_from(error))
    return RedirectResponse(f"/measurements/{key}", status_code=303)


async def show(request: Request, key: str, problem: Problem | None = None) -> Response:
    """Return the page of a measurement, with what was wrong with a correction of it."""
    service = of_request(request)
    try:
        shown = await run_in_threadpool(signal_view, service, key)
    except AppError as error:
        problem = problem_from(error)
        note(request, problem)
        summary = {"title": problem.title, "detail": problem.detail}
        return templates.TemplateResponse(
            request, "refused.html", await context(request, summary=summary), problem.status
        )
    usual = {
        "of": "sensors",
        "unit": "m/s2",
        "axis": "order" if shown["speed"] else "hz",
        "levels": "db",
        "speed": shown["speed"],
        "diagnosis": shown["diagnoses"][0][0] if shown["diagnoses"] else "",
        "with": shown["others"][0][0] if shown["others"] else "",
    }
    chosen = {name: request.query_params.get(name, usual.get(name, ""))[:200] for name in FIELDS}
    members: dict[str, Any] = {
        "signal": shown,
        "chosen": chosen,
        "choices": CHOICES,
        "title": f"{shown['name']}: jointplay",
    }
    members |= {"may_match": may_match(request)}
    return await answer_page(request, "signal.html", members, problem, (MOMENT,))
