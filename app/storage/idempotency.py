"""``Idempotency-Key``: a request that creates something may be sent again, and is done once.

A route that creates says what was asked (its content, in any form that JSON can hold) and how it is done; the rest
is here. Kept is the answer of what succeeded; after a failure the key is free again, so that the request may be tried
anew.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
from collections.abc import Awaitable, Callable, Collection
from datetime import datetime, timedelta
from typing import Annotated, Any

from fastapi import Header
from sqlalchemy import LargeBinary, String, delete, select, update
from sqlalchemy.orm import Mapped, Session, mapped_column
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from jointplay.app.errors import KeyInUseError, KeyReusedError
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Base, now

log = logging.getLogger(__name__)

HEADER = "idempotency-key"
LONGEST = 255
KEPT = timedelta(hours=24)
LEASE = timedelta(minutes=5)
"""After so long without an answer, the server that had taken a key is taken for dead."""

IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        examples=["7f3c1c1e-2f5b-4d0e-9a43-0c6a5d1f8e22"],
        min_length=1,
        max_length=LONGEST,
        pattern="^[!-~]+$",
        description="A text of the client's own, new for every new request: sent again with it, within 24 hours, the"
        " same request gives the same answer and creates nothing anew.",
    ),
]
"""Parameter of a route, for its documentation and its check."""


class IdempotencyRow(Base):
    """One key: what was asked with it, and what was answered; no status while it is being done."""

    __tablename__ = "idempotency"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    fingerprint: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(index=True)
    status: Mapped[int | None]
    headers: Mapped[dict[str, Any]]
    body: Mapped[bytes] = mapped_column(LargeBinary)


async def once(
    request: Request,
    key: str | None,
    database: ServiceDatabase,
    content: object,
    act: Callable[[], Awaitable[Response]],
) -> Response:
    """Do what a request asks, unless it was done before with the same key; then give that answer again.

    Parameters
    ----------
    request : Request
        Keys of different clients, methods and paths are different keys.
    key : str, optional
        As the route got it, declared as :data:`IdempotencyKey`; without one the request is simply done.
    database : ServiceDatabase
    content : object
        All that was asked, as JSON values: two requests with the same content are the same.
    act : callable
        Does it, and returns the whole answer.

    Raises
    ------
    KeyReusedError
        When it was used for another content.
    KeyInUseError
        When the first request with it is not answered yet.
    """
    if key is None:
        return await act()
    client = getattr(request.state, "key", None) or getattr(request.state, "person", None)
    place = digest([client, request.method, request.scope["path"], key])
    moment = now()
    earlier = await run_in_threadpool(reserve, database, place, digest(content), moment)
    if earlier is not None:
        return earlier
    try:
        answer = await act()
    except asyncio.CancelledError:
        # Not in a thread: a cancelled task waits for nothing any more.
        free(database, place, moment)
        raise
    except Exception:
        await run_in_threadpool(free, database, place, moment)
        raise
    await run_in_threadpool(settle, database, place, moment, answer)
    return answer


def digest(content: object) -> str:
    """Return the SHA-256 of JSON values."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def reserve(database: ServiceDatabase, place: str, fingerprint: str, moment: datetime) -> Response | None:
    """Take a key at a moment, or return the answer that was given with it.

    Raises
    ------
    KeyReusedError, KeyInUseError
        As :func:`once`.
    """
    empty: dict[str, Any] = {"status": None, "headers": {}, "body": b""}
    row = {"id": place, "fingerprint": fingerprint, "created_at": moment, **empty}
    with database.writing() as session:
        session.execute(delete(IdempotencyRow).where(IdempotencyRow.created_at < moment - KEPT))
        lost = (IdempotencyRow.status.is_(None)) & (IdempotencyRow.created_at < moment - LEASE)
        session.execute(delete(IdempotencyRow).where(lost))
        statement = database.insert(IdempotencyRow).values(row).on_conflict_do_nothing(index_elements=["id"])
        if session.execute(statement.returning(IdempotencyRow.id)).first() is not None:
            return None
        found = session.scalar(select(IdempotencyRow).where(IdempotencyRow.id == place))
    if found is None:
        raise KeyInUseError("Idempotency-Key: the first request with it has just failed; send it again")
    if found.fingerprint != fingerprint:
        raise KeyReusedError("Idempotency-Key: was used for another request; take a new one", field=HEADER)
    if found.status is None:
        raise KeyInUseError("Idempotency-Key: the first request with it is not answered yet")
    answer = Response(found.body, found.status)
    answer.raw_headers = [(name.encode(), value.encode()) for name, value in found.headers.items()]
    return answer


def forget(session: Session, places: Collection[str]) -> None:
    """Free the keys, in a transaction, whose answer names what is there no longer.

    Parameters
    ----------
    session : Session
    places : collection of str
        The ``Location`` of each answer.
    """
    session.execute(delete(IdempotencyRow).where(IdempotencyRow.headers["location"].as_string().in_(places)))


def free(database: ServiceDatabase, place: str, moment: datetime) -> None:
    """Free the key of a request that failed; where even that fails, the key is free after its lease."""
    try:
        settle(database, place, moment, None)
    except Exception:  # whatever it is, what is told is why the request failed
        log.exception("an Idempotency-Key stays in use until its lease is over")


def settle(database: ServiceDatabase, place: str, moment: datetime, answer: Response | None) -> None:
    """Keep the answer of a key; without one, or with one that says something failed, the key is free again.

    A key that was taken at a later moment is another request's: this one took longer than its lease.
    """
    chosen = (IdempotencyRow.id == place) & (IdempotencyRow.created_at == moment)
    with database.writing() as session:
        if answer is None or answer.status_code >= 400:
            session.execute(delete(IdempotencyRow).where(chosen))
        else:
            headers = {name.decode(): value.decode() for name, value in answer.raw_headers}
            kept = {"status": answer.status_code, "headers": headers, "body": bytes(answer.body)}
            session.execute(update(IdempotencyRow).where(chosen).values(kept))
