"""Rows of assets, of what belongs to them, and of what inspections found."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any, ClassVar

from sqlalchemy import JSON, Double, ForeignKey, String, Text
from sqlalchemy.orm import Mapped, mapped_column, relationship

from jointplay.app.storage.checksums import checksum
from jointplay.app.storage.rows import (
    Base,
    Sealed,
    damaged_row,
    now,
)
from jointplay.catalogue.following.standing import Known, Patience, Reason, judge


def reasons_at_first() -> list[dict[str, Any]]:
    """Return why nothing is known of an asset that was just noted, as JSON values."""
    patience = Patience(silent_after=timedelta(days=1), warn_within=timedelta(days=1))
    return [reason.model_dump() for reason in judge(Known(), now(), patience)]


class AssetRow(Sealed, Base):
    """One asset, and how it stands: what follows from all that is known of it is kept, not computed for every look.

    Whatever changes that counts up `changes`, in its own transaction; what was judged is by the `followed` first of
    them. It is to be judged anew at `due_at`, by time alone or since something has changed.
    """

    __tablename__ = "assets"
    NAME: ClassVar = "external_id"
    SEALED: ClassVar = (
        *("external_id", "machine", "notes", "baseline", "baselines_sha256", "created_at", "updated_at"),
        *("limits_um", "silent_after_days", "warn_within_days", "made_by"),
    )

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    external_id: Mapped[str] = mapped_column(String(128), unique=True)
    machine: Mapped[str] = mapped_column(String(200))
    notes: Mapped[str] = mapped_column(Text)
    baseline: Mapped[str | None] = mapped_column(ForeignKey("measurements.id"))
    created_at: Mapped[datetime]
    updated_at: Mapped[datetime]
    baselines_sha256: Mapped[str] = mapped_column(String(64))
    limits_um: Mapped[dict[str, Any]]
    silent_after_days: Mapped[int]
    warn_within_days: Mapped[int]
    state: Mapped[str] = mapped_column(String(16), default="unknown")
    need: Mapped[int] = mapped_column(default=0)
    reasons: Mapped[list[dict[str, Any]]] = mapped_column(JSON, default=reasons_at_first)
    known: Mapped[dict[str, Any]] = mapped_column(default=dict)
    said: Mapped[list[str]] = mapped_column(JSON, default=list)
    acknowledged: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    limit_at: Mapped[datetime | None]
    changes: Mapped[int] = mapped_column(default=1)
    followed: Mapped[int] = mapped_column(default=0)
    due_at: Mapped[datetime | None] = mapped_column(default=now, index=True)
    further: Mapped[list[AssetBaselineRow]] = relationship(
        order_by="AssetBaselineRow.place", lazy="selectin", cascade="all, delete-orphan"
    )

    def check(self) -> None:
        """Refuse a row whose baselines are not what was written, which stand in rows of their own."""
        _ = self.in_order

    @property
    def in_order(self) -> tuple[str, ...]:
        """Ids of its baselines.

        Raises
        ------
        DamagedRowError
            They are not those that somebody said.
        """
        found = () if self.baseline is None else (self.baseline, *(each.measurement for each in self.further))
        if checksum(list(found)) != self.baselines_sha256:
            raise damaged_row(self.__tablename__, self.external_id, self.number)
        return found

    @property
    def patience(self) -> Patience:
        """How long it may be silent, and how long before a limit somebody wants to know."""
        days = (timedelta(days=self.silent_after_days), timedelta(days=self.warn_within_days))
        return Patience(silent_after=days[0], warn_within=days[1])

    @property
    def judged(self) -> tuple[Reason, ...]:
        """What somebody should know of it."""
        return tuple(map(Reason.model_validate, self.reasons))


class AssetBaselineRow(Base):
    """A baseline of an asset besides its first."""

    __tablename__ = "asset_baselines"

    asset: Mapped[str] = mapped_column(ForeignKey("assets.external_id"), primary_key=True)
    place: Mapped[int] = mapped_column(primary_key=True)
    measurement: Mapped[str] = mapped_column(ForeignKey("measurements.id"))


class AssetMeasurementRow(Base):
    """A recording of an asset, and what was said of its sensors and speed when it was diagnosed last."""

    __tablename__ = "asset_measurements"

    asset: Mapped[str] = mapped_column(ForeignKey("assets.external_id"), primary_key=True)
    measurement: Mapped[str] = mapped_column(ForeignKey("measurements.id"), primary_key=True)
    mapping: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    speed: Mapped[float | None] = mapped_column(Double)


class AssetDiagnosisRow(Base):
    """A diagnosis of an asset."""

    __tablename__ = "asset_diagnoses"

    diagnosis: Mapped[str] = mapped_column(ForeignKey("diagnoses.id"), primary_key=True)
    asset: Mapped[str] = mapped_column(ForeignKey("assets.external_id"), index=True)
    asked_again_at: Mapped[datetime | None]


class FindingRow(Sealed, Base):
    """What an inspection found."""

    __tablename__ = "findings"
    SEALED: ClassVar = ("id", "diagnosis", "asset", "created_at", "at", "joints", "text", "made_by")

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(32), unique=True)
    diagnosis: Mapped[str] = mapped_column(ForeignKey("diagnoses.id"), index=True)
    asset: Mapped[str | None] = mapped_column(String(128), index=True)
    created_at: Mapped[datetime]
    at: Mapped[datetime]
    joints: Mapped[dict[str, Any]]
    text: Mapped[str] = mapped_column(Text)
