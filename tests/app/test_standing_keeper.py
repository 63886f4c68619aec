"""What an asset is known for outlives a failure: of a moment, or of one row."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any, cast

import pytest
from answers import hypothesis, joint
from life_cycle import diagnosed, stored
from sqlalchemy import text

from jointplay.app.errors import TimeLimitError, WorkerDiedError
from jointplay.app.jobs.standing_keeper import LATER, MOST_FAILURES, StandingKeeper
from jointplay.app.jobs.workers import TaskFailedError, WorkerPool
from jointplay.app.problems import problem_of
from jointplay.app.schemas.assets import AssetIn, FindingIn
from jointplay.app.storage.asset_rows import AssetRow
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.rows import now
from jointplay.app.storage.standings import Standings, standing_out
from jointplay.app.storage.store import Store
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.following.standing import JointKnown, Known
from jointplay.catalogue.following.state import CauseFollowed, Repair, WearState


class Failing:
    """Workers that fail at everything."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    async def run(self, *_: Any) -> Any:
        raise self.error


def keeper_of(store: Store, error: Exception) -> StandingKeeper:
    return StandingKeeper(store, cast(WorkerPool, Failing(error)))


def step(keeper: StandingKeeper) -> bool:
    return asyncio.run(keeper.step())


def asset(store: Store) -> AssetRow:
    return Assets(store.database).asset("press-7")


@pytest.fixture
def alarmed(store: Store) -> Store:
    """An asset of which joint A is beyond its limit, and that was heard again since."""
    Assets(store.database).put("press-7", AssetIn(machine="press"))
    joint = JointKnown(
        p_worn=1.0,
        p_over_limit=0.99,
        clearance_um=300.0,
        interval_um=(290.0, 310.0),
        limit_um=200.0,
        limit_at=(now(), now(), None),
    )
    due = Standings(store.database).take(now())
    assert due is not None
    known = Known(heard_at=now(), verdict="worn", joints={"A": joint})
    Standings(store.database).settle(due, known, now())
    diagnosed(store, stored(store), asset="press-7", verdict="in_order")
    assert asset(store).state == "alarm"
    return store


def failed(error: Exception) -> TaskFailedError:
    return TaskFailedError(problem_of(error))


PASSING: dict[str, Callable[[], Exception]] = {
    "late": lambda: TimeLimitError("stopped after 60 s"),
    "died": lambda: WorkerDiedError("ended early"),
    "failed": lambda: failed(KeyError("x")),
}


def due_at(store: Store) -> datetime:
    found = asset(store).due_at
    assert found is not None
    return found


def again(store: Store) -> None:
    """Let time pass until it is due."""
    with store.database.writing() as session:
        session.get_one(AssetRow, asset(store).number).due_at = now()


class Following:
    """Workers that find causes other than play, or repairs, in whatever they follow."""

    def __init__(self, *repairs: Repair, **causes: CauseFollowed) -> None:
        self.found = (repairs, causes)

    async def run(self, *_: Any) -> WearState:
        repairs, causes = self.found
        return WearState(at=now(), visits=2, joints={}, causes=causes, repairs=repairs)


def test_what_was_probably_worn_and_repaired_since_is_no_reason(store: Store) -> None:
    """A verdict of wear may name joints of which none is sure."""
    Assets(store.database).put("press-7", AssetIn(machine="press"))
    said = {
        "joints": {name: joint("open", 200.0, 0.6) for name in "AB"},
        "hypotheses": [hypothesis("A", 0.6, A=200.0), hypothesis("B", 0.4, B=200.0)],
    }
    diagnosed(store, stored(store), asset="press-7", verdict="worn", **said)
    for name, state in (("B", "watch"), ("A", "in_order")):
        with store.database.writing() as session:
            session.get_one(AssetRow, asset(store).number).changes += 1
        again(store)
        repair = Repair(at=now() + timedelta(minutes=1), joint=name, probability=1.0)
        assert step(StandingKeeper(store, cast(WorkerPool, Following(repair))))
        assert asset(store).state == state, asset(store).reasons


def test_a_cause_other_than_play_is_a_reason_and_outlives_a_failure(alarmed: Store) -> None:
    cause = CauseFollowed(
        unit="x stiffness", probability=0.97, size=0.62, per_year=-0.21, since=now(), since_baseline=True
    )
    assert step(StandingKeeper(alarmed, cast(WorkerPool, Following(**{"mount 1": cause}))))
    told = {"about": "cause mount 1", "state": "watch"}
    text = "Since its baseline, besides play: mount 1, 0.62 x stiffness (-0.21 a year), 97 %."
    assert {**told, "text": text} in asset(alarmed).reasons
    keeper = keeper_of(alarmed, PASSING["late"]())
    with alarmed.database.writing() as session:
        session.get_one(AssetRow, asset(alarmed).number).changes += 1
    for _ in range(MOST_FAILURES):
        again(alarmed)
        assert step(keeper)
    assert {**told, "text": text} in asset(alarmed).reasons
    assert any(reason["about"] == "wear" for reason in asset(alarmed).reasons)


@pytest.mark.parametrize("kind", PASSING)
def test_a_failure_of_a_moment_leaves_an_asset_as_it_stood_and_is_tried_again(alarmed: Store, kind: str) -> None:
    before = asset(alarmed)
    began = now()
    assert step(keeper_of(alarmed, PASSING[kind]()))
    row = asset(alarmed)
    same = ("state", "reasons", "known", "said", "followed", "need", "limit_at")
    assert [getattr(row, name) for name in same] == [getattr(before, name) for name in same]
    assert began + LATER <= due_at(alarmed) <= now() + LATER
    assert not standing_out(row).up_to_date
    assert not step(keeper_of(alarmed, PASSING[kind]())), "not before that"


def test_a_failure_that_does_not_pass_is_told_beside_what_is_known_of_the_joints(alarmed: Store) -> None:
    keeper = keeper_of(alarmed, TimeLimitError("stopped after 60 s"))
    for _ in range(MOST_FAILURES - 1):
        assert step(keeper)
        assert asset(alarmed).reasons[-1]["about"] == "joint A"
        again(alarmed)
    assert step(keeper)
    row = asset(alarmed)
    assert (row.state, [reason.about for reason in row.judged]) == ("alarm", ["joint A", "wear"])
    assert row.judged[1].text == "Its wear could not be followed: stopped after 60 s"
    assert (standing_out(row).up_to_date, standing_out(row).verdict) == (True, "in_order")


def test_a_failure_of_what_was_asked_is_told_at_once(alarmed: Store) -> None:
    assert step(keeper_of(alarmed, failed(DiagnosisError("visits: joint Z: must be one of A"))))
    row = asset(alarmed)
    assert [reason.text for reason in row.judged] == [
        "Its wear could not be followed: visits: joint Z: must be one of A"
    ]


@pytest.mark.parametrize("which", ["last", "earlier"])
def test_a_damaged_row_of_an_asset_leaves_its_joints(alarmed: Store, which: str) -> None:
    later = alarmed.correct_moment(stored(alarmed, b"other").id, now() + timedelta(minutes=1))
    keys = {
        "earlier": diagnosed(alarmed, stored(alarmed), asset="press-7", verdict="in_order"),
        "last": diagnosed(alarmed, later, asset="press-7"),
    }
    with alarmed.database.engine.begin() as connection:
        connection.execute(text(f"UPDATE diagnoses SET made_by = 'somebody else' WHERE id = '{keys[which]}'"))
    assert step(keeper_of(alarmed, KeyError("is not asked")))
    row = asset(alarmed)
    assert row.state == "alarm"
    assert [reason.about for reason in row.judged if reason.about != "verdict"] == ["joint A", "wear"]
    (said,) = (reason.text for reason in row.judged if reason.about == "wear")
    assert f"Its wear could not be followed: diagnosis {keys[which]}: its row is not what was written" in said


def test_an_answer_across_a_repair_alone_says_nothing_of_an_asset(store: Store) -> None:
    Assets(store.database).put("press-8", AssetIn(machine="press"))
    days = [now() - timedelta(days=each) for each in (3, 1)]
    rows = [store.correct_moment(stored(store, str(day).encode()).id, day) for day in days]
    key = diagnosed(store, *rows, asset="press-8", verdict="worn")
    said = {"joints": {"A": {"repaired": True}}, "at": (now() - timedelta(days=2)).isoformat()}
    Findings(store.database).add(store.diagnosis(key), FindingIn.model_validate(said))
    assert step(keeper_of(store, KeyError("is not asked")))
    row = Assets(store.database).asset("press-8")
    assert (row.state, [reason.about for reason in row.judged]) == ("unknown", ["wear"])
    assert "were diagnosed together only" in row.judged[0].text


def test_what_was_repaired_stays_so_where_following_fails(alarmed: Store) -> None:
    key = diagnosed(alarmed, stored(alarmed), asset="press-7", verdict="worn")
    due = Standings(alarmed.database).take(now())
    assert due is not None
    Standings(alarmed.database).settle(due, Known(heard_at=now(), verdict="worn", diagnosis=key, repaired=True), now())
    with alarmed.database.writing() as session:
        session.get_one(AssetRow, asset(alarmed).number).changes += 1
    keeper = keeper_of(alarmed, PASSING["late"]())
    for _ in range(MOST_FAILURES):
        again(alarmed)
        assert step(keeper)
    assert [reason.about for reason in asset(alarmed).judged] == ["wear"]


@pytest.mark.parametrize("has_finding", [False, True])
def test_another_date_of_what_teaches_makes_all_of_the_kind_due(store: Store, has_finding: bool) -> None:
    assets = Assets(store.database)
    for name in ("press-1", "press-2"):
        assets.put(name, AssetIn(machine="press"))
    measured = stored(store)
    key = diagnosed(store, measured, asset="press-1")
    if has_finding:
        found = {"joints": {"A": {"clearance_um": 140}}, "at": now().isoformat()}
        Findings(store.database).add(store.diagnosis(key), FindingIn.model_validate(found))
    before = assets.asset("press-2").changes
    store.correct_moment(measured.id, now() - timedelta(days=3))
    assert assets.asset("press-2").changes - before == has_finding
