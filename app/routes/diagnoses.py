"""Diagnoses: asking for one, finding it again, and what it looks like over HTTP."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Awaitable, Callable, Sequence
from datetime import datetime
from functools import partial
from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import BadFieldError, BadRequestError, UnsupportedMediaError
from jointplay.app.etags import respond
from jointplay.app.fields import TOLD
from jointplay.app.http import paging
from jointplay.app.http.deleting import DELETED, Why, delete
from jointplay.app.http.examples import MEASUREMENT
from jointplay.app.http.file_fields import ASSET, FILE, SAID
from jointplay.app.http.openapi import COMPUTING, problems
from jointplay.app.http.uploads import MULTIPART, Form, media_type, receive_form
from jointplay.app.http.validation import validate
from jointplay.app.routes.findings import Only, Since, damaged_out
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.resources import MADE_BY, DiagnosisItem, DiagnosisPage, DiagnosisRequest
from jointplay.app.service import of_request
from jointplay.app.storage.assets import diagnoses_of
from jointplay.app.storage.idempotency import IdempotencyKey, once
from jointplay.app.storage.rows import Damaged, DiagnosisRow
from jointplay.app.storage.store import measurement_key
from jointplay.app.storage.told import Told, read_told
from jointplay.catalogue.diagnosing.answer import Answer


class _Stored(BaseModel):
    """What an answer has besides when it is stored; a base of its own, so that it comes first."""

    id: str
    created_at: datetime
    made_by: str | None = MADE_BY
    measurement: str = Field(description="Id of the measurement, of several the first.")
    measurements: list[str] = Field(description="Ids of all measurements that have this answer.")
    measurements_deleted: list[str] = Field(default=[], description="Those of them that were deleted since.")
    asset: str | None = Field(description="External id of the machine that was measured, where the request named it.")


class DiagnosisOut(Answer, _Stored):
    """A finished diagnosis."""

    id: str
    catalogue: str = Field(description="Id of the catalogue as it was then; one that has grown has another.")
    mapping: dict[str, str] = Field(description="Column to sensor, beyond what their names say; empty: left out.")
    mapping_remembered: bool = Field(
        description="Whether the request left it out, so that it is that of the asset's last recording with the same"
        " columns."
    )


def diagnosis_out(row: DiagnosisRow, gone: Sequence[str] = ()) -> DiagnosisOut:
    """Return the outside shape of a stored diagnosis, some of whose measurements may be deleted."""
    stored = {
        "id": row.id,
        "created_at": row.created_at,
        "made_by": row.made_by,
        "measurement": row.measurement,
        "measurements": list(row.measurements),
        "measurements_deleted": list(gone),
        "asset": row.request.get("asset"),
        "catalogue": row.catalogue,
        "mapping": row.request.get("mapping", {}),
        "mapping_remembered": row.request.get("mapping_remembered", False),
    }
    members = {name: value for name, value in row.answer if name != "hash"}
    return DiagnosisOut.model_validate({**members, **stored})


router = APIRouter(prefix="/diagnoses", tags=["diagnoses"])

JSON_TYPE = "application/json"
FIELDS = TOLD | {"measurement", "catalogue", "speed", "effort", "mode", "mapping", "prior", "asset"}
TEXT = {"type": "string"}
ASKED = {
    "catalogue": "slider-crank",
    "speed": "606.8 rpm",
    "effort": "fast",
    "asset": "press-7",
    "measurement": MEASUREMENT,
}
FORM = {
    "type": "object",
    "required": ["catalogue"],
    "description": "Either `file` or `measurement` is needed.",
    "properties": {
        "file": FILE,
        **SAID,
        "measurement": TEXT,
        "catalogue": TEXT,
        "speed": TEXT,
        "effort": TEXT,
        "mode": TEXT,
        "asset": ASSET,
        "mapping": {"type": "string", "description": "A JSON object: measurement column to sensor."},
        "prior": {"type": "string", "description": "A JSON object, as in the other form of the body."},
    },
}


def body() -> dict[str, Any]:
    """Return the description of the two bodies that a diagnosis may be asked for with."""
    schema = DiagnosisRequest.model_json_schema(ref_template="#/components/schemas/{model}")
    content = {kind: {"schema": held, "example": ASKED} for kind, held in ((JSON_TYPE, schema), (MULTIPART, FORM))}
    return {"required": True, "content": content}


@router.post(
    "",
    status_code=201,
    response_model=DiagnosisOut,
    responses=problems(*COMPUTING),
    openapi_extra={"requestBody": body()},
)
async def ask(request: Request, idempotency_key: IdempotencyKey = None) -> Response:
    """Diagnose a stored measurement, or several of one machine (JSON), or a file sent in the same call (multipart)."""
    service = of_request(request)
    kind = media_type(request)
    if kind == JSON_TYPE:
        wanted = validate(DiagnosisRequest, parse(await request.body()))
        return await answer(request, idempotency_key, wanted, partial(service.diagnose, wanted))
    if kind != MULTIPART:
        raise UnsupportedMediaError(f"Content-Type: {kind or 'none'}: must be {JSON_TYPE} or {MULTIPART}")
    async with receive_form(request, service.store, FIELDS) as form:
        wanted, told = await run_in_threadpool(of_form, form)
        if form.file is None:
            return await answer(request, idempotency_key, wanted, partial(service.diagnose, wanted))
        diagnose = partial(service.diagnose_upload, form.file, form.file_name, told, wanted)
        return await answer(request, idempotency_key, wanted, diagnose, told.measured_at)


async def answer(
    request: Request,
    key: str | None,
    wanted: DiagnosisRequest,
    diagnose: Callable[[], Awaitable[DiagnosisRow]],
    measured_at: datetime | None = None,
) -> Response:
    """Answer a question by what `diagnose` finds, or with the answer that was given under its key before."""

    async def answered() -> Response:
        row = await diagnose()
        headers = {"Location": f"/api/v1/diagnoses/{row.id}"}
        return Response(diagnosis_out(row).model_dump_json(), 201, headers, JSON_TYPE)

    content: Any = wanted.model_dump(mode="json")
    if measured_at is not None:  # which is no part of the measurement's id
        content = [content, measured_at.isoformat()]
    return await once(request, key, of_request(request).store.claims, content, answered)


@router.get("", responses=problems(400, 422))
def diagnoses(
    request: Request, asset: Only = None, since: Since = None, cursor: Cursor = None, limit: Limit = None
) -> DiagnosisPage:
    """List the diagnoses, the newest first; of one asset, or since a moment, where that is asked for."""
    service = of_request(request)
    size = limit or service.settings.page_size
    found: list[Damaged] = []
    among = None if asset is None else diagnoses_of(asset)
    rows = service.store.diagnoses(paging.decode_number(cursor), size + 1, since, among, found)
    shown, damaged, following = paging.cut_around(rows, found, size)
    items = [item(row) for row in shown]
    return DiagnosisPage(items=items, damaged=damaged_out(service, damaged), next_cursor=following)


@router.get("/{key}", response_model=DiagnosisOut, responses=problems(404, 410))
async def diagnosis(request: Request, key: str) -> Response:
    """Return a diagnosis again; it says which of its measurements were deleted since."""
    store = of_request(request).store
    row = await run_in_threadpool(store.diagnosis, key)
    text = diagnosis_out(row, await run_in_threadpool(store.deleted_of, row)).model_dump_json()
    # Not the id: the same answer has another form in another version of the program.
    return respond(request, Response(text, media_type=JSON_TYPE), hashlib.sha256(text.encode()).hexdigest())


@router.delete("/{key}", status_code=204, responses=DELETED)
async def remove(request: Request, key: str, why: Why = "", idempotency_key: IdempotencyKey = None) -> Response:
    """Delete a diagnosis; its measurement stays. Refused where a finding speaks of it, or its measurement is on hold.

    The same question asked again has the same answer under the same id again.
    """
    return await delete(request, idempotency_key, lambda removal: removal.delete_diagnosis(key, why), why)


def of_form(form: Form) -> tuple[DiagnosisRequest, Told]:
    """Return what a form asks for, with the id that its file has when it is stored, and what is told of the file."""
    members: dict[str, Any] = {name: value for name, value in form.fields.items() if name not in TOLD}
    told = read_told(form.fields)
    for name in ("mapping", "prior"):
        if name in members:
            members[name] = parse(members[name], name)
    if form.file is None:
        named = sorted(TOLD & form.fields.keys())
        if named:
            raise BadFieldError(f"{named[0]}: says something of a file, and there is none", field=named[0])
        return validate(DiagnosisRequest, members), told
    if "measurement" in members:
        raise BadFieldError("measurement: give either a measurement or a file, not both", field="measurement")
    members["measurement"] = measurement_key(form.file.sha256, form.file_name, told)
    return validate(DiagnosisRequest, members), told


def parse(text: bytes | str, name: str = "") -> object:
    """Return the value of a JSON text; numbers that are not finite are refused."""
    try:
        return json.loads(text, parse_constant=refuse_constant)
    except (ValueError, RecursionError) as error:
        prefix = f"{name}: " if name else ""
        raise BadRequestError(f"{prefix}is not JSON: {error}", field=name) from None


def refuse_constant(name: str) -> object:
    """Refuse NaN and Infinity, which are not JSON."""
    raise ValueError(f"{name} is not a JSON number")


def item(row: DiagnosisRow) -> DiagnosisItem:
    """Return what a list says about a diagnosis."""
    return DiagnosisItem(
        id=row.id,
        created_at=row.created_at,
        machine=row.answer.machine,
        catalogue=row.catalogue,
        measurement=row.measurement,
        asset=row.request.get("asset"),
        verdict=row.answer.verdict,
        candidate_set=list(row.answer.candidate_set),
    )
