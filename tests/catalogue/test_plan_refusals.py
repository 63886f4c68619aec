"""Plans that cannot be: each is refused in one line that names field, value and rule."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_plans import QUICK_RETURN, plan_of

from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import load_plan, parse_plan
from jointplay.catalogue.plans.plan_check import check_plan
from jointplay.solver.machines.machine import parse_machine, shipped_machine


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("draw: {}", 'my.yaml: draw: {}: unknown key; did you mean "draws"?'),
        ("draws: {single: 0}", "my.yaml: draws.single: 0: must be greater than or equal to 1"),
        ("draws: {single: 2.5}", "my.yaml: draws.single: 2.5: must be a whole number"),
        ("clearance: {low: 2 mm}", "my.yaml: clearance.high: 0.002: must be greater than low"),
        ("sets: [[A, A]]", "my.yaml: sets.0: [A, A]: must name each joint once"),
        ("laws: {}", "my.yaml: laws: {}: must name at least one"),
        ("fits: {low: 20 um, high: 3 um}", "my.yaml: fits.high: 3e-06: must be greater than low"),
        (
            "fits: {high: 3 um}",
            "my.yaml: fits.low: must be given with the other bound, or neither (fits are then the machine's)",
        ),
        ("fits: {tight: 2}", "my.yaml: fits.tight: 2: must be less than or equal to 1"),
        ("fits: {in_faulty: 0.5}", "my.yaml: fits.in_faulty: 0.5: unknown key; known: low, high, tight, silent"),
        ("wide: {draws: 2}", "my.yaml: wide.draws: 2: must be less than or equal to 1"),
        ("clearance: {low: -1 um}", "my.yaml: clearance.low: -1 um: must be greater than 0"),
        ("clearance: {high: 2 m}", "my.yaml: clearance.high: 2: must not be larger than 0.1 m"),
        ("clearance: {lo: 1 um}", 'my.yaml: clearance.lo: 1 um: unknown key; did you mean "low"?'),
        ("hypotheses: [single]", "my.yaml: hypotheses.0: single: must be healthy, singles, pairs or triples"),
        ("hypotheses: [as-new]", "my.yaml: hypotheses.0: as-new: must be healthy, singles, pairs or triples"),
        ("hypotheses: []", "my.yaml: hypotheses: []: must name at least one, and each once"),
        ("speeds: [1, 1]", "my.yaml: speeds: [1, 1]: must name at least one, and each once"),
        ("loads: [{force: 1 N}, {force: 1}]", "my.yaml: loads: [1, 1]: must name at least one, and each once"),
        (
            "loads: [{force: 1 N, torque: 0}]",
            "my.yaml: loads.0: {force: 1 N, torque: 0}: must give exactly one of force, torque",
        ),
        (
            "loads: [{force: 2 N m}]",
            'my.yaml: loads.0.force: 2 N m: "N m" is a torque, must be a force, for example "0.5 kN"',
        ),
        (
            "uncertain: {contact.friction: {uniform: [2, 1]}}",
            "my.yaml: uncertain.contact.friction.uniform: [2, 1]: must be [low, high] with low <= high",
        ),
        (
            "uncertain: {contact.friction: {}}",
            "my.yaml: uncertain.contact.friction: {}: must give exactly one of "
            "uniform, loguniform, either_loguniform, factor_uniform, factor_loguniform, lognormal",
        ),
        (
            "uncertain: {film.viscosity: {factor_loguniform: [0.5, 2], zero: 1}}",
            "my.yaml: uncertain.film.viscosity.zero: 1: must be less than 1",
        ),
        (
            "wide: {uncertain: {links.ram.mass: {lognormal: 0.1, zero: 0.4}}}",
            "my.yaml: wide.uncertain.links.ram.mass.zero: 0.4: is for film.viscosity alone, of joints that run dry",
        ),
        (
            "sample_rate: 5 kHz",
            "my.yaml: sample_rate: 5000: must be at least 10000 Hz: bands reach 4000 Hz at the highest speed",
        ),
        ("accuracy: fast", "my.yaml: accuracy: fast: must be draft, standard or reference"),
        ("[1]", "my.yaml: a list: must be a mapping of keys to values"),
    ],
)
def test_refusals_are_one_line(tmp_path: Path, text: str, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my.yaml").write_text(text)
    with pytest.raises(PlanError) as caught:
        load_plan("my.yaml")
    assert str(caught.value) == line


@pytest.mark.parametrize("path", ["drive.ripple.0.phase", "joints.A.at.0", "sensors.0.at.0"])
def test_numbers_that_no_equation_holds_are_refused(path: str) -> None:
    tree = QUICK_RETURN.model_dump()
    tree["drive"]["ripple"] = [{"order": 1, "amplitude": 0.01, "phase": 0.5}]
    with pytest.raises(PlanError, match=rf"^plan: uncertain\.{path}: no equation of this machine holds such a number$"):
        entries_of(plan_of(uncertain={path: {"uniform": [0, 1]}}), parse_machine(tree))


def test_paths_the_machine_does_not_have_are_refused() -> None:
    plan = parse_plan({"uncertain": {"contact.frictoin": {"uniform": [0, 1]}}})
    with pytest.raises(PlanError, match=r'^plan: uncertain\.contact\.frictoin: .*did you mean "contact\.friction"\?$'):
        entries_of(plan, QUICK_RETURN)


def test_loads_that_the_output_does_not_take_are_refused() -> None:
    with pytest.raises(
        PlanError, match=r"^plan: loads\.0\.torque: 5 N m: the output of machine quick-return, link ram, "
    ):
        entries_of(plan_of(loads=[{"torque": "5 N m"}]), QUICK_RETURN)
    swings = shipped_machine("four-bar")
    with pytest.raises(PlanError, match=r"^plan: loads\.1\.force: 5 N: .*turns on the frame: give a torque$"):
        entries_of(plan_of(loads=[{"torque": 0}, {"force": "5 N"}]), swings)


def test_joints_whose_names_make_two_hypotheses_of_one_name_are_refused() -> None:
    text = QUICK_RETURN.canonical_json().replace('"C"', '"E+F"')
    with pytest.raises(PlanError, match=r"^plan: hypotheses: E\+F: names two hypotheses of machine quick-return"):
        entries_of(plan_of(hypotheses=["singles", "pairs"]), parse_machine(text))


def test_more_cases_than_a_builder_can_hold_are_refused() -> None:
    many = {"single": 100_000, "pair": 100_000}
    plan = plan_of(hypotheses=["singles", "pairs"], draws=many, wide={"draws": 1})
    with pytest.raises(PlanError, match=r"^plan: draws: make 3000000 cases of all hypotheses; at most 2000000 are"):
        check_plan(plan, QUICK_RETURN)


def test_machine_without_constant_speed_is_refused() -> None:
    tree = QUICK_RETURN.model_dump()
    tree["drive"]["speed"] = [[0, 0], [1, 10]]
    with pytest.raises(PlanError, match="a catalogue needs a drive of kind rotation with one speed"):
        entries_of(plan_of(), parse_machine(tree))


def test_a_link_driven_in_space_and_ground_that_does_not_come_round_are_refused() -> None:
    tree = QUICK_RETURN.model_dump()
    driven = {
        "kind": "position",
        "link": "ram",
        "direction": [1, 0],
        "harmonics": [{"frequency": 2, "amplitude": 0.01}],
    }
    with pytest.raises(PlanError, match=r"drive: kind position: a catalogue needs a drive of kind rotation"):
        entries_of(plan_of(), parse_machine({**tree, "drive": driven}))
    for motion, comes in (({"order": 3}, True), ({"order": 0.5}, False), ({"frequency": 2.0}, False)):
        tree["supports"][1]["motion"] = [{"displacement": [0, 1e-5], **motion}]
        machine = parse_machine(tree)
        if comes:
            assert entries_of(plan_of(), machine)
        else:
            with pytest.raises(PlanError, match=r"supports\.1\.motion\.0: a catalogue needs ground that stands"):
                entries_of(plan_of(), machine)


def test_unknown_presets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match='did you mean "standard"'):
        load_plan("standart")
    with pytest.raises(PlanError, match="cannot be read"):
        load_plan(tmp_path)
