"""What tables of answers and watched folders say of single recordings."""

from __future__ import annotations

from pathlib import Path

import pytest

from jointplay.app.commands.answers_table import answer_each, summary
from jointplay.app.commands.watch import summary as watched
from jointplay.catalogue.errors import MeasurementError


def test_a_refusal_in_a_table_names_its_cure(tmp_path: Path) -> None:
    def ask(number: int) -> None:
        raise MeasurementError("a.csv", None, "units", "s1-x", "has no unit", field="units")

    (row,) = answer_each([tmp_path / "a.csv"], ask, tmp_path / "table.csv", ())  # type: ignore[arg-type]
    assert row["refusal"].endswith("(option --unit, field units, in the form 'Unit')")


@pytest.mark.parametrize(
    ("verdict", "named"), [("worn", True), ("in_order", True), ("changed", False), ("unknown", False)]
)
def test_joints_are_named_only_by_a_verdict_on_joints(verdict: str, named: bool) -> None:
    row = {"file": "a.csv", "refusal": None, "first": "A", "probability": 0.78, "drive_speed_rpm": 600.0}
    assert ("A, 78 %" in summary([{**row, "verdict": verdict}])) is named
    answer = {"id": "7", "verdict": verdict, "hypotheses": [{"joints": {"A": {}}, "probability": 0.78}]}
    assert ("A, 78 %" in watched(answer)) is named
