"""Play as new and limits of turning joints in machine files."""

from __future__ import annotations

import copy
import json
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st
from machine_trees import MISSING, SLIDER_CRANK, changed

from jointplay.solver.equations.model import build_model
from jointplay.solver.errors import MachineError
from jointplay.solver.integrators.kernel import kernel_code
from jointplay.solver.machines.fits import LEAST_PART, new_fit
from jointplay.solver.machines.joints import TurningJoint
from jointplay.solver.machines.machine import Machine, machine_json_schema, parse_machine, shipped_machine
from jointplay.solver.machines.matrix import matrix_tree

KEYS = {
    "four-bar": "75a43efd89688279f4d001d7cc97b563bd30ccba50002542870781ae0310f4b5",
    "quick-return": "8a1ac5bd954bdb3052937e5b9d84028ef54f3feebea4dfda2104cae385aa6053",
    "slider-crank": "3562afd0833bbf108c727f4ebb5b2fe723a62709b78827eadb436ef00bebaf23",
}


def joint_a(tree: dict[str, Any]) -> TurningJoint:
    joint = parse_machine(tree).joints["A"]
    assert isinstance(joint, TurningJoint)
    return joint


def with_a(**members: object) -> dict[str, Any]:
    tree = copy.deepcopy(SLIDER_CRANK)
    joints: Any = tree["joints"]
    joints["A"] |= members
    return tree


@pytest.mark.parametrize("name", KEYS)
def test_machines_that_say_nothing_keep_their_content_key(name: str) -> None:
    assert shipped_machine(name).content_key == KEYS[name]


@pytest.mark.parametrize("tree", [SLIDER_CRANK, with_a(fit=None, limit=None)])
def test_defaults(tree: dict[str, Any]) -> None:
    joint = joint_a(tree)
    assert joint.play_as_new == (3e-6, 20e-6)
    assert joint.worn_out_from == pytest.approx(200e-6)
    assert str(joint.new_fit) == "3 to 20 um (default)"
    assert parse_machine(tree).content_key == KEYS["slider-crank"]


@pytest.mark.parametrize(
    ("said", "low", "high", "text"),
    [
        (["3 um", "12 um"], 3e-6, 12e-6, "given"),
        ([3e-6, 12e-6], 3e-6, 12e-6, "given"),
        ([0, "0.02 mm"], 2e-6, 20e-6, "given"),
        ("H7/g6", 3e-6, 17.5e-6, "H7/g6 at 16 mm"),
        (" H7 / g6 ", 3e-6, 17.5e-6, "H7/g6 at 16 mm"),
        ("H7/h6", 1.45e-6, 14.5e-6, "H7/h6 at 16 mm"),
        ("F8/h7", 8e-6, 30.5e-6, "F8/h7 at 16 mm"),
        ({"class": "H7/g6"}, 3e-6, 17.5e-6, "H7/g6 at 16 mm"),
        ({"class": "H7/g6", "diameter": "25 mm"}, 3.5e-6, 20.5e-6, "H7/g6 at 25 mm"),
        ({"class": "H9/d9", "diameter": 0.08}, 50e-6, 124e-6, "H9/d9 at 80 mm"),
    ],
)
def test_fits_are_resolved_and_written_as_they_were_said(said: Any, low: float, high: float, text: str) -> None:
    tree = with_a(fit=said)  # its pin_radius is 8 mm
    machine, joint = parse_machine(tree), joint_a(tree)
    assert joint.play_as_new == pytest.approx((low, high), rel=1e-12)
    assert joint.new_fit.text == text
    assert joint.worn_out_from == pytest.approx(10 * high)
    assert machine.content_key not in KEYS.values()
    written = json.loads(machine.canonical_json())
    jsonschema.Draft202012Validator(machine_json_schema()).validate(tree)
    jsonschema.Draft202012Validator(machine_json_schema()).validate(written)
    for again in (parse_machine(written), parse_machine(matrix_tree(machine)), parse_machine(machine.canonical_json())):
        assert again == machine
        assert again.content_key == machine.content_key
    assert Machine.model_validate(machine.model_dump()) == machine
    assert isinstance(written["joints"]["A"]["fit"], type(said) if text == "given" else str | dict)


def test_words_are_written_as_words() -> None:
    written = json.loads(parse_machine(with_a(fit="H7/g6", limit="0.1 mm")).canonical_json())["joints"]["A"]
    assert (written["fit"], written["limit"]) == ("H7/g6", 1e-4)
    written = json.loads(parse_machine(with_a(fit={"class": "H7/g6", "diameter": "25 mm"})).canonical_json())
    assert written["joints"]["A"]["fit"] == {"class": "H7/g6", "diameter": 0.025}


def test_a_class_follows_the_pin() -> None:
    joint = joint_a(with_a(fit="H7/g6"))
    assert joint.model_copy(update={"pin_radius": 0.0125}).play_as_new == (3.5e-6, 20.5e-6)


def test_limit() -> None:
    machine = parse_machine(with_a(limit="150 um"))
    assert joint_a(with_a(limit="150 um")).worn_out_from == pytest.approx(150e-6)
    assert parse_machine(machine.canonical_json()) == machine
    assert machine.content_key not in KEYS.values()


REACH = 'must be a range [low, high] of radial clearance or a class of ISO 286, as in "H7/g6"'


@pytest.mark.parametrize(
    ("members", "line"),
    [
        ({"fit": "H7/k6"}, "fit: H7/k6: is no clearance fit: the pin can be larger than its hole, "
         "and the joint would not turn"),
        ({"fit": "H7"}, 'fit: H7: is no fit class of ISO 286; write hole/shaft, as in "H7/g6"'),
        ({"fit": "10 um"}, f"fit: 10 um: {REACH}"),
        ({"fit": 1e-5}, f"fit: 1e-05: {REACH}"),
        ({"fit": ["3 um"]}, "fit: [3 um]: must be a list of 2 numbers"),
        ({"fit": [-1e-6, 1e-5]}, "fit.0: -1e-06: must not be less than 0"),
        ({"fit": ["3 um", "x"]}, 'fit.1: x: must be a length: a number, or a number with a unit ("0.2 mm")'),
        ({"fit": ["12 um", "3 um"]}, "fit.1: 3 um: must be greater than the lower end"),
        ({"fit": [0, 0]}, "fit.1: 0: must be greater than the lower end"),
        ({"fit": [3, 12]}, "fit.1: 12: must not be greater than 10 mm; a number without a unit is in m"),
        ({"fit": {}}, "fit.class: is missing"),
        ({"fit": {"class": 7}}, 'fit.class: 7: must be a class of ISO 286, as in "H7/g6"'),
        ({"fit": {"class": "H7"}}, 'fit.class: H7: is no fit class of ISO 286; write hole/shaft, as in "H7/g6"'),
        ({"fit": {"class": "H7/g6", "diamter": 1}}, 'fit.diamter: 1: unknown key; did you mean "diameter"?'),
        ({"fit": {"class": "H7/g6", "diameter": 0}}, "fit.diameter: 0: must be greater than 0"),
        ({"fit": {"class": "H7/g6", "diameter": 16}}, "fit.diameter: 16: ISO 286 is known here for pins of up to "
         "500 mm, this one has 16000 mm; give the range [low, high] of radial clearance"),
        ({"fit": "H7/g6", "pin_radius": 0}, "fit: H7/g6: needs the pin's diameter: give pin_radius, "
         "or {class: H7/g6, diameter: 16 mm}"),
        ({"fit": "H7/g6", "pin_radius": "0.3 m"}, "fit: H7/g6: ISO 286 is known here for pins of up to 500 mm, "
         "this one has 600 mm; give the range [low, high] of radial clearance"),
        ({"limit": 0}, "limit: 0: must be greater than 0"),
        ({"limit": 0.2}, "limit: 0.2: must not be greater than 0.1"),
        ({"limit": "20 um"}, "limit: 20 um: must be greater than the joint's play as new, 3 to 20 um (default)"),
        ({"fit": "H7/g6", "limit": 1e-5},
         "limit: 10 um: must be greater than the joint's play as new, 3 to 17.5 um (H7/g6 at 16 mm)"),
    ],
)  # fmt: skip
def test_refusals(members: dict[str, Any], line: str) -> None:
    with pytest.raises(MachineError) as caught:
        parse_machine(with_a(**members), "m.yaml")
    assert str(caught.value) == f"m.yaml: joints.A.{line}"


def test_a_joint_without_pin_radius_needs_a_diameter() -> None:
    tree = changed("joints.A.pin_radius", MISSING)
    tree["joints"]["A"]["fit"] = "H7/g6"
    with pytest.raises(MachineError, match="needs the pin's diameter"):
        parse_machine(tree)
    tree["joints"]["A"]["fit"] = {"class": "H7/g6", "diameter": "16 mm"}
    assert joint_a(tree).play_as_new == (3e-6, 17.5e-6)


def test_a_guide_without_a_length_has_none() -> None:
    with pytest.raises(MachineError, match=r"joints\.G1\.length: is missing: fit is that of a block of this length"):
        parse_machine(changed("joints.G1.fit", ["3 um", "12 um"]))


def test_the_compiled_model_is_the_same() -> None:
    plain, fitted = parse_machine(SLIDER_CRANK), parse_machine(with_a(fit="H7/g6", limit="0.1 mm"))
    codes = [kernel_code(build_model(machine, ("A",), ("joints.A.contact.friction",))) for machine in (plain, fitted)]
    assert codes[0].text == codes[1].text
    for path in ("joints.A.limit", "joints.A.fit.0"):
        with pytest.raises(MachineError, match=path):
            build_model(parse_machine(with_a(fit=["3 um", "9 um"], limit="0.1 mm")), ("A",), (path,))


@given(st.floats(5e-4, 0.25), st.sampled_from("DEFGH"), st.sampled_from("defgh"), st.integers(5, 11))
def test_every_class_leaves_a_range_to_draw_from(radius: float, hole: str, shaft: str, grade: int) -> None:
    joint = joint_a(with_a(fit=f"{hole}{grade}/{shaft}{grade}", pin_radius=radius))
    low, high = joint.play_as_new
    assert 0 < low < high < joint.worn_out_from
    if (hole, shaft) == ("H", "h"):
        assert low == LEAST_PART * high
    assert joint.new_fit == new_fit(joint.fit, 2 * radius, "")
