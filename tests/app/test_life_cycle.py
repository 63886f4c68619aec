"""What is deleted, what may not be, and what stays of it."""

from __future__ import annotations

import asyncio
import io
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from answers import diagnosis
from life_cycle import CONTENT, MACHINE, SUMMARY, class_of, diagnosed, files, found, pruner, statements, stored
from sqlalchemy import select

from jointplay import app
from jointplay.app.actor import Actor, acting
from jointplay.app.errors import (
    BuildOpenError,
    DeletedError,
    InUseError,
    ShippedMachineError,
    UnknownAssetError,
    UnknownMeasurementError,
)
from jointplay.app.etags import Conditions
from jointplay.app.jobs.standing_keeper import StandingKeeper
from jointplay.app.jobs.workers import WorkerPool
from jointplay.app.schemas.assets import AssetIn
from jointplay.app.storage import retention
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.audit import AuditLog
from jointplay.app.storage.build_queue import BuildDeathsRow, BuildQueue
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.machine_store import MachineStore
from jointplay.app.storage.removal import GOING, Removal
from jointplay.app.storage.rows import MeasurementRow, now
from jointplay.app.storage.standings import Due, Standings
from jointplay.app.storage.store import NewDiagnosis, Store
from jointplay.catalogue.following.standing import Known


def test_what_a_recording_is_follows_from_what_speaks_of_it(store: Store) -> None:
    routine, single, first, second, baseline = (stored(store, CONTENT + bytes([65 + k])) for k in range(5))
    Assets(store.database).put("press-7", AssetIn(machine="press", baseline=baseline.id))
    found(store, diagnosed(store, single))
    found(store, diagnosed(store, first, second))
    diagnosed(store, routine)
    classes = [class_of(store, row) for row in (routine, single, first, second, baseline)]
    assert classes == ["routine", "evidence", "evidence", "evidence", "baseline"]
    said = retention.say(store.database, routine.id, "evidence", None)
    assert (said.of, said.said, said.hold) == ("evidence", True, None)
    assert retention.say(store.database, routine.id, None, None).of == "routine"


def test_a_deleted_recording_says_so_and_may_come_back(store: Store) -> None:
    row = stored(store)
    (store.directory / "signals").mkdir()
    samples = store.directory / "signals" / f"{row.id}.npy"
    samples.touch()
    with acting(Actor(person="ann", address="10.0.0.9")):
        Removal(store).delete_measurement(row.id, "the customer has left")
    with pytest.raises(DeletedError, match=rf"{row.id}: was deleted at .* by ann: the customer has left"):
        store.measurement(row.id)
    with pytest.raises(DeletedError):
        Removal(store).delete_measurement(row.id, "")
    assert store.measurements(None, 10) == []
    assert files(store) == set()
    assert not samples.exists()
    with store.database.reading() as session:
        left = session.scalars(select(MeasurementRow)).one()
    assert (left.name, left.said, left.sha256) == ("", {}, row.sha256)  # nothing of what was said stays
    last = AuditLog(store.database).page(None, 1)[0]
    assert (last.action, last.kind, last.object, last.person) == ("deleted", "measurement", row.id, "ann")

    again = stored(store)
    assert (again.id, store.measurement(row.id).name) == (row.id, "a.csv")
    assert store.measurement(row.id).summary == SUMMARY
    assert store.path_of(row.sha256).read_bytes() == CONTENT


def test_a_diagnosis_outlives_its_recording(store: Store) -> None:
    row = stored(store)
    Assets(store.database).put("press-7", AssetIn(machine="press"))
    key = diagnosed(store, row, asset="press-7")
    Removal(store).delete_measurement(row.id, "")
    kept = store.diagnosis(key)
    assert store.deleted_of(kept) == [row.id]
    assert store.measurement_of(kept).name == "a.csv"
    assert store.measurements(None, 10, gone=True)[0].measured_at == row.measured_at  # its life goes on
    Removal(store).delete_diagnosis(key, "")
    with pytest.raises(DeletedError, match=f"diagnosis {key}"):
        store.diagnosis(key)
    with store.database.reading() as session:
        assert session.scalars(select(MeasurementRow)).one().name == ""
    with pytest.raises(UnknownMeasurementError):
        store.measurement("0" * 32)


def test_the_same_bytes_under_two_names_go_with_the_last(store: Store) -> None:
    one, two = stored(store, name="a.csv"), stored(store, name="b.csv")
    assert one.id != two.id
    Removal(store).delete_measurement(one.id, "")
    assert files(store) == {two.sha256}
    Removal(store).delete_measurement(two.id, "")
    assert files(store) == set()


@pytest.mark.parametrize(
    ("prepare", "cure"),
    [
        (lambda store, row: retention.say(store.database, row.id, None, "claim 7"), r"on hold \(claim 7\): lift that"),
        (
            lambda store, row: Assets(store.database).put("p", AssetIn(machine="press", baseline=row.id)),
            "baseline of asset p: give that another one first",
        ),
        (
            lambda store, row: found(store, diagnosed(store, row)),
            r"\(a finding speaks of diagnosis \w{32}\): say that",
        ),
        (
            lambda store, row: retention.say(store.database, row.id, "evidence", None),
            "is evidence: say that it is routine",
        ),
    ],
)
def test_what_is_needed_is_not_deleted(
    store: Store, prepare: Callable[[Store, MeasurementRow], Any], cure: str
) -> None:
    row = stored(store)
    prepare(store, row)
    with pytest.raises(InUseError, match=cure):
        Removal(store).delete_measurement(row.id, "")
    assert store.measurement(row.id).name == "a.csv"
    assert files(store) == {row.sha256}


def test_evidence_that_is_said_to_be_routine_may_go(store: Store) -> None:
    row = stored(store)
    key = diagnosed(store, row)
    finding = found(store, key)
    with pytest.raises(InUseError, match=f"finding {finding} speaks of it: delete that first"):
        Removal(store).delete_diagnosis(key, "")
    retention.say(store.database, row.id, "routine", None)
    Removal(store).delete_measurement(row.id, "")
    Removal(store).delete_finding(finding, "")
    with pytest.raises(DeletedError, match=f"finding {finding}"):
        Findings(store.database).finding(finding)
    Removal(store).delete_diagnosis(key, "")
    assert found(store, diagnosed(store, stored(store))) == finding  # all of it may come again
    assert Findings(store.database).finding(finding).diagnosis == store.diagnosis(key).id


def test_an_asset_leaves_its_recordings(store: Store) -> None:
    row = stored(store)
    assets = Assets(store.database)
    assets.put("press-7", AssetIn(machine="press", baselines=[row.id]))
    key = diagnosed(store, row, asset="press-7")
    finding = found(store, key)
    assert [each.id for each in Findings(store.database).of_machine("press", 5)] == [finding]
    retention.say(store.database, row.id, None, "claim 7")
    with pytest.raises(InUseError, match="claim 7"):
        Removal(store).delete_asset("press-7", "")
    retention.say(store.database, row.id, None, None)
    Removal(store).delete_asset("press-7", "sold")
    with pytest.raises(DeletedError, match=r"asset press-7: was deleted .*: sold"):
        assets.asset("press-7")
    assert store.measurement(row.id).id == store.diagnosis(key).measurement == row.id
    assert assets.put("press-7", AssetIn(machine="press"))[1]
    assert assets.asset("press-7").in_order == ()
    findings = Findings(store.database)
    assert findings.finding(finding).asset == "press-7"
    assert findings.of_asset(assets.asset("press-7"), 5) == findings.of_machine("press", 5) == []


def test_an_asset_that_is_deleted_while_something_works_for_it(store: Store) -> None:
    assets, standings, row = Assets(store.database), Standings(store.database), stored(store)
    key = diagnosed(store, row)
    assets.put("press-7", AssetIn(machine="press"))
    due = standings.take(now())
    assert due is not None
    standings.postpone(due, now())

    class Meanwhile:
        """Takes what is due, whose asset is deleted then."""

        def take(self, moment: datetime) -> Due | None:
            taken = standings.take(moment)
            Removal(store).delete_asset("press-7", "sold")
            return taken

        def __getattr__(self, name: str) -> Any:
            return getattr(standings, name)

    keeper: Any = StandingKeeper(store, WorkerPool.__new__(WorkerPool))
    keeper._standings = Meanwhile()
    assert asyncio.run(keeper.step())
    gone = r"^asset press-7: was deleted meanwhile$"
    with pytest.raises(UnknownAssetError, match=gone):
        standings.settle(due, Known(), now())
    with pytest.raises(UnknownAssetError, match=gone):
        assets.own("press-7", row.id)
    with pytest.raises(UnknownAssetError, match=gone), store.database.writing() as session:
        assets.note(session, "press-7", {}, key)
    upload = store.uploads.receive(io.BytesIO(b"late"))
    with pytest.raises(UnknownAssetError, match=gone):
        store.add_measurement(
            upload, "late.csv", None, SUMMARY, lambda session, made: assets.own_in(session, "press-7", made)
        )
    store.uploads.settle(upload)
    assert files(store) == {row.sha256}


def test_builds_that_ended_and_own_machines_may_go(store: Store) -> None:
    queue, removal = BuildQueue(store.database), Removal(store)
    row = queue.add({"name": "m"}, {"name": "p"}, "h" * 64, "made", None)
    with pytest.raises(BuildOpenError, match="has not ended: cancel it first"):
        removal.delete_build(row.id, "")
    queue.cancel(row.id)
    with store.database.writing() as session:  # it had died once
        session.add(BuildDeathsRow(build=row.id, in_a_row=1, most_done=0))
    removal.delete_build(row.id, "")
    with pytest.raises(DeletedError, match=f"build {row.id}"):
        queue.find(row.id)

    machines = MachineStore(store.directory / "machines")
    content = machines.find("slider-crank").canonical_json()
    for name in ("mine", "mine"):
        machines.put(name, content, Conditions())
    removal.delete_machine(machines, "mine", "")
    assert not list((store.directory / "machines").rglob("*.json"))
    assert machines.put("mine", content, Conditions())[1]
    assert machines.versions("mine") == [1]
    with pytest.raises(ShippedMachineError, match="cannot be deleted"):
        removal.delete_machine(machines, "slider-crank", "")


def test_a_catalogue_goes_whole(store: Store, tmp_path: Path) -> None:
    folder = tmp_path / "catalogues" / "made"
    (folder / "shards").mkdir(parents=True)
    queue = BuildQueue(store.database)
    row = queue.add({"name": "m"}, {"name": "p"}, "h" * 64, "made", None)
    with pytest.raises(InUseError, match=f"build {row.id} has not ended: cancel it first"):
        Removal(store).delete_catalogue(folder, "id", "")
    queue.cancel(row.id)
    measurement = stored(store)
    diagnosed(store, measurement)
    retention.say(store.database, measurement.id, None, "claim 7")
    with pytest.raises(InUseError, match="claim 7"):
        Removal(store).delete_catalogue(folder, "c", "")
    retention.say(store.database, measurement.id, None, None)
    Removal(store).delete_catalogue(folder, "c", "")
    assert list(folder.parent.iterdir()) == []
    (folder.parent / f"{GOING}made-1").mkdir()  # a server ended in the middle of it
    (going,) = pruner(store).look()
    assert (going.what, len(going.ids)) == ("catalogues", 1)
    list(pruner(store).prune())
    assert list(folder.parent.iterdir()) == []


def test_a_deletion_says_what_it_was(store: Store) -> None:
    assets, removal, log = Assets(store.database), Removal(store), AuditLog(store.database)
    row = stored(store)
    assets.put("press-7", AssetIn(machine="press", notes="hall 2"))
    key = diagnosed(store, row, asset="press-7")
    finding = found(store, key)
    build = BuildQueue(store.database).add({"name": "m"}, {"name": "p"}, "h" * 64, "made", None).id
    BuildQueue(store.database).cancel(build)
    removal.delete_finding(finding, "")
    removal.delete_diagnosis(key, "")
    removal.delete_asset("press-7", "")
    removal.delete_build(build, "")
    removal.delete_measurement(row.id, "")
    gone = {each.kind: each.before or {} for each in log.page(None, 50) if each.action == "deleted"}
    made = {each.kind: each.after or {} for each in log.page(None, 50) if each.action == "made"}
    for kind in ("finding", "diagnosis", "asset", "build"):
        assert gone[kind] == made[kind] != {}
    assert gone["measurement"]["members"] == {"sha256": row.sha256}


def test_what_is_deleted_is_put_on_no_hold(store: Store) -> None:
    row = stored(store)
    Removal(store).delete_measurement(row.id, "left")
    with pytest.raises(DeletedError, match="left"):
        retention.say(store.database, row.id, None, "claim 7")


def test_two_that_say_how_a_recording_is_kept_at_once(store: Store) -> None:
    row, holds = stored(store), ("claim 7", "claim 8", "claim 9", "claim 10")
    with ThreadPoolExecutor(len(holds)) as pool:
        said = list(pool.map(lambda hold: retention.say(store.database, row.id, None, hold).hold, holds))
    assert said == list(holds)
    if not store.database.is_sqlite:  # where rows are held one by one, a deletion waits for who says something
        asked = statements(store, lambda: retention.say(store.database, row.id, None, None))
        asked += statements(store, lambda: Removal(store).delete_measurement(row.id, ""))
        assert sum("FOR NO KEY UPDATE" in each and "FROM measurements" in each for each in asked) == 2


def test_as_many_recordings_as_there_are_may_be_evidence(store: Store) -> None:
    row, other = stored(store), stored(store, CONTENT + b"A")
    for first in (0, 24_000, 48_000):
        request = {"measurements": [row.id, *(f"{number:032x}" for number in range(first, first + 24_000))]}
        found(store, store.add_diagnosis(NewDiagnosis(row.id, "c", MACHINE, request, diagnosis())).id)
    assert (class_of(store, row), class_of(store, other)) == ("evidence", "routine")


def test_locks_of_a_database_differ() -> None:
    texts = [path.read_text() for path in Path(app.__file__).parent.rglob("*.py")]
    keys = [key for text in texts for key in re.findall(r"^\w+_LOCK = ([\d_]+)$", text, re.MULTILINE)]
    assert len(set(keys)) == len(keys) >= 3
