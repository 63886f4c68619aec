"""API keys and the sessions of browsers: made, looked up, renewed, taken back; of secrets only hashes are kept."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Literal

from cachetools import TTLCache
from sqlalchemy import String, delete, func, select, update
from sqlalchemy.orm import Mapped, Session, mapped_column

from jointplay.app.errors import KeyRevokedError, UnauthorizedError, UnknownKeyError
from jointplay.app.scopes import Scope
from jointplay.app.storage.audit import note
from jointplay.app.storage.database import ServiceDatabase, is_id
from jointplay.app.storage.rows import Base, now

PREFIX = "jp"
ID_BYTES = 6
SECRET_BYTES = 32
SESSION = timedelta(hours=12)
ADDRESSES, QUIET_S = 10_000, 60.0


class ApiKeyRow(Base):
    """A key: who may do what until when."""

    __tablename__ = "api_keys"

    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    name: Mapped[str] = mapped_column(String(80))
    sha256: Mapped[str] = mapped_column(String(64))
    scopes: Mapped[str] = mapped_column(String(80))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime]
    revoked_at: Mapped[datetime | None]


class FormerSecretRow(Base):
    """A secret that a key had before; it holds a while longer, until all who use it have the new one."""

    __tablename__ = "api_former_secrets"

    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    key: Mapped[str] = mapped_column(String(16), index=True)
    expires_at: Mapped[datetime]


class KeyUseRow(Base):
    """When a key was used last, to the minute."""

    __tablename__ = "api_key_uses"

    key: Mapped[str] = mapped_column(String(16), primary_key=True)
    used_at: Mapped[datetime]


class SessionRow(Base):
    """A browser that has signed in with a key; it may do what the key may, as long as the key may."""

    __tablename__ = "api_sessions"

    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    key: Mapped[str] = mapped_column(String(16))
    expires_at: Mapped[datetime]


@dataclass(frozen=True)
class Key:
    """What is known of a key; never its secret.

    Parameters
    ----------
    id : str
        Its public part, which logs and lists show.
    name : str
        What whoever made it calls it.
    scopes : frozenset of Scope
        What it may be used for.
    created_at, expires_at : datetime
        UTC.
    revoked_at : datetime or None
        When it was taken back.
    used_at : datetime or None
        When it was used last, to the minute, where that was asked for.
    """

    id: str
    name: str
    scopes: frozenset[Scope]
    created_at: datetime
    expires_at: datetime
    revoked_at: datetime | None
    used_at: datetime | None = None

    @property
    def state(self) -> Literal["valid", "expired", "revoked"]:
        """Return ``valid``, ``expired`` or ``revoked``."""
        if self.revoked_at is not None:
            return "revoked"
        return "valid" if now() < self.expires_at else "expired"


class Keys:
    """The keys in a database.

    Parameters
    ----------
    database : ServiceDatabase
        The service's.
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database
        self._refused: TTLCache[str, bool] = TTLCache(ADDRESSES, QUIET_S)
        self._used: dict[str, datetime] = {}
        self._lock = threading.Lock()  # of both: requests are answered in several threads

    def create(self, name: str, scopes: frozenset[Scope], lifetime: timedelta) -> tuple[Key, str]:
        """Make a key; return it and the token that is shown once and kept nowhere.

        Parameters
        ----------
        name : str
            At most 80 characters.
        scopes : frozenset of Scope
        lifetime : timedelta
            From now on.
        """
        identity, secret = secrets.token_hex(ID_BYTES), secrets.token_urlsafe(SECRET_BYTES)
        made = now()
        row = ApiKeyRow(
            id=identity,
            name=name[:80],
            sha256=digest(secret),
            scopes=" ".join(sorted(scopes)),
            created_at=made,
            expires_at=made + lifetime,
            revoked_at=None,
        )
        with self._database.writing() as session:
            session.add(row)
            note(session, "made", "key", identity, after=about_key(row))
        return key_of(row), f"{PREFIX}_{identity}_{secret}"

    def all(self) -> list[Key]:
        """Return all keys, the oldest first, those included that no longer hold."""
        with self._database.reading() as session:
            return self._with_use(session, session.scalars(select(ApiKeyRow).order_by(ApiKeyRow.created_at)).all())

    def expiring(self, within: timedelta) -> int:
        """Return how many keys hold now and will not for much longer."""
        soon = ApiKeyRow.revoked_at.is_(None), ApiKeyRow.expires_at.between(now(), now() + within)
        with self._database.reading() as session:
            return session.scalar(select(func.count()).select_from(ApiKeyRow).where(*soon)) or 0

    def key(self, identity: str) -> Key:
        """Return a key, also one that no longer holds.

        Raises
        ------
        UnknownKeyError
            When there is none of this id.
        """
        with self._database.reading() as session:
            return self._with_use(session, [_known(session, identity)])[0]

    def rotate(self, identity: str, grace: timedelta, lifetime: timedelta) -> tuple[Key, str, datetime]:
        """Give a key a new secret; return it, its new token and until when the secrets before it hold.

        Parameters
        ----------
        identity : str
        grace : timedelta
            From now on; no secret holds for longer than it would have, nor does a session.
        lifetime : timedelta
            Of the new secret, from now on.

        Raises
        ------
        UnknownKeyError
            When there is none of this id.
        KeyRevokedError
            When it was taken back.
        """
        secret, moment = secrets.token_urlsafe(SECRET_BYTES), now()
        with self._database.writing() as session:
            row = _known(session, identity, locked=True)  # of two at once, the second comes after the first
            if row.revoked_at is not None:
                raise KeyRevokedError(f"the key {row.id} was revoked; make another")
            before = about_key(row)
            until = min(moment + grace, row.expires_at)
            for table in (FormerSecretRow, SessionRow):
                late = (table.key == row.id) & (table.expires_at > until)
                session.execute(update(table).where(late).values(expires_at=until))
                session.execute(delete(table).where(table.expires_at <= moment))
            if until > moment:
                session.add(FormerSecretRow(sha256=row.sha256, key=row.id, expires_at=until))
            row.sha256, row.expires_at = digest(secret), moment + lifetime
            note(session, "rotated", "key", row.id, before, about_key(row))
            return self._with_use(session, [row])[0], f"{PREFIX}_{row.id}_{secret}", until

    def revoke(self, identity: str) -> Key:
        """Take a key back, and end the sessions that were opened with it; it holds for no later request.

        Raises
        ------
        UnknownKeyError
            When there is none of this id.
        """
        with self._database.writing() as session:
            row = _known(session, identity)
            before = about_key(row)
            row.revoked_at = row.revoked_at or now()
            if before["revoked_at"] is None:
                note(session, "revoked", "key", row.id, before, about_key(row))
            for table in (SessionRow, FormerSecretRow):
                session.execute(delete(table).where(table.key == row.id))
            return self._with_use(session, [row])[0]

    def find(self, token: str) -> Key:
        """Return the key that a token is of; found by a former secret, it holds as long as that.

        Raises
        ------
        UnauthorizedError
            When it is of none, or of one that has expired or was revoked. What the token was is not repeated.
        """
        prefix, _, rest = token.partition("_")
        identity, _, secret = rest.partition("_")
        if prefix != PREFIX or not secret:
            raise UnauthorizedError("the key is not of the form that this service hands out")
        row, sent = None, digest(secret)
        if is_id(identity):  # PostgreSQL refuses texts with some other characters
            with self._database.reading() as session:
                row = session.get(ApiKeyRow, identity)
                # The comparison takes as long for a wrong secret as for a right one.
                if row is not None and not hmac.compare_digest(row.sha256, sent):
                    former = session.get(FormerSecretRow, sent)
                    if former is not None and former.key == row.id and now() < former.expires_at:
                        return replace(self._in_use(row), expires_at=former.expires_at)
                    row = None
        if row is None:
            raise UnauthorizedError("the key is not known here")
        return self._in_use(row)

    def open_session(self, key: Key) -> str:
        """Return the token of a new session of a key; sessions that are over are forgotten.

        Raises
        ------
        UnauthorizedError
            When the key does not hold, or has a new secret since it was found.
        """
        token, formers = secrets.token_urlsafe(SECRET_BYTES), select(FormerSecretRow.expires_at)
        with self._database.writing() as session:
            row = _known(session, key.id, locked=True)  # as long as it is looked at, nobody gives it another secret
            valid(key_of(row))
            # Each secret has an end of its own, which the key bears that was found by it.
            ends = {row.expires_at, *session.scalars(formers.where(FormerSecretRow.key == key.id))}
            if key.expires_at not in ends:
                raise UnauthorizedError(f"the key {key.id} has just got another secret; sign in again")
            session.execute(delete(SessionRow).where(SessionRow.expires_at < now()))
            session.add(SessionRow(sha256=digest(token), key=key.id, expires_at=min(now() + SESSION, key.expires_at)))
            note(session, "signed in", "key", key.id)
        return token

    def note_refusal(self, address: str) -> None:
        """Note that somebody tried to sign in with what is no key.

        Of an address once a minute: nobody without a key is to fill a disk.
        """
        with self._lock:
            if address in self._refused:
                return
            self._refused[address] = True
        with self._database.writing() as session:
            note(session, "refused to sign in", "address", address)

    def of_session(self, token: str) -> Key:
        """Return the key that a session was opened with.

        Raises
        ------
        UnauthorizedError
            When the session is over, or its key no longer holds.
        """
        with self._database.reading() as session:
            row = session.get(SessionRow, digest(token))
            owner = None if row is None else session.get(ApiKeyRow, row.key)
        if row is None or owner is None or row.expires_at <= now():
            raise UnauthorizedError("the session is over; sign in again")
        return self._in_use(owner)

    def close_session(self, token: str) -> None:
        """End a session."""
        with self._database.writing() as session:
            ended = delete(SessionRow).where(SessionRow.sha256 == digest(token)).returning(SessionRow.key)
            for key in session.scalars(ended):
                note(session, "signed out", "key", key)

    def write_uses(self) -> None:
        """Store when keys were used since this was called last; a server does it once a minute."""
        with self._lock:
            used = dict(self._used)
        if not used:
            return
        statement = self._database.insert(KeyUseRow).values([{"key": key, "used_at": at} for key, at in used.items()])
        newer = statement.excluded.used_at
        kept = {"index_elements": ["key"], "set_": {"used_at": newer}, "where": KeyUseRow.used_at < newer}
        with self._database.writing() as session:
            session.execute(statement.on_conflict_do_update(**kept))
        with self._lock:  # what could not be stored is stored the next time
            self._used = {key: at for key, at in self._used.items() if used.get(key) != at}

    def _in_use(self, row: ApiKeyRow) -> Key:
        """Return a key that is used now, if it holds."""
        key = valid(key_of(row))
        with self._lock:
            self._used[key.id] = now()
        return key

    def _with_use(self, session: Session, rows: Sequence[ApiKeyRow]) -> list[Key]:
        """Return keys with the moments of their last use, those included that are not stored yet."""
        stored = {use.key: use.used_at for use in session.scalars(select(KeyUseRow))}
        found = []
        for row in rows:
            moments = [at for at in (stored.get(row.id), self._used.get(row.id)) if at is not None]
            found.append(replace(key_of(row), used_at=max(moments, default=None)))
        return found


def _known(session: Session, identity: str, *, locked: bool = False) -> ApiKeyRow:
    row = session.get(ApiKeyRow, identity, with_for_update=locked) if is_id(identity) else None
    if row is None:
        raise UnknownKeyError(f"key {identity[:80]}: there is none of this id; `jointplay keys list` shows them")
    return row


def about_key(row: ApiKeyRow) -> dict[str, object]:
    """Return what the audit log says of a key."""
    return {name: getattr(row, name) for name in ("name", "scopes", "expires_at", "revoked_at")}


def valid(key: Key) -> Key:
    """Return a key, if it holds.

    Raises
    ------
    UnauthorizedError
        When it has expired or was revoked.
    """
    if key.state != "valid":
        raise UnauthorizedError(f"the key {key.id} {'has expired' if key.state == 'expired' else 'was revoked'}")
    return key


def key_of(row: ApiKeyRow) -> Key:
    """Return what a row says of a key."""
    scopes = frozenset(Scope(scope) for scope in row.scopes.split())
    return Key(row.id, row.name, scopes, row.created_at, row.expires_at, row.revoked_at)


def digest(secret: str) -> str:
    """Return the SHA-256 of a secret.

    A secret of 256 random bits cannot be guessed, however fast the hash is; a slow one would only cost every request.
    """
    return hashlib.sha256(secret.encode()).hexdigest()
