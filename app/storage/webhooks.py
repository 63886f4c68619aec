"""Webhooks: who is told of what, and what is still to be told; both in the database.

A delivery is a row that is made in the transaction of the thing it tells of; whichever server looks first takes it up.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import JSON, ForeignKey, String, Text, delete, select, update
from sqlalchemy.orm import Mapped, Session, mapped_column

from jointplay.app.errors import UnknownWebhookError
from jointplay.app.schemas.webhooks import Event
from jointplay.app.storage import idempotency
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


@dataclass(frozen=True)
class Taken:
    """A delivery that this server is to make now."""

    id: str
    url: str
    secret: str
    event: str
    body: str
    attempts: int

    @property
    def is_last(self) -> bool:
        """Return whether no attempt follows this one."""
        return self.attempts > len(WAITS)


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
        """Store a webhook with a secret of its own."""
        secret = SECRET + base64.b64encode(secrets.token_bytes(32)).decode()
        row = WebhookRow(id=secrets.token_hex(16), url=url, events=list(events), secret=secret, created_at=now())
        with self._database.writing() as session:
            session.add(row)
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
            if session.execute(delete(WebhookRow).where(WebhookRow.id == key).returning(WebhookRow.id)).first() is None:
                raise unknown(key)
            # An answer that is kept has the secret, and says of a webhook that it is there.
            idempotency.forget(session, place_of(key))

    def deliveries(self, key: str, before: int | None, limit: int) -> list[DeliveryRow]:
        """Return what a webhook was told and is to be told, the newest first."""
        with self._database.reading() as session:
            return list(session.scalars(newest(session, DeliveryRow, before, limit).where(DeliveryRow.webhook == key)))

    def take(self, moment: datetime) -> Taken | None:
        """Return the delivery that is due for longest, taken for the time of a lease; ``None`` if none is."""
        with self._database.writing() as session:
            due = (
                select(DeliveryRow)
                .where(DeliveryRow.state == "waiting", DeliveryRow.due_at <= moment)
                .order_by(DeliveryRow.due_at)
                .limit(1)
                .with_for_update(skip_locked=True)
            )
            row = session.scalar(due)
            if row is None:
                return None
            hook = session.scalars(select(WebhookRow).where(WebhookRow.id == row.webhook)).one()
            row.attempts += 1
            # Due again if whoever has it now dies: nothing is forgotten, at worst told twice.
            row.due_at = moment + LEASE
            return Taken(row.id, hook.url, hook.secret, row.event, row.body, row.attempts)

    def settle(self, taken: Taken, moment: datetime, error: str = "") -> None:
        """Note how an attempt went: done, to be made again later, or given up after the last one."""
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
            session.execute(update(DeliveryRow).where(*mine).values(**values))


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
    held = select(WebhookRow).with_for_update(read=True, key_share=True)
    hooks = [hook for hook in session.scalars(held) if event in hook.events]
    for hook in hooks:
        key = secrets.token_hex(16)
        moment = now()
        body = {
            "id": key,
            "event": event,
            "created_at": moment.isoformat().replace("+00:00", "Z"),
            "data": dict(members),
        }
        session.add(
            DeliveryRow(
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
        )


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
