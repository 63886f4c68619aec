"""Assets: machines that stand somewhere, with their recordings, baseline, diagnoses and findings, in the database."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, Select, String, Text, select
from sqlalchemy.orm import Mapped, Session, mapped_column, relationship

from jointplay.app.errors import BadFieldError, UnknownAssetError, UnknownFindingError
from jointplay.app.schemas.assets import EXTERNAL_ID, AssetIn, FindingIn
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Base, DiagnosisRow, newest, now
from jointplay.app.storage.webhooks import announce


class AssetRow(Base):
    """One asset."""

    __tablename__ = "assets"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    external_id: Mapped[str] = mapped_column(String(128), unique=True)
    machine: Mapped[str] = mapped_column(String(200))
    notes: Mapped[str] = mapped_column(Text)
    baseline: Mapped[str | None] = mapped_column(ForeignKey("measurements.id"))
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    further: Mapped[list[AssetBaselineRow]] = relationship(
        order_by="AssetBaselineRow.place", lazy="selectin", cascade="all, delete-orphan"
    )

    @property
    def in_order(self) -> tuple[str, ...]:
        """Ids of its baselines."""
        return () if self.baseline is None else (self.baseline, *(each.measurement for each in self.further))


class AssetBaselineRow(Base):
    """A baseline of an asset besides its first."""

    __tablename__ = "asset_baselines"

    asset: Mapped[str] = mapped_column(ForeignKey("assets.external_id"), primary_key=True)
    place: Mapped[int] = mapped_column(primary_key=True)
    measurement: Mapped[str] = mapped_column(ForeignKey("measurements.id"))


class AssetMeasurementRow(Base):
    """A recording of an asset."""

    __tablename__ = "asset_measurements"

    asset: Mapped[str] = mapped_column(ForeignKey("assets.external_id"), primary_key=True)
    measurement: Mapped[str] = mapped_column(ForeignKey("measurements.id"), primary_key=True)


class AssetDiagnosisRow(Base):
    """A diagnosis of an asset."""

    __tablename__ = "asset_diagnoses"

    diagnosis: Mapped[str] = mapped_column(ForeignKey("diagnoses.id"), primary_key=True)
    asset: Mapped[str] = mapped_column(ForeignKey("assets.external_id"), index=True)


class FindingRow(Base):
    """What an inspection found."""

    __tablename__ = "findings"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    diagnosis: Mapped[str] = mapped_column(ForeignKey("diagnoses.id"), index=True)
    asset: Mapped[str | None] = mapped_column(String(128), index=True)
    created_at: Mapped[datetime]
    at: Mapped[datetime]
    joints: Mapped[dict[str, Any]]
    text: Mapped[str] = mapped_column(Text)


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
            With `only_new`, when there is one of this id.
        """
        moment, in_order = now(), wanted.in_order
        asked = {**wanted.model_dump(exclude={"baselines"}), "baseline": in_order[0] if in_order else None}
        first = {"external_id": external_id, "created_at": moment, "updated_at": moment, **asked}
        with self._database.writing() as session:
            # Two that put it at once wait for each other: one makes it, the other finds it.
            insert = (
                self._database.insert(AssetRow).values(first).on_conflict_do_nothing(index_elements=["external_id"])
            )
            new = session.scalar(insert.returning(AssetRow.number)) is not None
            if only_new and not new:
                said = f"external_id: {external_id}: there is an asset of this id already"
                raise BadFieldError(said, field="external_id")
            row = session.scalars(select(AssetRow).filter_by(external_id=external_id).with_for_update()).one()
            if row.in_order != in_order or any(getattr(row, name) != value for name, value in asked.items()):
                for name, value in asked.items():
                    setattr(row, name, value)
                row.further = [
                    AssetBaselineRow(place=place, measurement=key) for place, key in enumerate(in_order[1:], 1)
                ]
                row.updated_at = moment
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
        """
        row = None
        if re.fullmatch(EXTERNAL_ID, external_id):  # what can be no id does not reach the database
            with self._database.reading() as session:
                row = session.scalar(select(AssetRow).where(AssetRow.external_id == external_id))
        if row is None:
            raise UnknownAssetError(f"asset {external_id[:80]}: there is none of this id", field="asset")
        return row

    def page(self, before: int | None, limit: int) -> list[AssetRow]:
        """Return assets, the newest first, from below a row number on."""
        with self._database.reading() as session:
            return list(session.scalars(newest(session, AssetRow, before, limit)))

    def own(self, external_id: str, measurement: str) -> None:
        """Note that a stored measurement is of an asset."""
        with self._database.writing() as session:
            self.own_in(session, external_id, measurement)

    def own_in(self, session: Session, external_id: str, measurement: str) -> None:
        """Note in a transaction that a stored measurement is of an asset."""
        row = {"asset": external_id, "measurement": measurement}
        session.execute(self._database.insert(AssetMeasurementRow).values(row).on_conflict_do_nothing())

    def note(self, session: Session, external_id: str, measurements: Iterable[str], diagnosis: str) -> None:
        """Note in a transaction that a diagnosis, and what it is of, belong to an asset."""
        for measurement in measurements:
            self.own_in(session, external_id, measurement)
        row = {"asset": external_id, "diagnosis": diagnosis}
        session.execute(self._database.insert(AssetDiagnosisRow).values(row).on_conflict_do_nothing())

    def add_finding(self, row: DiagnosisRow, found: FindingIn) -> FindingRow:
        """Store a finding and return it: the same finding twice is one.

        Raises
        ------
        BadFieldError
            When it names a joint that the diagnosed machine does not have.
        """
        joints = row.machine["joints"].items()
        wearing = {name for name, joint in joints if joint["kind"] == "turning" or "length" in joint}
        for name in found.joints:
            if name not in wearing:
                known = ", ".join(sorted(wearing))
                raise BadFieldError(
                    f"joints: {name[:80]}: is no joint of this machine that can wear ({known})", field="joints"
                )
        said = found.model_dump(mode="json")
        # What findings could not say once is left out where it says nothing: the same finding keeps its id.
        said["joints"] = {name: joint.model_dump(exclude_defaults=True) for name, joint in found.joints.items()}
        key = hashlib.sha256(f"{row.id} {json.dumps(said, sort_keys=True)}".encode()).hexdigest()[:32]
        values = {
            "id": key,
            "diagnosis": row.id,
            "asset": row.request.get("asset"),
            "created_at": now(),
            "at": found.at,
            "joints": said["joints"],
            "text": found.text,
        }
        with self._database.writing() as session:
            insert = self._database.insert(FindingRow).values(values).on_conflict_do_nothing(index_elements=["id"])
            if session.scalar(insert.returning(FindingRow.id)) is not None:
                announce(session, "finding.created", {"finding": key, "diagnosis": row.id, "asset": values["asset"]})
        return self.finding(key)

    def finding(self, key: str) -> FindingRow:
        """Return a finding.

        Raises
        ------
        UnknownFindingError
            When there is none of this id.
        """
        row = self._database.find(FindingRow, key)
        if row is None:
            raise UnknownFindingError(f"finding {key[:80]}: there is none of this id")
        return row

    def findings_of_machine(self, machine: str, limit: int) -> list[FindingRow]:
        """Return findings at all assets that are one machine, the newest first."""
        with self._database.reading() as session:
            query = select(FindingRow).join(AssetRow, AssetRow.external_id == FindingRow.asset)
            query = query.where(AssetRow.machine == machine).order_by(FindingRow.number.desc()).limit(limit)
            return list(session.scalars(query))

    def findings(
        self,
        before: int | None,
        limit: int,
        since: datetime | None = None,
        only: Mapping[str, str | None] | None = None,
    ) -> list[FindingRow]:
        """Return findings, the newest first, from below a row number on.

        Parameters
        ----------
        before : int, optional
        limit : int
        since : datetime, optional
            Not those that came before.
        only : Mapping, optional
            Values of `diagnosis` and `asset`; ``None`` for any.
        """
        with self._database.reading() as session:
            query = newest(session, FindingRow, before, limit)
            if since is not None:
                query = query.where(FindingRow.created_at >= since)
            for name, value in (only or {}).items():
                if value is not None:
                    query = query.where(getattr(FindingRow, name) == value)
            return list(session.scalars(query))


def measurements_of(external_id: str) -> Select[str]:
    """Return the query for the ids of an asset's measurements."""
    return select(AssetMeasurementRow.measurement).where(AssetMeasurementRow.asset == external_id)


def diagnoses_of(external_id: str) -> Select[str]:
    """Return the query for the ids of an asset's diagnoses."""
    return select(AssetDiagnosisRow.diagnosis).where(AssetDiagnosisRow.asset == external_id)
