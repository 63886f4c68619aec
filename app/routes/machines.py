"""Machines that ship with the program."""

from __future__ import annotations

import json
from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from app import paging
from app.errors import UnknownMachineError
from app.etags import respond
from app.openapi import problems
from app.schemas import MachineItem, MachinePage
from app.service import of_request
from solver.machines.drawing import machine_svg
from solver.machines.machine import Machine, shipped_machine, shipped_machine_names

router = APIRouter(prefix="/machines", tags=["machines"])

Cursor = Annotated[str | None, Query(max_length=200, description="`next_cursor` of the page before.")]
Limit = Annotated[int | None, Query(ge=1, le=500, description="Number of items in the page.")]


@router.get("", responses=problems(400, 422))
def machines(request: Request, cursor: Cursor = None, limit: Limit = None) -> MachinePage:
    """List the machines by name."""
    after = paging.decode(cursor) if cursor is not None else ""
    size = limit or of_request(request).settings.page_size
    names = [name for name in shipped_machine_names() if name > after]
    items = [item(name, shipped_machine(name)) for name in names[:size]]
    return MachinePage(items=items, next_cursor=paging.encode(names[size - 1]) if len(names) > size else None)


@router.get("/{name}", responses=problems(404))
def machine(request: Request, name: str) -> Response:
    """Return a machine as the JSON form of its file, everything left out filled in."""
    found = known(name)
    document = Response(json.dumps(found.model_dump(), indent=2, allow_nan=False), media_type="application/json")
    return respond(request, document, found.content_key)


@router.get("/{name}/drawing.svg", responses=problems(404), response_class=Response)
def drawing(request: Request, name: str) -> Response:
    """Return the drawing of a machine in its drawn pose."""
    found = known(name)
    return respond(request, Response(machine_svg(found), media_type="image/svg+xml"), f"drawing-{found.content_key}")


def known(name: str) -> Machine:
    """Return a shipped machine.

    Raises
    ------
    UnknownMachineError
        When there is none of this name.
    """
    if name not in shipped_machine_names():
        raise UnknownMachineError(f"machine: {name[:80]}: there is none of this name")
    return shipped_machine(name)


def item(name: str, found: Machine) -> MachineItem:
    """Return what a list says about a machine."""
    return MachineItem(
        name=name,
        content_key=found.content_key,
        links=len(found.links),
        turning_joints=list(found.turning_joints),
        sliding_joints=list(found.sliding_joints),
        sensors=[sensor.name for sensor in found.sensors],
    )
