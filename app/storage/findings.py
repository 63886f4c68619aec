"""Findings: what inspections found at joints of assets, in the database; they teach what answers are worth."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from sqlalchemy import select

from jointplay.app.errors import BadFieldError, UnknownFindingError
from jointplay.app.schemas.assets import FindingIn
from jointplay.app.storage.asset_rows import AssetRow, FindingRow
from jointplay.app.storage.assets import touch
from jointplay.app.storage.audit import note
from jointplay.app.storage.database import ServiceDatabase
from jointplay.app.storage.rows import Damaged, DiagnosisRow, newest, now, one_of, rows_of
from jointplay.app.storage.tombstones import missing
from jointplay.app.storage.webhooks import announce

SAID_OF_FINDING = ("diagnosis", "asset", "at", "joints", "text")


class Findings:
    """The findings of a service.

    Parameters
    ----------
    database : ServiceDatabase
        Of the service's store.
    """

    def __init__(self, database: ServiceDatabase) -> None:
        self._database = database

    def add(self, row: DiagnosisRow, found: FindingIn) -> FindingRow:
        """Store a finding and return it: the same finding twice is one.

        Raises
        ------
        BadFieldError
            When it names a joint that the diagnosed machine does not have.
        """
        wearing = wearing_in(row.machine)
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
            insert = (
                self._database.insert(FindingRow)
                .values(FindingRow.seal(values))
                .on_conflict_do_nothing(index_elements=["id"])
            )
            if session.scalar(insert.returning(FindingRow.id)) is not None:
                # It teaches what answers to recordings of all machines of the kind are worth.
                of = select(AssetRow.machine).where(AssetRow.external_id == values["asset"])
                touch(session, AssetRow.machine == of.scalar_subquery())
                note(session, "made", "finding", key, after={name: values[name] for name in SAID_OF_FINDING})
                announce(session, "finding.created", {"finding": key, "diagnosis": row.id, "asset": values["asset"]})
            elif asset := session.scalar(select(AssetRow).filter_by(external_id=values["asset"])):
                kept = session.scalars(select(FindingRow).filter_by(id=key)).one()
                if kept.created_at < asset.created_at:  # of one that was deleted, of this name
                    kept.created_at = values["created_at"]
                    touch(session, AssetRow.external_id == asset.external_id)
        return self.finding(key)

    def finding(self, key: str) -> FindingRow:
        """Return a finding.

        Raises
        ------
        UnknownFindingError
            When there is none of this id.
        DeletedError
            When it was deleted.
        """
        row = one_of(self._database, FindingRow, key)
        if row is None:
            unknown = UnknownFindingError(f"finding {key[:80]}: there is none of this id")
            raise missing(self._database, "finding", key, unknown)
        return row

    def of_machine(self, machine: str, limit: int, damaged: list[Damaged] | None = None) -> list[FindingRow]:
        """Return findings at all assets that are one machine, the newest first; damaged ones as :meth:`page`."""
        with self._database.reading() as session:
            query = select(FindingRow).join(AssetRow, AssetRow.external_id == FindingRow.asset)
            query = query.where(AssetRow.machine == machine, FindingRow.created_at >= AssetRow.created_at)
            return rows_of(session, FindingRow, query.order_by(FindingRow.number.desc()).limit(limit), damaged)

    def of_asset(self, asset: AssetRow, limit: int, damaged: list[Damaged] | None = None) -> list[FindingRow]:
        """Return findings at an asset as :meth:`page`, but none at one of its name that was deleted."""
        return self.page(None, limit, asset.created_at, {"asset": asset.external_id}, damaged)

    def page(
        self,
        before: int | None,
        limit: int,
        since: datetime | None = None,
        only: Mapping[str, str | None] | None = None,
        damaged: list[Damaged] | None = None,
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
        damaged : list, optional
            Is given those that are damaged; without it one such is refused.
        """
        with self._database.reading() as session:
            query = newest(session, FindingRow, before, limit)
            if since is not None:
                query = query.where(FindingRow.created_at >= since)
            for name, value in (only or {}).items():
                if value is not None:
                    query = query.where(getattr(FindingRow, name) == value)
            return rows_of(session, FindingRow, query, damaged)


def about_finding(row: FindingRow) -> dict[str, Any]:
    """Return what somebody said in a finding."""
    return {name: getattr(row, name) for name in SAID_OF_FINDING}


def wearing_in(machine: Mapping[str, Any]) -> set[str]:
    """Return the joints of a stored machine that can wear."""
    return {name for name, joint in machine["joints"].items() if joint["kind"] == "turning" or "length" in joint}
