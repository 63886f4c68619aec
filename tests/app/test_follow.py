"""The command that follows a machine's wear."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from command_line import assert_refused, invoke
from recordings import RECORDINGS

from jointplay.app.pages.wear_state import what_moved
from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.following.state import WearState

FILES = [RECORDINGS / f"slider-crank-{number:02}.csv.gz" for number in (2, 5)]
MOMENTS = ("--measured-at", "2026-01-03T10:00:00Z", "--measured-at", "2026-06-03T10:00:00+02:00")


def test_recordings_in_the_order_they_were_made(shelf: Path) -> None:
    asked = ("--catalogue", shelf / "slider-crank", "--effort", "fast", "--json")
    state = json.loads(invoke("follow", *FILES, *asked, *MOMENTS).stdout)
    assert [point["at"] for point in state["joints"]["B"]["course"]] == ["2026-01-03T10:00:00Z", "2026-06-03T08:00:00Z"]
    swapped = ("--measured-at", MOMENTS[3], "--measured-at", MOMENTS[1])
    assert json.loads(invoke("follow", *reversed(FILES), *asked, *swapped).stdout) == state


def test_beside_recordings_of_the_machine_in_order(shelf: Path) -> None:
    """One of them may be followed, too: it is not compared with itself."""
    in_order = RECORDINGS / "slider-crank-01.csv.gz"
    asked = ("--catalogue", shelf / "slider-crank", "--effort", "fast", "--json")
    files = (in_order, *FILES, *asked, "--measured-at", "2026-01-01T10:00:00Z", *MOMENTS)
    alone = json.loads(invoke("follow", *files).stdout)
    beside = json.loads(invoke("follow", *files, "--baseline", in_order).stdout)
    course = beside["joints"]["B"]["course"]
    assert [point["at"] for point in course] == [point["at"] for point in alone["joints"]["B"]["course"]]
    assert course[0] == alone["joints"]["B"]["course"][0]
    assert course[1]["p_worn"] != alone["joints"]["B"]["course"][1]["p_worn"]
    assert beside["joints"]["B"]["p_worn"] > 0.9


def test_a_baseline_among_the_measurements_has_no_machine_simulated_for_it(
    shelf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def note(*given: Any, effort: str, **options: Any) -> Diagnosis:
        asked.append((len(options["baseline"]), effort))
        return diagnose(*given, effort="fast", **options)

    monkeypatch.setattr("jointplay.catalogue.diagnosing.diagnosis.diagnose", note)
    in_order = RECORDINGS / "slider-crank-01.csv.gz"
    said = ("--catalogue", shelf / "slider-crank", "--measured-at", "2026-01-01T10:00:00Z", *MOMENTS)
    invoke("follow", in_order, *FILES, *said, "--baseline", in_order, "--effort", "thorough")
    assert asked == [(0, "standard"), (1, "thorough"), (1, "thorough")]


def test_speeds_that_are_given(shelf: Path) -> None:
    asked = ("--catalogue", shelf / "slider-crank", "--effort", "fast", *MOMENTS)
    told = invoke("follow", *FILES, *asked, "--speed", "601 rpm", "--speed", "602 rpm").stdout
    assert told.endswith("slider-crank-02.csv.gz 601 rpm, slider-crank-05.csv.gz 602 rpm\n")
    refused = invoke("follow", *FILES, *asked, "--speed", "600 rpm")
    assert_refused(refused, 2, "'--speed': 1 for 2 measurements: must be one for each, or none")


def test_a_last_recording_that_says_what_others_said(shelf: Path) -> None:
    asked = ("--catalogue", shelf / "slider-crank", "--effort", "fast", "--json")
    state = WearState.model_validate_json(invoke("follow", *FILES, *asked, *MOMENTS).stdout)
    calm = {name: found.model_copy(update={"moved_by": 0.01}) for name, found in state.joints.items()}
    said = "The last recording has changed little of which joints are worn."
    assert what_moved(state.model_copy(update={"joints": calm})) == said


def test_in_words_with_what_was_found_and_mended(shelf: Path) -> None:
    asked = ("--catalogue", shelf / "slider-crank", "--effort", "fast", *MOMENTS)
    told = ("--found", "B=150um@2026-06-04T06:00:00Z", "--repaired", "B=2026-06-05T06:00:00Z")
    worn = invoke("follow", *FILES, *asked).stdout
    assert worn.startswith("By 2 recordings, up to 2026-06-03 08:00 UTC:")
    assert "µm a year" in worn
    assert re.search(r"The last recording has moved the probability of wear of .*B from \d+ % to > 99 %", worn)
    mended = invoke("follow", *FILES, *asked, *told).stdout
    assert "Joint B was repaired on 2026-06-05." in mended
    assert "in order" in next(line for line in mended.splitlines() if line.strip().startswith("B "))


@pytest.mark.parametrize(
    ("told", "text"),
    [
        ((), "says no time of measurement"),
        (MOMENTS[:2], "'--measured-at': 1 for 2 measurements: must be one for each, or none"),
        ((*MOMENTS, "--found", "B=150@2026-06-04T06:00:00Z"), "'--found': \"B=150@2026-06-04T06:00:00Z\""),
        ((*MOMENTS, "--found", "B=150um"), "the time must be a moment with a time zone"),
        ((*MOMENTS, "--found", "B=150um@2062-06-04T06:00:00Z"), "the time lies more than a day ahead"),
        ((*MOMENTS, "--repaired", "Q=2026-06-05T06:00:00Z"), "joint Q: must be one of A, B, O"),
    ],
)
def test_refusals(told: tuple[str, ...], text: str, shelf: Path) -> None:
    asked = ("--catalogue", shelf / "slider-crank", "--effort", "fast")
    assert_refused(invoke("follow", *FILES, *asked, *told), 2, text)
