"""Guides with a length as joints that wear: in plans, in a small catalogue of real simulations, and in its answers."""

from __future__ import annotations

import math
from typing import Any

import pytest
from small_plans import counted, plan_of, sizes_of

from jointplay.app.errors import BadFieldError
from jointplay.app.pages.page_forms import weights_of
from jointplay.catalogue.building.build import build
from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.evaluation.differences import with_differences
from jointplay.catalogue.evaluation.protocols import EvaluationProtocol, draw_truth
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.plans.cases import entries_of, travel
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.plans.plan_check import plan_lines
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate

LENGTH, HEIGHT = 0.06, 0.04
FITS = {"O": 9e-6, "A": 12e-6, "B": 7e-6, "G1": 10e-6}


def press(**guide: Any) -> Machine:
    """The slider-crank with a guide that can wear."""
    tree = shipped_machine("slider-crank").model_dump(mode="json")
    tree["joints"]["G1"] |= {"length": LENGTH, "height": HEIGHT, **guide}
    return parse_machine(tree)


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    """Healthy, four singles and a pair."""
    plan = {
        "sets": [["B", "G1"]], "laws": {"own": 1}, "guard": 0, "seconds": 1.0,
        "draws": {"healthy": 64, "single": 64, "pair": 64},
    }  # fmt: skip
    folder = tmp_path_factory.mktemp("guide") / "press"
    build(press(), parse_plan({"hypotheses": ["healthy", "singles"], **plan}), folder, workers=0)
    return Catalogue.open(folder)


def answer(catalogue: Catalogue, **worn: float) -> Diagnosis:
    """Of a machine with the play of fits in every joint but these, m."""
    machine = catalogue.machine
    history = simulate(machine, Case(Fault({**FITS, **worn})), Settings(duration=2.0, sample_rate=10_000))
    names = [sensor.name for sensor in machine.sensors]
    return diagnose(Recording.from_arrays(history.at_sensors(machine), 10_000, names), catalogue)


@pytest.mark.long
def test_a_worn_guide_is_named(catalogue: Catalogue) -> None:
    assert sorted(catalogue.hypotheses) == ["A", "B", "B+G1", "G1", "O", "healthy"]
    found = answer(catalogue, G1=4e-4)
    assert found.verdict == "worn"
    assert found.candidate_set == ("G1",)
    assert found.hypotheses[0].joints["G1"].clearance_um == pytest.approx(400, rel=0.35)
    assert found.joints["G1"].condition == "worn"
    assert found.joints["G1"].limit_um == pytest.approx(200)


@pytest.mark.parametrize("worn", [{"A": 4e-4}, {}])
def test_a_guide_in_order_is_not(catalogue: Catalogue, worn: dict[str, float]) -> None:
    found = answer(catalogue, **worn)
    assert found.verdict == ("worn" if worn else "in_order")
    assert found.hypotheses[0].label == (next(iter(worn)) if worn else "healthy")
    assert found.joint_probabilities["G1"] < 0.05


def test_a_guide_worn_with_a_pin_is_named_with_it(catalogue: Catalogue) -> None:
    found = answer(catalogue, B=3e-4, G1=3e-4)
    assert found.hypotheses[0].label == "B+G1"


def test_plans_wear_guides_alone_and_with_others() -> None:
    machine = press(fit=["5 um", "30 um"])
    plan = plan_of(hypotheses=["healthy", "singles", "pairs"], laws={"own": 1, "hertz": 1})
    entries = entries_of(plan, machine)
    assert counted(entries) == {
        "healthy": 3,
        **dict.fromkeys(["A", "B", "G1", "O"], 6),
        **dict.fromkeys(["A+B", "A+G1", "A+O", "B+G1", "B+O", "G1+O"], 4),
    }
    assert all(sorted(sizes_of(entry)) == ["A", "B", "G1", "O"] for entry in entries)
    # By its largest play a block leans as far as a link does by that of a pin.
    assert math.atan(2 * travel(machine, "G1") / LENGTH) == pytest.approx(0.1, rel=0.01)
    for entry in entries:
        size = sizes_of(entry)["G1"]
        assert 1.25 * 30e-6 <= size <= travel(machine, "G1") if "G1" in entry.worn else size <= 30e-6
        assert "joints.G1.contact.stiffness" in entry.parameters
        assert "joints.G1.pin_radius" not in entry.parameters
    assert {entry.variant.machine(machine).joints["G1"].contact.law for entry in entries} == {"linear", "hertz"}
    assert "G1 5-30 um" in "\n".join(plan_lines(plan, machine))


def test_guides_without_a_length_stay_as_they_were() -> None:
    machine = shipped_machine("slider-crank")
    assert all(target.path.split(".")[1] != "G1" for target in MachineNumbers(machine).targets("contact.friction"))
    rule = "sets.0: G1: is no joint of machine slider-crank that can wear; these are A, B, O"
    with pytest.raises(PlanError, match=rule):
        entries_of(plan_of(sets=[["A", "G1"]]), machine)


def test_numbers_of_the_ideal_guide_cannot_be_drawn() -> None:
    plan = plan_of(uncertain={"joints.G1.length": {"uniform": [0.05, 0.07]}})
    with pytest.raises(PlanError, match=r"uncertain\.joints\.G1\.length"):
        entries_of(plan, press())


@pytest.mark.parametrize("difference", ["law", "frame"])
def test_recordings_of_an_evaluation_have_play_in_guides(difference: str) -> None:
    truth = draw_truth(press(), Hypothesis.of(["G1"]), EvaluationProtocol("usual"), 1, 0)
    other = with_differences(truth, (difference,), 1, 0)
    assert sorted(other.clearances) == ["A", "B", "G1", "O"]
    assert (other.machine.joints["G1"].contact.law != "linear") == (difference == "law")


def test_priors_weigh_guides_that_can_wear() -> None:
    assert weights_of("G1=3", press()) == {"G1": 3.0}
    with pytest.raises(BadFieldError, match=r"prior\.joints\.G1"):
        weights_of("G1=3", shipped_machine("slider-crank"))


def test_the_fit_of_a_guide_is_from_wall_to_wall() -> None:
    """H7/g6 at 40 mm: hole 0 to 25, shaft -25 to -9 um; half of 9 to 50 um."""
    joint = press(fit="H7/g6", limit="0.1 mm").joints["G1"]
    assert joint.play_as_new == pytest.approx((4.5e-6, 25e-6))
    assert joint.worn_out_from == 1e-4
    assert press().joints["G1"].play_as_new == (3e-6, 20e-6)


@pytest.mark.parametrize(
    ("said", "line"),
    [
        ({"fit": "H7/g6", "height": 0}, "joints.G1.fit: H7/g6: needs the size from wall to wall: give height, or"),
        ({"limit": "10 um"}, "joints.G1.limit: 10 um: must be greater than the joint's play as new, 3 to 20 um"),
        ({"length": None, "height": 0, "fit": ["5 um", "9 um"]}, "joints.G1.length: is missing: height is that of"),
    ],
)
def test_refusals(said: dict[str, Any], line: str) -> None:
    with pytest.raises(MachineError) as refused:
        press(**said)
    assert line in str(refused.value)
