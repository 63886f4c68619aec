from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.drawing import machine_svg, place_labels
from jointplay.solver.machines.machine import (
    Machine,
    load_machine,
    parse_machine,
    shipped_machine,
    shipped_machine_names,
)
from jointplay.solver.machines.shapes import convex_outline, machine_shapes

SHAPER = Path(__file__).parents[1] / "data" / "machines" / "quick-return-shaper.yaml"
NAMESPACE = "{http://www.w3.org/2000/svg}"


def root(machine: Machine, **options: object) -> ET.Element:
    return ET.fromstring(machine_svg(machine, **options))  # type: ignore[arg-type]


def classes(svg: ET.Element) -> list[str]:
    return [name for element in svg.iter() for name in element.get("class", "").split()]


@pytest.mark.parametrize("name", shipped_machine_names())
def test_everything_is_drawn_inside_the_picture(name: str) -> None:
    machine = shipped_machine(name)
    svg = root(machine)
    found = classes(svg)
    assert found.count("link") == len(machine.links)
    assert found.count("joint") == len(machine.joints)
    assert found.count("support") == len(machine.supports)
    assert found.count("sensor") == len(machine.sensors)
    assert {f"joint-{joint}" for joint in machine.joints} <= set(found)
    texts = [element.text for element in svg.iter(f"{NAMESPACE}text")]
    sensors = [sensor.name for sensor in machine.sensors]
    assert sorted(map(str, texts)) == sorted([*machine.joints, *machine.links, *sensors])
    _, _, width, height = map(float, svg.attrib["viewBox"].split())
    for element in svg.iter():
        x, y = (float(element.get(key, "0")) for key in (("cx", "cy") if "cx" in element.attrib else ("x", "y")))
        assert 0 <= x <= width
        assert 0 <= y <= height
        for mx, my in re.findall(r"[ML]([-\d.]+) ([-\d.]+)", element.get("d", "")):
            assert 0 <= float(mx) <= width
            assert 0 <= float(my) <= height


def test_it_can_be_read_aloud_and_follows_the_page() -> None:
    text = machine_svg(shipped_machine("slider-crank"))
    svg = ET.fromstring(text)
    title, desc = svg.find(f"{NAMESPACE}title"), svg.find(f"{NAMESPACE}desc")
    assert title is not None
    assert desc is not None
    assert svg.get("role") == "img"
    assert svg.get("aria-labelledby") == f"{title.get('id')} {desc.get('id')}"
    assert title.text == "Drawing of slider-crank"
    assert desc.text == (
        "Links: frame, crank, rod, slider; the frame is frame. "
        "Joints: O (turning, crank on frame), A (turning, rod on crank), B (turning, rod on slider), "
        "G1 (sliding, slider on frame). Driven at O. Supports: mount on frame, mount on frame. "
        "Sensors: s1-x, s1-y, s2-x, s2-y."
    )
    assert svg.get("stroke") == "currentColor"
    assert "#" not in text  # no colour of its own
    assert "<style" not in text
    assert " style=" not in text


def test_joints_are_coloured_and_titled_on_request() -> None:
    svg = root(shipped_machine("slider-crank"), joint_colours={"A": "#d1495b", "G1": "rgb(1 2 3)"}, title="worn: A")
    fills = {
        group.get("class"): group[1].get("fill")
        for group in svg.iter(f"{NAMESPACE}g")
        if "joint" in group.get("class", "")
    }
    assert fills == {
        "joint joint-O": "none",
        "joint joint-A": "#d1495b",
        "joint joint-B": "none",
        "joint joint-G1": "rgb(1 2 3)",
    }
    title = svg.find(f"{NAMESPACE}title")
    assert title is not None
    assert title.text == "worn: A"


def test_an_unknown_joint_cannot_be_coloured() -> None:
    with pytest.raises(MachineError) as caught:
        machine_svg(shipped_machine("slider-crank"), {"Z": "red"})
    assert str(caught.value) == "slider-crank: joints.Z: is not a joint of this machine; known: O, A, B, G1"


def test_names_and_colours_cannot_break_out() -> None:
    machine = parse_machine({"name": "a<b>&\"c'", "links": {"my bed": {"fixed": True}}})
    assert root(machine).find(f"{NAMESPACE}title").text == "Drawing of a<b>&\"c'"  # type: ignore[union-attr]
    assert "link-my-bed" in classes(root(machine))
    coloured = root(shipped_machine("four-bar"), joint_colours={"A": '"/><script>'})
    assert not list(coloured.iter(f"{NAMESPACE}script"))


def test_every_kind_of_support_drive_and_load_is_drawn() -> None:
    svg = root(load_machine(SHAPER))
    titles = [element.text for element in svg.iter(f"{NAMESPACE}title")]
    assert "spring on bed, to the ground" in titles
    assert "damper on bed, to the ground" in titles
    assert "spring and damper on bed, to the ground" in titles
    assert "spring on ram, to another link" in titles
    assert titles.count("load on ram") == 3
    assert "turning joint O: crank on bed, driven" in titles
    found = classes(svg)
    assert found.count("drive") == 1
    assert found.count("ground") == 3


def test_a_fixed_frame_stands_on_the_ground() -> None:
    body = {"mass": 1, "inertia": 1, "cg": [1, 0]}
    tree = {
        "name": "pendulum",
        "links": {"wall": {"fixed": True}, "rod": body},
        "joints": {"P": {"kind": "turning", "links": ["rod", "wall"], "at": [0, 0]}},
    }
    machine = parse_machine(tree)
    assert classes(root(machine)).count("ground") == 1
    rod = machine_shapes(machine).links[1]
    assert rod.outline == ((0.0, 0.0), (1.0, 0.0))  # from its only joint to its centre of gravity


def test_a_single_body_is_drawn() -> None:
    machine = parse_machine({"name": "free", "links": {"body": {"mass": 1, "inertia": 1, "cg": [3, 4]}}})
    assert machine_shapes(machine).bounds == (3.0, 4.0, 3.0, 4.0)
    assert root(machine).get("viewBox") == "0 0 112 112"


def test_a_slotted_rocker_stays_a_bar() -> None:
    shapes = {link.name: link for link in machine_shapes(shipped_machine("quick-return")).links}
    assert len(shapes["rocker"].outline) == 2
    assert not shapes["rocker"].closed
    assert shapes["frame"].closed


@given(st.lists(st.tuples(st.integers(-50, 50), st.integers(-50, 50)), min_size=1, max_size=12))
def test_an_outline_holds_every_point(points: list[tuple[float, float]]) -> None:
    outline = convex_outline(points)
    assert set(outline) <= set(points)
    if len(outline) < 3:
        return
    size = max(math.dist(a, b) for a in points for b in points)
    for (ax, ay), (bx, by) in zip(outline, outline[1:] + outline[:1], strict=True):
        for x, y in points:
            assert (bx - ax) * (y - ay) - (by - ay) * (x - ax) >= -0.01 * size**2


def test_labels_of_one_place_do_not_cover_each_other() -> None:
    spots = place_labels([(name, (100.0, 100.0)) for name in "ABCD"], [], [((100.0, 100.0), 14.0)], (200.0, 200.0))
    for index, (x, y) in enumerate(spots):
        assert math.dist((x, y), (100, 100)) > 10
        for other_x, other_y in spots[:index]:
            assert abs(x - other_x) >= 16 or abs(y - other_y) >= 14


def test_pins_are_drawn_over_the_blocks_they_sit_in() -> None:
    """Joint A of the quick-return sits in the block that slides in G1."""
    svg = machine_svg(shipped_machine("quick-return"), {"A": "#c00", "G1": "#fff"})
    assert svg.index("joint-G1") < svg.index("joint-A")


def test_a_driven_link_and_moving_ground_have_arrows() -> None:
    tree = shipped_machine("slider-crank").model_dump()
    belt = {"kind": "spring", "link": "frame", "at": [0, 0], "anchor": [0.4, 0.2], "stiffness": 10}
    shaken = {"displacement": [0, 1e-3], "frequency": 5.0}
    tree["drive"] = {"kind": "position", "link": "slider", "direction": [1, 0], "speed": 0.1}
    tree["supports"] = [{**tree["supports"][0], "motion": [shaken]}, {**belt, "motion": [shaken]}, tree["supports"][1]]
    machine = parse_machine(tree)
    shapes = machine_shapes(machine)
    assert [(drive.name, drive.at, drive.direction) for drive in shapes.drives] == [("slider", (0.2, 0.05), (1.0, 0.0))]
    assert [support.motion for support in shapes.supports] == [(0.0, 1.0), (0.0, 1.0), None]
    svg = root(machine)
    assert (classes(svg).count("drive"), classes(svg).count("motion")) == (1, 2)
    assert "Driven at the centre of gravity of slider." in machine_svg(machine)
    assert not any(joint.driven for joint in shapes.joints)
