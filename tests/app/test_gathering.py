"""What is known of an asset is gathered from the database: which answers count, and which findings teach."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from life_cycle import diagnosed, stored
from sqlalchemy import text

from jointplay.app.errors import DamagedRowError, NothingToFollowError
from jointplay.app.jobs.following import Life, follow_life, gather
from jointplay.app.schemas.assets import AssetIn, FindingIn
from jointplay.app.storage.assets import Assets
from jointplay.app.storage.findings import Findings
from jointplay.app.storage.rows import MeasurementRow
from jointplay.app.storage.store import Store
from jointplay.solver.machines.machine import shipped_machine

DATA = Path(__file__).parents[1] / "data" / "service"
MARCH = datetime(2026, 3, 1, 6, tzinfo=UTC)


@pytest.fixture
def presses(store: Store) -> Store:
    """Two assets of one machine."""
    for name in ("press-1", "press-2"):
        Assets(store.database).put(name, AssetIn(machine="press"))
    return store


def recorded(store: Store, content: str, days: float = 0.0) -> MeasurementRow:
    """A recording that was made some days after the first of March."""
    return store.correct_moment(stored(store, content.encode()).id, MARCH + timedelta(days=days))


def found(store: Store, diagnosis: str, days: float, **joint: bool) -> str:
    """What was found some days after the first of March."""
    said = {"joints": {"A": {"clearance_um": 140, **joint}}, "at": (MARCH + timedelta(days=days)).isoformat()}
    return Findings(store.database).add(store.diagnosis(diagnosis), FindingIn.model_validate(said)).id


def heard(store: Store) -> list[tuple[float, int]]:
    """Days after the first of March of what counts of press-1, and of how many recordings each is."""
    return sorted(
        ((at - MARCH) / timedelta(days=1), len(key.split())) for at, key, _ in gather(store, "press-1").visits
    )


def lessons(store: Store) -> int:
    """How many findings teach press-1 something; it has a recording of its own."""
    diagnosed(store, recorded(store, "its own"), asset="press-1")
    return len(gather(store, "press-1").lessons)


def damage(store: Store, table: str, key: str) -> None:
    with store.database.engine.begin() as connection:
        changed = connection.execute(text(f"UPDATE {table} SET made_by = 'somebody else' WHERE id = '{key}'"))
        assert changed.rowcount == 1


@pytest.mark.parametrize(
    ("day", "counted"),
    [
        (-1, [(59, 2)]),
        (0, [(0, 1), (59, 1)]),
        (30, [(0, 1), (59, 1)]),
        (59, [(59, 2)]),
    ],
)
def test_an_answer_to_recordings_of_before_and_after_a_repair_does_not_count(
    presses: Store, day: int, counted: list[tuple[float, int]]
) -> None:
    """A recording of the moment of a repair is of the machine before it."""
    first, last = recorded(presses, "first"), recorded(presses, "last", 59)
    single = [diagnosed(presses, each, asset="press-1") for each in (first, last)]
    diagnosed(presses, first, last, asset="press-1", verdict="worn")
    found(presses, single[0], 20)
    assert heard(presses) == [(59, 2)], "nothing was repaired"
    found(presses, single[0], day, repaired=True)
    assert heard(presses) == counted


def test_an_asset_that_was_only_heard_across_a_repair_is_not_followed(presses: Store) -> None:
    both = recorded(presses, "first"), recorded(presses, "last", 59)
    found(presses, diagnosed(presses, *both, asset="press-1"), 30, repaired=True)
    with pytest.raises(NothingToFollowError, match="asset press-1: its recordings were diagnosed together only"):
        gather(presses, "press-1")
    alone = diagnosed(presses, both[1], asset="press-1")
    assert [answer["hash"] for _, _, answer in gather(presses, "press-1").visits] == [
        presses.diagnosis(alone).answer.hash
    ]


@pytest.mark.parametrize("table", ["measurements", "diagnoses", "findings"])
def test_what_is_damaged_of_another_asset_teaches_nothing_and_stops_nobody(presses: Store, table: str) -> None:
    measured = [recorded(presses, name) for name in ("sound", "damaged")]
    answers = [diagnosed(presses, each, asset="press-2") for each in measured]
    findings = [found(presses, each, 1) for each in answers]
    assert lessons(presses) == 2
    damage(presses, table, {"measurements": measured[1].id, "diagnoses": answers[1], "findings": findings[1]}[table])
    assert lessons(presses) == 1
    with pytest.raises(DamagedRowError):
        gather(presses, "press-2")


@pytest.mark.parametrize(
    ("days", "teaches"), [(-1.1, False), (-1, True), (0, True), (31, True), (31.1, False), (270, False)]
)
def test_a_finding_teaches_what_the_answer_to_a_recording_of_that_time_is_worth(
    presses: Store, days: float, teaches: bool
) -> None:
    answer = diagnosed(presses, recorded(presses, "other"), asset="press-2")
    found(presses, answer, days)
    assert lessons(presses) == teaches
    assert len(gather(presses, "press-2").findings) == 1, "its own state goes by it in any case"


def test_the_last_of_several_recordings_is_what_a_finding_has_to_be_near_to(presses: Store) -> None:
    both = recorded(presses, "first"), recorded(presses, "last", 20)
    found(presses, diagnosed(presses, *both, asset="press-2"), 50)
    assert lessons(presses) == 1


@pytest.mark.parametrize(
    ("repaired", "after", "teaches"),
    [
        (5, 10, False),
        (0, 10, False),
        (10, 10, True),  # as it was found, before it was mended
        (12, 10, True),
        (-0.5, -0.8, False),
        (-0.8, -0.8, False),
    ],
)
def test_what_is_found_at_a_joint_that_was_repaired_meanwhile_teaches_nothing(
    presses: Store, repaired: float, after: float, teaches: bool
) -> None:
    answer = diagnosed(presses, recorded(presses, "other"), asset="press-2")
    found(presses, diagnosed(presses, recorded(presses, "long ago", -90), asset="press-2"), repaired, repaired=True)
    found(presses, answer, after)
    assert lessons(presses) == teaches


def test_a_repair_counts_where_nobody_has_measured() -> None:
    machine = shipped_machine("slider-crank").model_dump(mode="json", exclude_unset=True)
    answer = json.loads((DATA / "answer-1.json").read_text())
    mended = {"B": {"repaired": True}}
    life = Life(machine, [(MARCH, "a", answer)], [(MARCH + timedelta(days=1), "f", mended)], [(answer, mended)], {})
    assert [repair.joint for repair in follow_life(life).repairs] == ["B"]
