from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path

import pytest
from extremes.scenes import four_bar
from hypothesis import given
from hypothesis import strategies as st

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.course import MOST_LINKS, course_of
from jointplay.solver.machines.drawing import LETTERS, Picture, Sheet, draw_machine, machine_svg
from jointplay.solver.machines.labels import Label, distance_to_box, place_labels
from jointplay.solver.machines.machine import (
    Machine,
    load_machine,
    parse_machine,
    shipped_machine,
    shipped_machine_names,
)
from jointplay.solver.machines.marks import RED
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
    assert_inside(draw_machine(machine))


def assert_inside(picture: Picture) -> None:
    left, top, width, height = picture.box
    boxes = [(*at, mark.radius, mark.radius) for group in picture.groups for mark in group.marks for at in mark.points]
    boxes += [(*label.middle, *label.half) for label in picture.labels]
    for x, y, half_x, half_y in boxes:
        assert left <= x - half_x and x + half_x <= left + width
        assert top <= y - half_y and y + half_y <= top + height


def grounds(machine: Machine) -> int:
    """How many pieces of ground are drawn: each has one level line."""
    marks = [mark for group in draw_machine(machine).groups for mark in group.marks if mark.look == "ground"]
    return sum(mark.points[0][1] == mark.points[-1][1] for mark in marks)


def assert_apart(picture: Picture) -> None:
    """No text covers another one, or a pin."""
    for index, label in enumerate(picture.labels):
        for other in picture.labels[:index]:
            room = [label.half[k] + other.half[k] - abs(label.middle[k] - other.middle[k]) for k in (0, 1)]
            assert min(room) <= 0, (label.text, other.text)
        for group in picture.groups:
            for mark in group.marks:
                if mark.radius and group.kind == "joint":
                    assert distance_to_box(mark.points[0], label.middle, label.half) >= 0.5 * mark.radius, label.text


@pytest.mark.parametrize("name", shipped_machine_names())
def test_labels_cover_neither_each_other_nor_pins(name: str) -> None:
    assert_apart(draw_machine(shipped_machine(name)))


def test_letters_are_legible_on_a_telephone() -> None:
    """328 pixels are left of 360; 9 is the least that browsers draw by default in print."""
    for name in shipped_machine_names():
        picture = draw_machine(shipped_machine(name))
        assert min(size for size, *_ in LETTERS.values()) * 328 / picture.box[2] >= 8.5, name


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
    assert grounds(load_machine(SHAPER)) == 3


def test_a_fixed_frame_stands_on_the_ground() -> None:
    body = {"mass": 1, "inertia": 1, "cg": [1, 0]}
    tree = {
        "name": "pendulum",
        "links": {"wall": {"fixed": True}, "rod": body},
        "joints": {"P": {"kind": "turning", "links": ["rod", "wall"], "at": [0, 0]}},
    }
    machine = parse_machine(tree)
    assert grounds(machine) == 1
    rod = machine_shapes(machine).links[1]
    assert rod.outlines == (((0.0, 0.0), (1.0, 0.0)),)  # from its only joint to its centre of gravity


def test_a_single_body_is_drawn() -> None:
    machine = parse_machine({"name": "free", "links": {"body": {"mass": 1, "inertia": 1, "cg": [3, 4]}}})
    assert machine_shapes(machine).bounds == (3.0, 4.0, 3.0, 4.0)
    assert_inside(draw_machine(machine))


def test_a_slotted_rocker_is_one_bar_with_its_slot_as_far_as_the_block_goes() -> None:
    machine = shipped_machine("quick-return")
    shapes = machine_shapes(machine)
    links = {link.name: link for link in shapes.links}
    ((start, end),) = links["rocker"].outlines  # from C to E, whichever way round
    ends = sorted([machine.joints["C"].at, machine.joints["E"].at])
    assert [pytest.approx(at, abs=1e-6) for at in ends] == sorted([start, end])
    assert len(links["frame"].points) > 2
    slot = next(guide for guide in shapes.guides if guide.name == "G1")
    assert not slot.on_frame
    # The crank of 80 mm goes round 250 mm above C: the block is between 170 and 330 mm from there.
    reach = sorted(math.dist(machine.joints["C"].at, at) for at in (slot.start, slot.end))
    more = 0.06 * course_of(machine).size
    assert reach == pytest.approx([0.17 - more, 0.33 + more], abs=1e-3)


def yoke(**more: object) -> Machine:
    """A scotch yoke drawn at 30 deg: crank of 40 mm, rod to the right."""
    x, y = 0.04 * math.cos(math.pi / 6), 0.04 * math.sin(math.pi / 6)
    body = {"mass": 1, "inertia": 0.01}
    tree: dict[str, object] = {
        "name": "yoke",
        "links": {
            "bed": {"fixed": True},
            **{name: {**body, "cg": [x, y]} for name in ("crank", "block", "yoke")},
        },
        "joints": {
            "O": {"kind": "turning", "links": ["crank", "bed"], "at": [0, 0]},
            "A": {"kind": "turning", "links": ["block", "crank"], "at": [x, y]},
            "G1": {"kind": "sliding", "links": ["block", "yoke"], "at": [x, y], "direction": [0, 1]},
            "G2": {"kind": "sliding", "links": ["yoke", "bed"], "at": [x + 0.15, 0], "direction": [1, 0]},
        },
        "drive": {"kind": "rotation", "joint": "O", "speed": 10},
        "sensors": [{"name": "v1", "at": [0.0, 0.1], "direction": [0, 1]}],
    }
    return parse_machine({**tree, **more})


def test_a_slotted_yoke_is_a_slot_across_and_a_rod_along() -> None:
    shapes = machine_shapes(yoke())
    links, guides = ({each.name: each for each in group} for group in (shapes.links, shapes.guides))
    slot, rod = links["yoke"].outlines
    assert {round(x, 9) for x, _ in slot} == {round(0.04 * math.cos(math.pi / 6), 9)}  # upright
    assert sorted(y for _, y in slot) == pytest.approx([-0.04 - 0.0099, 0.04 + 0.0099], abs=3e-3)
    assert [y for _, y in rod] == pytest.approx([0.0, 0.0], abs=1e-9)  # and not the diagonal from pin to guide
    assert (guides["G1"].on_frame, guides["G2"].on_frame) == (False, True)
    long = math.dist(guides["G2"].start, guides["G2"].end)
    assert 0.08 < long < 0.12  # twice the crank, and a little


def test_a_sensor_beyond_everything_else_is_drawn() -> None:
    """Its arrow and name are above the highest joint."""
    picture = draw_machine(yoke())
    assert_inside(picture)
    (sensor,) = (group for group in picture.groups if group.kind == "sensor")
    assert min(y for mark in sensor.marks for _, y in mark.points) >= picture.box[1]
    assert "v1" in [label.text for label in picture.labels]


@pytest.mark.parametrize(
    ("speed", "links", "sense"),
    [
        (10, ["crank", "bed"], 1),
        (-10, ["crank", "bed"], -1),
        (10, ["bed", "crank"], -1),
        ([[0, 0], [1, -5]], ["crank", "bed"], -1),
    ],
)
def test_the_arc_of_the_drive_goes_the_way_of_the_crank(speed: object, links: list[str], sense: int) -> None:
    joints = yoke().model_dump()["joints"]
    joints["O"] |= {"links": links, "pin": "crank"}
    picture = draw_machine(yoke(joints=joints, drive={"kind": "rotation", "joint": "O", "speed": speed}))
    (drive,) = (group for group in picture.groups if group.kind == "drive")
    points = drive.marks[0].points
    middle = next(group for group in picture.groups if group.name == "O").marks[0].points[0]
    turns = [
        (a[0] - middle[0]) * (b[1] - middle[1]) - (a[1] - middle[1]) * (b[0] - middle[0]) for a, b in pairwise(points)
    ]
    assert all(turn * sense < 0 for turn in turns)  # y is down
    assert ("clockwise" in drive.title) and ("counter" in drive.title) == (sense > 0)


def stuck(short: float = 0.02) -> Machine:
    """A four-bar whose crank and bed are together longer than its other links: it stops on the way."""
    return four_bar(0.06, 0.12, 0.14 - short, 0.20, 1.0)


def test_what_cannot_be_assembled_is_drawn_where_it_is_open_widest() -> None:
    machine = stuck()
    picture = draw_machine(machine, open_joint="B")
    shapes = machine_shapes(machine, "B")
    assert shapes.gap is not None and shapes.gap.name == "B"
    # Crank and bed on one line are 260 mm; coupler and rocker 240 mm.
    assert shapes.gap.size == pytest.approx(0.02, abs=2e-4)
    assert math.dist(*shapes.gap.ends) == pytest.approx(shapes.gap.size)
    (gap,) = (group for group in picture.groups if group.kind == "gap")
    assert math.dist(*gap.marks[0].points) == pytest.approx(shapes.gap.size * Sheet(shapes).scale)
    assert {mark.colour for mark in gap.marks} == {RED}
    assert [label.text for label in picture.labels if label.kind == "gap"] == ["B: 20 mm open"]
    assert "It cannot be assembled: at " in picture.description
    assert_inside(picture)
    assert_apart(picture)
    svg = root(machine, open_joint="B")
    assert classes(svg).count("gap") == 1


def test_all_other_joints_stay_closed_there() -> None:
    course = course_of(stuck(), "D")
    assert course.widest[0] == "D"
    for name in "OAB":
        assert course.gaps[name].max() < 1e-6
    shared = course_of(stuck())
    assert sum(gap.max() > 1e-3 for gap in shared.gaps.values()) > 1


@pytest.mark.parametrize(("links", "positions"), [(5, 72), (MOST_LINKS, 1)])
def test_machines_of_many_links_are_drawn_as_they_stand(links: int, positions: int) -> None:
    body = {"mass": 1, "inertia": 0.1}
    tree: dict[str, dict[str, object]] = {"links": {"wall": {"fixed": True}}, "joints": {}}
    for k in range(links):
        tree["links"][f"L{k}"] = {**body, "cg": [k + 0.5, 0]}
        tree["joints"][f"J{k}"] = {"kind": "turning", "links": [f"L{k}", f"L{k - 1}" if k else "wall"], "at": [k, 0]}
    machine = parse_machine({"name": "chain", **tree, "drive": {"kind": "rotation", "joint": "J0", "speed": 1}})
    assert len(course_of(machine).drive) == positions


def test_nothing_is_open_in_a_machine_that_can_be_assembled() -> None:
    machine = shipped_machine("four-bar")
    assert machine_shapes(machine, "").gap is None
    assert draw_machine(machine, open_joint="B").groups == draw_machine(machine).groups


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
    labels = [Label(name, (100.0, 100.0), clear=8.0) for name in ("A", "B", "G1", "crank")]
    spots = place_labels(labels, [((60.0, 100.0), (140.0, 100.0), 10.0)], (0.0, 0.0, 200.0, 200.0))
    for index, (label, (x, y)) in enumerate(zip(labels, spots, strict=True)):
        assert distance_to_box((100, 100), (x, y), label.half) >= 8
        assert abs(y - 100) > 5 + label.half[1]  # off the line
        for other, (other_x, other_y) in zip(labels[:index], spots, strict=False):
            wide, high = (label.half[k] + other.half[k] for k in (0, 1))
            assert abs(x - other_x) >= wide or abs(y - other_y) >= high


def test_pins_are_drawn_over_the_blocks_they_sit_in() -> None:
    """Joint A of the quick-return sits in the block that slides in G1."""
    svg = machine_svg(shipped_machine("quick-return"), {"A": "#c00", "G1": "#fff"})
    assert svg.index("joint-G1") < svg.index("joint-A")


def test_of_two_pins_in_one_place_the_coloured_one_is_on_top() -> None:
    svg = machine_svg(shipped_machine("v-twin"), {"A1": "#c00"})
    assert svg.index('class="joint joint-A2"') < svg.index('class="joint joint-A1"')


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
    assert not any(joint.sense for joint in shapes.joints)
