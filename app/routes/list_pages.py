"""The pages that list recordings and diagnoses, the newest first."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request
from sqlalchemy import select
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from jointplay.app.http import paging
from jointplay.app.http.handlers import problem_from
from jointplay.app.pages.listed import diagnosis_rows, recording_rows
from jointplay.app.pages.page_forms import UPLOAD
from jointplay.app.routes.asset_pages import answer_page
from jointplay.app.routes.findings import damaged_out
from jointplay.app.routes.pages import REFUSALS, refuse
from jointplay.app.service import Service, of_request
from jointplay.app.storage.rows import Damaged, DiagnosisRow

router = APIRouter()


@router.get("/measurements")
async def recordings(request: Request) -> Response:
    """List the recordings and spectra that were sent."""
    return await show(request, "measurements")


@router.get("/diagnoses")
async def diagnoses(request: Request) -> Response:
    """List the diagnoses, of one recording where it is named."""
    return await show(request, "diagnoses", request.query_params.get("measurement", ""))


async def show(request: Request, folder: str, only: str = "") -> Response:
    """Return a page of a list."""
    try:
        members = await run_in_threadpool(listed, of_request(request), folder, only, request.query_params.get("cursor"))
    except REFUSALS as error:
        return await refuse(request, problem_from(error), UPLOAD, "index.html", {})
    return await answer_page(request, "listed.html", members, None)


def listed(service: Service, folder: str, only: str, cursor: str | None) -> dict[str, Any]:
    """Return what a page of a list shows.

    Raises
    ------
    BadCursorError
        For a cursor that is none.
    UnknownMeasurementError
        When there is no measurement of the id that is named.
    """
    store, size = service.store, service.settings.page_size
    before, found = paging.decode_number(cursor), list[Damaged]()
    shown: dict[str, Any] = {"folder": folder, "first": cursor is None, "only": ""}
    if folder == "measurements":
        rows = store.measurements(before, size + 1, None, found)
        cut, damaged, shown["following"] = paging.cut_around(rows, found, size)
        shown |= {"rows": recording_rows(store.database, cut), "name": "Recordings"}
    else:
        among = None
        if only:
            shown |= {"only": only, "of": store.measurement(only).name}
            among = select(DiagnosisRow.id).where(DiagnosisRow.measurement == only)
        answers = store.diagnoses(before, size + 1, None, among, found)
        answered, damaged, shown["following"] = paging.cut_around(answers, found, size)
        damaged = list(damaged)
        shown |= {"rows": diagnosis_rows(store, answered, damaged), "name": "Diagnoses"}
    shown |= {"damaged": damaged_out(service, damaged), "title": f"{shown['name']}: jointplay"}
    return shown
