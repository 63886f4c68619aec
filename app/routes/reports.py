"""The report of a diagnosis, as HTML or PDF."""

from __future__ import annotations

import hashlib
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request
from sqlalchemy import select
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from jointplay.app.etags import matches, respond
from jointplay.app.http.openapi import problems
from jointplay.app.http.query import chosen_type
from jointplay.app.pages.history import chart, measured
from jointplay.app.reports.content import Report, report_of
from jointplay.app.reports.documents import html, pdf, policy
from jointplay.app.reports.figures import ReportFigures, figures_of
from jointplay.app.reports.trend import trend_svg
from jointplay.app.service import Service, of_request
from jointplay.app.storage.assets import Assets, diagnoses_of
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.solver.machines.machine import parse_machine

router = APIRouter(prefix="/diagnoses", tags=["diagnoses"])

MOST_PAST = 200  # diagnoses of an asset, the newest so many, that a report draws

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
    said, figures = await run_in_threadpool(find_report, service, row, response)
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


def find_report(service: Service, row: DiagnosisRow, response: str) -> tuple[Report, ReportFigures]:
    """Return what the report of a stored diagnosis says and shows, the response of the frame drawn already."""
    measurement, gone = service.store.measurement_of(row), service.store.deleted_of(row)
    asset = row.request.get("asset")
    found = Assets(service.store.database)
    known = found.known(asset) if asset else None  # it may have been deleted since
    if known is None:
        return report_of(row, measurement, asset, gone=gone), figures_of(row, response)
    return report_of(row, measurement, asset, known.notes, gone), figures_of(
        row, response, find_trend(service, found, row)
    )


def find_trend(service: Service, assets: Assets, row: DiagnosisRow) -> str:
    """Return the past of the asset up to the recording of a diagnosis; empty where that is its first one."""
    asset = row.request["asset"]
    diagnoses = service.store.diagnoses(None, MOST_PAST, among=diagnoses_of(asset))
    used = {key for each in (row, *diagnoses) for key in each.measurements}
    among = select(MeasurementRow.id).where(MeasurementRow.id.in_(used))
    measurements = {each.id: each for each in service.store.measurements(None, len(used), among, gone=True)}
    end = measured(row, measurements)
    past = [each for each in diagnoses if measured(each, measurements) <= end]
    if len({each.measurements for each in past}) < 2:
        return ""
    findings = [each for each in assets.findings(None, MOST_PAST, only={"asset": asset}) if each.at <= end]
    limits = {name: state.limit_um for name, state in row.answer.joints.items()}
    return trend_svg(chart(past, measurements, findings)["data"], limits)
