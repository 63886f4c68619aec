"""API keys: made, listed, renewed and taken back by whoever has the scope `admin`."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from datetime import timedelta

from fastapi import APIRouter, Depends, Request, Response
from starlette.concurrency import run_in_threadpool

from jointplay.app.errors import ForbiddenError
from jointplay.app.etags import respond
from jointplay.app.http import paging
from jointplay.app.http.openapi import problems
from jointplay.app.http.uploads import JSON_TYPE, json_body
from jointplay.app.routes.machines import Cursor, Limit
from jointplay.app.schemas.keys import KeyIn, KeyMade, KeyOut, KeyPage, KeyRotated, Rotation
from jointplay.app.scopes import Scope
from jointplay.app.service import of_request
from jointplay.app.storage.keys import Key, Keys

router = APIRouter(prefix="/keys", tags=["keys"])


@router.post("", status_code=201, responses=problems(400, 413, 415, 422), dependencies=[Depends(json_body)])
def add(request: Request, response: Response, wanted: KeyIn) -> KeyMade:
    """Make a key; the answer holds its secret, which is not shown again. It can do no more than whoever makes it."""
    check_grant(request, wanted.scopes)
    key, token = keys_of(request).create(wanted.name, frozenset(wanted.scopes), timedelta(days=wanted.days))
    response.headers["Location"] = f"/api/v1/keys/{key.id}"
    return KeyMade(**key_out(key).model_dump(), key=token)


@router.get("", responses=problems(400, 422))
def keys(request: Request, cursor: Cursor = None, limit: Limit = None) -> KeyPage:
    """List the keys, the newest first, those included that no longer hold."""
    size, start = limit or of_request(request).settings.page_size, paging.decode_number(cursor) or 0
    found = keys_of(request).all()[::-1]
    following = paging.encode(str(start + size)) if len(found) > start + size else None
    return KeyPage(items=[key_out(key) for key in found[start : start + size]], next_cursor=following)


@router.get("/{key}", response_model=KeyOut, responses=problems(404))
async def key(request: Request, key: str) -> Response:
    """Return one key, without its secret."""
    text = key_out(await run_in_threadpool(keys_of(request).key, key)).model_dump_json()
    return respond(request, Response(text, media_type=JSON_TYPE), hashlib.sha256(text.encode()).hexdigest())


@router.post("/{key}/rotate", responses=problems(400, 404, 409, 413, 415, 422), dependencies=[Depends(json_body)])
def rotate(request: Request, key: str, how: Rotation) -> KeyRotated:
    """Give a key a new secret; the one before holds a while longer, so that nobody who uses it is locked out."""
    found = keys_of(request)
    check_grant(request, found.key(key).scopes)
    renewed, token, until = found.rotate(key, timedelta(hours=how.grace_hours), timedelta(days=how.days))
    return KeyRotated(**key_out(renewed).model_dump(), key=token, former_until=until)


@router.post("/{key}/revoke", responses=problems(404))
def revoke(request: Request, key: str) -> KeyOut:
    """Take a key back, and its sessions: from the next request on it opens nothing. It stays in the list."""
    return key_out(keys_of(request).revoke(key))


def check_grant(request: Request, wanted: Iterable[Scope]) -> None:
    """Refuse to hand out a secret that may do what whoever asks may not: no scope would be kept from `admin` else.

    Raises
    ------
    ForbiddenError
    """
    held: frozenset[Scope] | None = request.state.scopes
    lacking = sorted(frozenset(wanted) - held) if held is not None else []
    if lacking:
        raise ForbiddenError(f"scopes: {', '.join(lacking)}: whoever hands out a key must have its scopes", lacking[0])


def keys_of(request: Request) -> Keys:
    """Return the keys of the service."""
    found: Keys = request.app.state.keys
    return found


def key_out(key: Key) -> KeyOut:
    """Return the outside shape of a key."""
    return KeyOut(
        id=key.id,
        name=key.name,
        scopes=sorted(key.scopes),
        created_at=key.created_at,
        expires_at=key.expires_at,
        used_at=key.used_at,
        state=key.state,
    )
