"""When keys were used last is stored once a minute, however often that is, and no request waits for it."""

from __future__ import annotations

import asyncio
import logging

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from jointplay.app.storage.keys import Keys

log = logging.getLogger(__name__)
EVERY_S = 60.0


async def store_uses(keys: Keys) -> None:
    """Store them now, if the database takes them."""
    try:
        await run_in_threadpool(keys.write_uses)
    except SQLAlchemyError as error:
        log.warning("last uses of keys wait for the database: %s", type(error).__name__)


async def keep_storing_uses(keys: Keys) -> None:
    """Store them every minute, until this is cancelled."""
    while True:
        await asyncio.sleep(EVERY_S)
        await store_uses(keys)
