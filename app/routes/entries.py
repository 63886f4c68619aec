"""Entries of a catalogue: the simulated cases, and the spectrum of each."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from jointplay.app.etags import matches, respond, tag
from jointplay.app.http import paging
from jointplay.app.http.openapi import problems
from jointplay.app.http.query import chosen_type
from jointplay.app.schemas.entries import EntryDetail, EntryLevels, EntryPage, EntryQuery, LevelQuery
from jointplay.app.service import Service, of_request
from jointplay.app.shelves.entries import Rendered
from jointplay.app.shelves.entry_forms import FORMS

router = APIRouter(prefix="/catalogues/{name}/entries", tags=["catalogues"])

BINARY = {"schema": {"type": "string", "format": "binary"}}
FORMS_SHOWN: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The entry in the form that `Accept` asks for.",
        "content": {kind: {"schema": {"type": "string"}} if kind == "text/csv" else BINARY for kind in list(FORMS)[1:]},
    },
    304: {"description": "The client holds this form of the entry already (`If-None-Match`)."},
}


@router.get("", responses=problems(400, 404, 409, 422, 500))
def entries(request: Request, name: str, query: Annotated[EntryQuery, Query()]) -> EntryPage:
    """List the simulated cases: healthy first, then by hypothesis and draw; failed ones last."""
    service = of_request(request)
    after = paging.decode(query.cursor) if query.cursor is not None else None
    size = query.limit or service.settings.page_size
    items, more = service.entries.page(service.shelf.find(name), query, after, size)
    return EntryPage(items=items, next_cursor=paging.encode(items[-1].key) if more else None)


@router.get("/{key}", response_model=EntryDetail, responses={**FORMS_SHOWN, **problems(404, 406, 409, 500)})
async def entry(request: Request, name: str, key: str) -> Response:
    """Return one case with its spectrum: JSON, or by `Accept` as CSV, HDF5 or NPY.

    The key may be shortened to its first digits, eight at least, where only one entry begins so.
    """
    kind = chosen_type(request, list(FORMS))
    service = of_request(request)
    found = in_memory(service, name, key, kind)
    if found is None or (found.body is None and not matches(request, found.key)):
        found = await run_in_threadpool(look_up, service, request, name, key, kind)
    headers = {"ETag": tag(found.key), "Cache-Control": "no-cache", "Vary": "Accept"}
    if matches(request, found.key):
        return Response(status_code=304, headers=headers)
    return Response(found.body, headers=headers, media_type=kind)


@router.get("/{key}/levels", response_model=EntryLevels, responses=problems(404, 409, 422, 500))
def levels(request: Request, name: str, key: str, query: Annotated[LevelQuery, Query()]) -> Response:
    """Return the levels of one case as displacement, velocity or acceleration, in the scaling that is asked for."""
    service = of_request(request)
    found = service.entries.levels(service.shelf.find(name), key, query).model_dump_json().encode()
    answer = Response(found, media_type="application/json")
    return respond(request, answer, hashlib.sha256(found).hexdigest()[:40])


def in_memory(service: Service, name: str, key: str, kind: str) -> Rendered | None:
    """Return what is there of an entry without reading anything: quick enough to need no thread."""
    offer = service.shelf.find_unchanged(name)
    return None if offer is None else service.entries.recall(offer, key, kind)


def look_up(service: Service, request: Request, name: str, key: str, kind: str) -> Rendered:
    """Return an entry in a form, with its body unless the client holds that."""
    offer = service.shelf.find(name)
    found = service.entries.find_tagged(offer, key, kind)
    return found if matches(request, found.key) else service.entries.whole(offer, key, kind)
