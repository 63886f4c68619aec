"""Assets: machines that stand somewhere, with their recordings, baseline and diagnoses, in the database."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Select, func, or_, select, update
from sqlalchemy.orm import Session

from jointplay.app.errors import BadFieldError, UnknownAssetError
from jointplay.app.schemas.assets import EXTERNAL_ID, AssetIn
from jointplay.app.storage.asset_rows import (
    AssetBaselineRow,
    AssetDiagnosisRow,
    AssetMeasurementRow,
    AssetRow,
    FindingRow,
)
from jointplay.app.storage.audit import note
from jointplay.app.storage.checksums import checksum
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Damaged, DiagnosisRow, newest, now, rows_of
from jointplay.app.storage.tombstones import missing

NEEDED = 10
"""Added to the severity of what nobody has acknowledged."""


@dataclass(frozen=True)
class AsRead:
    """How a recording was read for an answer.

    Parameters
    ----------
    mapping : mapping of str to str
        Sensor of each of its columns that is not named like its sensor.
    speed : float or None
        Drive speed that was given, rad/s.
    """

    mapping: Mapping[str, str]
    speed: float | None = None


class Assets:
    """The assets of a service.

    Parameters
    ----------
    database : ServiceDatabase
        Of the service's store.
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database

    def put(self, external_id: str, wanted: AssetIn, *, only_new: bool = False) -> tuple[AssetRow, bool]:
        """Store what is known of an asset; return it, and whether it is new.

        Its baselines have to be stored measurements; the caller has looked.

        Raises
        ------
        BadFieldError
            With `only_new`, when there is one of this id; when it has diagnoses of another machine.
        """
        moment, in_order = now(), wanted.in_order
        asked = {**wanted.model_dump(exclude={"baselines"}), "baseline": in_order[0] if in_order else None}
        moments = {"created_at": moment, "updated_at": moment}
        own = {"external_id": external_id, **moments, "baselines_sha256": checksum(list(in_order[:1]))}
        first = AssetRow.seal({**own, **asked})
        with self._database.writing() as session:
            # Two that put it at once wait for each other: one makes it, the other finds it.
            insert = (
                self._database.insert(AssetRow).values(first).on_conflict_do_nothing(index_elements=["external_id"])
            )
            new = session.scalar(insert.returning(AssetRow.number)) is not None
            if only_new and not new:
                said = f"external_id: {external_id}: there is an asset of this id already"
                raise BadFieldError(said, field="external_id")
            row = one_locked(session, external_id)
            if row.machine != wanted.machine:
                refuse_another_machine(session, external_id, wanted.machine)
            before = None if new else about_asset(row)
            if row.in_order != in_order or any(getattr(row, name) != value for name, value in asked.items()):
                for name, value in asked.items():
                    setattr(row, name, value)
                row.further = [
                    AssetBaselineRow(place=place, measurement=key) for place, key in enumerate(in_order[1:], 1)
                ]
                row.updated_at = moment
                row.baselines_sha256 = checksum(list(in_order))
                row.changes, row.due_at = row.changes + 1, moment
            if before != (after := about_asset(row)):
                note(session, "made" if new else "changed", "asset", external_id, before, after)
            session.flush()
            for measurement in in_order:
                self.own_in(session, external_id, measurement)
        return row, new

    def asset(self, external_id: str) -> AssetRow:
        """Return an asset.

        Raises
        ------
        UnknownAssetError
            When there is none of this id.
        DeletedError
            When it was deleted.
        """
        row = self.known(external_id)
        if row is None:
            unknown = UnknownAssetError(f"asset {external_id[:80]}: there is none of this id", field="asset")
            raise missing(self._database, "asset", external_id, unknown)
        return row

    def known(self, external_id: str) -> AssetRow | None:
        """Return an asset; None where there is none of this id."""
        if not re.fullmatch(EXTERNAL_ID, external_id):  # what can be no id does not reach the database
            return None
        with self._database.reading() as session:
            query = select(AssetRow).where(AssetRow.external_id == external_id)
            return next(iter(rows_of(session, AssetRow, query, None)), None)

    def page(
        self,
        before: int | None,
        limit: int,
        state: str | None = None,
        search: str | None = None,
        damaged: list[Damaged] | None = None,
    ) -> list[AssetRow]:
        """Return assets, the newest first, from below a row number on; of a state, or with a text, where one is given.

        Parameters
        ----------
        before : int, optional
        limit : int
        state : str, optional
        search : str, optional
            In their id, machine or notes, in whatever case.
        damaged : list, optional
            Is given those that are damaged; without it one such is refused.
        """
        with self._database.reading() as session:
            query = newest(session, AssetRow, before, limit).where(*filters(state, search))
            return rows_of(session, AssetRow, query, damaged)

    def urgent(
        self,
        after: int,
        limit: int,
        state: str | None = None,
        search: str | None = None,
        damaged: list[Damaged] | None = None,
    ) -> list[AssetRow]:
        """Return assets from a place on, those first that need somebody most; the rest as for :meth:`page`.

        Of those that need somebody alike, the one is first whose limit is reached first.
        """
        order = (AssetRow.need.desc(), AssetRow.limit_at.asc().nulls_last(), AssetRow.number.desc())
        with self._database.reading() as session:
            query = select(AssetRow).where(*filters(state, search)).order_by(*order)
            return rows_of(session, AssetRow, query.offset(after).limit(limit), damaged)

    def counts(self) -> dict[str, int]:
        """Return how many assets are in each state."""
        with self._database.reading() as session:
            found = session.execute(select(AssetRow.state, func.count()).group_by(AssetRow.state)).all()
        return {str(state): int(count) for state, count in found}

    def as_read(self, external_id: str, measurements: Collection[str]) -> dict[str, AsRead]:
        """Return how recordings of an asset were read when they were diagnosed last, of those that were, by id."""
        row = AssetMeasurementRow
        query = select(row.measurement, row.mapping, row.speed).where(row.asset == external_id)
        query = query.where(row.measurement.in_(measurements), row.mapping.is_not(None))
        with self._database.reading() as session:
            return {key: AsRead(mapping, speed) for key, mapping, speed in session.execute(query)}

    def own(self, external_id: str, measurement: str) -> None:
        """Note that a stored measurement is of an asset."""
        with self._database.writing() as session:
            self.own_in(session, external_id, measurement)
            touch(session, AssetRow.external_id == external_id)

    def own_in(self, session: Session, external_id: str, measurement: str) -> None:
        """Note in a transaction that a stored measurement is of an asset.

        Raises
        ------
        UnknownAssetError
            When the asset was deleted since somebody has looked.
        """
        hold(session, external_id)
        row = {"asset": external_id, "measurement": measurement}
        insert = self._database.insert(AssetMeasurementRow).values(row).on_conflict_do_nothing()
        if session.execute(insert.returning(AssetMeasurementRow.asset)).first() is not None:
            note(session, "gained", "asset", external_id, after={"measurement": measurement})

    def note(
        self,
        session: Session,
        external_id: str,
        measurements: Mapping[str, AsRead],
        diagnosis: str,
        *,
        again: bool = False,
    ) -> bool:
        """Note in a transaction that a diagnosis, and what it is of, belong to an asset; return whether that is new.

        One that was asked before, but not last, counts as asked last from now on.

        Parameters
        ----------
        session : Session
        external_id : str
        measurements : mapping of str to AsRead
            By id.
        diagnosis : str
        again : bool
            Whether it was there before, perhaps of an asset of this name that was deleted since.

        Raises
        ------
        UnknownAssetError
            When the asset was deleted since somebody has looked.
        """
        hold(session, external_id)
        for measurement, read in measurements.items():
            self.own_in(session, external_id, measurement)
            which = (AssetMeasurementRow.asset == external_id, AssetMeasurementRow.measurement == measurement)
            said: dict[str, Any] = {"mapping": dict(read.mapping)}
            if read.speed is not None:  # that nobody said it again takes nothing back
                said["speed"] = read.speed
            session.execute(update(AssetMeasurementRow).where(*which).values(said))
        row = {"asset": external_id, "diagnosis": diagnosis, "asked_again_at": now() if again else None}
        insert = self._database.insert(AssetDiagnosisRow).values(row).on_conflict_do_nothing()
        is_new = session.execute(insert.returning(AssetDiagnosisRow.asset)).first() is not None
        is_last = is_new
        if not is_new and (turns := asked(session, external_id))[diagnosis] < max(turns.values()):
            is_last = True
            its = update(AssetDiagnosisRow).where(AssetDiagnosisRow.diagnosis == diagnosis)
            session.execute(its.values(asked_again_at=now()))
        if is_last:
            touch(session, AssetRow.external_id == external_id)
        return is_new


def one_locked(session: Session, external_id: str, *, key_share: bool = False) -> AssetRow:
    """Return an asset that nobody else changes until the end of a transaction.

    Parameters
    ----------
    session : Session
    external_id : str
    key_share : bool
        Whether others may make rows meanwhile that speak of it.

    Raises
    ------
    DamagedRowError
        It is damaged.
    UnknownAssetError
        It was deleted since somebody has looked.
    """
    query = select(AssetRow).filter_by(external_id=external_id).with_for_update(key_share=key_share)
    for row in rows_of(session, AssetRow, query, None):
        return row
    raise deleted_meanwhile(external_id)


def hold(session: Session, external_id: str) -> None:
    """Let nobody delete an asset until the end of a transaction.

    Raises
    ------
    UnknownAssetError
        It was deleted since somebody has looked.
    """
    query = select(AssetRow.number).filter_by(external_id=external_id).with_for_update(read=True, key_share=True)
    if session.scalar(query) is None:
        raise deleted_meanwhile(external_id)


def deleted_meanwhile(external_id: str) -> UnknownAssetError:
    """Return the error for an asset that was there just now."""
    return UnknownAssetError(f"asset {external_id}: was deleted meanwhile", field="asset")


def refuse_another_machine(session: Session, external_id: str, machine: str) -> None:
    """Refuse another machine than that of an asset's newest diagnosis: answers of both would be followed as one.

    Raises
    ------
    BadFieldError
    """
    diagnosed = newest_machine(session, external_id)
    if diagnosed is not None and diagnosed["name"] != machine:
        said = f"machine: {machine[:80]}: asset {external_id} has diagnoses of a {diagnosed['name']}"
        raise BadFieldError(f"{said}: must stay; another machine is another asset", field="machine")


def newest_machine(session: Session, external_id: str) -> dict[str, Any] | None:
    """Return the file of the machine by an asset's newest diagnosis; None where there is none."""
    known = select(DiagnosisRow.machine).where(DiagnosisRow.id.in_(diagnoses_of(external_id)))
    return session.scalar(known.order_by(DiagnosisRow.number.desc()).limit(1))


def about_asset(row: AssetRow) -> dict[str, Any]:
    """Return what people said of an asset."""
    names = ("machine", "notes", "limits_um", "silent_after_days", "warn_within_days")
    return {**{name: getattr(row, name) for name in names}, "baselines": list(row.in_order)}


def filters(state: str | None, search: str | None) -> list[ColumnElement[bool]]:
    """Return what assets of a state, and with a text in what they are called, have to fulfil."""
    found = [] if state is None else [AssetRow.state == state]
    if search:
        texts = (AssetRow.external_id, AssetRow.machine, AssetRow.notes)
        found.append(or_(*(text.icontains(search, autoescape=True) for text in texts)))
    return found


def touch(session: Session, which: ColumnElement[bool]) -> None:
    """Note in a transaction that something has changed of which the standing of assets depends."""
    # In one order: two that touch the same assets wait for each other, not for ever.
    held = select(AssetRow.number).where(which).order_by(AssetRow.number).with_for_update(key_share=True)
    numbers = list(session.scalars(held))
    values = {"changes": AssetRow.changes + 1, "due_at": now()}
    session.execute(update(AssetRow).where(AssetRow.number.in_(numbers)).values(values))


def touch_owners(session: Session, measurement: str) -> None:
    """Note in a transaction that something about a measurement has changed: its assets may stand otherwise."""
    owners = select(AssetMeasurementRow.asset).where(AssetMeasurementRow.measurement == measurement)
    touch(session, AssetRow.external_id.in_(owners))


def touch_taught(session: Session, measurement: str) -> None:
    """Note the same where it was made is what has changed: what findings at its assets teach all of their kind, too."""
    owners = select(AssetMeasurementRow.asset).where(AssetMeasurementRow.measurement == measurement)
    own = AssetRow.external_id.in_(owners)
    found = select(FindingRow.asset).where(FindingRow.asset.in_(owners))
    kinds = list(session.scalars(select(AssetRow.machine).where(AssetRow.external_id.in_(found))))
    touch(session, own | AssetRow.machine.in_(kinds))


def measurements_of(external_id: str) -> Select[str]:
    """Return the query for the ids of an asset's measurements."""
    return select(AssetMeasurementRow.measurement).where(AssetMeasurementRow.asset == external_id)


def asked(session: Session, external_id: str) -> dict[str, tuple[datetime, int]]:
    """Return the order in which an asset's diagnoses were asked, by their ids: when that was last, and the row."""
    at = func.coalesce(AssetDiagnosisRow.asked_again_at, DiagnosisRow.created_at, type_=DiagnosisRow.created_at.type)
    query = select(DiagnosisRow.id, at, DiagnosisRow.number).join(
        AssetDiagnosisRow, AssetDiagnosisRow.diagnosis == DiagnosisRow.id
    )
    found = session.execute(query.where(AssetDiagnosisRow.asset == external_id))
    return {key: (moment, number) for key, moment, number in found}


def diagnoses_of(external_id: str) -> Select[str]:
    """Return the query for the ids of an asset's diagnoses."""
    return select(AssetDiagnosisRow.diagnosis).where(AssetDiagnosisRow.asset == external_id)
