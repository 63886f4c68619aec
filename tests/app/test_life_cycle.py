"""What is deleted, what may not be, what stays of it, and what goes by itself."""

from __future__ import annotations

import asyncio
import io
import os
import re
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from answers import diagnosis
from sqlalchemy import event, select, update
from sqlalchemy.orm import Session

from jointplay import app
from jointplay.app.actor import Actor, acting
from jointplay.app.errors import (
    BuildOpenError,
    BusyError,
    DeletedError,
    InUseError,
    QuotaError,
    ShippedMachineError,
    UnknownAssetError,
    UnknownMeasurementError,
)
from jointplay.app.etags import Conditions
from jointplay.app.jobs.housekeeper import Housekeeper
from jointplay.app.jobs.standing_keeper import StandingKeeper
from jointplay.app.jobs.workers import WorkerPool
from jointplay.app.schemas.assets import AssetIn, FindingIn
from jointplay.app.storage import retention
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.audit import AuditLog
from jointplay.app.storage.build_queue import BuildDeathsRow, BuildQueue
from jointplay.app.storage.idempotency import IdempotencyRow
from jointplay.app.storage.machine_store import MachineStore
from jointplay.app.storage.pruning import Pruner
from jointplay.app.storage.removal import GOING, Removal
from jointplay.app.storage.retention import Quotas, kept_of
from jointplay.app.storage.rows import DiagnosisRow, MeasurementRow, now
from jointplay.app.storage.standings import Due, Standings
from jointplay.app.storage.store import NewDiagnosis, Store
from jointplay.app.storage.stored_files import ABANDONED_S, ORPHANS_S, PARTIAL, StoredFiles
from jointplay.app.storage.usage import days_to_fill, measure
from jointplay.app.storage.webhooks import DeliveryRow, Webhooks, announce
from jointplay.catalogue.following.standing import Known

SUMMARY = {"kind": "recording", "channels": [{"name": "s1-x", "unit": "g"}], "warnings": [], "import_report": []}
MACHINE = {"name": "press", "joints": {"A": {"kind": "turning"}}}
CONTENT = b"t,s1-x\n0,1\n"


def stored(store: Store, content: bytes = CONTENT, name: str = "a.csv") -> MeasurementRow:
    upload = store.receive(io.BytesIO(content))
    try:
        return store.add_measurement(upload, name, None, SUMMARY)
    finally:
        store.settle(upload)


def diagnosed(store: Store, *measurements: MeasurementRow, asset: str | None = None, catalogue: str = "c") -> str:
    ids = [each.id for each in measurements]
    request = {"asset": asset, "measurements": ids if len(ids) > 1 else None}

    def also(session: Session, key: str) -> None:
        if asset is not None:
            Assets(store.database).note(session, asset, ids, key)

    return store.add_diagnosis(NewDiagnosis(ids[0], catalogue, MACHINE, request, diagnosis(), also)).id


def found(store: Store, diagnosis: str) -> str:
    said = FindingIn.model_validate({"joints": {"A": {"clearance_um": 140}}, "at": "2026-11-21T10:30:00Z"})
    return Assets(store.database).add_finding(store.diagnosis(diagnosis), said).id


def class_of(store: Store, row: MeasurementRow) -> str:
    with store.database.reading() as session:
        return kept_of(session, row.id).of


def aged(store: Store, *rows: MeasurementRow, days: float = 100.0) -> None:
    with store.database.writing() as session:
        for row in rows:
            session.get_one(MeasurementRow, row.number).created_at = now() - timedelta(days=days)


def pruner(store: Store, **keep_days: float) -> Pruner:
    return Pruner(store, store.directory / "catalogues", keep_days)


def files(store: Store) -> set[str]:
    return {path.name for path in (store.directory / "measurements").rglob("*") if path.is_file()}


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
        Assets(store.database).finding(finding)
    Removal(store).delete_diagnosis(key, "")
    assert found(store, diagnosed(store, stored(store))) == finding  # all of it may come again
    assert Assets(store.database).finding(finding).diagnosis == store.diagnosis(key).id


def test_an_asset_leaves_its_recordings(store: Store) -> None:
    row = stored(store)
    assets = Assets(store.database)
    assets.put("press-7", AssetIn(machine="press", baselines=[row.id]))
    key = diagnosed(store, row, asset="press-7")
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
        assets.note(session, "press-7", [], key)
    upload = store.receive(io.BytesIO(b"late"))
    with pytest.raises(UnknownAssetError, match=gone):
        store.add_measurement(
            upload, "late.csv", None, SUMMARY, lambda session, made: assets.own_in(session, "press-7", made)
        )
    store.settle(upload)
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


def test_recordings_go_when_their_time_is_over(store: Store) -> None:
    rows = [stored(store, CONTENT + bytes([65 + k]) * (k + 1)) for k in range(6)]
    routine, young, held, baseline, evidence, same = rows
    twin = stored(store, CONTENT + b"F" * 6, name="twin.csv")
    assert twin.sha256 == same.sha256
    Assets(store.database).put("press-7", AssetIn(machine="press", baseline=baseline.id))
    found(store, diagnosed(store, evidence))
    retention.say(store.database, held.id, "routine", "claim 7")
    retention.say(store.database, baseline.id, "routine", None)  # which it is all the same
    aged(store, routine, held, baseline, evidence, same)
    assert pruner(store).look() == []
    keeper = pruner(store, routine=90.0, evidence=3650.0)
    (going,) = keeper.look()
    assert set(going.ids) == {routine.id, same.id}
    assert (going.what, going.why) == ("routine recordings", "kept for 90 days")
    assert going.size_bytes == routine.size_bytes + same.size_bytes
    assert len(files(store)) == 6  # it was only looked at
    (gone,) = keeper.prune()
    assert set(gone.ids) == set(going.ids)
    assert files(store) == {row.sha256 for row in (young, held, baseline, evidence, twin)}
    assert list(keeper.prune()) == []
    with pytest.raises(DeletedError, match="by system: kept for 90 days"):
        store.measurement(routine.id)
    (gone,) = pruner(store, evidence=50.0).prune()
    assert gone.ids == (evidence.id,)


def test_a_damaged_row_keeps_no_other_from_going_and_goes_when_it_is_told(
    store: Store, caplog: pytest.LogCaptureFixture
) -> None:
    rows = [stored(store, CONTENT + bytes([65 + k])) for k in range(3)]
    key = diagnosed(store, rows[2])
    found(store, key)
    aged(store, *rows)
    with store.database.writing() as session:
        damage = update(MeasurementRow).where(MeasurementRow.id == rows[0].id).values(name="other.csv")
        session.execute(damage)
        session.execute(update(DiagnosisRow).values(catalogue="other"))
    (gone,) = pruner(store, routine=90.0).prune()
    assert gone.ids == (rows[1].id,)
    assert f"not tidied up: measurement {rows[0].id}: its row is not what was written" in caplog.text
    with pytest.raises(InUseError, match=rf"\(a finding speaks of diagnosis {key}\)"):
        Removal(store).delete_measurement(rows[2].id, "")
    Removal(store)._bury_catalogue("made", "other", "")
    Removal(store).delete_measurement(rows[0].id, "damaged")
    assert files(store) == {rows[2].sha256}
    with store.database.reading() as session:
        assert session.scalar(select(MeasurementRow.name).where(MeasurementRow.id == rows[0].id)) == ""
    with pytest.raises(DeletedError, match="damaged"):
        Removal(store).delete_measurement(rows[0].id, "")


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


def statements(store: Store, act: Callable[[], Any]) -> list[str]:
    """What a database is asked meanwhile."""
    asked: list[str] = []

    def note(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        asked.append(statement)

    event.listen(store.database.engine, "before_cursor_execute", note)
    act()
    event.remove(store.database.engine, "before_cursor_execute", note)
    return asked


def test_assets_and_kept_answers_are_touched_once_for_a_batch(store: Store) -> None:
    rows = [stored(store, CONTENT + bytes([65 + k])) for k in range(3)]
    assets = Assets(store.database)
    for row, name in zip(rows, ("c", "b", "a"), strict=True):
        assets.put(name, AssetIn(machine="press"))
        assets.own(name, row.id)
    with store.database.writing() as session:
        for row in rows:
            kept = {"location": f"/api/v1/measurements/{row.id}"}
            session.add(IdempotencyRow(id=row.id, fingerprint="f", created_at=now(), headers=kept, body=b""))
    changes = [assets.asset(name).changes for name in "abc"]
    asked = statements(store, lambda: Removal(store).delete_measurements([row.id for row in rows], ""))
    assert sum(each.startswith("UPDATE assets") for each in asked) == 1
    assert sum(each.startswith("DELETE FROM idempotency") for each in asked) == 1
    assert [assets.asset(name).changes for name in "abc"] == [count + 1 for count in changes]
    with store.database.reading() as session:
        assert session.scalars(select(IdempotencyRow)).all() == []


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


def test_what_killed_servers_left_is_tidied_while_others_run(store: Store) -> None:
    row = stored(store)
    late = store.receive(io.BytesIO(b"sending"))  # killed here: the bytes have no name yet
    named = store.receive(io.BytesIO(b"named"))
    store._name(named)  # and here: they have it, but no row
    young = store.receive(io.BytesIO(b"young"))
    old = time.time() - ABANDONED_S - 60
    for path in (late.path, store.path_of(named.sha256), store.path_of(row.sha256)):
        os.utime(path, (old, old))
    stranger = store.path_of(row.sha256).with_name("notes.txt")
    stranger.write_text("not ours")
    os.utime(stranger, (old, old))
    assert [(each.what, each.ids) for each in pruner(store).look()] == [
        ("uploads that broke off", (late.path.name,)),
        ("files of no recording", (named.sha256,)),
    ]
    assert len(list(pruner(store).prune())) == 2
    assert files(store) == {young.path.name, row.sha256, "notes.txt"}
    assert young.path.name.startswith(PARTIAL)
    aside = store.directory / "orphans" / named.sha256
    assert aside.read_bytes() == b"named"
    os.utime(aside, (old, old))
    assert list(pruner(store).prune()) == []  # a day is not enough
    month = time.time() - ORPHANS_S - 60
    os.utime(aside, (month, month))
    expected = [("files in orphans/", (named.sha256,))]
    assert [(each.what, each.ids) for each in pruner(store).look()] == expected
    assert [(each.what, each.ids) for each in pruner(store).prune()] == expected
    assert not aside.exists()


def age_files(store: Store, *, by_s: float = ABANDONED_S + 60) -> None:
    for path in (store.directory / "measurements").rglob("*"):
        os.utime(path, (time.time() - by_s,) * 2)


def test_nothing_goes_beside_the_database_of_another(
    url: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with closing(Store(tmp_path / "data", url)) as store:
        rows = [stored(store, CONTENT + bytes([65 + k])) for k in range(3)]
        age_files(store)
        assert store.files.why_apart() == ""
    with closing(Store(tmp_path / "data", f"sqlite:///{tmp_path / 'wrong.sqlite'}")) as wrong:
        for _ in range(2):
            assert "it has the id of another database than" in pruner(wrong).why_apart()
            assert pruner(wrong).look() == list(pruner(wrong).prune()) == []
            (tmp_path / "data" / "database.id").unlink(missing_ok=True)  # as folders of before there were ids
            assert "most of its files are of another database than" in pruner(wrong).why_apart()
            assert pruner(wrong).look() == list(pruner(wrong).prune()) == []
            stored(wrong, b"new")  # one that is spoken of is not most of them
            (tmp_path / "data" / "database.id").write_text("0" * 32)
        keeper = Housekeeper(pruner(wrong))
        keeper.step()
        keeper.step()
        assert caplog.text.count("files of no recording stay there; name the right one in JOINTPLAY_DATABASE") == 1
        assert {row.sha256 for row in rows} < files(wrong)
        (tmp_path / "data" / "database.id").unlink()
    with closing(Store(tmp_path / "data", url)) as store:
        age_files(store)
        (gone,) = pruner(store).prune()  # most of its files are its own: that of the other is put aside
        assert gone.what == "files of no recording"
        assert files(store) == {row.sha256 for row in rows}
        assert (tmp_path / "data" / "database.id").is_file()


def test_what_was_put_aside_comes_back_with_its_row(store: Store) -> None:
    row = stored(store)
    aside = store.directory / "orphans" / row.sha256
    aside.parent.mkdir()
    store.path_of(row.sha256).rename(aside)  # its row had been lost, and is back from a backup
    assert list(pruner(store).prune()) == []
    assert store.path_of(row.sha256).read_bytes() == CONTENT
    assert not aside.exists()


def test_what_fails_keeps_nothing_else_from_going(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    late = store.receive(io.BytesIO(b"sending"))
    os.utime(late.path, (0, 0))

    def fail(*_: object, **__: object) -> None:
        raise OSError("no")

    monkeypatch.setattr(Pruner, "_prune_expired", fail)
    monkeypatch.setattr(Pruner, "_prune_told", fail)
    with pytest.raises(OSError, match="no") as failed:
        list(pruner(store).prune())
    assert failed.value.__notes__ == ["besides: OSError: no"]
    assert not late.path.exists()


def test_deliveries_that_were_made_go(store: Store) -> None:
    hooks = Webhooks(store.database)
    hook = hooks.add("http://127.0.0.1:9/x", ["finding.created"])
    for _ in range(3):
        with store.database.writing() as session:
            announce(session, "finding.created", {"finding": "f"})
    waiting, recent, old = hooks.deliveries(hook.id, None, 5)
    month = now() - timedelta(days=31)
    with store.database.writing() as session:
        for key, state in ((recent.id, "delivered"), (old.id, "delivered")):
            session.execute(update(DeliveryRow).where(DeliveryRow.id == key).values(state=state))
        session.execute(update(DeliveryRow).where(DeliveryRow.id != recent.id).values(created_at=month))
    (gone,) = pruner(store).prune()
    assert (gone.what, gone.ids) == ("deliveries of webhooks", (old.id,))
    assert {each.id for each in hooks.deliveries(hook.id, None, 5)} == {waiting.id, recent.id}


def test_bytes_that_are_deleted_while_they_come_are_not_acknowledged(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the moment at which a file has its name and its row, somebody deletes the last row of the same bytes."""
    row = stored(store)
    lock = StoredFiles.lock

    def others(self: StoredFiles, session: Session, *, alone: bool) -> None:
        lock(self, session, alone=alone)
        if not alone:
            store.path_of(row.sha256).unlink()

    monkeypatch.setattr(StoredFiles, "lock", others)
    with pytest.raises(BusyError, match="deleted at this moment; send them again"):
        stored(store, name="b.csv")
    assert len(store.measurements(None, 10)) == 1


def test_a_deletion_that_is_cut_short_leaves_no_row_without_its_file(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = stored(store)

    def killed(*_arguments: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as dying:
        dying.setattr(StoredFiles, "drop", killed)
        with pytest.raises(KeyboardInterrupt):
            Removal(store).delete_measurement(row.id, "")
    with pytest.raises(DeletedError):
        store.measurement(row.id)
    assert files(store) == {row.sha256}
    os.utime(store.path_of(row.sha256), (0, 0))
    (gone,) = pruner(store).prune()
    assert (gone.what, gone.ids) == ("files of no recording", (row.sha256,))


def test_a_quota_says_what_is_used_and_allowed(url: str, tmp_path: Path) -> None:
    size = len(CONTENT) + 1
    with closing(Store(tmp_path, url, Quotas(3 * size, 2 * size))) as store:
        check_quotas(store)


def check_quotas(store: Store) -> None:
    with acting(Actor(key="k1")):
        one, _ = (stored(store, CONTENT + bytes([65 + k])) for k in range(2))
        with pytest.raises(QuotaError, match=r"2.4e-05 MB of 2.4e-05 MB are used by key k1; this has 1.2e-05 MB"):
            stored(store, CONTENT + b"C")
        assert stored(store, CONTENT + b"A").id == one.id  # what is there already is no more
    assert len(files(store)) == 2  # neither row nor file of what was refused
    with acting(Actor(key="k2")):
        stored(store, CONTENT + b"D")
        with pytest.raises(QuotaError, match="are used by all together"):
            stored(store, CONTENT + b"E")
    Removal(store).delete_measurement(one.id, "")
    with acting(Actor(key="k1")):
        stored(store, CONTENT + b"C")


def test_a_quota_of_a_person_who_signed_in_at_a_proxy(url: str, tmp_path: Path) -> None:
    with closing(Store(tmp_path, url, Quotas(None, 2 * len(CONTENT) + 2))) as store:
        for who, letters in (("ann", b"AB"), ("x" * 300, b"CD"), ("x" * 299, b"")):
            with acting(Actor(person=who, address="192.0.2.7")):
                for letter in letters:
                    stored(store, CONTENT + bytes([letter]))
                with pytest.raises(QuotaError, match=f"are used by {who[:256]};"):
                    stored(store, CONTENT + b"E")
        with acting(Actor(address="192.0.2.7")):  # without keys nobody is known who could be held to it
            stored(store, CONTENT + b"E")


def test_when_a_disk_is_full() -> None:
    assert days_to_fill(100.0, []) == float("inf")
    assert days_to_fill(100.0, [(10.0, float("inf"))]) == 10.0
    assert days_to_fill(100.0, [(10.0, 50.0)]) == float("inf")  # as much goes as comes before it is full
    assert days_to_fill(100.0, [(10.0, 50.0), (5.0, float("inf"))]) == 10.0  # 50 and 25 in 5 days, then 5 a day
    assert days_to_fill(0.0, [(1.0, float("inf"))]) == 0.0


def test_what_is_stored_is_measured(store: Store) -> None:
    rows = [stored(store, CONTENT + bytes(1000 * k)) for k in range(3)]
    found(store, diagnosed(store, rows[2]))
    aged(store, rows[0], days=30.0)
    usage = measure(store)
    routine, evidence = usage.classes["routine"], usage.classes["evidence"]
    assert (routine.count, evidence.count, usage.classes["baseline"].count) == (2, 1, 0)
    assert routine.size_bytes == rows[0].size_bytes + rows[1].size_bytes
    assert routine.per_day == pytest.approx(rows[1].size_bytes / 7)  # of a week; the first came before
    assert evidence.per_day == pytest.approx(rows[2].size_bytes)  # of the day since which it is there
    assert routine.oldest is not None and now() - routine.oldest > timedelta(days=29)
    assert usage.database_bytes > 10_000
    daily = routine.per_day + evidence.per_day + usage.database_per_day
    assert usage.days_until_full({}) == pytest.approx(usage.free_bytes / daily)
    Removal(store).delete_measurement(rows[1].id, "")
    assert measure(store).classes["routine"].count == 1
