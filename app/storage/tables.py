"""Every table of the service: they are known once their modules are loaded."""

from __future__ import annotations

from sqlalchemy import MetaData

from jointplay.app.storage import assets, build_queue, idempotency, keys, webhooks
from jointplay.app.storage.store import Base

_MODULES = (assets, build_queue, idempotency, keys, webhooks)

TABLES: MetaData = Base.metadata
