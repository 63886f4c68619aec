"""The report of a diagnosis, as HTML or PDF."""

from __future__ import annotations

import hashlib
import logging
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from jointplay.app.errors import DamagedRowError, DeletedError, NothingToFollowError, UnknownAssetError
from jointplay.app.etags import matches, respond
from jointplay.app.http.openapi import problems
from jointplay.app.http.query import chosen_type
from jointplay.app.jobs.following import MOST_LESSONS
from jointplay.app.jobs.workers import TaskFailedError
from jointplay.app.pages.wear_state import chart, past_words
from jointplay.app.reports.content import Report, report_of
from jointplay.app.reports.documents import html, pdf, policy
from jointplay.app.reports.figures import ReportFigures, figures_of
from jointplay.app.reports.trend import trend_svg
from jointplay.app.service import Service, of_request
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.rows import DiagnosisRow
from jointplay.catalogue.following.state import WearState
from jointplay.solver.machines.machine import parse_machine

router = APIRouter(prefix="/diagnoses", tags=["diagnoses"])

#: The report of a diagnosis is there without the state of wear of its asset, where that cannot be told: it was deleted
#: since, only answers across a repair are of it, or one of its rows is damaged.
NOT_FOLLOWED = (UnknownAssetError, DeletedError, NothingToFollowError, DamagedRowError, TaskFailedError)

log = logging.getLogger(__name__)

HTML_TYPE, PDF_TYPE = "text/html", "application/pdf"
FORMATS = {"html": HTML_TYPE, "pdf": PDF_TYPE}
CONTENT = {HTML_TYPE: {"schema": {"type": "string"}}, PDF_TYPE: {"schema": {"type": "string", "format": "binary"}}}

Format = Annotated[Literal["html", "pdf"] | None, Query(examples=["html"], description="In place of `Accept`.")]


@router.get(
    "/{key}/report",
    response_class=Response,
    responses={
        200: {"description": "The report.", "content": CONTENT},
        **problems(404, 406, 422, 500, 503, 504),
    },
)
async def report(request: Request, key: str, format: Format = None) -> Response:
    """Return the report of a diagnosis, one page for a work order, as HTML or PDF by `Accept` or `format`."""
    service = of_request(request)
    media = FORMATS[format] if format else chosen_type(request, (HTML_TYPE, PDF_TYPE))
    row = await run_in_threadpool(service.store.diagnosis, key)
    machine = await run_in_threadpool(parse_machine, row.machine)
    response = await service.draw_response(machine, phase=False)
    past = await find_past(service, row)
    said, figures = await run_in_threadpool(find_report, service, row, response, past)
    page = await run_in_threadpool(html, said, figures)
    digest = hashlib.sha256(page.encode()).hexdigest()
    if media == HTML_TYPE:
        answer = Response(page, media_type=HTML_TYPE, headers={"Content-Security-Policy": policy()})
    else:
        # Both say the same, so that the page tells whether a client holds the document already, without making it.
        digest = f"{digest}-pdf"
        held = matches(request, digest)
        name = f'inline; filename="diagnosis-{key}.pdf"'
        made = b"" if held else await service.pool.run(pdf, said, figures)
        answer = Response(made, media_type=PDF_TYPE, headers={"Content-Disposition": name})
    answer = respond(request, answer, digest)
    answer.headers["Vary"] = "Accept"
    return answer


async def find_past(service: Service, row: DiagnosisRow) -> WearState | None:
    """Return the state of wear of the asset of a diagnosis up to its recording; None where there is no such thing."""
    asset = row.request.get("asset")
    try:
        past = await service.follow(asset, row) if asset else None
    except NOT_FOLLOWED as error:
        if isinstance(error, TaskFailedError) and error.problem.status >= 500:
            raise
        log.info("report of %s: without the state of wear of its asset: %s", row.id, error)
        return None
    return past if past and past.visits > 1 else None


def find_report(
    service: Service, row: DiagnosisRow, response: str, past: WearState | None
) -> tuple[Report, ReportFigures]:
    """Return what the report of a stored diagnosis says and shows, the response of the frame drawn already."""
    measurement, gone = service.store.measurement_of(row), service.store.deleted_of(row)
    asset = row.request.get("asset")
    database = service.store.database
    known = Assets(database).known(asset) if asset else None
    notes = known.notes if known else ""
    if past is None or known is None:
        return report_of(row, measurement, asset, notes, gone), figures_of(row, response)
    findings = [each for each in Findings(database).of_asset(known, MOST_LESSONS) if each.at <= past.at]
    drawn = chart(past, findings)
    trend = trend_svg(drawn["data"]) if drawn else ""
    return report_of(row, measurement, asset, notes, gone, past_words(past)), figures_of(row, response, trend)
