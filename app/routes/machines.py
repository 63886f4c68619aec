"""Machines: those that ship with the program, and those that were put there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from jointplay.app.errors import BadRequestError, UnsupportedMediaError
from jointplay.app.etags import Conditions, respond, tag
from jointplay.app.http import paging
from jointplay.app.http.deleting import DELETED, Why, delete
from jointplay.app.http.openapi import DRAWING, problems
from jointplay.app.http.uploads import media_type
from jointplay.app.jobs import tasks
from jointplay.app.jobs.workers import TaskFailedError
from jointplay.app.pages import understanding
from jointplay.app.problems import Problem
from jointplay.app.schemas.machines import (
    MachineCheck,
    MachineItem,
    MachinePage,
    MachineVersionItem,
    MachineVersionPage,
    Motion,
)
from jointplay.app.schemas.resources import FieldError
from jointplay.app.service import of_request
from jointplay.app.storage.idempotency import IdempotencyKey
from jointplay.app.storage.machine_store import MachineVersion, check_name
from jointplay.solver.machines.drawing import machine_svg
from jointplay.solver.machines.fault import parse_fault
from jointplay.solver.machines.machine import Machine

router = APIRouter(prefix="/machines", tags=["machines"])

Cursor = Annotated[str | None, Query(max_length=200, description="`next_cursor` of the page before.")]
Clearances = Annotated[
    str, Query(max_length=400, examples=["healthy"], description="Radial clearances by joint, as in `A=0.2mm,F=50um`.")
]
Limit = Annotated[int | None, Query(ge=1, le=500, examples=[20], description="Number of items in the page.")]

Version = Annotated[int | None, Query(ge=1, examples=[1], description="Number of a version; the newest unless given.")]

JSON_TYPE = "application/json"
YAML_TYPES = ("application/yaml", "application/x-yaml", "text/yaml", "text/x-yaml")
FILE: dict[str, Any] = {"type": "object", "description": "A machine file; see docs/reference/machine-file.md."}
SHOWN: dict[str, Any] = {"content": {JSON_TYPE: {"schema": FILE}}}
MACHINE_FILE = {
    "name": "pendulum",
    "links": {"base": {"fixed": True}, "arm": {"mass": "1.2 kg", "inertia": 0.02, "cg": [0.1, 0]}},
    "joints": {"O": {"kind": "turning", "links": ["arm", "base"], "at": [0, 0]}},
    "drive": {"kind": "rotation", "joint": "O", "speed": "120 rpm"},
}
MACHINE_YAML = """name: pendulum
links:
  base: {fixed: true}
  arm: {mass: 1.2 kg, inertia: 0.02, cg: [0.1, 0]}
joints:
  O: {kind: turning, links: [arm, base], at: [0, 0]}
drive: {kind: rotation, joint: O, speed: 120 rpm}
"""
BODY: dict[str, Any] = {
    "required": True,
    "content": {
        JSON_TYPE: {"schema": FILE, "example": MACHINE_FILE},
        YAML_TYPES[0]: {"schema": {"type": "string"}, "example": MACHINE_YAML},
    },
}
CHECKED: dict[str, Any] = {  # whatever is sent is looked at, and said to be wrong
    "required": True,
    "content": {kind: {"schema": {}, "example": shown["example"]} for kind, shown in BODY["content"].items()},
}
FILE_SHOWN: dict[int | str, dict[str, Any]] = {
    200: {"description": "The file, as it was sent; JSON is YAML, too.", "content": {YAML_TYPES[0]: {"schema": {}}}}
}
PUT_SHOWN: dict[int | str, dict[str, Any]] = {
    200: {"description": "The machine of this name is this one now; there was one before.", **SHOWN},
    201: {"description": "There was no machine of this name.", **SHOWN},
}


@router.get("", responses=problems(400, 422))
def machines(request: Request, cursor: Cursor = None, limit: Limit = None) -> MachinePage:
    """List the machines by name."""
    service = of_request(request)
    after = paging.decode(cursor) if cursor is not None else ""
    size = limit or service.settings.page_size
    names = [name for name in service.machines.names() if name > after]
    items = [item(name, service.machines.find(name), service.machines.ships(name)) for name in names[:size]]
    return MachinePage(items=items, next_cursor=paging.encode(names[size - 1]) if len(names) > size else None)


@router.post(
    "/drawing.svg",
    responses={**DRAWING, **problems(400, 413, 415, 422, 500, 503, 504)},
    openapi_extra={"requestBody": BODY},
    response_class=Response,
)
async def sketch(request: Request) -> Response:
    """Draw a machine file (JSON or YAML) that is not stored.

    A machine that cannot be assembled is drawn where it is open widest, as near to closed as it comes, the gap in red;
    the description of the drawing says why. What is not even a machine is refused, as by `PUT`.
    """
    text = file_text(media_type(request), await request.body())
    look = await of_request(request).pool.run(tasks.look_at_machine, text, "machine")
    if not look.drawing and look.refusal is not None:
        raise TaskFailedError(look.refusal)
    return Response(look.drawing, media_type="image/svg+xml")


@router.get("/{name}", responses={200: {"description": "The machine.", **SHOWN}, **problems(404, 410)})
def machine(request: Request, name: str) -> Response:
    """Return a machine as the JSON form of its file, everything left out filled in."""
    found = of_request(request).machines.find(name)
    return respond(request, document(found), found.content_key)


@router.post(
    "/check",
    responses=problems(400, 413, 415, 500, 503, 504),
    openapi_extra={"requestBody": CHECKED},
)
async def check(request: Request) -> MachineCheck:
    """Check a machine file (JSON or YAML) as `jointplay check` does; nothing is stored."""
    text = file_text(media_type(request), await request.body())
    look = await of_request(request).pool.run(tasks.look_at_machine, text, "machine")
    return MachineCheck(refusal=refusal_of(look.refusal), account=look.account)


@router.get("/{name}/versions", responses=problems(400, 404, 422))
def versions(request: Request, name: str, cursor: Cursor = None, limit: Limit = None) -> MachineVersionPage:
    """List what was put under a name, the newest first.

    To take one back put its `file` there again.
    """
    service = of_request(request)
    before, size = paging.decode_number(cursor), limit or service.settings.page_size
    numbers = [each for each in service.machines.versions(name) if before is None or each < before]
    items = [version_item(service.machines.version(name, each)) for each in numbers[:size]]
    return MachineVersionPage(
        items=items, next_cursor=paging.encode(str(numbers[size - 1])) if len(numbers) > size else None
    )


@router.get("/{name}/file", responses={**FILE_SHOWN, **problems(404, 422)}, response_class=Response)
def file(request: Request, name: str, version: Version = None) -> Response:
    """Return the file of a machine as it was written, comments and all; of one version where it is named."""
    found = of_request(request).machines.version(name, version)
    ending = "json" if found.text.lstrip().startswith("{") else "yaml"
    answer = Response(found.text, media_type=YAML_TYPES[0])
    answer.headers["Content-Disposition"] = f'attachment; filename="{name}.{ending}"'
    return respond(request, answer, f"{found.number}-{hashlib.sha256(found.text.encode()).hexdigest()}")


@router.put(
    "/{name}",
    responses={**PUT_SHOWN, **problems(400, 409, 412, 413, 415, 422, 500, 503, 504, 507)},
    openapi_extra={"requestBody": BODY},
)
async def put(request: Request, name: str) -> Response:
    """Store a machine file (JSON or YAML) under a name, after the checks of `jointplay check`.

    What was there stays as a version. The same file again changes nothing. `If-None-Match: *` stores only a new one,
    `If-Match` with the entity tag of `GET` only in the place of that one.
    """
    service = of_request(request)
    check_name(name)
    text = file_text(media_type(request), await request.body())
    content = await service.pool.run(tasks.check_machine, text, name)
    stored, created = await run_in_threadpool(service.machines.put, name, content, Conditions.of(request), text)
    answer = document(stored)
    answer.status_code = 201 if created else 200
    answer.headers["ETag"] = tag(stored.content_key)
    if created:
        answer.headers["Location"] = f"/api/v1/machines/{name}"
    return answer


@router.delete("/{name}", status_code=204, responses=DELETED)
async def remove(request: Request, name: str, why: Why = "", idempotency_key: IdempotencyKey = None) -> Response:
    """Delete a machine that was put here, with its versions; catalogues and diagnoses have theirs with them."""
    machines = of_request(request).machines
    return await delete(request, idempotency_key, lambda removal: removal.delete_machine(machines, name, why), why)


@router.get("/{name}/drawing.svg", responses={**DRAWING, **problems(404)}, response_class=Response)
def drawing(request: Request, name: str) -> Response:
    """Return the drawing of a machine in its drawn pose."""
    found = of_request(request).machines.find(name)
    return respond(request, Response(machine_svg(found), media_type="image/svg+xml"), f"drawing-{found.content_key}")


@router.get("/{name}/motion", responses=problems(404, 422, 500, 503, 504))
async def motion(request: Request, name: str, fault: Clearances = "") -> Motion:
    """Return how the drawing of a machine moves in one period of its drive, and worn pins in their sockets.

    With a fault the machine is simulated until it has settled; a machine that is not turned at a constant speed has no
    pins then.
    """
    service = of_request(request)
    found = await run_in_threadpool(service.machines.find, name)
    worn = tuple(parse_fault(fault, found).items())
    return Motion(**await service.pool.run(understanding.motion, found.canonical_json(), worn))


def document(found: Machine) -> Response:
    """Return a machine as JSON."""
    return Response(json.dumps(found.model_dump(), indent=2, allow_nan=False), media_type=JSON_TYPE)


def file_text(kind: str, content: bytes) -> str:
    """Return the text of a machine file in the body of a request.

    Raises
    ------
    UnsupportedMediaError
        When the body is neither JSON nor YAML by its type.
    BadRequestError
        When it is no text, or JSON by its type alone.
    """
    if kind not in (JSON_TYPE, *YAML_TYPES):
        raise UnsupportedMediaError(f"Content-Type: {kind or 'none'}: must be {JSON_TYPE} or {YAML_TYPES[0]}")
    try:
        text = content.decode("utf-8-sig")
        if kind == JSON_TYPE:
            json.loads(text)  # what it holds is read by the reader of machine files, which refuses doubled keys
    except UnicodeDecodeError:
        raise BadRequestError("the body is not text in UTF-8") from None
    except (ValueError, RecursionError) as error:
        raise BadRequestError(f"the body is not JSON: {error}") from None
    return text


def refusal_of(problem: Problem | None) -> FieldError | None:
    """Return why a machine file is refused: one line, with its place in the file as far as that is known."""
    if problem is None:
        return None
    place: Mapping[str, Any] = next(iter(problem.errors), {})
    return FieldError(field=place.get("field", ""), line=place.get("line"), message=problem.detail)


def version_item(found: MachineVersion) -> MachineVersionItem:
    """Return what a list says about a version."""
    return MachineVersionItem(number=found.number, content_key=found.content_key, saved_at=found.saved_at)


def item(name: str, found: Machine, ships: bool) -> MachineItem:
    """Return what a list says about a machine."""
    return MachineItem(
        name=name,
        content_key=found.content_key,
        links=len(found.links),
        turning_joints=list(found.turning_joints),
        sliding_joints=list(found.sliding_joints),
        shipped=ships,
        sensors=[sensor.name for sensor in found.sensors],
    )
