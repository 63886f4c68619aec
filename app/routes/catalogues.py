"""Catalogues that measurements can be compared with."""

from __future__ import annotations

import hashlib

from fastapi import APIRouter, Request
from starlette.responses import Response

from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.deleting import DELETED, Why, delete
from jointplay.app.http.openapi import DRAWING, problems
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.resources import CatalogueDetail, CatalogueItem, CataloguePage, DamagedItem
from jointplay.app.service import of_request
from jointplay.app.shelves.catalogues import Offer
from jointplay.app.storage.idempotency import IdempotencyKey
from jointplay.app.storage.removal import Removal
from jointplay.solver.machines.drawing import machine_svg

router = APIRouter(prefix="/catalogues", tags=["catalogues"])


@router.get("", responses=problems(400, 422))
def catalogues(request: Request, cursor: Cursor = None, limit: Limit = None) -> CataloguePage:
    """List the catalogues by name."""
    service = of_request(request)
    after = paging.decode(cursor) if cursor is not None else ""
    size = limit or service.settings.page_size
    found = [offer.description for offer in service.shelf.offers() if offer.description.name > after]
    more = len(found) > size
    items = [CatalogueItem.model_validate(brief(each)) for each in found[:size]]
    damaged = [DamagedItem(id=each.name, problem=each.reason) for each in service.shelf.damages()]
    following = paging.encode(found[size - 1].name) if more else None
    return CataloguePage(items=items, next_cursor=following, damaged=damaged)


@router.get("/{name}", response_model=CatalogueDetail, responses=problems(404, 410, 500))
def catalogue(request: Request, name: str) -> Response:
    """Return one catalogue with its plan and the statuses of its cases."""
    offer = of_request(request).shelf.find(name)
    document = Response(offer.description.model_dump_json(), media_type="application/json")
    return respond(request, document, hashlib.sha256(document.body).hexdigest())


@router.delete("/{name}", status_code=204, responses=DELETED)
async def remove(request: Request, name: str, why: Why = "", idempotency_key: IdempotencyKey = None) -> Response:
    """Delete a catalogue. Diagnoses that were made with it stay, but nobody can repeat them.

    Refused while it is built, and where a measurement that was diagnosed with it is on hold.
    """
    shelf = of_request(request).shelf

    def act(removal: Removal) -> None:
        offer = shelf.find(name)
        same = [each for each in shelf.offers() if each.description.id == offer.description.id]
        removal.delete_catalogue(offer.path, offer.description.id, why, last=len(same) == 1)

    return await delete(request, idempotency_key, act, why)


@router.get("/{name}/drawing.svg", responses={**DRAWING, **problems(404, 500)}, response_class=Response)
def drawing(request: Request, name: str) -> Response:
    """Return the drawing of the catalogue's machine in its drawn pose."""
    offer: Offer = of_request(request).shelf.find(name)
    picture = Response(machine_svg(offer.machine), media_type="image/svg+xml")
    return respond(request, picture, f"drawing-{offer.machine.content_key}")


def brief(description: CatalogueDetail) -> dict[str, object]:
    """Return the members that a list shows."""
    return {name: getattr(description, name) for name in CatalogueItem.model_fields}
