"""The application factory of the HTTP service."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

from fastapi import Depends, FastAPI
from starlette.concurrency import run_in_threadpool
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

from jointplay.app.errors import BadFieldError
from jointplay.app.http import handlers, openapi
from jointplay.app.http.deadline import Deadline
from jointplay.app.http.examples import read_document
from jointplay.app.http.gate import Gate, TokenBuckets
from jointplay.app.http.middleware import BodyLimit, RequestLog, SecurityHeaders, State
from jointplay.app.http.proxies import Proxies
from jointplay.app.http.query import refuse_unknown
from jointplay.app.http.stored import Stored
from jointplay.app.jobs.answers import Answers
from jointplay.app.jobs.background import Background
from jointplay.app.jobs.build_runner import BuildRunner
from jointplay.app.jobs.build_watch import BuildWatch
from jointplay.app.jobs.housekeeper import Housekeeper
from jointplay.app.jobs.key_uses import keep_storing_uses, store_uses
from jointplay.app.jobs.scrubber import Scrubber
from jointplay.app.jobs.standing_keeper import StandingKeeper
from jointplay.app.jobs.webhook_sender import WebhookSender
from jointplay.app.jobs.workers import WorkerPool
from jointplay.app.logs import LogSettings
from jointplay.app.metrics import Metrics
from jointplay.app.routes import (
    asset_pages,
    assets,
    audit,
    browser_pages,
    build_pages,
    builds,
    catalogues,
    custody_pages,
    diagnoses,
    entries,
    finding_pages,
    findings,
    forecasts,
    health,
    keys,
    list_pages,
    machine_pages,
    machines,
    measurements,
    pages,
    reports,
    signal_pages,
    signals,
    signin,
    try_pages,
    verifications,
    webhooks,
)
from jointplay.app.scopes import API, parse_people
from jointplay.app.service import Service
from jointplay.app.settings import ServiceSettings
from jointplay.app.shelves.catalogues import CatalogueShelf
from jointplay.app.storage.audit import note_machine
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.keys import Keys
from jointplay.app.storage.machine_store import MachineStore
from jointplay.app.storage.pruning import Pruner
from jointplay.app.storage.retention import Quotas
from jointplay.app.storage.store import Store
from jointplay.app.storage.tombstones import missing
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

    Raises
    ------
    BadFieldError
        When people are to sign in otherwise than settings can say, or at no proxy.
    """
    chosen = settings if settings is not None else ServiceSettings()
    people = parse_people(chosen.people)
    if people and not chosen.trusted_proxies:
        raise BadFieldError(
            "JOINTPLAY_PEOPLE: people sign in at a proxy: JOINTPLAY_PROXIES must name its address", field="people"
        )
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(application: FastAPI) -> AsyncIterator[None]:
        store = Store(chosen.data, chosen.database, Quotas(*chosen.quotas))
        store.database.limit_waits()
        log = LogSettings(chosen.log_format, chosen.log_level)
        pool = WorkerPool(chosen.workers, chosen.queue_limit, chosen.time_limit_s, log, metrics)
        background = Background(chosen.time_limit_s, log)
        answers = Answers(pool, background, store.uploads, chosen.time_limit_s)
        kept_here = (partial(note_machine, store.database), partial(missing, store.database, "machine"))
        put_there = MachineStore(chosen.data / "machines", *kept_here)
        shelf = CatalogueShelf(chosen.catalogues, partial(missing, store.database, "catalogue"))
        queue = BuildQueue(store.database)
        runner = BuildRunner(
            queue, chosen.catalogues, chosen.builds, chosen.build_lease_s, log=log, scheduler=chosen.scheduler
        )
        service = Service(chosen, store, shelf, pool, put_there, queue, runner, metrics, answers)
        metrics.registry.register(State(service))
        metrics.registry.register(Stored(service))
        application.state.service = service
        application.state.keys = kept_keys = Keys(store.database)
        application.state.watch = BuildWatch(queue, service.stopping)
        application.state.failed_sign_ins = TokenBuckets(signin.FAILURES_PER_S, signin.FAILURES)
        runner.start()
        sender = WebhookSender(Webhooks(store.database), chosen.webhooks_private, metrics.count_delivery)
        sender.start()
        keeper = Housekeeper(Pruner(store, chosen.catalogues, chosen.keep_days))
        keeper.start()
        behind: list[asyncio.Task[Any]] = [
            asyncio.create_task(StandingKeeper(store, pool).run()),
            asyncio.create_task(Scrubber(store, metrics).run()),
            asyncio.create_task(keep_storing_uses(kept_keys)),
            asyncio.create_task(store.claims.keep()),
        ]
        if warm:
            behind.append(asyncio.create_task(service.warm()))
            behind.append(asyncio.create_task(asyncio.to_thread(settle, application)))
        try:
            yield
        finally:
            for task in behind:
                task.cancel()
            await asyncio.gather(*behind, return_exceptions=True)
            await store_uses(kept_keys)
            service.stop()
            await run_in_threadpool(runner.close)
            await run_in_threadpool(sender.close)
            await run_in_threadpool(keeper.close)
            pool.close()
            await background.close()
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
                verifications,
                reports,
                assets,
                findings,
                keys,
                webhooks,
                audit,
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
                custody_pages,
                signal_pages,
                list_pages,
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
    application.add_middleware(Gate, settings=chosen, people=people)
    application.add_middleware(Deadline, time_limit=chosen.time_limit_s)
    application.add_middleware(RequestLog, templates=templates, metrics=metrics)
    application.add_middleware(SecurityHeaders)
    application.add_middleware(Proxies, trusted=chosen.trusted_proxies)
    application.openapi = openapi.make_document(application, keyed=chosen.keys == "required")  # type: ignore[method-assign]
    return application


def settle(application: FastAPI) -> None:
    """Make what the first query would wait for, and let no collection of garbage look through what stays for ever.

    Objects of requests are mostly gone without one: it is begun when there are more of them than requests have.
    """
    application.openapi()  # by it queries are judged
    gc.freeze()
    gc.set_threshold(20_000)
