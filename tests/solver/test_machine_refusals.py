"""Machine files that are refused: file, path, value and rule in one line."""

from __future__ import annotations

import math
from typing import Any

import pytest
from machine_trees import MISSING, SPRING, changed

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.machine import parse_machine


def refusal(tree: dict[str, Any] | str) -> str:
    with pytest.raises(MachineError) as caught:
        parse_machine(tree, "m.yaml")
    message = str(caught.value)
    assert "\n" not in message
    return message


LOAD = {"link": "crank", "at": [0, 0]}
TORQUE = {"kind": "torque", "joint": "O"}


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        # numbers
        ("links.crank.mass", -1, "links.crank.mass: -1: must be greater than 0"),
        ("links.crank.mass", 0.0, "links.crank.mass: 0: must be greater than 0"),
        ("links.crank.mass", math.nan, "links.crank.mass: nan: must be finite"),
        ("links.crank.inertia", math.inf, "links.crank.inertia: inf: must be finite"),
        ("links.crank.inertia", -1e-4, "links.crank.inertia: -0.0001: must be greater than 0"),
        ("links.crank.mass", True, 'links.crank.mass: true: must be a number in kg or a string with a unit ("80 g")'),
        ("links.crank.mass", "80 mm", 'links.crank.mass: 80 mm: "mm" is a length, must be a mass, for example "80 g"'),
        ("joints.A.contact", {"stiffness": -1.0e7}, "joints.A.contact.stiffness: -1e+07: must be greater than 0"),
        ("joints.A.contact", {"damping": -1}, "joints.A.contact.damping: -1: must not be less than 0"),
        ("joints.A.pin_radius", "-1 mm", "joints.A.pin_radius: -1 mm: must not be less than 0"),
        ("defaults.contact.friction", -0.1, "defaults.contact.friction: -0.1: must not be less than 0"),
        ("defaults.contact.friction_velocity", 0, "defaults.contact.friction_velocity: 0: must be greater than 0"),
        ("links.crank.cg", [1], "links.crank.cg: [1]: must be a list of 2 numbers"),
        ("links.crank.cg", "1 mm", "links.crank.cg: 1 mm: must be a list of 2 numbers"),
        ("links.crank.cg", [1, "x"],
         'links.crank.cg.1: x: must be a length: a number, or a number with a unit ("0.2 mm")'),
        ("joints.G1.direction", [0, 0], "joints.G1.direction: [0, 0]: must not be the zero vector"),
        ("sensors.0.direction", [0, -0.0], "sensors.0.direction: [0, -0]: must not be the zero vector"),
        # keys and kinds
        ("links.crank.mas", 3, 'links.crank.mas: 3: unknown key; did you mean "mass"?'),
        ("joints.A.contact", {"Stiffness": 1}, 'joints.A.contact.Stiffness: 1: unknown key; did you mean "stiffness"?'),
        ("sensor", [], 'sensor: []: unknown key; did you mean "sensors"?'),
        ("joints.A.direction", [1, 0], "joints.A.direction: [1, 0]: unknown key; "
         "known: kind, links, at, contact, fit, limit, clearance, pin, pin_radius, viscous, journal_friction, film"),
        ("drive.rippel", [], 'drive.rippel: []: unknown key; did you mean "ripple"?'),
        ("joints.A.kind", "turnin", 'joints.A.kind: turnin: is not a known kind; did you mean "turning"?'),
        ("joints.A.kind", MISSING, "joints.A.kind: is missing"),
        ("drive.kind", "steam",
         "drive.kind: steam: is not a known kind; known: rotation, translation, position, torque, force"),
        ("supports.1.kind", "spirng", 'supports.1.kind: spirng: is not a known kind; did you mean "spring"?'),
        ("initial", {"pose": "drwn"}, "initial.pose: drwn: must be drawn or equilibrium"),
        ("links.frame.locked", ["x", "z"], "links.frame.locked.1: z: must be x, y or theta"),
        ("links.frame.locked", ["x", "x"], "links.frame.locked: x, x: must name each motion once"),
        ("links.frame.fixed", "yes", "links.frame.fixed: yes: must be true or false"),
        ("links.crank.ma\nss", 3, 'links.crank.ma ss: 3: unknown key; did you mean "mass"?'),
        # shapes
        ("links", [1], "links: [1]: must be a mapping of keys to values"),
        ("links", {}, "links: a machine needs at least one link, the frame"),
        ("links.crank", 3, "links.crank: 3: must be a mapping of keys to values"),
        ("joints", [], "joints: []: must be a mapping of keys to values"),
        ("sensors", {"a": 1}, "sensors: {a: 1}: must be a list"),
        ("joints.A.links", ["rod"], "joints.A.links.1: is missing"),
        ("joints.A.links", ["rod", "crank", "slider"], "joints.A.links: [rod, crank, slider]: must have 2 entries"),
        ("name", MISSING, "name: is missing"),
        ("name", "two\nlines", "name: two lines: must be one line of text"),
        ("links.crank.mass", MISSING, "links.crank.mass: is missing; only a fixed link needs none"),
        ("links.crank.inertia", None, "links.crank.inertia: is missing; only a fixed link needs none"),
        ("links.crank.cg", MISSING, "links.crank.cg: is missing; only a fixed link needs none"),
        # names
        ("links.a,b", {}, "links.a,b: a,b: a name must be letters, digits, spaces, -, + or _"),
        ("sensors.0.name", "s/1", "sensors.0.name: s/1: a name must be letters, digits, spaces, -, + or _"),
        ("frame", "fram", 'frame: fram: is not a link of this machine; did you mean "frame"?'),
        ("joints.A.links", ["rod", "cranc"],
         'joints.A.links.1: cranc: is not a link of this machine; did you mean "crank"?'),
        ("joints.A.links", ["rod", "rod"], "joints.A.links: rod, rod: must be two different links"),
        ("joints.A.pin", "frame", "joints.A.pin: frame: must be one of the joint's links, rod or crank"),
        ("supports.0.link", "x", "supports.0.link: x: is not a link of this machine; known: frame, crank, rod, slider"),
        ("supports.0.to_link", "frame", "supports.0.to_link: frame: must be another link than link"),
        ("sensors.1.name", "s1-x", "sensors.1.name: s1-x: must be the only sensor of this name"),
        ("initial", {"velocities": {"cran": {"omega": 1}}},
         'initial.velocities.cran: is not a link of this machine; did you mean "crank"?'),
        ("drive.joint", "P", "drive.joint: P: is not a joint of this machine; known: O, A, B, G1"),
        ("links.spare", {"mass": 1, "inertia": 1, "cg": [0, 0]},
         "links.spare: is not connected to the frame by any joint or support"),
        # drives
        ("drive.joint", "G1", "drive.joint: G1: is a sliding joint; a rotation drive needs a turning joint"),
        ("drive", {"kind": "force", "joint": "O", "force": 1},
         "drive.joint: O: is a turning joint; a force drive needs a sliding joint"),
        ("drive.speed", MISSING, "drive.speed: is missing"),
        ("drive.speed", [], "drive.speed: []: must be a list of rows [s, rad/s]"),
        ("drive.speed", [[0, 1], [0, 2]], "drive.speed.1.0: must be greater than in the row before (0)"),
        ("drive.speed", [[0, 1], [1, 2, 3]], "drive.speed.1: [1, 2, 3]: must be a list of 2 numbers"),
        ("drive.speed", [[0, 1], ["1 s", "2 m"]],
         'drive.speed.1.1: 2 m: "m" is a length, must be a speed of rotation, for example "600 rpm"'),
        ("drive.ripple", [{"order": 0, "amplitude": 1}], "drive.ripple.0.order: 0: must be greater than 0"),
        ("drive", TORQUE, "drive: give one of torque, curve"),
        ("drive", {**TORQUE, "torque": 1, "curve": [[0, 1]]}, "drive: give only one of torque, curve"),
        # supports
        ("supports.0", {**SPRING, "anchor": [0, 0]},
         "supports.0.anchor: [0, 0]: must not be the point at; a mount needs no anchor"),
        ("supports.0", {**SPRING, "free_length": 0.1, "static_deflection": 0.1},
         "supports.0.static_deflection: 0.1: give only one of free_length, static_deflection"),
        ("supports.0", {**SPRING, "static_deflection": "-101 mm"},
         "supports.0.static_deflection: -0.101: would make the free length negative"),
        ("supports.0.stiffness", [1, -1], "supports.0.stiffness.1: -1: must not be less than 0"),
        # loads
        ("loads", [LOAD], "loads.0: give one of force or torque, over_time, over_angle"),
        ("loads", [{**LOAD, "torque": 1, "over_time": [[0, 0, 0, 0]]}],
         "loads.0: give only one of force or torque, over_time"),
        ("loads", [{**LOAD, "over_angle": [[0, 1, 1, 1], ["360 deg", 1, 1, 1]]}],
         "loads.0.over_angle.1.0: must be less than one turn after the first row: the table repeats by itself"),
        ("loads", [{**LOAD, "over_time": [[1, 0, 0, 0], [0, 0, 0, 0]]}],
         "loads.0.over_time.1.0: must be greater than in the row before (1)"),
        ("loads", [{**LOAD, "order": 2, "over_time": [[0, 0, 0, 0]]}],
         "loads.0.order: 2: is of a force or torque, and there is a table"),
        ("loads", [{**LOAD, "torque": 1, "phase": 0.5}], "loads.0.phase: 0.5: needs an order"),
        ("loads", [{**LOAD, "torque": 1, "order": 1.5}], "loads.0.order: 1.5: must be a whole number"),
    ],
)  # fmt: skip
def test_refusals_name_file_path_value_and_rule(path: str, value: object, line: str) -> None:
    assert refusal(changed(path, value)) == f"m.yaml: {line}"


@pytest.mark.parametrize(
    ("name", "said"), [("over_angle", {"over_angle": [[0, 1, 1, 1]]}), ("order", {"torque": 1, "order": 2})]
)
def test_a_load_over_the_angle_needs_a_drive_that_turns(name: str, said: dict[str, object]) -> None:
    tree = changed("loads", [{**LOAD, **said}])
    del tree["drive"]
    assert refusal(tree) == f"m.yaml: loads.0.{name}: needs a rotation or torque drive: there is no drive angle"


def test_a_fixed_link_has_no_velocity() -> None:
    tree = changed("links.frame", {"fixed": True})
    tree["initial"] = {"velocities": {"frame": {"omega": 1}}}
    assert refusal(tree) == "m.yaml: initial.velocities.frame: is fixed and cannot have a velocity"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: 1\nb: 2\na: 3", "line 3: a: is given twice; every key may stand once"),
        ('{"name": "x", "name": "y"}', "name: is given twice; every key may stand once"),
        ("1: {}\n'1': {}", "1: is given twice; every key may stand once"),
        ("- 1", "a list: must be a mapping of keys to values"),
        ("", "nothing: must be a mapping of keys to values"),
        ("just text", "text: must be a mapping of keys to values"),
        ("a: [1", "line 1: is not YAML: expected ',' or ']', but got '<stream end>'"),
        ("a: 1\n\tb: 2", "line 2: is not YAML: found character '\\t' that cannot start any token"),
        ("2.5: x", "2.5: a key must be text"),
        ("name: !!binary aGk=", "name: b'hi': must be text, a number, a list or a mapping"),
        ("a: &a [*a]", "a.0.0: must not be nested deeper than 20 levels"),
        ("[" * 10_000, "must not be nested deeper than 20 levels"),
        ("a: " + "{b: " * 65, "must not be nested deeper than 20 levels"),
        ("a: !!python/none x",
         "line 1: is not YAML: could not determine a constructor for the tag 'tag:yaml.org,2002:python/none'"),
    ],
)  # fmt: skip
def test_broken_text_is_refused_with_its_line(text: str, line: str) -> None:
    assert refusal(text) == f"m.yaml: {line}"


def test_broken_json_is_refused_with_its_line() -> None:
    with pytest.raises(MachineError) as caught:
        parse_machine('{"name": "x",\n "links": }', "m.json")
    assert str(caught.value) == "m.json: line 2: is not JSON: Expecting value"


def test_a_small_file_that_unfolds_into_a_huge_one_is_refused() -> None:
    rows = ["a0: &a0 [1,1,1,1,1,1,1,1,1,1]"]
    rows += [f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 10)]
    assert refusal("\n".join(rows)) == "m.yaml: must not hold more than 200000 values"


def test_a_huge_text_is_refused() -> None:
    assert refusal("# " * 1_500_000) == "m.yaml: 3000000 characters: must not be longer than 2000000"
