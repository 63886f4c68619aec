"""What is remarked of a machine: each remark comes just beyond its bound, and not just inside it."""

from __future__ import annotations

import math
from typing import Any

import pytest
from machine_trees import changed

from jointplay.solver.cases.remarks import LEAST_WIDTH, MAIN_ORDERS, NO_PEAK, find_remarks
from jointplay.solver.machines.machine import parse_machine, shipped_machine_names, shipped_machine_text
from jointplay.solver.machines.remarks import FAR_OUTSIDE, speed_remarks
from jointplay.solver.machines.yamlfile import read_tree

#: Of the slider-crank as it ships, and true of it: the second order of its frame's x has its peak at 10.5 Hz of the
#: drive, 2 dB above what it is at 10 Hz and 9 dB above that at 9 Hz.
SHIPPED = "drive: order 2 is at 20 Hz, in the resonance of frame in x at 20.9 Hz, damping ratio 0.064"


def remarks_on(tree: dict[str, Any]) -> list[str]:
    return [line for line in find_remarks(parse_machine(tree)) if line != SHIPPED]


def block(damping_ratio: float = 0.02, frequency: float = 50.0, **others: Any) -> dict[str, Any]:
    """A frame of 10 kg on a spring in y that a rotor turns on, 600 rpm; other motions locked."""
    stiffness = 12.0 * (2 * math.pi * frequency) ** 2
    damping = 2 * damping_ratio * math.sqrt(stiffness * 12.0)
    links = {
        "frame": {"mass": 10, "inertia": 1, "cg": [0, 0], "locked": ["x", "theta"]},
        "rotor": {"mass": 2, "inertia": 0.01, "cg": [0, 0]},
    }
    mount = {"kind": "mount", "link": "frame", "at": [0, 0], "stiffness": [0, stiffness], "damping": [0, damping]}
    drive = {"kind": "rotation", "joint": "O", "speed": "600 rpm"} | others.pop("drive", {})
    joints = {"O": {"kind": "turning", "links": ["rotor", "frame"], "at": [0, 0]}}
    return {"name": "block", "links": links, "joints": joints, "drive": drive, "supports": [mount]} | others


@pytest.mark.parametrize("name", shipped_machine_names())
def test_shipped_machines_are_plausible(name: str) -> None:
    found = find_remarks(parse_machine(shipped_machine_text(name)))
    assert found == ([SHIPPED] if name == "slider-crank" else [])


@pytest.mark.parametrize(
    ("speed", "said"),
    [
        (600, "drive.speed: 600 is in rad/s: 5729.6 rpm; write 600rpm if that was meant"),
        ("1500", "drive.speed: 1500 is in rad/s: 14324 rpm; write 1500rpm if that was meant"),
        ("600 rpm", None),
        (62.831853072, None),
        ([[0, 0], [1, 60]], None),
    ],
)
def test_a_speed_without_a_unit_is_said_in_rpm(speed: object, said: str | None) -> None:
    found = list(speed_remarks({"drive": {"kind": "rotation", "joint": "O", "speed": speed}}))
    assert found == ([said] if said else [])
    assert list(speed_remarks({"drive": {"kind": "translation", "joint": "G", "speed": speed}})) == []


@pytest.mark.parametrize("name", shipped_machine_names())
def test_shipped_machines_turn_at_whole_speeds(name: str) -> None:
    assert list(speed_remarks(read_tree(shipped_machine_text(name), name))) == []


def test_a_pin_larger_than_its_link() -> None:
    line = "joints.A.pin_radius: 0.0501 m: larger than link crank, 0.05 m; is it in mm, or an eccentric?"
    assert remarks_on(changed("joints.A.pin_radius", 0.0501)) == [line]
    assert remarks_on(changed("joints.A.pin_radius", 0.0499)) == []
    # The rod is 0.15 m long; the slider is not, wherever on its line the guide is drawn.
    assert len(remarks_on(changed("joints.B.pin_radius", 0.151))) == 1
    assert remarks_on(changed("joints.B.pin_radius", 0.149)) == []
    assert remarks_on(changed("joints.G1.at", [0.201, 0.05])) == []


def test_a_crank_without_length() -> None:
    line = (
        "links.crank: joints O and A: 19.9 um long, no more than the radial play of its joints as new, 20 um; "
        "it moves nothing"
    )
    assert [each for each in remarks_on(changed("joints.A.at", [19.9e-6, 0.05])) if "long, no" in each] == [line]
    assert not any("long, no" in each for each in remarks_on(changed("joints.A.at", [20.1e-6, 0.05])))
    # Neither its pins nor its centre of gravity can be compared with a length that it does not have.
    assert len(remarks_on(changed("joints.A.at", [0.0, 0.05]))) == 1


def test_a_drive_that_does_not_move_all_of_it() -> None:
    tree = changed("drive", {"kind": "torque", "joint": "O", "torque": "1 N m"})
    assert not any("follow" in line for line in remarks_on(tree))
    del tree["joints"]["B"]
    line = "drive: 2 motions of links besides the frame's do not follow from it; is a joint missing?"
    assert line in remarks_on(tree)
    tree["drive"] = {"kind": "rotation", "joint": "O", "speed": "600 rpm"}
    assert line in remarks_on(tree)


def test_joints_of_what_stands_may_be_at_one_place() -> None:
    bob = {"mass": 1, "inertia": 0.01, "cg": [0, -1]}
    hung = {"kind": "turning", "at": [0, 0]}
    joints = {name: {**hung, "links": [name, "wall"]} for name in ("left", "right")}
    links = {"bed": {"fixed": True}, "wall": {"fixed": True}, "left": bob, "right": bob}
    assert remarks_on({"name": "two pendulums", "frame": "bed", "links": links, "joints": joints}) == []


@pytest.mark.parametrize(
    ("link", "place", "length"),
    [
        ("crank", (-FAR_OUTSIDE * 0.05, 0.05), "the link is 0.05 m"),
        ("slider", (0.2 + 1.5, 0.05), "the machine is 0.5 m"),
    ],
)
def test_a_centre_of_gravity_far_outside_its_link(link: str, place: tuple[float, float], length: str) -> None:
    """A slider has one turning joint: the machine's length counts."""
    x, y = place
    (line,) = (each for each in remarks_on(changed(f"links.{link}.cg", [x * 1.001, y])) if not each.startswith("drive"))
    assert line.startswith(f"links.{link}.cg: (") and f"and {length} long; is it in mm?" in line
    assert not any("cg" in each for each in remarks_on(changed(f"links.{link}.cg", [x * 0.999, y])))


def test_an_overdamped_frame() -> None:
    """The slow half of z s^2 + ...: exp(-w (ratio - sqrt(ratio^2 - 1)) t), down to 1 %."""
    slow = 2 * math.pi * 50 * (2 - math.sqrt(3))
    (line,) = remarks_on(block(damping_ratio=2.0))
    assert line == (
        f"supports: motion of frame in y: over-damped: it does not swing, it needs {math.log(100) / slow:.3g} s to "
        "come back to 1%; is the damping in N s/m?"
    )
    assert len(remarks_on(block(damping_ratio=1.001))) == 1
    assert remarks_on(block(damping_ratio=0.999)) == []


def test_a_foot_that_hardly_moves_leaves_a_swing_about_it() -> None:
    """One foot of two is a thousand times as damped: the frame creeps in x and y, and swings about this foot."""
    found = remarks_on(changed("supports.0.damping", [2e5, 3e5]))
    assert [line.split(":")[1] for line in found] == [" motion of frame in x", " motion of frame in y"]


@pytest.mark.parametrize("order", MAIN_ORDERS)
@pytest.mark.parametrize("side", [-1, 1])
def test_an_order_in_a_resonance(order: float, side: int) -> None:
    """Within the band in which the answer is above its peak less 3 dB."""
    for ratio in (0.02, 0.3):
        width = max(ratio, LEAST_WIDTH)
        inside, outside = (10.0 * order / (1 + side * part * width) for part in (0.99, 1.01))
        met = [line for line in remarks_on(block(ratio, inside)) if f"order {order:g} " in line]
        assert met == [
            f"drive: order {order:g} is at {10 * order:.3g} Hz, in the resonance of frame in y at {inside:.3g} Hz, "
            f"damping ratio {ratio:g}"
        ]
        assert not any(f"order {order:g} " in line for line in remarks_on(block(ratio, outside)))


def test_a_mode_without_a_peak_is_no_resonance() -> None:
    """Just below, the answer to order 1 has points 3 dB below its peak on both sides."""
    assert remarks_on(block(0.99 * NO_PEAK, 10.0))
    assert remarks_on(block(1.01 * NO_PEAK, 10.0)) == []
    peak = 1 / (2 * NO_PEAK * math.sqrt(1 - NO_PEAK**2))
    assert peak == pytest.approx(math.sqrt(2), rel=1e-12)


def test_orders_that_the_file_gives_are_looked_at() -> None:
    assert remarks_on(block()) == []  # order 5
    load = {"link": "frame", "at": [0, 0], "force": [0, 10], "order": 5}
    assert "order 5 is at 50 Hz" in remarks_on(block(loads=[load]))[0]
    ripple = {"ripple": [{"order": 5, "amplitude": 0.01}]}
    assert "order 5 is at 50 Hz" in remarks_on(block(drive=ripple))[0]
    # A run-up goes through every frequency; a torque has no speed.
    assert remarks_on(block(frequency=10.0, drive={"speed": [[0, 0], [1, 70]]})) == []
    assert remarks_on(block(frequency=10.0) | {"drive": {"kind": "torque", "joint": "O", "torque": 1}}) == []


def test_motions_that_no_spring_holds_are_no_modes() -> None:
    assert remarks_on(block() | {"supports": []}) == []
    damper = {"kind": "damper", "link": "frame", "at": [0, 0], "anchor": [0, -1], "damping": 1e6}
    assert remarks_on(block() | {"supports": [damper]}) == []


def test_a_guide_that_wedges() -> None:
    """The rod pushes at its steepest with the crank at right angles: friction times tan(asin(1/3)) is 1."""
    wedging = 1 / math.tan(math.asin(1 / 3))
    (line,) = remarks_on(changed("joints.G1.friction", 1.001 * wedging))
    assert line == (
        "joints.G1.friction: 2.83126: times its leverage on the normal force 1 after 90 deg of the drive; "
        "from 1 on a guide wedges where its load presses it on"
    )
    assert remarks_on(changed("joints.G1.friction", 0.999 * wedging)) == []


def test_a_contact_law_that_returns_another_restitution() -> None:
    tree = read_tree(shipped_machine_text("four-bar"), "four-bar.yaml")
    tree["joints"]["A"]["contact"] = {"law": "lankarani-nikravesh", "stiffness": 6.6e10, "restitution": 0.5}
    line = "joint A: contact law lankarani-nikravesh asked for a restitution of 0.5 returns 0.725"
    assert remarks_on(tree) == [line]
