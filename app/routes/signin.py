"""Signing in with a key, for browsers: the key goes into a form once, a session into a cookie."""

from __future__ import annotations

from math import ceil

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from jointplay.app.errors import RateLimitedError, UnauthorizedError
from jointplay.app.http.gate import COOKIE, TokenBuckets, address
from jointplay.app.http.handlers import templates
from jointplay.app.http.uploads import plain_fields
from jointplay.app.service import of_request
from jointplay.app.storage.keys import SESSION, Keys

router = APIRouter()
FAILURES, FAILURES_PER_S = 10, 0.2
"""Keys that do not hold which an address may send at once, and a second in the long run."""


@router.get("/sign-in")
async def form(request: Request) -> Response:
    """Show the form; without keys, and for whom a proxy knows, there is nothing to sign in to."""
    place = local(request.query_params.get("next", "/"))
    if of_request(request).settings.keys == "off" or request.state.person:
        return RedirectResponse(place, status_code=303)
    return show_form(request, place, "", 200)


@router.post("/sign-in")
async def sign_in(request: Request) -> Response:
    """Open a session for a key."""
    fields = dict(await plain_fields(request))
    place = local(fields.get("next", "/"))
    keys: Keys = request.app.state.keys
    failures: TokenBuckets = request.app.state.failed_sign_ins
    sender = address(request)
    if wait := failures.wait(sender):
        error = RateLimitedError("too many keys that do not hold; Retry-After says when to try again", ceil(wait))
        response = show_form(request, place, str(error), 429)
        response.headers.update(error.headers)
        return response
    try:
        key = await run_in_threadpool(keys.find, fields.get("key", "").strip())
        token = await run_in_threadpool(keys.open_session, key)
    except UnauthorizedError as error:
        failures.take(sender)
        await run_in_threadpool(keys.note_refusal, sender)
        return show_form(request, place, str(error), 401)
    response = RedirectResponse(place, status_code=303)
    response.set_cookie(
        COOKIE,
        token,
        max_age=int(SESSION.total_seconds()),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )
    return response


@router.post("/sign-out")
async def sign_out(request: Request) -> Response:
    """End the session."""
    keys: Keys = request.app.state.keys
    await run_in_threadpool(keys.close_session, request.cookies.get(COOKIE, ""))
    response = RedirectResponse("/sign-in", status_code=303)
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return response


def show_form(request: Request, place: str, message: str, status: int) -> Response:
    """Return the page with the form."""
    members = {"place": place, "message": message, "timeout_ms": 60_000}
    return templates.TemplateResponse(request, "sign_in.html", members, status_code=status)


def local(place: str) -> str:
    """Return a path of this service; anything that a browser would take for another site becomes the first page."""
    plain = place.startswith("/") and not place.startswith("//") and "\\" not in place and place.isprintable()
    return place if plain else "/"
