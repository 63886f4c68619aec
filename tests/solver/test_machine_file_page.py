from __future__ import annotations

import re
from pathlib import Path

import pytest

from jointplay.solver.machines.fits import DEFAULT_PLAY, LIMIT_FACTOR, ToleranceClass
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.solver.machines.yamlfile import read_tree

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "machine-file.md").read_text(encoding="utf-8")
ONE_LINE = " ".join(PAGE.split())
EXAMPLES = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


def test_the_matrix_example_is_a_machine() -> None:
    (example,) = (text for text in EXAMPLES if "matrix:" in text)
    machine = parse_machine(example)
    assert (machine.turning_joints, machine.sliding_joints) == (("O", "A", "B"), ("G",))
    assert machine.clearances == {"A": pytest.approx(2e-4)}


@pytest.mark.parametrize("key", ["links", "joints", "defaults", "supports"])
def test_the_other_examples_are_parts_of_machines(key: str) -> None:
    examples = [text for text in EXAMPLES if text.startswith(f"{key}:")]
    assert examples
    names = {"bed": [0, 0], "crank": [1, 0], "block": [2, 0], "rocker": [3, 0]}
    links = {name: {"mass": 1, "inertia": 1, "cg": cg} for name, cg in names.items()}
    joints = {
        str(index): {"kind": "turning", "links": [name, "bed"], "at": [0, index]}
        for index, name in enumerate(list(names)[1:])
    }
    tree = {"name": "page", "links": links, "joints": joints}
    base = tree.get(key)
    for example in examples:
        given = read_tree(example, "page")[key]
        assert parse_machine({**tree, key: {**base, **given} if isinstance(base, dict) else given})  # type: ignore[dict-item]


def test_every_key_of_a_machine_has_a_row() -> None:
    rows = set(re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE))
    assert set(Machine.model_fields) <= rows


def test_what_the_page_says_of_fits() -> None:
    assert "`H7/g6` on a pin of 16 mm (hole 0 to +18 µm, pin −17 to −6 µm) for 3 to 17.5 µm" in ONE_LINE
    pin = ToleranceClass("g", 6).deviations(16e-3), ToleranceClass("H", 7).deviations(16e-3)
    assert pin == ((-17, -6), (0, 18))
    assert "| 3 to 20 µm |" in PAGE and DEFAULT_PLAY == (3e-6, 20e-6)
    assert "200 µm where `fit` is left out" in ONE_LINE and LIMIT_FACTOR * DEFAULT_PLAY[1] == pytest.approx(200e-6)
