"""How assets stand, in every kind of database: judged once for a change, told once, by whichever server."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from answers import diagnosis
from life_cycle import diagnosed, stored
from sqlalchemy import delete, select, text
from uploaded import uploaded

from jointplay.app.errors import BadFieldError, DamagedRowError
from jointplay.app.jobs.following import gather
from jointplay.app.schemas.assets import AssetIn, FindingIn
from jointplay.app.schemas.webhooks import EVENTS
from jointplay.app.storage.asset_rows import AssetDiagnosisRow, AssetRow
from jointplay.app.storage.assets import AsRead, Assets
from jointplay.app.storage.build_queue import BuildQueue
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.removal import Removal
from jointplay.app.storage.rows import now
from jointplay.app.storage.standings import LEASE, Due, Standings, standing_out
from jointplay.app.storage.store import NewDiagnosis, Store
from jointplay.app.storage.webhooks import DeliveryRow, Webhooks
from jointplay.catalogue.following.standing import JointKnown, Known

NOW = now().replace(microsecond=0)
MACHINE = {"name": "m", "joints": {"B": {"kind": "turning"}}}


def wears(p_over: float = 0.0, um: float = 140.0, likely: float | None = None, heard: float = -1.0) -> Known:
    """An asset whose joint B is worn."""
    at = None if likely is None else NOW + timedelta(days=likely)
    limit_at = (at, at, None)
    joint = JointKnown(
        p_worn=1.0, p_over_limit=p_over, clearance_um=um, interval_um=(um, um), limit_um=200.0, limit_at=limit_at
    )
    return Known(heard_at=NOW + timedelta(days=heard), verdict="worn", joints={"B": joint})


@pytest.fixture
def stores(url: str, tmp_path: Path) -> Iterator[list[Store]]:
    """What two servers of one database have, and a webhook that is told everything."""
    with ExitStack() as stack:
        found = [stack.enter_context(closing(Store(tmp_path, url))) for _ in range(2)]
        Webhooks(found[0].database).add("http://127.0.0.1:9/", EVENTS)
        yield found


def put(store: Store, name: str = "press-7", **members: Any) -> AssetRow:
    return Assets(store.database).put(name, AssetIn.model_validate({"machine": "m", **members}))[0]


def asset(store: Store, name: str = "press-7") -> AssetRow:
    return Assets(store.database).asset(name)


def taken(store: Store, moment: datetime | None = None) -> Due:
    due = Standings(store.database).take(moment or now())
    assert due is not None
    return due


def told(store: Store) -> list[tuple[str, dict[str, Any]]]:
    """Everything that was told, the first first."""
    with store.database.reading() as session:
        rows = session.scalars(select(DeliveryRow).order_by(DeliveryRow.number))
        return [(row.event, json.loads(row.body)["data"]) for row in rows]


def judged(store: Store, known: Known, moment: datetime = NOW) -> AssetRow:
    """The asset when it was judged by this."""
    put(store, notes=f"{known} {moment}")  # whatever it is that has changed
    Standings(store.database).settle(taken(store), known, moment)
    return asset(store)


def test_a_new_asset_is_due_and_nothing_is_told_of_it(stores: list[Store]) -> None:
    row = put(stores[0])
    assert (row.state, [each.about for each in row.judged]) == ("unknown", ["wear"])
    assert standing_out(row).up_to_date is False
    due = taken(stores[0])
    assert (due.external_id, due.known) == ("press-7", None)
    assert Standings(stores[1].database).take(now()) is None, "one server has it"
    Standings(stores[0].database).settle(due, Known(), now())
    assert asset(stores[0]).due_at is None
    assert standing_out(asset(stores[1])).up_to_date is True
    assert told(stores[0]) == []


def test_what_a_killed_server_had_taken_is_due_again(stores: list[Store]) -> None:
    put(stores[0])
    moment = now()
    first = taken(stores[0], moment)
    assert Standings(stores[1].database).take(moment + LEASE - timedelta(seconds=1)) is None
    assert taken(stores[1], moment + LEASE) == first


def test_each_change_is_told_once(stores: list[Store]) -> None:
    store = stores[0]
    judged(store, wears())
    judged(store, wears(um=141.0))
    judged(store, wears(0.9, 230.0))
    states = [(event, data["before"], data["state"]) for event, data in told(store)]
    assert states == [
        ("asset.state_changed", "unknown", "watch"),
        ("asset.state_changed", "watch", "alarm"),
    ]
    event = told(store)[-1][1]
    assert (event["asset"], event["machine"], event["reasons"][0]["about"]) == ("press-7", "m", "joint B")
    judged(store, Known(heard_at=NOW, verdict="in_order"))
    assert told(store)[-1][1]["state"] == "in_order"
    assert len(told(store)) == 3


def test_two_servers_that_judge_the_same_tell_it_once(stores: list[Store]) -> None:
    put(stores[0])
    moment = now()
    dues = [taken(stores[0], moment), taken(stores[1], moment + LEASE)]
    begin = threading.Barrier(2)

    def settle(number: int) -> None:
        begin.wait(300)
        Standings(stores[number].database).settle(dues[number], wears(0.9, 230.0), NOW)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(settle, range(2)))
    assert [event for event, _ in told(stores[0])] == ["asset.state_changed"]


def test_what_changes_while_it_is_judged_is_judged_again(stores: list[Store]) -> None:
    put(stores[0])
    due = taken(stores[0])
    put(stores[1], notes="moved")
    late = taken(stores[1])
    Standings(stores[1].database).settle(late, wears(0.9, 230.0), NOW)
    Standings(stores[0].database).settle(due, wears(), NOW)  # which knows less
    assert asset(stores[0]).state == "alarm"
    put(stores[0], notes="again")
    due = taken(stores[0])
    put(stores[1], notes="and again")
    Standings(stores[0].database).settle(due, wears(), NOW)
    row = asset(stores[0])
    assert (row.state, standing_out(row).up_to_date) == ("watch", False)
    assert taken(stores[1]).known is None


def test_nothing_is_told_of_a_transaction_that_fails(stores: list[Store], monkeypatch: pytest.MonkeyPatch) -> None:
    """As a server that is killed before its end."""
    store = stores[0]
    put(store)
    due = taken(store)
    with monkeypatch.context() as broken:
        broken.setattr("jointplay.app.storage.standings.need_of", lambda _row: {}["killed"])
        with pytest.raises(KeyError):
            Standings(store.database).settle(due, wears(0.9, 230.0), NOW)
    assert told(store) == [] and asset(store).state == "unknown"
    Standings(store.database).settle(taken(stores[1], now() + LEASE), wears(0.9, 230.0), NOW)
    assert [event for event, _ in told(store)] == ["asset.state_changed"]


def test_silence_is_told_once_until_it_ends_and_comes_by_time_alone(stores: list[Store]) -> None:
    store = stores[0]
    heard = Known(heard_at=NOW, verdict="in_order")
    row = judged(store, heard)
    put(store, silent_after_days=7)
    Standings(store.database).settle(taken(store), heard, NOW)
    row = asset(store)
    assert (row.state, row.due_at) == ("in_order", NOW + timedelta(days=7))
    assert Standings(store.database).take(NOW + timedelta(days=6)) is None
    later = NOW + timedelta(days=7)
    due = taken(store, later)
    assert due.known == heard, "nothing has to be followed again for that"
    Standings(store.database).settle(due, due.known, later)
    row = asset(store)
    assert (row.state, row.due_at) == ("unknown", None)
    events = [event for event, _ in told(store)]
    assert events[-2:] == ["asset.state_changed", "asset.silent"]
    assert told(store)[-1][1] == {
        "asset": "press-7",
        "machine": "m",
        "heard_at": NOW.isoformat(),
        "silent_after_days": 7,
    }
    put(store, silent_after_days=7, notes="still")
    Standings(store.database).settle(taken(store), heard, later)
    assert len(told(store)) == len(events)
    put(store, silent_after_days=7, notes="heard")
    Standings(store.database).settle(taken(store), heard.model_copy(update={"heard_at": later}), later)
    put(store, silent_after_days=7, notes="silent again")
    Standings(store.database).settle(taken(store), heard, later)
    assert [event for event, _ in told(store)].count("asset.silent") == 2


def test_a_limit_that_is_near_is_told_once_until_it_leaves(stores: list[Store]) -> None:
    store = stores[0]
    for likely in (100, 29, 25, 100, 20):
        judged(store, wears(likely=likely))
    said = [data for event, data in told(store) if event == "limit.predicted"]
    assert len(said) == 2
    assert said[0]["joint"] == "B" and said[0]["limit_um"] == 200.0
    assert datetime.fromisoformat(said[0]["limit_at"][1]) == NOW + timedelta(days=29)
    row = judged(store, wears(likely=100))
    assert (row.due_at, row.limit_at) == (NOW + timedelta(days=29), NOW + timedelta(days=100))  # it is silent first


def test_what_is_acknowledged_holds_until_it_gets_worse_or_has_another_reason(stores: list[Store]) -> None:
    store = stores[0]
    standings = Standings(store.database)
    judged(store, wears())
    with pytest.raises(BadFieldError, match="state: alarm: press-7 is watch now"):
        standings.acknowledge("press-7", "alarm", "key of hall B", "")
    standings.acknowledge("press-7", "watch", "key of hall B", "bearing is ordered")
    row = judged(store, wears(um=150.0))
    seen = standing_out(row).acknowledged
    assert seen is not None and (seen.by, seen.note) == ("key of hall B", "bearing is ordered")
    assert row.need == 2
    assert judged(store, wears(0.9, 230.0)).acknowledged is None
    standings.acknowledge("press-7", "alarm", "", "")
    row = judged(store, wears(um=150.0))
    assert row.acknowledged is not None, "it got better"
    other = wears(um=150.0).model_copy(update={"heard_at": NOW - timedelta(days=40)})
    assert judged(store, other).acknowledged is None, "and is silent besides"
    standings.acknowledge("press-7", "watch", "", "")
    standings.forget_acknowledgement("press-7")
    assert asset(store).need == 12
    judged(store, Known(heard_at=NOW, verdict="in_order"))
    with pytest.raises(BadFieldError, match="there is nothing to acknowledge"):
        standings.acknowledge("press-7", "in_order", "", "")


def test_what_needs_somebody_most_comes_first(stores: list[Store]) -> None:
    store = stores[0]
    cases = {
        "fine": Known(heard_at=NOW, verdict="in_order"),
        "seen": wears(0.9, 230.0),
        "later": wears(likely=200),
        "sooner": wears(likely=90),
        "alarm": wears(0.9, 230.0),
        "no-date": wears(),
    }
    for name, known in cases.items():
        put(store, name)
        Standings(store.database).settle(taken(store), known, NOW)
    Standings(store.database).acknowledge("seen", "alarm", "", "")
    found = Assets(store.database)
    order = ["alarm", "sooner", "later", "no-date", "seen", "fine"]
    assert [row.external_id for row in found.urgent(0, 10)] == order
    assert [row.external_id for row in found.urgent(2, 2)] == order[2:4]
    assert [row.external_id for row in found.urgent(0, 10, "alarm")] == ["alarm", "seen"]
    assert [row.external_id for row in found.urgent(0, 10, None, "ER")] == ["sooner", "later"]
    assert found.page(None, 10, None, "%") == []
    assert found.counts() == {"alarm": 2, "watch": 3, "in_order": 1}


def test_whatever_counts_makes_an_asset_due(stores: list[Store]) -> None:
    store = stores[0]
    assets = Assets(store.database)

    def settled(name: str = "press-7") -> AssetRow:
        while due := Standings(store.database).take(now()):
            Standings(store.database).settle(due, Known(heard_at=NOW, verdict="in_order"), now())
        return asset(store, name)

    put(store)
    put(store, "press-8")
    before = settled()
    measured = store.add_measurement(uploaded(store), "a.csv", None, {})
    assert settled().changes == before.changes
    assets.own("press-7", measured.id)
    assert settled().changes == before.changes + 1
    store.correct_moment(measured.id, NOW - timedelta(days=3))
    assert settled().changes == before.changes + 2
    new = NewDiagnosis(
        measured.id,
        "c" * 64,
        MACHINE,
        {"asset": "press-7"},
        diagnosis(),
        lambda session, key, new: assets.note(session, "press-7", {measured.id: AsRead({})}, key),
    )
    answered = store.add_diagnosis(new)
    assert settled().changes == before.changes + 3
    assert store.add_diagnosis(new).id == answered.id
    assert settled().changes == before.changes + 3, "the same again is nothing new"
    other = settled("press-8")
    for _ in range(2):
        Findings(store.database).add(answered, FindingIn(text="bush worn", at=NOW.isoformat()))
    assert settled().changes == before.changes + 4
    assert settled("press-8").changes == other.changes + 1, "findings teach about all machines of a kind"
    assert Standings(store.database).last_heard("press-7")[0] == NOW - timedelta(days=3)
    assert put(store).changes == settled().changes == before.changes + 4, "nothing of it is new"


def heard(store: Store) -> tuple[str | None, datetime | None]:
    """The answer to the last recording of press-1, and its time."""
    _, row, at = Standings(store.database).last_heard("press-1")
    return (None if row is None else row.id), at


def test_the_last_of_several_recordings_says_which_answer_is_the_last(stores: list[Store]) -> None:
    store = stores[0]
    put(store, "press-1")
    assert heard(store) == (None, None)
    january, february, march = (NOW - timedelta(days=days) for days in (90, 60, 30))
    rows = [store.correct_moment(stored(store, str(at).encode()).id, at) for at in (january, february, march)]
    both = diagnosed(store, rows[0], rows[2], asset="press-1")
    assert heard(store) == (both, march)
    single = diagnosed(store, rows[1], asset="press-1")
    assert heard(store) == (both, march), "though its first recording is of January"
    again = diagnosed(store, rows[2], rows[0], asset="press-1")
    assert heard(store) == (again, march), "the newest answer to the last recording"
    said = {"joints": {"A": {"clearance_um": 140, "repaired": True}}, "at": (march - timedelta(days=1)).isoformat()}
    Findings(store.database).add(store.diagnosis(single), FindingIn.model_validate(said))
    assert heard(store) == (single, february), "those of before and after a repair are of no state"


def test_the_question_that_was_asked_last_counts(stores: list[Store]) -> None:
    """Whoever has tried something else comes back to the answer of before by asking for it again."""
    store = stores[0]
    put(store, "press-1")
    row = stored(store)
    before = diagnosed(store, row, asset="press-1", verdict="worn")
    tried = diagnosed(store, row, asset="press-1", verdict="changed")
    assert heard(store)[0] == tried and gather(store, "press-1").visits[0][2]["verdict"] == "changed"
    changes = asset(store, "press-1").changes
    assert diagnosed(store, row, asset="press-1", verdict="worn") == before
    assert heard(store)[0] == before and gather(store, "press-1").visits[0][2]["verdict"] == "worn"
    assert asset(store, "press-1").changes == changes + 1
    assert diagnosed(store, row, asset="press-1", verdict="worn") == before
    assert asset(store, "press-1").changes == changes + 1, "it was the last already"
    assert diagnosed(store, row, asset="press-1", verdict="changed") == tried == heard(store)[0]


def test_a_recording_that_was_sent_by_two_names_was_made_once(stores: list[Store]) -> None:
    store = stores[0]
    put(store, "press-1")
    january, february = (NOW - timedelta(days=days) for days in (90, 60))
    first, other = stored(store, b"1"), stored(store, b"2")
    store.correct_moment(first.id, january)
    store.correct_moment(other.id, february)
    diagnosed(store, first, asset="press-1")
    last = diagnosed(store, other, asset="press-1")
    diagnosed(store, stored(store, b"1", "again.csv"), asset="press-1")
    assert heard(store) == (last, february)
    assert Standings(store.database).last_heard("press-1")[0] == february, "it was not heard when it was sent again"


def test_in_an_asset_that_is_made_anew_what_is_asked_last_counts(stores: list[Store]) -> None:
    store = stores[0]
    put(store, "press-1")
    row = stored(store)
    first = diagnosed(store, row, asset="press-1", verdict="worn")
    diagnosed(store, row, asset="press-1", verdict="changed")
    Removal(store).delete_asset("press-1", "scrapped")
    put(store, "press-1")
    assert heard(store) == (None, None)
    diagnosed(store, row, asset="press-1", verdict="changed")
    diagnosed(store, row, asset="press-1", verdict="worn")
    assert heard(store)[0] == first


def test_an_answer_that_counts_for_the_state_of_wear_counts_for_the_standing(stores: list[Store]) -> None:
    """One to several recordings before one to the last alone, unless it has no verdict."""
    store = stores[0]
    put(store, "press-1")
    rows = [store.correct_moment(stored(store, str(day).encode()).id, NOW - timedelta(days=day)) for day in (9, 3)]
    common = diagnosed(store, *rows, asset="press-1", verdict="worn")
    single = diagnosed(store, rows[1], asset="press-1", verdict="in_order")
    assert heard(store)[0] == common
    diagnosed(store, *rows, asset="press-1", verdict="unknown")
    assert heard(store)[0] == common
    with store.database.writing() as session:
        session.execute(delete(AssetDiagnosisRow).where(AssetDiagnosisRow.diagnosis == common))
    assert heard(store)[0] == single


@pytest.mark.parametrize(("column", "value"), [("request", "{}"), ("made_by", "somebody else"), ("result", "[")])
def test_which_row_is_damaged_is_told_where_the_last_answer_is_sought(
    stores: list[Store], column: str, value: str
) -> None:
    store = stores[0]
    put(store, "press-1")
    key = diagnosed(store, stored(store), asset="press-1")
    value = value if store.database.is_sqlite else value.replace("[", "[]")  # PostgreSQL takes no other JSON
    with store.database.engine.begin() as connection:
        connection.execute(text(f"UPDATE diagnoses SET {column} = :value"), {"value": value})
    with pytest.raises(DamagedRowError, match=f"diagnosis {key}: its row is not what was written"):
        heard(store)


def test_the_end_of_a_build_is_told_once(stores: list[Store]) -> None:
    queues = [BuildQueue(each.database) for each in stores]
    row = queues[0].add(MACHINE, {"name": "quick"}, "0" * 64, "press", None)
    for each in queues:
        each.cancel(row.id)
    claimed = queues[0].add(MACHINE, {"name": "quick"}, "0" * 64, "press", None)
    assert queues[0].claim("me", 60.0) is not None
    for each in queues:
        each.end(claimed.id, "me", "done", {"catalogue_id": "c1"})
    same = {"machine": "m", "catalogue": "press", "message": ""}
    assert told(stores[0]) == [
        ("build.ended", {"build": row.id, "catalogue_id": None, "state": "cancelled", **same}),
        ("build.ended", {"build": claimed.id, "catalogue_id": "c1", "state": "done", **same}),
    ]
