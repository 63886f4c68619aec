"""What a machine asks of somebody, and why, by what is known of it."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from jointplay.catalogue.following.standing import (
    JointKnown,
    Known,
    Patience,
    find_due,
    is_worse,
    judge,
    next_change,
    state_of,
)
from jointplay.catalogue.following.state import CauseFollowed

NOW = datetime(2026, 6, 1, tzinfo=UTC)
PATIENCE = Patience(silent_after=timedelta(days=30), warn_within=timedelta(days=30))


def days(count: float) -> datetime:
    return NOW + timedelta(days=count)


def joint(p_worn: float = 0.0, p_over: float = 0.0, um: float = 20.0, likely: float | None = None) -> JointKnown:
    dates = (None, None, None) if likely is None else (days(0.5 * likely), days(likely), None)
    return JointKnown(
        p_worn=p_worn,
        p_over_limit=p_over,
        clearance_um=um,
        interval_um=(0.8 * um, 1.2 * um),
        limit_um=200.0,
        limit_at=dates,
    )


def known(verdict: Any = "in_order", heard: float = -1.0, failure: str = "", **joints: JointKnown) -> Known:
    return Known(
        heard_at=days(heard), verdict=verdict, verdict_at=days(heard), joints=joints or {"A": joint()}, failure=failure
    )


def cause(probability: float, per_year: float = 0.0, since_baseline: bool = True) -> CauseFollowed:
    return CauseFollowed(
        unit="x stiffness",
        probability=probability,
        size=0.62,
        per_year=per_year,
        since=NOW,
        since_baseline=since_baseline,
    )


LOOSE = "Since its baseline, besides play: mount 1, 0.62 x stiffness (-0.21 a year), 97 %."


@pytest.mark.parametrize(
    ("what", "state", "texts"),
    [
        (known(), "in_order", []),
        (known("worn", B=joint(1.0, 0.87, 214.0)), "alarm", ["beyond its limit of 200 µm: 214 µm, 87 % sure"]),
        (known("worn", B=joint(1.0, 1.0, 1400.0)), "alarm", ["of 200 µm: 1.4 mm, > 99 % sure"]),
        (known("worn", B=joint(1.0, 0.3, 190.0)), "watch", ["may be beyond its limit of 200 µm: 190 µm, 30 %"]),
        (known("worn", B=joint(1.0, 0.0, 140.0, 20)), "watch", ["reaches its limit of 200 µm about 2026-06-21"]),
        (
            known("worn", B=joint(1.0, 0.0, 140.0, -3)),
            "alarm",
            ["has likely reached its limit of 200 µm by 2026-05-29"],
        ),
        (known("worn", B=joint(1.0, 0.0, 140.0, 900)), "watch", ["Joint B is worn: 140 µm, below its limit"]),
        (known(A=joint(0.2, 0.0, 20.0, 10)), "in_order", []),
        (known("worn"), "watch", ["Its last recording says that a joint is worn"]),
        (known("worn").model_copy(update={"repaired": True}), "in_order", []),
        (known("worn", B=joint(1.0, 0.9, 250.0)).model_copy(update={"repaired": True}), "alarm", ["Joint B is beyond"]),
        (known().model_copy(update={"causes": {"mount 1": cause(0.97, -0.21)}}), "watch", [LOOSE]),
        (known().model_copy(update={"causes": {"mount 1": cause(0.97)}}), "watch", ["0.62 x stiffness, 97 %."]),
        (known().model_copy(update={"causes": {"mount 1": cause(0.49)}}), "in_order", []),
        (known().model_copy(update={"causes": {"load": cause(0.97, 0.0, since_baseline=False)}}), "in_order", []),
        (known("changed"), "watch", ["it has changed, and not surely by play"]),
        (known("unknown"), "unknown", ["Its last recording has no verdict."]),
        (known(heard=-31.0), "unknown", ["No recording since 2026-05-01, for more than 30 days."]),
        (known(failure="too long"), "unknown", ["could not be followed: too long"]),
        (Known(), "unknown", ["There is no recording of it yet."]),
        (Known(heard_at=days(-1)), "unknown", ["None of its recordings was diagnosed yet."]),
        (
            known("changed", -31.0, A=joint(1.0, 0.3, 190.0), B=joint(1.0, 0.9, 250.0)),
            "alarm",
            ["Joint B", "Joint A", "not surely by play", "No recording since"],
        ),
    ],
)
def test_what_it_asks_and_why(what: Known, state: str, texts: list[str]) -> None:
    reasons = judge(what, NOW, PATIENCE)
    assert state_of(reasons) == state
    assert len(reasons) == len(texts)
    assert all(text in reason.text for text, reason in zip(texts, reasons, strict=True))


def test_time_alone_changes_it_when_it_was_said_to() -> None:
    """At no moment before, and at that one."""
    for what in (
        known(),
        known("worn", B=joint(1.0, 0.0, 140.0, 50)),
        known("worn", 0.0, B=joint(1.0, 0.0, 140.0, 12)),
    ):
        at = NOW
        for _ in range(4):
            following = next_change(what, at, PATIENCE)
            if following is None:
                break
            before = judge(what, following - timedelta(seconds=1), PATIENCE)
            assert before == judge(what, at, PATIENCE)
            assert judge(what, following, PATIENCE) != before
            at = following
        assert judge(what, days(10_000), PATIENCE) == judge(what, at, PATIENCE)


def test_worse_is_what_is_new_or_asks_more() -> None:
    watch = judge(known("worn", B=joint(1.0, 0.0, 140.0)), NOW, PATIENCE)
    more = judge(known("worn", B=joint(1.0, 0.3, 190.0)), NOW, PATIENCE)
    alarm = judge(known("worn", B=joint(1.0, 0.9, 250.0)), NOW, PATIENCE)
    two = judge(known("worn", A=joint(1.0, 0.9, 250.0), B=joint(1.0, 0.9, 250.0)), NOW, PATIENCE)
    assert is_worse(alarm, watch) and is_worse(two, alarm) and is_worse(watch, ())
    assert not is_worse(more, watch) and not is_worse(watch, alarm) and not is_worse((), alarm)


def test_limits_that_are_foretold_soon() -> None:
    what = known("worn", A=joint(1.0, 0.0, 140.0, 31), B=joint(1.0, 0.0, 140.0, 29), C=joint(0.1, 0.0, 10.0, 5))
    assert find_due(what, NOW, PATIENCE) == ("B",)
    assert what.limit_at is not None and what.limit_at[1] == days(29)
