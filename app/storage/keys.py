"""API keys and the sessions of browsers: made, looked up, taken back; of their secrets only hashes are kept."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from dataclasses import dataclass
from datetime import datetime, timedelta

from cachetools import TTLCache
from sqlalchemy import String, delete, select
from sqlalchemy.orm import Mapped, mapped_column

from jointplay.app.errors import UnauthorizedError, UnknownKeyError
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
    """

    id: str
    name: str
    scopes: frozenset[Scope]
    created_at: datetime
    expires_at: datetime
    revoked_at: datetime | None

    @property
    def state(self) -> str:
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
            return [key_of(row) for row in session.scalars(select(ApiKeyRow).order_by(ApiKeyRow.created_at))]

    def revoke(self, identity: str) -> Key:
        """Take a key back, and end the sessions that were opened with it; it holds for no later request.

        Raises
        ------
        UnknownKeyError
            When there is none of this id.
        """
        with self._database.writing() as session:
            row = session.get(ApiKeyRow, identity)
            if row is None:
                raise UnknownKeyError(f"key {identity}: there is none of this id; `jointplay keys list` shows them")
            before = about_key(row)
            row.revoked_at = row.revoked_at or now()
            if before["revoked_at"] is None:
                note(session, "revoked", "key", identity, before, about_key(row))
            session.execute(delete(SessionRow).where(SessionRow.key == identity))
            return key_of(row)

    def find(self, token: str) -> Key:
        """Return the key that a token is of.

        Raises
        ------
        UnauthorizedError
            When it is of none, or of one that has expired or was revoked. What the token was is not repeated.
        """
        prefix, _, rest = token.partition("_")
        identity, _, secret = rest.partition("_")
        if prefix != PREFIX or not secret:
            raise UnauthorizedError("the key is not of the form that this service hands out")
        row = None
        if is_id(identity):  # PostgreSQL refuses texts with some other characters
            with self._database.reading() as session:
                row = session.get(ApiKeyRow, identity)
        # The comparison takes as long for a wrong secret as for a right one.
        if row is None or not hmac.compare_digest(row.sha256, digest(secret)):
            raise UnauthorizedError("the key is not known here")
        return valid(key_of(row))

    def open_session(self, key: Key) -> str:
        """Return the token of a new session of a key; sessions that are over are forgotten."""
        token = secrets.token_urlsafe(SECRET_BYTES)
        with self._database.writing() as session:
            session.execute(delete(SessionRow).where(SessionRow.expires_at < now()))
            session.add(SessionRow(sha256=digest(token), key=key.id, expires_at=now() + SESSION))
            note(session, "signed in", "key", key.id)
        return token

    def note_refusal(self, address: str) -> None:
        """Note that somebody tried to sign in with what is no key.

        Of an address once a minute: nobody without a key is to fill a disk.
        """
        if address not in self._refused:
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
        return valid(key_of(owner))

    def close_session(self, token: str) -> None:
        """End a session."""
        with self._database.writing() as session:
            session.execute(delete(SessionRow).where(SessionRow.sha256 == digest(token)))


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
