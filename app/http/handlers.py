"""How exceptions become problem documents, or pages where a person reads them."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from datetime import datetime
from http import HTTPStatus
from pathlib import Path
from urllib.parse import quote

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from fastapi.templating import Jinja2Templates
from markupsafe import Markup, escape
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Match, Mount
from starlette.types import Scope

from jointplay.app.errors import AppError, BadFieldError, BadRequestError, TimeLimitError
from jointplay.app.jobs.workers import TaskFailedError
from jointplay.app.problems import MEDIA_TYPE, PLAIN_TYPE, Problem, of_status, of_validation, problem_of
from jointplay.app.rows import show_unit
from jointplay.app.words import spell_moment
from jointplay.catalogue.errors import CatalogueError
from jointplay.solver.errors import SolverError

log = logging.getLogger(__name__)
templates = Jinja2Templates(directory=Path(__file__).parents[1] / "templates")


def show_moment(moment: datetime | str, zone: bool = True) -> Markup:
    """Return a moment of UTC, or what `spell_moment` made of it, as an element that is shown in the reader's zone.

    Parameters
    ----------
    moment : datetime or str
    zone : bool
        Whether the zone is named with it; the head of a column can do that for all of its rows.
    """
    said = moment if isinstance(moment, str) else spell_moment(moment)
    form = '<time datetime="{}Z"{}><span class="piece">{}</span> <span class="piece">{}</span></time>'
    day, clock = said.removesuffix(" UTC").split(" ")
    how = ("", f"{clock} UTC") if zone else (Markup(" data-bare"), clock)
    return Markup(form).format(f"{day}T{clock}", how[0], day, how[1])


def show_moments(text: str) -> Markup:
    """Return a text with its moments of UTC as such elements."""
    return Markup(SPELLED.sub(lambda found: show_moment(found[0]), str(escape(text))))


SPELLED = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC")
templates.env.filters |= {"moment": show_moment, "moments": show_moments, "unit": show_unit}


def path_of(scope: Scope) -> str:
    """Return the path by which a request is routed: decoded, without the prefix that the application is mounted at.

    Not that of ``Request.url``: it is read from a text that is put together from what the client says (``Host``),
    and names another place where that holds a slash, or where a path holds what such texts leave out (tabs).
    """
    path: str = scope["path"]
    inside = path.removeprefix(scope.get("root_path", ""))
    return inside if inside.startswith("/") else path


def is_fragment(request: Request) -> bool:
    """Return whether a script asks, and shows the answer in a part of the page."""
    return request.headers.get("hx-request") == "true"


def is_page(request: Request) -> bool:
    """Return whether a person in front of a browser will read the answer."""
    if path_of(request.scope).startswith("/api/"):
        return False
    return is_fragment(request) or "text/html" in request.headers.get("accept", "")


def problem_page(request: Request, problem: Problem) -> Response:
    """Return a problem as a page, or as the part of a page that a script asked for."""
    bare = problem.detail.rstrip(".") == problem.title
    detail = "Nothing is at this address." if bare and problem.status == 404 else problem.detail
    members = {"summary": {"title": problem.title, "detail": detail}, "title": f"{problem.title}: jointplay"}
    template = "_refusal.html" if is_fragment(request) else "refused.html"
    return templates.TemplateResponse(request, template, members, problem.status, dict(problem.headers))


def answer(request: Request, problem: Problem) -> Response:
    """Return a problem as the answer to a request: a document, or a page where a person in a browser reads it."""
    note(request, problem)
    if is_page(request):
        return problem_page(request, problem)
    return JSONResponse(
        problem.document(quote(request.scope["path"])),
        problem.status,
        headers=dict(problem.headers),
        media_type=MEDIA_TYPE,
    )


def note(request: Request, problem: Problem) -> None:
    """Note which problem a request is answered with, for its line in the log."""
    request.state.problem = problem.type.rpartition(":")[2] if problem.type != PLAIN_TYPE else str(problem.status)


def problem_from(error: Exception) -> Problem:
    """Return the problem that an exception of any kind means."""
    if isinstance(error, TaskFailedError):
        return error.problem
    if isinstance(error, RequestValidationError):
        entries = list(error.errors())
        broken = next((entry for entry in entries if entry["type"] == "json_invalid"), None)
        if broken is not None:
            return problem_of(BadRequestError(f"is not JSON: {broken['ctx']['error']}"))
        return of_validation(entries)
    if isinstance(error, HTTPException):
        if isinstance(error.__cause__, AppError):
            return problem_of(error.__cause__)  # the framework reads the body, and says 400 of whatever ends that
        return of_status(error.status_code, str(error.detail or ""), error.headers)
    return problem_of(error)


async def handle(request: Request, error: Exception) -> Response:
    """Answer an exception; those that nobody foresaw are logged whole."""
    problem = problem_from(error)
    if problem.status == HTTPStatus.NOT_FOUND and problem.type == PLAIN_TYPE and has_slash(request.scope):
        problem = problem_of(BadFieldError("the address holds %2F: no id or name has a / in it", field="path"))
    if problem.status == HTTPStatus.METHOD_NOT_ALLOWED:
        problem = replace(problem, headers={**problem.headers, "Allow": ", ".join(find_methods(request))})
    if problem.status >= 500:
        known = isinstance(error, AppError) and problem.status != 500
        goes_on = isinstance(error, TimeLimitError) and bool(error.headers)
        level = logging.INFO if goes_on else logging.ERROR
        log.log(level, "%s", problem.detail, exc_info=None if known else error)
    return answer(request, problem)


def has_slash(scope: Scope) -> bool:
    """Return whether a part of an address was sent with a slash in it, which is none between parts."""
    return b"%2f" in scope.get("raw_path", b"").lower()


def find_methods(request: Request) -> list[str]:
    """Return the methods that the address of a request knows: of all routes, where the framework names the first's.

    An address of its own, like `/machines/check`, is no name of a machine.
    """
    if own := request.app.openapi()["paths"].get(request.scope["path"]):
        return [method for method in ("GET", "POST", "PUT", "PATCH", "DELETE") if method.lower() in own]
    routes = [route for route in request.app.router.routes if not isinstance(route, Mount)]
    found = [
        method
        for method in ("GET", "POST", "PUT", "PATCH", "DELETE")
        if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in routes)
    ]
    return found or ["GET", "HEAD"]  # a file: only those are left


def install(application: FastAPI) -> None:
    """Let all exceptions of an application be answered here."""
    for kind in (
        AppError,
        SolverError,
        CatalogueError,
        TaskFailedError,
        RequestValidationError,
        HTTPException,
        SQLAlchemyError,
        OSError,
        Exception,
    ):
        application.add_exception_handler(kind, handle)
