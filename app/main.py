"""The application factory of the HTTP service."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from fastapi import Depends, FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

from jointplay.app.http import handlers, openapi
from jointplay.app.http.examples import read_document
from jointplay.app.http.gate import Gate, TokenBuckets
from jointplay.app.http.middleware import BodyLimit, RequestLog, SecurityHeaders, State
from jointplay.app.http.query import refuse_unknown
from jointplay.app.jobs.build_runner import BuildRunner
from jointplay.app.jobs.build_watch import BuildWatch
from jointplay.app.jobs.standing_keeper import StandingKeeper
from jointplay.app.jobs.webhook_sender import WebhookSender
from jointplay.app.jobs.workers import WorkerPool
from jointplay.app.logs import LogSettings
from jointplay.app.metrics import Metrics
from jointplay.app.routes import (
    asset_pages,
    assets,
    browser_pages,
    build_pages,
    builds,
    catalogues,
    diagnoses,
    entries,
    finding_pages,
    findings,
    forecasts,
    health,
    machine_pages,
    machines,
    measurements,
    pages,
    reports,
    signal_pages,
    signals,
    signin,
    try_pages,
    webhooks,
)
from jointplay.app.scopes import API
from jointplay.app.service import Service
from jointplay.app.settings import ServiceSettings
from jointplay.app.shelves.catalogues import CatalogueShelf
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.machine_store import MachineStore
from jointplay.app.storage.store import Store
from jointplay.app.storage.webhooks import Webhooks

STATIC = Path(__file__).parent / "static"


def create_app(settings: ServiceSettings | None = None, *, warm: bool = False) -> FastAPI:
    """Return the service as an ASGI application.

    Parameters
    ----------
    settings : Settings, optional
        Read from the environment when not given.
    warm : bool
        Whether workers start at once and load what they need, in the background, in place of with the first request.
    """
    chosen = settings if settings is not None else ServiceSettings()
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(application: FastAPI) -> AsyncIterator[None]:
        store = Store(chosen.data, chosen.database)
        log = LogSettings(chosen.log_format, chosen.log_level)
        pool = WorkerPool(chosen.workers, chosen.queue_limit, chosen.time_limit_s, log, metrics)
        put_there = MachineStore(chosen.data / "machines")
        queue = BuildQueue(store.database)
        runner = BuildRunner(
            queue, chosen.catalogues, chosen.builds, chosen.build_lease_s, log=log, scheduler=chosen.scheduler
        )
        service = Service(chosen, store, CatalogueShelf(chosen.catalogues), pool, put_there, queue, runner, metrics)
        metrics.registry.register(State(service))
        application.state.service = service
        application.state.keys = Keys(store.database)
        application.state.watch = BuildWatch(queue, service.stopping)
        application.state.failed_sign_ins = TokenBuckets(signin.FAILURES_PER_S, signin.FAILURES)
        runner.start()
        sender = WebhookSender(Webhooks(store.database), chosen.webhooks_private, metrics.count_delivery)
        sender.start()
        behind = [asyncio.create_task(StandingKeeper(store, pool).run())]
        if warm:
            behind.append(asyncio.create_task(service.warm()))
        try:
            yield
        finally:
            for task in behind:
                task.cancel()
            await asyncio.gather(*behind, return_exceptions=True)
            service.stop()
            await run_in_threadpool(runner.close)
            await run_in_threadpool(sender.close)
            pool.close()
            store.close()

    # The framework's own documentation pages load scripts from elsewhere; the document itself is at /openapi.json.
    application = FastAPI(
        title="jointplay",
        summary="Which joints of a machine have play, and how much, from the vibration of its frame.",
        version=read_document()["info"]["version"],
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,  # a redirect would name http, also where a proxy speaks TLS
        lifespan=lifespan,
    )
    templates = ["/openapi.json"]
    for modules, prefix, shown in (
        (
            (
                machines,
                catalogues,
                entries,
                builds,
                forecasts,
                measurements,
                signals,
                diagnoses,
                reports,
                assets,
                findings,
                webhooks,
            ),
            API,
            True,
        ),
        ((health,), "", True),
        (
            (
                pages,
                machine_pages,
                browser_pages,
                build_pages,
                asset_pages,
                finding_pages,
                signal_pages,
                try_pages,
                signin,
            ),
            "",
            False,
        ),
    ):
        for module in modules:
            application.include_router(
                module.router,
                prefix=prefix,
                include_in_schema=shown,
                dependencies=[Depends(refuse_unknown)] if prefix else None,
            )
            templates += [prefix + route.path for route in module.router.routes if isinstance(route, Route)]
    application.mount("/static", StaticFiles(directory=STATIC), name="static")
    templates.append("/static/{path:path}")
    handlers.install(application)
    application.add_middleware(
        BodyLimit, upload_bytes=chosen.max_upload_bytes, receive_timeout=chosen.receive_timeout_s
    )
    application.add_middleware(Gate, settings=chosen)
    application.add_middleware(RequestLog, templates=templates, metrics=metrics)
    application.add_middleware(SecurityHeaders)
    application.openapi = openapi.make_document(application, keyed=chosen.keys == "required")  # type: ignore[method-assign]
    return application
