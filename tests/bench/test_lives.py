"""What the benchmark of lives asks, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from benchmarks import lives


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[str, int, str]]:
    """Names, recordings of the past and efforts that were asked for; nothing is diagnosed."""
    (tmp_path / "catalogues" / "press").mkdir(parents=True)
    found: list[tuple[str, int, str]] = []

    def diagnose(
        line: dict[str, Any], file: Path, past: list[Path], catalogue: None, effort: str, alone: str
    ) -> dict[str, Any]:
        assert file.exists()
        found.append((line["name"], len(past), effort))
        efforts = {**line.get("alone", {}), alone: {"effort": alone}}
        return {"answer": {"effort": effort}, **line, "alone": efforts}

    monkeypatch.setattr(lives, "_diagnose", diagnose)
    monkeypatch.setattr("jointplay.catalogue.storage.store.Catalogue.open", lambda folder: None)
    return found


def record(folder: Path, visits: Iterable[int], speed: float = 600.0) -> None:
    """Write recordings of a life, and what is true of them."""
    folder.mkdir(exist_ok=True)
    truths = {}
    for visit in visits:
        truths[f"p-{visit}"] = {"machine": "press", "speed_rpm": speed, "life": {"number": 1, "visit": visit}}
        (folder / f"p-{visit}.npz").touch()
    (folder / "truth.json").write_text(json.dumps(truths))


def test_the_first_are_the_baseline_and_what_is_there_is_not_asked_again(
    asked: list[tuple[str, int, str]], tmp_path: Path
) -> None:
    folder, answers = tmp_path / "recordings", tmp_path / "answers.jsonl"
    record(folder, (1, 2))
    lives.answer_all(folder, tmp_path / "catalogues", answers, "thorough", "standard")
    assert asked == []  # a life without its baseline
    record(folder, (4, 3, 2, 1))
    lives.answer_all(folder, tmp_path / "catalogues", answers, "thorough", "standard")
    first = [("p-1", 2, "standard"), ("p-2", 2, "standard"), ("p-3", 2, "standard")]
    assert asked == [*first, ("p-4", 3, "thorough")]
    record(folder, (1, 2, 3, 4, 5))
    lives.answer_all(folder, tmp_path / "catalogues", answers, "thorough", "standard")
    assert asked[4:] == [("p-5", 3, "thorough")]
    assert [line["name"] for line in lives.read_lines(answers)] == ["p-1", "p-2", "p-3", "p-4", "p-5"]


def test_single_answers_of_another_effort_are_added(
    asked: list[tuple[str, int, str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, answers = tmp_path / "recordings", tmp_path / "answers.jsonl"
    record(folder, (1, 2, 3, 4))
    for alone in ("standard", "thorough", "thorough"):
        lives.answer_all(folder, tmp_path / "catalogues", answers, "thorough", alone)
    assert len(asked) == 8
    lines = lives.read_lines(answers)
    assert [line["name"] for line in lines] == ["p-1", "p-2", "p-3", "p-4"]
    assert all(set(line["alone"]) == {"standard", "thorough"} for line in lines)
    assert lines[3]["answer"]["effort"] == "thorough"
    assert lives.lives_of(lines, "fast") == {}
    assert capsys.readouterr().err == "left out: press 1: p-1 has no single answer of effort fast\n"


def test_answers_of_another_effort_or_recording_are_refused(asked: list[tuple[str, int, str]], tmp_path: Path) -> None:
    folder, answers = tmp_path / "recordings", tmp_path / "answers.jsonl"
    record(folder, (1, 2, 3, 4))
    lives.answer_all(folder, tmp_path / "catalogues", answers, "thorough", "standard")
    with pytest.raises(SystemExit, match=r"p-4: effort: thorough: must be standard, as asked"):
        lives.answer_all(folder, tmp_path / "catalogues", answers, "standard", "standard")
    record(folder, (1, 2, 3, 4), speed=600.0 * (1.0 + 1e-15))  # as another processor rounds
    lives.answer_all(folder, tmp_path / "catalogues", answers, "thorough", "standard")
    record(folder, (1, 2, 3, 4), speed=600.001)
    with pytest.raises(SystemExit, match=r"p-1: is of another recording of this name"):
        lives.answer_all(folder, tmp_path / "catalogues", answers, "thorough", "standard")
    assert len(asked) == 4


def test_a_line_without_truth_is_refused(tmp_path: Path) -> None:
    (tmp_path / "old.jsonl").write_text('{"name": "p-1", "answer": null}\n')
    with pytest.raises(SystemExit, match=r"old\.jsonl: p-1: no truth"):
        lives.read_lines(tmp_path / "old.jsonl")
