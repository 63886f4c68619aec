"""Lines of refusals: where in its file a machine is wrong."""

from __future__ import annotations

import pytest

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.machine import parse_machine
from jointplay.solver.machines.source_lines import line_of

FILE = """name: pendulum
links:
  base: {fixed: true}
  arm:
    mass: 1.2
    inertia: 0.02
    cg: [0.1, 0]
joints:
  O: {kind: turning, links: [arm, base], at: [0, 0]}
sensors:
  - {name: one, at: [0, 0], direction: [0, 1]}
  - name: two
    at: [0, 0]
    direction: [0, 1]
"""
JSON = """{
  "name": "pendulum",
  "links": {
    "base": {"fixed": true},
    "base": {"mass": 1}
  }
}
"""


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("name", 1),
        ("links.base.fixed", 3),
        ("links.arm.cg", 7),
        ("links.arm.cg.1", 7),
        ("joints.O.pin_radius", 9),  # that is missing: the mapping it is missing in
        ("sensors.1", 12),
        ("sensors.1.direction", 14),
        ("sensors.7.at", 10),
        ("drive", 1),
        ("line 4", 4),
        ("line 400", 14),
        ("", None),
    ],
)
def test_lines_of_paths(path: str, line: int | None) -> None:
    assert line_of(FILE, path) == line


def test_a_key_that_json_gives_twice_is_found_where_it_stands_again() -> None:
    with pytest.raises(MachineError) as caught:
        parse_machine(JSON)
    assert line_of(JSON, caught.value.path) == 5


@pytest.mark.parametrize("text", ["links: [", "[" * 100_000, "a: b: c", "\x00", ""])
def test_what_cannot_be_read_has_no_line(text: str) -> None:
    assert line_of(text, "links.base") is None


@pytest.mark.parametrize(
    ("wrong", "right", "line"),
    [
        ("mass: 1.2", "mas: 1.2", 5),
        ("cg: [0.1, 0]", "cg: [0.1]", 7),
        ("kind: turning", "kind: turnin", 9),
        ("    inertia: 0.02\n", "    inertia: [\n", 8),  # where the reader of YAML stumbles
    ],
)
def test_refusals_have_their_line(wrong: str, right: str, line: int) -> None:
    text = FILE.replace(wrong, right)
    assert text != FILE
    with pytest.raises(MachineError) as caught:
        parse_machine(text)
    assert line_of(text, caught.value.path) == line
