"""Builds as rows: who works on which, until when, and what came of it.

A server claims a build for a while and extends that while it lives. The lease of one that died runs out, and the next
server takes the build up again; what was stored in the catalogue until then stays.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple, get_args

from sqlalchemy import Double, ForeignKey, String, Text, and_, func, or_, select, text
from sqlalchemy.orm import Mapped, Session, aliased, mapped_column

from jointplay.app.errors import BuildEndedError, UnknownBuildError
from jointplay.app.logs import request_id
from jointplay.app.schemas.builds import BuildOut, State
from jointplay.app.storage.audit import note
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Base, newest, now
from jointplay.app.storage.tombstones import missing
from jointplay.app.storage.webhooks import announce

ATTEMPTS = 5
"""How often in a row the process or server of a build may die before it did a case more than any before."""

ORDERS_LOCK = 7_264_917_003_120
"""Key of PostgreSQL's advisory lock that is held while a build is put into the queue."""

ENDED: frozenset[State] = frozenset({"done", "failed", "cancelled", "worker_lost"})
"""States that a build does not leave."""


class BuildRow(Base):
    """A catalogue to be built, everything that is needed for it, and how far it is."""

    __tablename__ = "builds"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    created_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    ended_at: Mapped[datetime | None]
    machine: Mapped[dict[str, Any]]
    plan: Mapped[dict[str, Any]]
    plan_hash: Mapped[str] = mapped_column(String(64))
    catalogue: Mapped[str] = mapped_column(String(255))
    catalogue_id: Mapped[str | None] = mapped_column(String(64))
    workers: Mapped[int | None]
    state: Mapped[str] = mapped_column(String(16), index=True)
    message: Mapped[str] = mapped_column(Text)
    cases_done: Mapped[int]
    cases_total: Mapped[int]
    rate_per_s: Mapped[float] = mapped_column(Double)
    seconds_left: Mapped[float | None] = mapped_column(Double)
    attempts: Mapped[int]
    owner: Mapped[str] = mapped_column(Text)
    lease_until: Mapped[float] = mapped_column(Double)
    cancel_asked: Mapped[bool]
    request_id: Mapped[str | None] = mapped_column(String(64))


class BuildDeathsRow(Base):
    """How often in a row a build has died, and the most cases that it had done until then."""

    __tablename__ = "build_deaths"

    build: Mapped[str] = mapped_column(ForeignKey("builds.id"), primary_key=True)
    in_a_row: Mapped[int]
    most_done: Mapped[int]


@dataclass(frozen=True)
class Beat:
    """What a sign of life is answered with: whether the build is still its sender's, and whether to stop it."""

    owned: bool
    cancel: bool


class Running(NamedTuple):
    """How far all builds are that run, together."""

    done: int
    total: int
    rate: float


class BuildQueue:
    """All builds of a database.

    Parameters
    ----------
    database : ServiceDatabase
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database

    def add(
        self,
        machine: Mapping[str, Any],
        plan: Mapping[str, Any],
        plan_hash: str,
        catalogue: str,
        workers: int | None,
    ) -> BuildRow:
        """Store a build that is to be done, and return it committed; or the same build that has not ended yet."""
        row = BuildRow(
            id=secrets.token_hex(16),
            created_at=now(),
            machine=dict(machine),
            plan=dict(plan),
            plan_hash=plan_hash,
            catalogue=catalogue,
            workers=workers,
            state="queued",
            message="",
            cases_done=0,
            cases_total=0,
            rate_per_s=0.0,
            attempts=0,
            owner="",
            lease_until=0.0,
            cancel_asked=False,
            request_id=request_id(),
        )
        with self._database.writing() as session:
            if not self._database.is_sqlite:  # which lets one in at a time anyway
                session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": ORDERS_LOCK})
            same = session.scalars(
                select(BuildRow)
                .filter_by(plan_hash=plan_hash, catalogue=catalogue, workers=workers, cancel_asked=False)
                .where(BuildRow.state.not_in(ENDED))
                .order_by(BuildRow.number)
            )
            found = next((each for each in same if each.machine == row.machine), row)
            if found is row:
                session.add(row)
                note(session, "made", "build", row.id, after=about_build(row))
            else:
                note(session, "asked for again", "build", found.id)
        return self.find(found.id)

    def find(self, key: str) -> BuildRow:
        """Return a build.

        Raises
        ------
        UnknownBuildError
            When there is none of this id.
        DeletedError
            When it was deleted.
        """
        row = self._database.find(BuildRow, key)
        if row is None:
            unknown = UnknownBuildError(f"build {key[:80]}: there is none of this id")
            raise missing(self._database, "build", key, unknown)
        return row

    def list_builds(self, before: int | None, limit: int) -> list[BuildRow]:
        """Return builds, the newest first, from below a row number on."""
        with self._database.reading() as session:
            return list(session.scalars(newest(session, BuildRow, before, limit)))

    def counts(self) -> tuple[dict[State, int], Running]:
        """Return how many builds are in each state, and how far those are that run."""
        sums = (func.sum(BuildRow.cases_done), func.sum(BuildRow.cases_total), func.sum(BuildRow.rate_per_s))
        with self._database.reading() as session:
            found = session.execute(select(BuildRow.state, func.count(), *sums).group_by(BuildRow.state)).all()
        rows = {state: (count, Running(done, total, rate)) for state, count, done, total, rate in found}
        counts = {state: rows[state][0] if state in rows else 0 for state in get_args(State)}
        return counts, rows["running"][1] if "running" in rows else Running(0, 0, 0.0)

    def claim(self, owner: str, seconds: float) -> BuildRow | None:
        """Take the oldest build that nobody works on, for a while; ``None`` where there is none.

        Builds of one catalogue wait for each other. One whose server died is taken up again, as long as it gets on.
        """
        with self._database.reading() as session:  # most looks find nothing, and need no lock for that
            if session.scalar(self._open(session)) is None:
                return None
        with self._database.writing() as session:
            row: BuildRow
            for row in session.scalars(self._open(session).with_for_update(skip_locked=True)):
                if row.state == "running":
                    self._lost(session, row, "its server ended in the middle of it")
                if row.state == "queued":
                    row.state, row.owner, row.attempts = "running", owner, row.attempts + 1
                    row.started_at = row.started_at or now()
                    # What an earlier attempt said is not how far this one is; cases it left are found at once.
                    row.cases_done, row.cases_total, row.rate_per_s = 0, 0, 0.0
                    row.lease_until = self._clock(session) + seconds
                    return row
        return None

    def beat(self, key: str, owner: str, seconds: float, progress: Mapping[str, Any]) -> Beat:
        """Extend a lease, and note how far the build is."""
        with self._database.writing() as session:
            row = self._mine(session, key, owner)
            if row is None:
                return Beat(owned=False, cancel=False)
            row.lease_until = self._clock(session) + seconds
            for name, value in progress.items():
                setattr(row, name, value)
            return Beat(owned=True, cancel=row.cancel_asked)

    def end(self, key: str, owner: str, state: State, values: Mapping[str, Any]) -> None:
        """Note how a build ended, if it is still this server's."""
        with self._database.writing() as session:
            row = self._mine(session, key, owner)
            if row is not None:
                for name, value in values.items():
                    setattr(row, name, value)
                self._close(session, row, state)

    def lose(self, key: str, owner: str, message: str) -> None:
        """Note that the process of a build died: it waits to be taken up again, or is given up."""
        with self._database.writing() as session:
            row = self._mine(session, key, owner)
            if row is not None:
                self._lost(session, row, message)

    def release(self, key: str, owner: str) -> None:
        """Give a build back that this server stops in good order; that counts as no attempt."""
        with self._database.writing() as session:
            row = self._mine(session, key, owner)
            if row is not None:
                row.attempts -= 1
                self._lost(session, row, "", died=False)

    def cancel(self, key: str) -> BuildRow:
        """Stop a build: one that waits at once, one that runs as soon as its server hears of it.

        Raises
        ------
        UnknownBuildError
            When there is none of this id.
        BuildEndedError
            When it has ended already, otherwise than by this.
        """
        self.find(key)
        with self._database.writing() as session:
            row = session.scalars(select(BuildRow).where(BuildRow.id == key).with_for_update()).one()
            if row.state == "queued":
                self._close(session, row, "cancelled")
            elif row.state == "running":
                if not row.cancel_asked:
                    note(session, "cancelled", "build", key)
                row.cancel_asked = True
            elif row.state != "cancelled":
                raise BuildEndedError(f"build {key}: is {row.state} already, and cannot be cancelled")
            return row

    def _open(self, session: Session) -> Any:
        other = aliased(BuildRow)
        clock = self._clock(session)
        over = and_(BuildRow.state == "running", BuildRow.lease_until < clock)
        busy = select(other.catalogue).where(other.state == "running", other.lease_until >= clock)
        waiting = and_(BuildRow.state == "queued", BuildRow.catalogue.not_in(busy))
        return select(BuildRow).where(or_(waiting, over)).order_by(BuildRow.number)

    def _mine(self, session: Session, key: str, owner: str) -> BuildRow | None:
        mine = (BuildRow.id == key, BuildRow.owner == owner, BuildRow.state == "running")
        found: BuildRow | None = session.scalar(select(BuildRow).where(*mine).with_for_update())
        return found

    def _lost(self, session: Session, row: BuildRow, message: str, *, died: bool = True) -> None:
        row.owner, row.lease_until, row.rate_per_s, row.seconds_left = "", 0.0, 0.0, None
        row.message = message
        if row.cancel_asked:
            self._close(session, row, "cancelled")
        elif died and self._count_death(session, row) >= ATTEMPTS:
            row.message = f"{message}; given up after {ATTEMPTS} attempts without progress"
            self._close(session, row, "worker_lost")
        else:
            row.state = "queued"

    def _count_death(self, session: Session, row: BuildRow) -> int:
        """Return how often in a row a build has died; what it did before it died is kept, and forgives all deaths."""
        deaths = session.get(BuildDeathsRow, row.id) or BuildDeathsRow(build=row.id, in_a_row=0, most_done=0)
        session.add(deaths)
        if row.cases_done > deaths.most_done:
            deaths.in_a_row, deaths.most_done = 0, row.cases_done
        else:
            deaths.in_a_row += 1
        return deaths.in_a_row

    def _close(self, session: Session, row: BuildRow, state: State) -> None:
        ended = {"state": state, "catalogue_id": row.catalogue_id, "message": row.message}
        note(session, "cancelled" if state == "cancelled" else "ended", "build", row.id, after=ended)
        row.state, row.ended_at = state, now()
        row.owner, row.lease_until, row.seconds_left = "", 0.0, None
        told = {"build": row.id, "machine": row.machine["name"], "catalogue": row.catalogue}
        announce(
            session, "build.ended", {**told, "catalogue_id": row.catalogue_id, "state": state, "message": row.message}
        )

    def _clock(self, session: Session) -> float:
        return float(session.scalar(select(self._database.epoch())) or 0.0)


def about_build(row: BuildRow) -> dict[str, Any]:
    """Return what the audit log says of a build that is asked for."""
    return {"machine": row.machine["name"], "plan_hash": row.plan_hash, "catalogue": row.catalogue}


def build_out(row: BuildRow) -> BuildOut:
    """Return the outside shape of a build."""
    moments = ("created_at", "started_at", "ended_at")
    same = ("id", "plan_hash", "catalogue", "catalogue_id", "workers", "state", "message", *moments)
    counts = ("cases_done", "cases_total", "rate_per_s", "seconds_left", "attempts")
    return BuildOut(
        **{name: getattr(row, name) for name in (*same, *counts)},
        machine=row.machine["name"],
        plan=row.plan["name"],
    )
