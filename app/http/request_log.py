"""The outermost layer of a request: its id, its line in the log, and an answer to what nobody foresaw."""

from __future__ import annotations

import asyncio
import logging
import re
import secrets
import time
from collections.abc import Sequence
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jointplay.app import logs
from jointplay.app.errors import NotReadyError
from jointplay.app.http.handlers import handle, path_of
from jointplay.app.http.uploads import MULTIPART
from jointplay.app.metrics import Metrics

HEADER = "X-Request-ID"
SAFE = re.compile(r"[A-Za-z0-9._-]{1,64}")
GONE = 499
"""Status in the log of a request whose client went before there was an answer."""

log = logging.getLogger(__name__)


class RequestLog:
    """Middleware that gives every request an id, and every answer a line in the log.

    Parameters
    ----------
    app : ASGIApp
        The application behind.
    templates : sequence of str
        Of all routes.
    metrics : Metrics
        Counts answers.
    """

    def __init__(self, app: ASGIApp, templates: Sequence[str], metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics
        self._templates = Templates(templates)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and note what became of it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        scope.setdefault("state", {})
        identity = identity_of(Headers(scope=scope))
        with logs.of_request(identity):
            await self._answer(scope, receive, send, identity)

    async def _answer(self, scope: Scope, receive: Receive, send: Send, identity: str) -> None:
        status: int | None = None

        async def noted(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[HEADER] = identity
            await send(message)

        began = time.perf_counter()
        route = self._templates.of(path_of(scope))  # now: where files are mounted, the scope is changed
        try:
            await self._app(scope, receive, noted)
        except ClientDisconnect:
            pass
        except asyncio.CancelledError:
            # The server is ending, and does not wait any longer.
            if status is None:
                error = NotReadyError("the service is stopping, and this was not done; try again in a few seconds")
                await (await handle(Request(scope), error))(scope, receive, noted)
            raise
        except Exception as error:
            # Not left to the framework: its answer would be without an id and without the headers of all others.
            if status is not None:
                log.exception("the answer broke off")
                raise
            await (await handle(Request(scope), error))(scope, receive, noted)
        finally:
            self._note(scope, route, GONE if status is None else status, time.perf_counter() - began)

    def _note(self, scope: Scope, route: str | None, status: int, seconds: float) -> None:
        self._metrics.count_answer(scope["method"], route, status, seconds)
        told: dict[str, Any] = {
            "method": scope["method"],
            "route": route,
            "path": scope["path"],
            "status": status,
            "duration_ms": round(1000 * seconds, 1),
            "key": scope["state"].get("key"),
        }
        if "problem" in scope["state"]:
            told["problem"] = scope["state"]["problem"]
            if scope["method"] == "POST" and Headers(scope=scope).get("content-type", "").startswith(MULTIPART):
                self._metrics.count_refusal(told["problem"])
        log.info("request", extra={logs.MEMBERS: told})


def identity_of(headers: Headers) -> str:
    """Return the id that a request brings, if it is short and of safe characters; else a new one."""
    given = headers.get(HEADER, "")
    return given if SAFE.fullmatch(given) else secrets.token_hex(16)


class Templates:
    """Finds the template of a path: logs and metrics name routes, not what is asked for by them.

    Parameters
    ----------
    templates : sequence of str
        Such as ``/machines/{name}``; the first that fits counts.
    """

    def __init__(self, templates: Sequence[str]) -> None:
        self._plain = {template for template in templates if "{" not in template}
        self._patterns = [(compile_path(template)[0], template) for template in templates if "{" in template]

    def of(self, path: str) -> str | None:
        """Return the template of a path; ``None`` where there is none."""
        if path in self._plain:
            return path
        return next((template for pattern, template in self._patterns if pattern.fullmatch(path)), None)
