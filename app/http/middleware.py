"""What stands around every request: its id, its line in the log, limits of its body, headers of its answer, metrics.

The outermost layer answers what nobody foresaw. The limit on bodies is enforced while they arrive. The headers let a
browser run and load nothing but our own files. Metrics say how the service is at the moment Prometheus asks.
"""

from __future__ import annotations

import asyncio
import logging
import re
import secrets
import time
from collections.abc import Iterator, Sequence
from datetime import timedelta
from typing import Any

import psutil
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, Request
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from jointplay.app import logs
from jointplay.app.errors import BadRequestError, NotReadyError, SlowRequestError, UploadTooLargeError
from jointplay.app.http.gate import address, host_name
from jointplay.app.http.handlers import handle, path_of
from jointplay.app.http.uploads import MULTIPART
from jointplay.app.jobs.clients import Client, working_for
from jointplay.app.metrics import Metrics
from jointplay.app.scopes import API
from jointplay.app.service import Service
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.rows import now
from jointplay.app.storage.webhooks import Webhooks

POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self'",
        "connect-src 'self'",
        "form-action 'self'",
        "base-uri 'none'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
TLS_HEADERS = HEADERS | {"Strict-Transport-Security": "max-age=31536000"}
"""Where the client speaks TLS, with us or with a proxy: for a year its browser will not speak otherwise."""

JSON_BYTES = 1_000_000
RECORDINGS = f"{API}/measurements"
DIAGNOSES = f"{API}/diagnoses"
RECORDING_BYTES = 16_000_000
"""Largest recording as JSON, which is held in memory; a file is not."""
FORMS = {"/sign-in": 4000, "/sign-out": 4000}
"""Largest form that is taken without a key [bytes]."""
SLOWEST = 1000
"""Slowest that a body may come, after its first seconds [bytes/s]."""

log = logging.getLogger(__name__)
HEADER = "X-Request-ID"
SAFE = re.compile(r"[A-Za-z0-9._-]{1,64}")
DAMAGE = ("recording-missing", "recording-damaged", "row-damaged")
"""Problems that say that something kept is damaged."""
EXPIRING = timedelta(days=14)
"""Keys that end so soon are counted: somebody has to renew them."""
GONE = 499
"""Status in the log of a request whose client went before there was an answer."""


class SecurityHeaders:
    """Middleware that adds the headers to every answer, errors included."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on and add the headers to its answer."""

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in (TLS_HEADERS if is_secured(scope) else HEADERS).items():
                    headers.setdefault(name, value)  # a page of its own kind may say something stricter
                if headers.get("content-type", "").startswith("text/html"):
                    # Pages and their parts share addresses; going back must not show one for the other.
                    headers.add_vary_header("HX-Request")
            await send(message)

        await self._app(scope, receive, with_headers if scope["type"] == "http" else send)


def is_secured(scope: Scope) -> bool:
    """Return whether a client speaks TLS with a name that is this service's: localhost is that of others, too."""
    return scope["scheme"] == "https" and host_name(Headers(scope=scope).get("host", "")) != "localhost"


class BodyLimit:
    """Middleware that stops reading a body at its limit, so that no upload is ever held whole in memory.

    Whoever reads bodies knows when a client has gone, so it says, too, whom the workers' tasks of a request are for.

    Parameters
    ----------
    app : ASGIApp
        The application behind.
    upload_bytes : int
        Largest multipart body where files are taken; any other body may have at most `JSON_BYTES`, a recording
        `RECORDING_BYTES`.
    receive_timeout : float
        Longest pause between two parts of a body, and time after which `SLOWEST` counts [s].
    """

    def __init__(self, app: ASGIApp, upload_bytes: int, receive_timeout: float) -> None:
        self._app = app
        self._receive_timeout = receive_timeout
        self._upload_bytes = upload_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on with a counted body."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        headers = request.headers
        multipart = headers.get("content-type", "").lower().startswith("multipart/") and takes_files(path_of(scope))
        usual = RECORDING_BYTES if path_of(scope) == RECORDINGS else JSON_BYTES
        limit = self._upload_bytes if multipart else min(FORMS.get(path_of(scope), usual), self._upload_bytes)
        declared = headers.get("content-length", "0")
        received = 0
        whole = False
        began: float | None = None

        async def counted() -> Message:
            nonlocal received, whole, began
            if not declared.isdecimal():
                raise BadRequestError(f"Content-Length: {declared}: must be a whole number")
            # A declared length is refused before the first byte is read, an undeclared one when the limit is passed.
            if int(declared) > limit:
                raise too_large(limit)
            moment = time.monotonic()
            began = moment if began is None else began
            left = began + self._receive_timeout + received / SLOWEST - moment
            # After the body the same call waits for the client to go, as long as an answer takes.
            try:
                async with asyncio.timeout(None if whole else min(left, self._receive_timeout)):
                    message = await receive()
            except TimeoutError:
                how = f"paused for longer than {self._receive_timeout:g} s"
                if left < self._receive_timeout:
                    how = f"came slower than {SLOWEST} bytes a second"
                raise SlowRequestError(f"the request body {how}, the limit of this service") from None
            received += len(message.get("body", b""))
            whole = not message.get("more_body", False)
            if received > limit:
                raise too_large(limit)
            return message

        async def leave() -> None:
            while (await counted())["type"] != "http.disconnect":
                pass

        name = getattr(request.state, "key", None) or getattr(request.state, "person", None) or address(request)
        with working_for(Client(name, leave)):
            await self._app(scope, counted, send)


def takes_files(path: str) -> bool:
    """Return whether files are streamed to disk at an address; elsewhere in the interface a body is held in memory."""
    return path in (RECORDINGS, DIAGNOSES) or not path.startswith(f"{API}/")


def too_large(limit: int) -> UploadTooLargeError:
    """Return the refusal of a body over the limit."""
    return UploadTooLargeError(f"the request body is larger than {limit / 1e6:g} MB, the limit of this service")


class State(Collector):
    """How a service is at the moment it is asked.

    Parameters
    ----------
    service : Service
    """

    def __init__(self, service: Service) -> None:
        self._service = service

    def describe(self) -> list[Metric]:
        """Return nothing: names are known when they are asked for."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Give what is measured."""
        service = self._service
        yield gauge("queue_length", "Tasks that wait for a worker.", service.pool.waiting)
        yield gauge("queue_limit", "Tasks that may wait for a worker.", service.settings.queue_limit)
        yield gauge("workers_busy", "Workers that have a task.", service.pool.busy)
        offers = service.shelf.offers()
        yield gauge("catalogues", "Catalogues that are offered.", len(offers))
        yield gauge("catalogues_damaged", "Catalogues that cannot be used.", len(service.shelf.damages()))
        entries = GaugeMetricFamily(
            "jointplay_catalogue_entries", "Simulated cases in a catalogue that is offered.", labels=["catalogue"]
        )
        for offer in offers:
            entries.add_metric([offer.description.name], offer.description.entries)
        yield entries
        yield from self._rows()
        yield self._memory()

    def _rows(self) -> Iterator[Metric]:
        try:
            counts, running = self._service.builds.counts()
            backlog = Webhooks(self._service.store.database).backlog(now())
            expiring = Keys(self._service.store.database).expiring(EXPIRING)
        except SQLAlchemyError as error:
            log.warning("metrics without the database: %s", str(error).partition("\n")[0])
            yield gauge("database_up", "Whether the database answers.", 0)
            return
        yield gauge("database_up", "Whether the database answers.", 1)
        yield gauge("keys_expiring", f"Keys that hold, for {EXPIRING.days} days at most.", expiring)
        states = GaugeMetricFamily("jointplay_builds", "Builds of all servers of the database.", labels=["state"])
        for state, count in counts.items():
            states.add_metric([state], count)
        yield states
        yield gauge("builds_running_cases_done", "Cases done, of builds that run.", running.done)
        yield gauge("builds_running_cases", "All cases of builds that run.", running.total)
        yield gauge("builds_cases_per_second", "Cases a second, of builds that run.", running.rate)
        yield gauge("webhook_deliveries_waiting", "Deliveries to webhooks that are to be made.", backlog.waiting)
        yield gauge("webhook_oldest_delivery_seconds", "Age of the oldest of them.", backlog.age_s)
        yield gauge("webhooks_disabled", "Webhooks at which nothing succeeded for days.", backlog.disabled)

    def _memory(self) -> Metric:
        family = GaugeMetricFamily("jointplay_memory_bytes", "Resident memory of a process.", labels=["process"])
        service = self._service
        for name, pid in (("server", None), *service.pool.processes(), *service.answers.background.processes()):
            try:
                family.add_metric([name], psutil.Process(pid).memory_info().rss)
            except psutil.Error:  # it ended just now
                continue
        return family


def gauge(name: str, says: str, value: float) -> Metric:
    """Return a number that goes up and down."""
    return GaugeMetricFamily(f"jointplay_{name}", says, value=value)


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
            "address": address(Request(scope)),
            "key": scope["state"].get("key"),
            "person": scope["state"].get("person"),
        }
        if "problem" in scope["state"]:
            told["problem"] = scope["state"]["problem"]
            if told["problem"] in DAMAGE:
                self._metrics.count_damage(told["problem"])
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
