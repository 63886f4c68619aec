"""A recording as it is looked at: its samples, spectra and revolutions, as numbers for charts and tables."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from math import pi
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import BadFieldError
from jointplay.app.etags import respond
from jointplay.app.http.openapi import problems
from jointplay.app.http.query import chosen_type
from jointplay.app.jobs import signals
from jointplay.app.jobs.samples import StoredRecording
from jointplay.app.questions import columns_of
from jointplay.app.schemas.signals import SignalOut, SignalQuery, SignalRow
from jointplay.app.service import Service, of_request
from jointplay.app.speeds import speed_of
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow
from jointplay.catalogue.signals.signal_question import SignalQuestion

router = APIRouter(prefix="/measurements", tags=["measurements"])

FORMS = ("application/json", "text/csv")
FORMS_SHOWN: dict[int | str, dict[str, Any]] = {
    200: {"description": "What is seen, as `Accept` asks.", "content": {FORMS[1]: {"schema": {"type": "string"}}}}
}


@router.get(
    "/{key}/signal", response_model=SignalOut, responses={**FORMS_SHOWN, **problems(404, 406, 422, 500, 503, 504)}
)
async def signal(request: Request, key: str, query: Annotated[SignalQuery, Query()]) -> Response:
    """Return a recording as charts show it: over time, by frequency, over revolutions, by the angle of the drive.

    However long it is, no more than `points` places are answered: ask for a part of the axis (`from`, `to`) to see it
    more closely. JSON, or CSV by `Accept`.
    """
    kind = chosen_type(request, FORMS)
    service = of_request(request)
    found = await look(service, key, query, kind)
    return respond(request, Response(found, media_type=kind), hashlib.sha256(found).hexdigest()[:40])


@router.get("/{key}/series", response_model=list[SignalRow], responses=problems(404, 422, 500, 503, 504))
async def series(request: Request, key: str, query: Annotated[SignalQuery, Query()]) -> Response:
    """Return the lines of `/signal` as a plain list of values, each with its place: for panels that read flat rows.

    What is seen otherwise, overall levels and spectrograms, is refused.
    """
    found = await look(of_request(request), key, query, signals.ROWS)
    return respond(request, Response(found, media_type=FORMS[0]), hashlib.sha256(found).hexdigest()[:40])


async def look(service: Service, key: str, query: SignalQuery, kind: str) -> bytes:
    """Let a worker see what a query asks of a measurement.

    Raises
    ------
    AppError
        There is no such measurement or diagnosis, or the query breaks a rule.
    """
    row = await run_in_threadpool(service.store.measurement, key)
    if query.start is not None and query.end is not None and query.start >= query.end:
        raise BadFieldError(f"to: {query.end:g}: must be greater than from, {query.start:g}", field="to")
    speed = speed_of(query.speed)
    machine: Mapping[str, Any] | None = None
    mapping: Mapping[str, str] = {}
    near = clearances = catalogue = None
    hypotheses: list[tuple[str, dict[str, float]]] = []
    if query.diagnosis is not None:
        diagnosis = await run_in_threadpool(service.store.diagnosis, query.diagnosis)
        machine, mapping = diagnosis.machine, diagnosis.request.get("mapping") or {}
        if speed is None and row.id in diagnosis.measurements:
            speed = speed_in(diagnosis, row)
        read = dict(
            zip(diagnosis.request.get("baselines", ()), diagnosis.request.get("baselines_read", ()), strict=False)
        )
        if own := read.get(row.id):
            mapping = mapping if own["mapping"] is None else own["mapping"]
            speed = own["speed"] if speed is None else speed
        # It may be of others that have an answer together with this one.
        mapping = {column: sensor for column, sensor in mapping.items() if column in columns_of(row.summary)}
        best = diagnosis.answer.hypotheses[0].joints
        clearances = {joint: found.clearance_um * 1e-6 for joint, found in best.items()}
        # Another recording of the machine turned at a speed of its own.
        near = diagnosis.answer.drive_speed_rpm * pi / 30
        if query.view == "matched":
            offer = await run_in_threadpool(service.shelf.find, diagnosis.answer.catalogue)
            catalogue = (str(offer.path), offer.stamp)
            hypotheses = [
                (each.label, {joint: found.clearance_um * 1e-6 for joint, found in each.joints.items()})
                for each in diagnosis.answer.hypotheses[:2]
            ]
    stored = StoredRecording(row.id, str(service.store.path_of(row.sha256)), row.name, row.told, service.samples)
    asked = query.model_dump(exclude={"diagnosis", "speed"})
    found: bytes = await service.pool.run(
        signals.look,
        stored,
        SignalQuestion(**asked, speed=speed),
        kind,
        machine,
        mapping,
        near,
        clearances,
        catalogue,
        hypotheses,
    )
    return found


def speed_in(diagnosis: DiagnosisRow, measurement: MeasurementRow) -> float:
    """Return the drive speed [rad/s] of a recording by a diagnosis of it."""
    answer = diagnosis.answer
    own = [each.drive_speed_rpm for each in answer.recordings if each.sha256 == measurement.sha256]
    return (own[0] if own else answer.drive_speed_rpm) * pi / 30
