"""``Idempotency-Key``: a request that creates something may be sent again, and is done once.

A route that creates says what was asked (its content, in any form that JSON can hold) and how it is done; the rest
is here. Kept is the answer of what succeeded; after a failure the key is free again, so that the request may be tried
anew.

A key is claimed while the request is done. Its server says again and again that it lives; one that died says nothing,
and the next request with the key takes it over. Whoever was only slow finds that out before anything is committed.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import secrets
from collections.abc import Awaitable, Callable, Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Annotated, Any

from fastapi import Header
from sqlalchemy import Double, LargeBinary, String, delete, event, select, update
from sqlalchemy.exc import SQLAlchemyError
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
LEASE_S = 12.0
"""After so long without a sign of life, the server that had claimed a key is taken for dead."""

BEAT_S = LEASE_S / 4
"""Time between two signs of life."""

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
    owner: Mapped[str | None] = mapped_column(String(32))
    lease_until: Mapped[float | None] = mapped_column(Double)


@dataclass(frozen=True)
class Claim:
    """A key while its request is done.

    Parameters
    ----------
    place : str
        Id of its row.
    owner : str
        Of this request alone: whoever takes the key over is another.
    """

    place: str
    owner: str


_CLAIM: ContextVar[Claim | None] = ContextVar("claim", default=None)


class Claims:
    """The keys that a server has claimed.

    Parameters
    ----------
    database : ServiceDatabase
        From now on its transactions are refused that belong to a claim which is gone.
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database
        self._held: set[Claim] = set()
        event.listen(database.session, "before_commit", self._confirm)

    def take(self, place: str, fingerprint: str) -> Claim | Response:
        """Claim a key, or return the answer that was given with it.

        Raises
        ------
        KeyReusedError, KeyInUseError
            As :func:`once`.
        """
        claim, moment, row = Claim(place, secrets.token_hex(16)), now(), IdempotencyRow
        empty: dict[str, Any] = {"status": None, "headers": {}, "body": b"", **self._signed(claim.owner)}
        values = {"id": place, "fingerprint": fingerprint, "created_at": moment, **empty}
        with self._database.writing() as session:
            lost = (row.id == place) & row.status.is_(None) & (row.lease_until < self._database.epoch())
            session.execute(delete(row).where(lost | (row.created_at < moment - KEPT)))
            statement = self._database.insert(row).values(values).on_conflict_do_nothing(index_elements=["id"])
            if session.execute(statement.returning(row.id)).first() is not None:
                self._held.add(claim)
                return claim
            found = session.scalar(select(row).where(row.id == place))
        if found is None:
            raise KeyInUseError("Idempotency-Key: the first request with it has just failed; send it again")
        if found.fingerprint != fingerprint:
            raise KeyReusedError("Idempotency-Key: was used for another request; take a new one", field=HEADER)
        if found.status is None:
            raise KeyInUseError("Idempotency-Key: the first request with it is not answered yet")
        answer = Response(found.body, found.status)
        answer.raw_headers = [(name.encode(), value.encode()) for name, value in found.headers.items()]
        return answer

    def settle(self, claim: Claim, answer: Response | None) -> None:
        """Keep the answer of a key; without one, or with one that says something failed, the key is free again.

        Nothing is done to a key that another request has taken over.
        """
        self._held.discard(claim)
        chosen = (IdempotencyRow.id == claim.place) & (IdempotencyRow.owner == claim.owner)
        with self._database.writing() as session:
            if answer is None or answer.status_code >= 400:
                session.execute(delete(IdempotencyRow).where(chosen))
            else:
                headers = {name.decode(): value.decode() for name, value in answer.raw_headers}
                kept = {"status": answer.status_code, "headers": headers, "body": bytes(answer.body)}
                session.execute(update(IdempotencyRow).where(chosen).values(kept))

    def free(self, claim: Claim) -> None:
        """Free the key of a request that failed; where even that fails, the key is free after its lease."""
        try:
            self.settle(claim, None)
        except Exception:  # whatever it is, what is told is why the request failed
            log.exception("an Idempotency-Key stays in use until its lease is over")

    def beat(self) -> None:
        """Give a sign of life for all that is being done."""
        held = list(self._held)
        if held:
            places, owners = [claim.place for claim in held], [claim.owner for claim in held]
            mine = IdempotencyRow.id.in_(places) & IdempotencyRow.owner.in_(owners)
            with self._database.writing() as session:
                session.execute(update(IdempotencyRow).where(mine).values(self._signed()))

    async def keep(self) -> None:
        """Give signs of life until this is cancelled."""
        while True:
            await asyncio.sleep(BEAT_S)
            try:
                await asyncio.to_thread(self.beat)  # those of requests may all wait for something else
            except SQLAlchemyError as error:
                log.warning("claims of keys wait for the database: %s", type(error).__name__)

    def _confirm(self, session: Session) -> None:
        """Refuse to commit what another request with the same key is doing by now."""
        claim = _CLAIM.get()
        # What reads from a connection goes on in the context of the request that began it: one that was answered.
        if claim in self._held:
            mine = (IdempotencyRow.id == claim.place) & (IdempotencyRow.owner == claim.owner)
            # With the commit the lease begins anew, so that nobody takes the key over before the answer is kept.
            renewed = update(IdempotencyRow).where(mine).values(self._signed()).returning(IdempotencyRow.id)
            if session.execute(renewed).first() is None:
                raise KeyInUseError("Idempotency-Key: this took so long that another request with it was let in")

    def _signed(self, owner: str | None = None) -> dict[str, Any]:
        lease = {"lease_until": self._database.epoch() + LEASE_S}
        return lease if owner is None else {"owner": owner, **lease}


@contextmanager
def doing(claim: Claim) -> Iterator[None]:
    """Let what is committed in a block be done for a claim."""
    token = _CLAIM.set(claim)
    try:
        yield
    finally:
        _CLAIM.reset(token)


async def once(
    request: Request, key: str | None, claims: Claims, content: object, act: Callable[[], Awaitable[Response]]
) -> Response:
    """Do what a request asks, unless it was done before with the same key; then give that answer again.

    Parameters
    ----------
    request : Request
        Keys of different clients, methods and paths are different keys.
    key : str, optional
        As the route got it, declared as :data:`IdempotencyKey`; without one the request is simply done.
    claims : Claims
    content : object
        All that was asked, as JSON values: two requests with the same content are the same.
    act : callable
        Does it, and returns the whole answer.

    Raises
    ------
    KeyReusedError
        When it was used for another content.
    KeyInUseError
        When the first request with it is not answered yet, or this one took so long that another has taken it over.
    """
    if key is None:
        return await act()
    client = getattr(request.state, "key", None) or getattr(request.state, "person", None)
    place = digest([client, request.method, request.scope["path"], key])
    claim = await run_in_threadpool(claims.take, place, digest(content))
    if isinstance(claim, Response):
        return claim
    try:
        with doing(claim):
            answer = await act()
    except asyncio.CancelledError:
        # Not in a thread: a cancelled task waits for nothing any more.
        claims.free(claim)
        raise
    except Exception:
        await run_in_threadpool(claims.free, claim)
        raise
    await run_in_threadpool(claims.settle, claim, answer)
    return answer


def digest(content: object) -> str:
    """Return the SHA-256 of JSON values."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def forget(session: Session, places: Collection[str]) -> None:
    """Free the keys, in a transaction, whose answer names what is there no longer.

    Parameters
    ----------
    session : Session
    places : collection of str
        The ``Location`` of each answer.
    """
    session.execute(delete(IdempotencyRow).where(IdempotencyRow.headers["location"].as_string().in_(places)))
