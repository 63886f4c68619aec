from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from machine_trees import MISSING, SLIDER_CRANK, SPRING, changed

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fields import UnitVector
from jointplay.solver.machines.joints import Contact, TurningJoint
from jointplay.solver.machines.machine import (
    Machine,
    load_machine,
    machine_json_schema,
    parse_machine,
    shipped_machine,
    shipped_machine_names,
    shipped_machine_text,
)
from jointplay.solver.machines.parts import Mount, RotationDrive, Spring
from jointplay.solver.machines.yamlfile import LARGEST_TEXT, read_tree

SHAPER = Path(__file__).parents[1] / "data" / "machines" / "quick-return-shaper.yaml"


def test_yaml_1_2_numbers_and_words() -> None:
    text = """
    name: y
    links:
      y: {mass: 1.0e7, inertia: 1e-3, cg: [.5, -0]}
      no: {mass: 1, inertia: 1, cg: [0, 0]}
    joints: {on: {kind: turning, links: [no, y], at: [0, 0]}}
    """
    machine = parse_machine(text)
    assert (machine.name, machine.frame, machine.turning_joints) == ("y", "y", ("on",))
    assert machine.links["y"].mass == 1.0e7
    assert machine.links["y"].inertia == 1e-3
    assert machine.links["y"].cg == (0.5, 0.0)


def test_links_may_be_called_by_numbers() -> None:
    text = "{name: 1, links: {1: {fixed: true}, 2: {mass: 1, inertia: 1, cg: [0, 0]}}," \
           " joints: {1: {kind: turning, links: [2, 1], at: [0, 0]}}}"  # fmt: skip
    machine = parse_machine(text)
    assert machine.frame == "1"
    assert machine.joints["1"].links == ("2", "1")


def test_the_same_machine_as_yaml_json_and_mapping() -> None:
    machine = parse_machine(shipped_machine_text("slider-crank"))
    assert parse_machine(json.dumps(SLIDER_CRANK)) == machine
    assert parse_machine(SLIDER_CRANK) == machine


def test_everything_the_file_format_has_is_read() -> None:
    machine = load_machine(SHAPER)
    assert (machine.name, machine.frame, machine.gravity) == ("quick-return shaper", "bed", 9.81)
    assert machine.turning_joints == ("O", "A", "C", "E", "F")
    assert machine.sliding_joints == ("G", "guide")
    joints = {name: joint for name, joint in machine.joints.items() if isinstance(joint, TurningJoint)}
    assert (joints["O"].pin, joints["O"].pin_radius, joints["E"].pin) == ("crank", 0.0, "rocker")
    assert joints["C"].viscous == 0.02
    assert joints["O"].contact == machine.defaults.contact
    assert joints["A"].contact == Contact(stiffness=1e7, friction_velocity=0.01)
    assert joints["E"].contact == Contact(
        stiffness=2e7, friction=0.1, friction_velocity=0.01
    )  # the rest from the defaults
    guide = machine.joints["G"]
    assert guide.kind == "sliding"
    assert math.hypot(*guide.direction) == pytest.approx(1, abs=1e-15)
    assert guide.direction[0] / guide.direction[1] == pytest.approx(0.305 / 0.952, rel=1e-15)
    drive = machine.drive
    assert isinstance(drive, RotationDrive)
    assert (drive.speed, drive.ripple[0].order, drive.ripple[0].amplitude) == (12.566, 1.0, 0.01)
    assert machine.initial.velocities["crank"].omega == -1
    assert machine.initial.velocities["crank"].velocity is None
    assert machine.initial.velocities["bed"].velocity == (0.4, -0.3)
    spring, damper, mount, between = machine.supports
    assert isinstance(spring, Spring)
    assert spring.free_length == pytest.approx(0.3, rel=1e-15)
    assert (damper.kind, mount.kind) == ("damper", "mount")
    assert isinstance(mount, Mount)
    assert mount.stiffness == (2e5, 4e5)
    assert isinstance(between, Spring)
    assert (between.to_link, between.stiffness, between.free_length) == ("bed", 4000.0, 0.3)
    assert machine.loads[0].force == (-500.0, 0.0)
    assert machine.loads[1].over_time == ((0, 0, 0, 0), (1, -500, 0, 0))
    assert machine.loads[2].over_angle == ((0, 0, 0, 0), (1.2, -800, 0, 0), (3.1, 0, 0, 0))
    assert machine.sensors[0].direction == (0.0, 1.0)


@pytest.mark.parametrize(
    "drive",
    [
        {"kind": "rotation", "joint": "O", "speed": [[0, 0], [2.0, 62.8]]},
        {"kind": "rotation", "joint": "O", "speed": [[0, 0], ["2 s", "600 rpm"]]},
        {"kind": "rotation", "joint": "O", "speed": 0},
        {"kind": "rotation", "joint": "O", "speed": "-600 rpm"},
        {"kind": "translation", "joint": "G1", "speed": 0.1,
         "harmonics": [{"frequency": 1.5, "amplitude": 0.06, "phase": -1.5708}]},
        {"kind": "translation", "joint": "G1", "speed": [[0, 0], [1, 0.1]]},
        {"kind": "torque", "joint": "O", "torque": 5.0},
        {"kind": "torque", "joint": "O", "curve": [[0, 20], [150, 0]]},
        {"kind": "force", "joint": "G1", "force": 100},
        {"kind": "force", "joint": "G1", "curve": [[0, 100], ["1 m/s", "0 N"]]},
        None,
    ],
)  # fmt: skip
def test_every_kind_of_drive_is_read(drive: dict[str, Any] | None) -> None:
    machine = parse_machine(changed("drive", drive))
    assert (machine.drive.kind if machine.drive else None) == (drive["kind"] if drive else None)
    assert parse_machine(machine.canonical_json()) == machine


def test_free_length_from_static_deflection() -> None:
    machine = parse_machine(changed("supports.0", {**SPRING, "static_deflection": "5 mm"}))
    spring = machine.supports[0]
    assert isinstance(spring, Spring)
    assert spring.free_length == pytest.approx(0.105, rel=1e-15)


def test_a_frame_alone_and_a_body_on_a_spring_are_machines() -> None:
    body = {"mass": 1, "inertia": 1, "cg": [0, 0]}
    assert parse_machine({"name": "free", "links": {"body": body}}).frame == "body"
    spring = {**SPRING, "link": "mass"}
    parse_machine({"name": "two", "links": {"base": {"fixed": True}, "mass": body}, "supports": [spring]})


def test_shipped_machines() -> None:
    assert shipped_machine_names() == (
        "elliptic-trammel", "four-bar", "inverted-slider-crank", "parallel-cranks", "quick-return", "scotch-yoke",
        "slider-crank", "stephenson-six-bar", "toggle-press", "v-twin", "walking-beam", "watt-six-bar",
    )  # fmt: skip
    for name in shipped_machine_names():
        machine = shipped_machine(name)
        assert machine.name == name
        assert [sensor.name for sensor in machine.sensors] == ["s1-x", "s1-y", "s2-x", "s2-y"]
    assert shipped_machine("slider-crank").turning_joints == ("O", "A", "B")
    assert shipped_machine("four-bar").turning_joints == ("O", "A", "B", "D")
    assert shipped_machine("quick-return").turning_joints == ("O", "A", "C", "E", "F")
    speeds = {name: shipped_machine(name).drive for name in shipped_machine_names()}
    assert {name: round(drive.speed * 30 / math.pi) for name, drive in speeds.items()} == {  # type: ignore[union-attr]
        "elliptic-trammel": 120,
        "four-bar": 300,
        "inverted-slider-crank": 270,
        "parallel-cranks": 300,
        "quick-return": 120,
        "scotch-yoke": 240,
        "slider-crank": 600,
        "stephenson-six-bar": 150,
        "toggle-press": 90,
        "v-twin": 900,
        "walking-beam": 30,
        "watt-six-bar": 180,
    }


@pytest.mark.parametrize("name", ["slider-crank", "four-bar", "quick-return"])
def test_links_of_shipped_machines_are_as_long_as_they_should_be(name: str) -> None:
    machine = shipped_machine(name)
    lengths = {
        "slider-crank": {("O", "A"): 0.05, ("A", "B"): 0.15},
        "four-bar": {("O", "A"): 0.06, ("A", "B"): 0.2, ("B", "D"): 0.15, ("O", "D"): 0.2},
        "quick-return": {("O", "A"): 0.08, ("O", "C"): 0.25, ("C", "E"): 0.42, ("E", "F"): 0.12},
    }[name]
    for (one, other), length in lengths.items():
        assert math.dist(machine.joints[one].at, machine.joints[other].at) == pytest.approx(length, abs=1e-8)


def test_resolve_by_name_and_by_path(tmp_path: Path) -> None:
    assert load_machine("four-bar") == shipped_machine("four-bar")
    path = tmp_path / "my.yaml"
    path.write_text("\ufeff" + shipped_machine_text("four-bar"), encoding="utf-8")
    assert load_machine(path) == shipped_machine("four-bar")
    with pytest.raises(MachineError) as caught:
        load_machine("four-baar")
    assert str(caught.value) == 'four-baar: is neither a file nor a shipped machine; did you mean "four-bar"?'
    with pytest.raises(MachineError) as caught:
        shipped_machine("fourbar")
    assert str(caught.value) == 'fourbar: is not a shipped machine; did you mean "four-bar"?'


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "long.yaml").write_text("a" * (LARGEST_TEXT + 1))
    for path, rule in (
        (tmp_path / "none.yaml", "is neither a file nor a shipped machine"),
        (tmp_path, "cannot be read: Is a directory"),
        (tmp_path / "long.yaml", f"must not be longer than {LARGEST_TEXT} characters"),
    ):
        with pytest.raises(MachineError) as caught:
            load_machine(path)
        assert str(caught.value).startswith(f"{path}: {rule}")
    path = tmp_path / "latin.yaml"
    path.write_bytes("name: Kurbelschwinge für alle".encode("latin-1"))
    with pytest.raises(MachineError) as caught:
        load_machine(path)
    assert str(caught.value) == f"{path}: is not a text file in UTF-8"


def test_content_key_is_of_the_content() -> None:
    machine = shipped_machine("slider-crank")
    turned = dict(reversed(SLIDER_CRANK.items()))
    assert parse_machine(turned).content_key == machine.content_key
    assert len(machine.content_key) == 64
    assert hash(parse_machine(turned)) == hash(machine)
    other = parse_machine(changed("links.crank.mass", 0.30000000000000004))
    assert other.content_key != machine.content_key
    plain = parse_machine(changed("links.crank.mass", 0.3))
    assert plain.content_key == machine.content_key


def test_a_machine_cannot_be_changed() -> None:
    machine = shipped_machine("slider-crank")
    with pytest.raises(ValueError, match="frozen"):
        machine.gravity = 0.0  # type: ignore[misc]


def test_schema_accepts_the_files_and_refuses_mistakes() -> None:
    schema = machine_json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    for name in shipped_machine_names():
        validator.validate(read_tree(shipped_machine_text(name), name))
        validator.validate(json.loads(shipped_machine(name).canonical_json()))
    validator.validate(read_tree(SHAPER.read_text(), "shaper"))
    for path, value in (
        ("links.crank.mas", 3),
        ("links.crank.mass", -1),
        ("links.crank.cg", [1]),
        ("joints.A.kind", "turnin"),
        ("drive.speed", True),
        ("name", MISSING),
    ):
        assert not validator.is_valid(changed(path, value)), path


lengths = st.floats(-10, 10)
positive = st.floats(1e-9, 1e9)
points = st.tuples(lengths, lengths)
names = st.from_regex(r"[a-zA-Z][a-zA-Z0-9_]{0,7}", fullmatch=True)
directions = points.filter(lambda vector: max(map(abs, vector)) > 1e-6)


@st.composite
def machine_trees(draw: st.DrawFn) -> dict[str, Any]:
    """Draw open chains: each link is joined to one before it."""
    links = draw(st.lists(names, min_size=1, max_size=5, unique=True))
    tree: dict[str, Any] = {
        "name": "drawn",
        "gravity": draw(lengths),
        "links": {name: {"mass": draw(positive), "inertia": draw(positive), "cg": draw(points)} for name in links},
        "joints": {},
        "sensors": [{"name": "s", "at": draw(points), "direction": draw(directions)}],
        "supports": [{"kind": "mount", "link": draw(st.sampled_from(links)), "at": draw(points),
                      "stiffness": draw(st.tuples(positive, positive))}],
    }  # fmt: skip
    for index, name in enumerate(links[1:], start=1):
        joint: dict[str, Any] = {"links": [name, draw(st.sampled_from(links[:index]))], "at": draw(points)}
        if draw(st.booleans()):
            joint |= {"kind": "turning", "contact": {"stiffness": draw(positive)}, "pin_radius": draw(positive)}
        else:
            joint |= {"kind": "sliding", "direction": draw(directions), "friction": draw(st.floats(0, 1))}
        tree["joints"][f"J{index}"] = joint
    return tree


def test_a_direction_along_an_axis_but_for_rounding_has_no_negative_zero() -> None:
    x, y = UnitVector().validate((2.0, -5e-324))
    assert (x, math.copysign(1.0, y)) == (1.0, 1.0)


@given(machine_trees())
def test_what_is_written_is_read_again(tree: dict[str, Any]) -> None:
    machine = parse_machine(tree)
    again = parse_machine(machine.canonical_json())
    assert again == machine
    assert again.content_key == machine.content_key
    assert Machine.model_validate(machine.model_dump()) == machine
    for joint in machine.joints.values():
        if joint.kind == "sliding":
            assert abs(math.hypot(*joint.direction) - 1) < 1e-15
    jsonschema.Draft202012Validator(machine_json_schema()).validate(json.loads(machine.canonical_json()))
