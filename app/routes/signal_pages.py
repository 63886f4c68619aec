"""The page on which a recording is looked at; its charts come by the HTTP interface."""

from __future__ import annotations

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from jointplay.app.errors import AppError
from jointplay.app.http.handlers import note, problem_from, templates
from jointplay.app.pages.signal_view import signal_view
from jointplay.app.routes.pages import context
from jointplay.app.service import of_request

router = APIRouter(prefix="/measurements")

CHOICES = {
    "of": (("sensors", "sensors"), ("frame", "motion of the frame")),
    "unit": (("m/s2", "m/s²"), ("g", "g"), ("mm/s", "mm/s"), ("um", "µm")),
    "axis": (("order", "order of the drive"), ("hz", "Hz")),
    "levels": (("db", "dB"), ("log", "logarithmic"), ("lin", "linear")),
    "harmonics": (("", "none"), ("drive", "of the drive"), ("cursor", "of where I click")),
}
FIELDS = (*CHOICES, "channel", "speed", "diagnosis", "with")


@router.get("/{key}")
async def signal(request: Request, key: str) -> Response:
    """Show a recording: over time, by frequency, over revolutions, by the angle of the drive."""
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
    members = {"signal": shown, "chosen": chosen, "choices": CHOICES, "title": f"{shown['name']}: jointplay"}
    return templates.TemplateResponse(request, "signal.html", await context(request, **members))
