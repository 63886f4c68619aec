"""The notebooks under ``examples``: every cell runs, in order, in a folder of its own."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[2] / "examples"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def cells_of(notebook: Path) -> list[dict[str, Any]]:
    content = json.loads(notebook.read_text(encoding="utf-8"))
    assert content["nbformat"] == 4
    return [cell for cell in content["cells"] if cell["cell_type"] == "code"]


def run(notebook: Path) -> dict[str, Any]:
    """Names that a notebook leaves."""
    names: dict[str, Any] = {}
    for number, cell in enumerate(cells_of(notebook), start=1):
        exec(compile("".join(cell["source"]), f"{notebook.name}, cell {number}", "exec"), names)
    return names


def test_no_output_is_kept() -> None:
    assert len(NOTEBOOKS) == 3
    assert not any(cell["outputs"] or cell["execution_count"] for each in NOTEBOOKS for cell in cells_of(each))


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_own_machine() -> None:
    found = run(FOLDER / "own_machine.ipynb")
    assert found["worn"].status == "ok"
    change, high = found["change"], found["high"]
    assert float(sorted(change[high])[high.sum() // 2]) > 10.0  # dB, at high orders; that is what the text says


def test_catalogue_to_diagnosis() -> None:
    found = run(FOLDER / "catalogue_to_diagnosis.ipynb")
    assert found["answer"].verdict == "worn"
    assert [name for name, joint in found["answer"].joints.items() if joint.p_worn > 0.5] == ["B"]
    assert Path("answer.png").exists()


def test_what_accuracy_costs() -> None:
    found = run(FOLDER / "what_accuracy_costs.ipynb")
    assert all(run.status == "ok" for run in found["runs"].values())
    assert math.isfinite(found["chance"])
