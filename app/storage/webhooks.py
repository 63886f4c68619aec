"""Webhooks: who is told of what, and what is still to be told; both in the database.

A delivery is a row that is made in the transaction of the thing it tells of; whichever server looks first takes it up.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import secrets
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Literal
from urllib.parse import urlsplit

from sqlalchemy import JSON, ForeignKey, String, Text, delete, exists, func, or_, select, update
from sqlalchemy.orm import Mapped, Session, mapped_column

from jointplay.app.errors import BadFieldError, UnknownDeliveryError, UnknownWebhookError, WebhookDisabledError
from jointplay.app.schemas.webhooks import Event
from jointplay.app.storage import idempotency
from jointplay.app.storage.audit import note
from jointplay.app.storage.database import ServiceDatabase, is_id
from jointplay.app.storage.rows import Base, newest, now

SIGNATURE = "Jointplay-Signature"
SECRET = "whsec_"
"""Beginning of a secret, by which receivers know that it is one."""

LEASE = timedelta(seconds=120)
"""Longer than one attempt can take: a delivery that was taken by a server that died is free again after it."""

WAITS = tuple(timedelta(seconds=seconds) for seconds in (10, 60, 300, 1800, 7200, 21600, 86400))
"""Between attempts; after the last one the delivery is given up."""

KEPT_ERROR = 200

MOST = 100
"""Webhooks that there may be."""

GIVEN_UP_AFTER = timedelta(days=5)
"""A webhook at which nothing succeeded for this long is told nothing more."""

TEST: Literal["webhook.test"] = "webhook.test"
"""Event of a delivery that was asked for, to try an address: made once, also at one that was given up."""


class WebhookRow(Base):
    """Who is told.

    The secret has to be kept as it is, because it signs; it is shown once.
    """

    __tablename__ = "webhooks"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    url: Mapped[str] = mapped_column(Text)
    events: Mapped[list[str]] = mapped_column(JSON)
    secret: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime]


class DeliveryRow(Base):
    """What one of them is told."""

    __tablename__ = "webhook_deliveries"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    webhook: Mapped[str] = mapped_column(ForeignKey("webhooks.id", ondelete="CASCADE"), index=True)
    event: Mapped[str] = mapped_column(String(64))
    body: Mapped[str] = mapped_column(Text)
    state: Mapped[str] = mapped_column(String(16), index=True)
    attempts: Mapped[int]
    due_at: Mapped[datetime]
    error: Mapped[str] = mapped_column(Text)
    created_at: Mapped[datetime]


class TroubleRow(Base):
    """A webhook at which nothing has succeeded since the last failure; the next success takes this away."""

    __tablename__ = "webhook_troubles"

    webhook: Mapped[str] = mapped_column(ForeignKey("webhooks.id", ondelete="CASCADE"), primary_key=True)
    since: Mapped[datetime]
    error: Mapped[str] = mapped_column(Text)
    disabled_at: Mapped[datetime | None]


@dataclass(frozen=True)
class Taken:
    """A delivery that this server is to make now."""

    id: str
    url: str
    secret: str
    event: str
    body: str
    attempts: int
    webhook: str = ""
    troubled: bool = False

    @property
    def is_last(self) -> bool:
        """Return whether no attempt follows this one."""
        return self.attempts > len(WAITS) or self.event == TEST


@dataclass(frozen=True)
class Backlog:
    """What is still to be told.

    Parameters
    ----------
    waiting : int
        Deliveries.
    age_s : float
        Of the oldest of them.
    disabled : int
        Webhooks that were given up.
    """

    waiting: int
    age_s: float
    disabled: int


class Webhooks:
    """The webhooks of a service.

    Parameters
    ----------
    database : ServiceDatabase
        Of the service's store.
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database

    def add(self, url: str, events: Sequence[str]) -> WebhookRow:
        """Store a webhook with a secret of its own.

        Raises
        ------
        BadFieldError
            When there are too many.
        """
        secret = SECRET + base64.b64encode(secrets.token_bytes(32)).decode()
        row = WebhookRow(id=secrets.token_hex(16), url=url, events=list(events), secret=secret, created_at=now())
        with self._database.writing() as session:
            if (session.scalar(select(func.count()).select_from(WebhookRow)) or 0) >= MOST:
                raise BadFieldError(f"url: there are {MOST} webhooks, which are all there may be", field="url")
            session.add(row)
            note(session, "made", "webhook", row.id, after=about_webhook(row))
        return row

    def webhook(self, key: str) -> WebhookRow:
        """Return a webhook.

        Raises
        ------
        UnknownWebhookError
            When there is none of this id.
        """
        row = self._database.find(WebhookRow, key)
        if row is None:
            raise unknown(key)
        return row

    def page(self, before: int | None, limit: int) -> list[WebhookRow]:
        """Return webhooks, the newest first, from below a row number on."""
        with self._database.reading() as session:
            return list(session.scalars(newest(session, WebhookRow, before, limit)))

    def troubles(self, keys: Collection[str]) -> dict[str, TroubleRow]:
        """Return what troubles webhooks, of those that something does."""
        with self._database.reading() as session:
            found = session.scalars(select(TroubleRow).where(TroubleRow.webhook.in_(keys)))
            return {row.webhook: row for row in found}

    def remove(self, key: str) -> None:
        """Forget a webhook, and what it was still to be told.

        Raises
        ------
        UnknownWebhookError
            When there is none of this id.
        """
        if not is_id(key):
            raise unknown(key)
        with self._database.writing() as session:
            session.execute(delete(DeliveryRow).where(DeliveryRow.webhook == key))
            row = session.scalar(select(WebhookRow).where(WebhookRow.id == key).with_for_update())
            if row is None:
                raise unknown(key)
            session.delete(row)
            note(session, "deleted", "webhook", key, before=about_webhook(row))
            # An answer that is kept has the secret, and says of a webhook that it is there.
            idempotency.forget(session, [place_of(key)])

    def deliveries(self, key: str, before: int | None, limit: int) -> list[DeliveryRow]:
        """Return what a webhook was told and is to be told, the newest first."""
        with self._database.reading() as session:
            return list(session.scalars(newest(session, DeliveryRow, before, limit).where(DeliveryRow.webhook == key)))

    def test(self, key: str) -> DeliveryRow:
        """Note a delivery that tries a webhook.

        Raises
        ------
        UnknownWebhookError
            When there is none of this id.
        """
        hook = self.webhook(key)
        with self._database.writing() as session:
            row = delivery_of(hook, TEST, {"webhook": hook.id})
            session.add(row)
            note(session, "tried", "webhook", hook.id)
        return row

    def redeliver(self, key: str, delivery: str) -> DeliveryRow:
        """Let a delivery be made again, at once and as often as at first.

        Raises
        ------
        UnknownWebhookError, UnknownDeliveryError
            When there is none of these ids.
        WebhookDisabledError
            When the webhook was given up.
        """
        hook = self.webhook(key)
        row = self._database.find(DeliveryRow, delivery)
        if row is None or row.webhook != hook.id:
            raise UnknownDeliveryError(f"delivery {delivery[:80]}: this webhook has none of this id")
        trouble = self.troubles([hook.id]).get(hook.id)
        if trouble is not None and trouble.disabled_at is not None:
            raise WebhookDisabledError(f"webhook {hook.id}: is disabled; a test that succeeds enables it")
        values = {"state": "waiting", "attempts": 0, "error": "", "due_at": now()}
        with self._database.writing() as session:
            note(session, "redelivered", "webhook", hook.id, after={"delivery": row.id})
            mine = update(DeliveryRow).where(DeliveryRow.id == row.id).values(**values).returning(DeliveryRow)
            return session.scalars(mine, execution_options={"populate_existing": True}).one()

    def take(self, moment: datetime, beside: Collection[str] = (), troubled: bool = True) -> Taken | None:
        """Return the delivery that is due for longest, taken for the time of a lease; ``None`` if none is.

        Webhooks at which something succeeded come first.

        Parameters
        ----------
        moment : datetime
        beside : collection of str
            Webhooks that are being told something.
        troubled : bool
            Whether it may be for a webhook at which nothing succeeds.
        """
        with self._database.writing() as session:
            due = (
                select(DeliveryRow, TroubleRow.webhook)
                .outerjoin(TroubleRow, TroubleRow.webhook == DeliveryRow.webhook)
                .where(DeliveryRow.state == "waiting", DeliveryRow.due_at <= moment)
                .where(DeliveryRow.webhook.not_in(beside))
                .where(or_(TroubleRow.disabled_at.is_(None), DeliveryRow.event == TEST))
                .order_by(TroubleRow.webhook.is_not(None), DeliveryRow.due_at)
                .limit(1)
                .with_for_update(skip_locked=True, of=DeliveryRow)
            )
            if not troubled:
                due = due.where(TroubleRow.webhook.is_(None))
            found = session.execute(due).one_or_none()
            if found is None:
                return None
            row, trouble = found
            hook = session.scalars(select(WebhookRow).where(WebhookRow.id == row.webhook)).one()
            row.attempts += 1
            # Due again if whoever has it now dies: nothing is forgotten, at worst told twice.
            row.due_at = moment + LEASE
            said = (row.id, hook.url, hook.secret, row.event, row.body, row.attempts)
            return Taken(*said, webhook=hook.id, troubled=trouble is not None)

    def settle(self, taken: Taken, moment: datetime, error: str = "") -> bool:
        """Note how an attempt went: done, to be made again later, or given up after the last one.

        Returns whether the webhook was given up with it.
        """
        values: dict[str, Any] = {"error": error[:KEPT_ERROR]}
        if not error:
            values["state"] = "delivered"
        elif taken.is_last:
            values["state"] = "failed"
        else:
            values["due_at"] = moment + WAITS[taken.attempts - 1]
        # Somebody who took it up later, because this took longer than the lease, has the last word.
        mine = (DeliveryRow.id == taken.id, DeliveryRow.attempts == taken.attempts)
        with self._database.writing() as session:
            noted = update(DeliveryRow).where(*mine).values(**values).returning(DeliveryRow.webhook)
            key = session.scalar(noted)
            if key is None:  # or it was forgotten meanwhile
                return False
            if not error:
                over = delete(TroubleRow).where(TroubleRow.webhook == key).returning(TroubleRow.disabled_at)
                if session.scalar(over) is not None:
                    note(session, "enabled", "webhook", key)
                return False
            return self._blame(session, key, moment, values["error"])

    def _blame(self, session: Session, key: str, moment: datetime, error: str) -> bool:
        """Note that a webhook has failed; give it up when it did for long enough, and say so to all others."""
        row = {"webhook": key, "since": moment, "error": error, "disabled_at": None}
        session.execute(self._database.insert(TroubleRow).values(row).on_conflict_do_nothing())
        trouble = session.scalars(select(TroubleRow).where(TroubleRow.webhook == key).with_for_update()).one()
        trouble.error = error
        if trouble.disabled_at is not None or moment - trouble.since < GIVEN_UP_AFTER:
            return False
        trouble.disabled_at = moment
        note(session, "disabled", "webhook", key)
        session.flush()
        waiting = (DeliveryRow.webhook == key, DeliveryRow.state == "waiting")
        given_up = {"state": "failed", "error": "the webhook was given up"}
        session.execute(update(DeliveryRow).where(*waiting).values(**given_up))
        members = {"webhook": key, "failing_since": spell(trouble.since), "error": error}
        announce(session, "webhook.disabled", members)
        return True

    def backlog(self, moment: datetime) -> Backlog:
        """Return what is still to be told."""
        waiting = select(func.count(), func.min(DeliveryRow.created_at)).where(DeliveryRow.state == "waiting")
        disabled = select(func.count()).select_from(TroubleRow).where(TroubleRow.disabled_at.is_not(None))
        with self._database.reading() as session:
            count, oldest = session.execute(waiting).one()
            age = 0.0 if oldest is None else max(0.0, (moment - oldest).total_seconds())
            return Backlog(count, age, session.scalar(disabled) or 0)


_TOLD = (
    select(WebhookRow)
    .where(~exists().where(TroubleRow.webhook == WebhookRow.id, TroubleRow.disabled_at.is_not(None)))
    .with_for_update(read=True, key_share=True, of=WebhookRow)
)


def announce(session: Session, event: Event, members: Mapping[str, Any]) -> None:
    """Note in a transaction that everybody who asked for an event is to be told of it.

    Parameters
    ----------
    session : Session
    event : str
    members : Mapping
        What is told, as JSON values.
    """
    # Nobody may forget one of them before this transaction is over: its deliveries would belong to nothing.
    for hook in session.scalars(_TOLD):
        if event in hook.events:
            session.add(delivery_of(hook, event, members))


def delivery_of(hook: WebhookRow, event: str, members: Mapping[str, Any]) -> DeliveryRow:
    """Return a delivery that is to be made at once."""
    key, moment = secrets.token_hex(16), now()
    body = {"id": key, "event": event, "created_at": spell(moment), "data": dict(members)}
    return DeliveryRow(
        id=key,
        webhook=hook.id,
        event=event,
        body=json.dumps(body),
        state="waiting",
        attempts=0,
        due_at=moment,
        error="",
        created_at=moment,
    )


def spell(moment: datetime) -> str:
    """Return a moment of UTC in ISO 8601."""
    return moment.isoformat().replace("+00:00", "Z")


def about_webhook(row: WebhookRow) -> dict[str, Any]:
    """Return what the audit log says of a webhook; the path of its address may be a secret, too."""
    return {"host": urlsplit(row.url).netloc.rpartition("@")[2], "events": row.events}


def standard_signature(secret: str, key: str, timestamp: int, body: bytes) -> str:
    """Return the value of the header ``webhook-signature`` of Standard Webhooks.

    Parameters
    ----------
    secret : str
        As it was shown when the webhook was made: base64, with ``whsec_`` before it or, of older ones, without.
    key : str
        Id of the delivery.
    timestamp : int
        Seconds since 1970, UTC.
    body : bytes
    """
    signed = f"{key}.{timestamp}.".encode() + body
    found = hmac.new(base64.b64decode(secret.removeprefix(SECRET)), signed, hashlib.sha256).digest()
    return f"v1,{base64.b64encode(found).decode()}"


def signature(secret: str, timestamp: int, body: bytes) -> str:
    """Return the value of this program's own header that proves who sent a body, and when.

    Parameters
    ----------
    secret : str
        As it was shown when the webhook was made; its characters are the key.
    timestamp : int
        Seconds since 1970, UTC.
    body : bytes
    """
    signed = f"{timestamp}.".encode() + body
    return f"t={timestamp},v1={hmac.new(secret.encode(), signed, hashlib.sha256).hexdigest()}"


def place_of(key: str) -> str:
    """Return where a webhook can be asked for."""
    return f"/api/v1/webhooks/{key}"


def unknown(key: str) -> UnknownWebhookError:
    """Return the error for an id that no webhook has."""
    return UnknownWebhookError(f"webhook {key[:80]}: there is none of this id")
