"""How exceptions become problem documents."""

from __future__ import annotations

import logging

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from app.errors import AppError
from app.problems import MEDIA_TYPE, Problem, of_status, of_validation, problem_of
from app.workers import TaskFailedError
from catalogue.errors import CatalogueError
from solver.errors import SolverError

log = logging.getLogger(__name__)


def answer(request: Request, problem: Problem) -> Response:
    """Return a problem as the answer to a request."""
    return JSONResponse(
        problem.document(request.url.path), problem.status, headers=dict(problem.headers), media_type=MEDIA_TYPE
    )


def problem_from(error: Exception) -> Problem:
    """Return the problem that an exception of any kind means."""
    if isinstance(error, TaskFailedError):
        return error.problem
    if isinstance(error, RequestValidationError):
        return of_validation(list(error.errors()))
    if isinstance(error, HTTPException):
        return of_status(error.status_code, str(error.detail or ""), error.headers)
    return problem_of(error)


async def handle(request: Request, error: Exception) -> Response:
    """Answer an exception; those that are our own fault are logged whole."""
    problem = problem_from(error)
    if problem.status >= 500:
        log.error("%s %s: %s", request.method, request.url.path, problem.detail, exc_info=error)
    return answer(request, problem)


def install(application: FastAPI) -> None:
    """Let all exceptions of an application be answered here."""
    for kind in (
        AppError,
        SolverError,
        CatalogueError,
        TaskFailedError,
        RequestValidationError,
        HTTPException,
        Exception,
    ):
        application.add_exception_handler(kind, handle)
