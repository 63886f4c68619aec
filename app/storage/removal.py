"""Deleting what a service keeps: rows first, with a tombstone; then files that no row speaks of any more.

A recording's row stays, emptied of what its sender said once no diagnosis speaks of it: it is the place at which the
same bytes come back, and when it was made goes on counting in its asset's life. A server that dies in between leaves
files without a row, which are tidied later, never a row without its file.
"""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from sqlalchemy import delete, or_, select, update
from sqlalchemy.orm import Session

from jointplay.app.actor import actor
from jointplay.app.errors import BuildOpenError, DamagedRowError, InUseError
from jointplay.app.storage import audit, idempotency
from jointplay.app.storage.asset_rows import (
    AssetBaselineRow,
    AssetDiagnosisRow,
    AssetMeasurementRow,
    AssetRow,
    FindingRow,
)
from jointplay.app.storage.assets import Assets, about_asset, deleted_meanwhile, measurements_of, touch
from jointplay.app.storage.build_queue import ENDED, BuildDeathsRow, BuildQueue, BuildRow, about_build
from jointplay.app.storage.findings import Findings, about_finding
from jointplay.app.storage.machine_store import MachineStore
from jointplay.app.storage.remembered import RememberedRow
from jointplay.app.storage.retention import hold_rows, kept_of, refuse_held
from jointplay.app.storage.rows import Damaged, DiagnosisRow, MeasurementRow, rows_of
from jointplay.app.storage.store import Store, about_diagnosis
from jointplay.app.storage.tombstones import Kind, TombstoneRow, bury, deleted, refuse_deleted
from jointplay.catalogue.storage.directory import CatalogueDirectory

log = logging.getLogger(__name__)

GOING = ".deleted-"
"""Beginning of the name of a folder that is being deleted."""


class Removal:
    """Deletes what a service keeps.

    Parameters
    ----------
    store : Store
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._database = store.database

    def delete_measurement(self, key: str, why: str) -> None:
        """Delete a recording; diagnoses of it stay, and say so.

        Raises
        ------
        UnknownMeasurementError, DeletedError
            When there is none of this id, or none any more.
        InUseError
            When it is on hold, a baseline of an asset, or evidence.
        """
        with suppress(DamagedRowError):  # which may go all the same
            self._store.measurement(key)
        with self._database.writing() as session:
            hold_rows(session, [key])
            sha256 = session.scalars(select(MeasurementRow.sha256).where(MeasurementRow.id == key)).one()
            refuse_deleted(session, "measurement", [key])
            refuse_held(session, [key])
            refuse_baseline(session, key)
            if kept_of(session, key).of == "evidence":
                raise InUseError(f"measurement {key}: is evidence{evidence_of(session, key)}", field="measurement")
            self._bury_measurements(session, {key: sha256}, why)
        self._drop({key: sha256})

    def delete_measurements(self, keys: Collection[str], why: str) -> dict[str, int]:
        """Delete recordings whose time is over, whatever they were; returns the sizes of those that went.

        Those stay that are on hold or baselines of an asset by now.
        """
        damaged: list[Damaged] = []
        with self._database.writing() as session:
            hold_rows(session, keys)
            query = select(MeasurementRow).where(MeasurementRow.id.in_(list(keys)))
            query = query.where(MeasurementRow.id.not_in(deleted("measurement")))
            found = {row.id: row for row in rows_of(session, MeasurementRow, query, damaged)}
            for key in list(found):
                try:
                    refuse_held(session, [key])
                    refuse_baseline(session, key)
                except InUseError:
                    del found[key]
            checksums, sizes = (
                {key: getattr(row, name) for key, row in found.items()} for name in ("sha256", "size_bytes")
            )
            self._bury_measurements(session, checksums, why)
        self._drop(checksums)
        for each in damaged:
            log.warning("not tidied up: %s", each.problem)
        return sizes

    def _bury_measurements(self, session: Session, checksums: dict[str, str], why: str) -> None:
        for key, sha256 in checksums.items():
            self._bury(session, "measurement", key, why, {"sha256": sha256}, sha256)
        idempotency.forget(session, [f"/api/v1/measurements/{key}" for key in checksums])
        # All at once, so that assets are held in one order: others touch the same.
        owners = select(AssetMeasurementRow.asset).where(AssetMeasurementRow.measurement.in_(list(checksums)))
        touch(session, AssetRow.external_id.in_(owners))
        empty_unspoken(session, checksums)

    def _drop(self, checksums: dict[str, str]) -> None:
        for key in checksums:
            self._store.files.drop_samples(key)
        self._store.files.drop(set(checksums.values()))

    def delete_diagnosis(self, key: str, why: str) -> None:
        """Delete an answer.

        Raises
        ------
        UnknownDiagnosisError, DeletedError
            When there is none of this id, or none any more.
        InUseError
            When a finding speaks of it, or its recording is on hold.
        """
        row = self._store.diagnosis(key)
        with self._database.writing() as session:
            refuse_held(session, row.measurements)
            finding = session.scalar(select(FindingRow.id).where(FindingRow.diagnosis == key).limit(1))
            if finding is not None:
                raise InUseError(
                    f"diagnosis {key}: finding {finding} speaks of it: delete that first", field="diagnosis"
                )
            owners = select(AssetDiagnosisRow.asset).where(AssetDiagnosisRow.diagnosis == key)
            touch(session, AssetRow.external_id.in_(owners))
            session.execute(delete(AssetDiagnosisRow).where(AssetDiagnosisRow.diagnosis == key))
            session.execute(delete(DiagnosisRow).where(DiagnosisRow.id == key))
            gone = deleted("measurement").where(TombstoneRow.id.in_(row.measurements))
            empty_unspoken(session, list(session.scalars(gone)))
            self._bury(session, "diagnosis", key, why, about_diagnosis(row))
            idempotency.forget(session, [f"/api/v1/diagnoses/{key}"])

    def delete_finding(self, key: str, why: str) -> None:
        """Delete what an inspection found.

        Raises
        ------
        UnknownFindingError, DeletedError
            When there is none of this id, or none any more.
        InUseError
            When the recording that it teaches of is on hold.
        """
        found = Findings(self._database).finding(key)
        row = self._store.diagnosis(found.diagnosis)
        with self._database.writing() as session:
            refuse_held(session, row.measurements)
            of = select(AssetRow.machine).where(AssetRow.external_id == found.asset)
            touch(session, AssetRow.machine == of.scalar_subquery())
            session.execute(delete(FindingRow).where(FindingRow.id == key))
            self._bury(session, "finding", key, why, about_finding(found))
            idempotency.forget(session, [f"/api/v1/findings/{key}"])

    def delete_asset(self, external_id: str, why: str) -> None:
        """Delete an asset; its recordings and what was answered of them stay, and are nobody's.

        Raises
        ------
        UnknownAssetError, DeletedError
            When there is none of this id, or none any more.
        InUseError
            When one of its recordings is on hold.
        """
        before = None
        with suppress(DamagedRowError):  # which may go all the same
            before = about_asset(Assets(self._database).asset(external_id))
        with self._database.writing() as session:
            # First: whoever is noting something of it has done so, or will find that it is gone.
            query = select(AssetRow.number).where(AssetRow.external_id == external_id).with_for_update()
            if session.scalar(query) is None:
                raise deleted_meanwhile(external_id)
            refuse_held(session, session.scalars(measurements_of(external_id)))
            for table in (AssetMeasurementRow, AssetDiagnosisRow, AssetBaselineRow, RememberedRow):
                session.execute(delete(table).where(table.asset == external_id))
            session.execute(delete(AssetRow).where(AssetRow.external_id == external_id))
            self._bury(session, "asset", external_id, why, before)
            idempotency.forget(session, [f"/api/v1/assets/{external_id}"])

    def delete_build(self, key: str, why: str) -> None:
        """Delete what is known of a build that has ended; its catalogue stays.

        Raises
        ------
        UnknownBuildError, DeletedError
            When there is none of this id, or none any more.
        BuildOpenError
            When it has not ended.
        """
        BuildQueue(self._database).find(key)
        with self._database.writing() as session:
            query = select(BuildRow).where(BuildRow.id == key, BuildRow.state.in_(ENDED)).with_for_update()
            if (row := session.scalar(query)) is None:
                raise BuildOpenError(f"build {key}: has not ended: cancel it first")
            session.execute(delete(BuildDeathsRow).where(BuildDeathsRow.build == key))
            session.execute(delete(BuildRow).where(BuildRow.id == key))
            self._bury(session, "build", key, why, about_build(row))
            idempotency.forget(session, [f"/api/v1/builds/{key}"])

    def delete_machine(self, machines: MachineStore, name: str, why: str) -> None:
        """Delete a machine that was put here, with its versions; catalogues and diagnoses have theirs with them.

        Raises
        ------
        UnknownMachineError, DeletedError
            When there is none of this name, or none any more.
        ShippedMachineError
            When it ships with the program.
        """
        machines.check_own(name)
        with self._database.writing() as session:
            # First: until the file is gone as well, the machine is there and nobody looks for its tombstone.
            self._bury(session, "machine", name, why, None)
            idempotency.forget(session, [f"/api/v1/machines/{name}"])
        machines.remove(name)

    def delete_catalogue(self, folder: Path, identity: str, why: str, *, last: bool = True) -> None:
        """Delete a catalogue; diagnoses that were made with it stay, but cannot be repeated.

        Parameters
        ----------
        folder : Path
        identity : str
            Its id as it is now.
        why : str
        last : bool
            Whether no other folder holds the same.

        Raises
        ------
        CatalogueBusyError
            When somebody builds it.
        InUseError
            When a build of it waits, or a recording that was diagnosed with it is on hold.
        """
        going = folder.with_name(f"{GOING}{folder.name}-{time.time_ns()}")
        with CatalogueDirectory(folder).hold_alone():
            self._bury_catalogue(folder.name, identity if last else None, why)
            folder.rename(going)
        shutil.rmtree(going, ignore_errors=True)

    def _bury_catalogue(self, name: str, identity: str | None, why: str) -> None:
        with self._database.writing() as session:
            open_builds = select(BuildRow.id).where(BuildRow.catalogue == name, BuildRow.state.not_in(ENDED))
            build = session.scalar(open_builds.limit(1))
            if build is not None:
                rule = f"build {build} has not ended: cancel it first"
                raise InUseError(f"catalogue {name}: {rule}", field="catalogue")
            columns = (DiagnosisRow.measurement, DiagnosisRow.request["measurements"])
            used = session.execute(select(*columns).where(DiagnosisRow.catalogue == identity))
            refuse_held(session, {key for first, several in used for key in several or [first]})
            names = (name, *([identity] if identity else []))
            for each in names:
                self._bury(session, "catalogue", each, why, None)
            idempotency.forget(session, [f"/api/v1/catalogues/{each}" for each in names])

    def _bury(
        self, session: Session, kind: Kind, key: str, why: str, before: dict[str, Any] | None, sha256: str = ""
    ) -> None:
        """Note in a transaction that something is deleted, and what it was."""
        bury(session, kind, key, actor().name, why, sha256)
        audit.note(session, "deleted", kind, key, before, {"why": why})


def baseline_of(session: Session, key: str) -> str | None:
    """Return an asset that a recording is a baseline of."""
    further = select(AssetBaselineRow.asset).where(AssetBaselineRow.measurement == key)
    query = select(AssetRow.external_id).where(or_(AssetRow.baseline == key, AssetRow.external_id.in_(further)))
    return session.scalar(query.limit(1))


def refuse_baseline(session: Session, key: str) -> None:
    """Refuse to delete the baseline of an asset.

    Raises
    ------
    InUseError
    """
    asset = baseline_of(session, key)
    if asset is not None:
        rule = f"is a baseline of asset {asset}: give that another one first"
        raise InUseError(f"measurement {key}: {rule}", field="measurement")


def evidence_of(session: Session, key: str) -> str:
    """Return why a recording is evidence, and what to do about that."""
    columns = (DiagnosisRow.id, DiagnosisRow.measurement, DiagnosisRow.request["measurements"])
    answers = session.execute(select(*columns).join(FindingRow, FindingRow.diagnosis == DiagnosisRow.id))
    found = [of for of, first, several in answers if key in (several or [first])]
    cure = f"say that it is routine first, with PUT /measurements/{key}/retention"
    return f" (a finding speaks of diagnosis {found[0]}): {cure}" if found else f": {cure}"


def empty_unspoken(session: Session, keys: Iterable[str]) -> None:
    """Take what senders said from the rows of deleted recordings that no diagnosis speaks of."""
    asked = set(keys)
    if not asked:
        return
    spoken = set(session.scalars(select(DiagnosisRow.measurement).where(DiagnosisRow.measurement.in_(asked))))
    several = DiagnosisRow.request["measurements"]
    for found in session.scalars(select(several).where(several.as_string().is_not(None))):
        spoken.update(found or ())
    query = select(MeasurementRow).where(MeasurementRow.id.in_(asked - spoken))
    damaged: list[Damaged] = []
    rows_of(session, MeasurementRow, query, damaged)
    numbers = [each.number for each in damaged]
    emptied: dict[str, Any] = {"name": "", "said": {}, "summary": {"channels": [], "warnings": []}}
    for row in session.scalars(query.where(MeasurementRow.number.not_in(numbers))):
        for name, value in emptied.items():
            setattr(row, name, value)
    # Of those the same goes, but they stay as damaged as they were.
    session.execute(update(MeasurementRow).where(MeasurementRow.number.in_(numbers)).values(emptied))


def tidy_folders(catalogues: Path) -> int:
    """Delete what is left of catalogues whose deletion was cut short; returns how many there were."""
    left = [path for path in catalogues.glob(f"{GOING}*") if path.is_dir()] if catalogues.is_dir() else []
    for path in left:
        shutil.rmtree(path, ignore_errors=True)
    return len(left)
