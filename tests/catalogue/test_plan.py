"""Plans: what they ask for, how they extend each other, what they refuse."""

from __future__ import annotations

import functools
import itertools
import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from small_plans import MOUNTS, QUICK_RETURN, counted, draws, keys, plan_of, sizes_of

from jointplay.catalogue.errors import CatalogueMismatchError, PlanError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.entry import Entry, Recipe
from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.plans.plan import parse_plan, preset, preset_names
from jointplay.catalogue.plans.plan_check import plan_lines
from jointplay.catalogue.plans.plan_parts import STIFFNESS_SCATTER, DrawCounts
from jointplay.catalogue.plans.variants import Variant
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.groups import full_paths
from jointplay.solver.machines.machine import parse_machine, shipped_machine, shipped_machine_text
from jointplay.solver.simulation.simulate import simulate_batch


@functools.cache
def entries_of_preset(name: str, machine: str = "quick-return") -> tuple[Entry, ...]:
    return entries_of(preset(name), shipped_machine(machine))


@pytest.mark.long
def test_presets_hold_what_they_say() -> None:
    quick = entries_of_preset("quick")
    # A half of the machines in order are there on another day, too.
    assert counted(quick) == {"healthy": 256 + 128, **dict.fromkeys("ACEFO", 192)}
    standard = entries_of_preset("standard")
    pairs, triples = (["+".join(worn) for worn in itertools.combinations("ACEFO", count)] for count in (2, 3))
    # As many again in which the machine's own data are uncertain.
    numbers = {
        "healthy": 576 + 288,
        **dict.fromkeys("ACEFO", 576),
        **dict.fromkeys(pairs, 576),
        **dict.fromkeys(triples, 576),
    }
    assert counted(standard) == {label: 2 * count for label, count in numbers.items()}
    assert Counter(entry.stratum for entry in standard) == dict.fromkeys(("trusted", "wide"), len(standard) // 2)
    # Of a machine with fewer joints, as drawing the largest preset takes long.
    fewer, most = (counted(entries_of_preset(name, "slider-crank")) for name in ("standard", "thorough"))
    assert most == {label: 4 * count for label, count in fewer.items()}
    for entries in (quick, standard):
        sizes = [sizes_of(entry)[joint] for entry in entries for joint in entry.worn]
        assert 2.5e-5 <= min(sizes) < 2.55e-5
        assert 3.9e-3 < max(sizes) <= 4e-3  # twice what is told, of one worn joint
        several = [sizes_of(entry)[joint] for entry in entries if len(entry.worn) > 1 for joint in entry.worn]
        assert not several or 1.96e-3 < max(several) <= 2e-3
        rigid = sum(entry.joints == entry.worn for entry in entries)
        assert rigid / len(entries) == pytest.approx(0.25, abs=0.01)
        assert sum(entry.joints == ("A", "C", "E", "F", "O") for entry in entries) == len(entries) - rigid


@pytest.mark.long
def test_each_preset_contains_the_smaller_one() -> None:
    smaller: set[str] = set()
    for name in preset_names():
        larger = {entry.key for entry in entries_of_preset(name, "slider-crank")}
        assert smaller < larger
        smaller = larger


def test_entries_are_unique_and_the_same_every_time() -> None:
    plan = plan_of(hypotheses=["healthy", "singles", "pairs", "triples"], sets=[["A", "C", "E"], ["A", "C", "E", "F"]])
    first = keys(plan)
    assert first == keys(parse_plan(plan.content))
    assert len(set(first)) == len(first)


def test_entries_do_not_depend_on_the_order_of_the_machine_file() -> None:
    same = parse_machine(QUICK_RETURN.canonical_json())
    assert list(same.joints) != list(QUICK_RETURN.joints)
    assert keys(preset("quick"), same) == keys(preset("quick"))


def test_what_a_joint_draws_does_not_depend_on_the_numbers_of_others() -> None:
    tree: dict[str, Any] = QUICK_RETURN.model_dump(mode="json")
    tree["joints"]["A"]["contact"] = {"law": "flores", "stiffness": 1e10, "restitution": 0.8}  # no damping
    plan = plan_of(uncertain={"contact.damping": {"lognormal": 0.4}}, hypotheses=["healthy"])
    some, every = (entries_of(plan, machine)[0].parameters for machine in (parse_machine(tree), QUICK_RETURN))
    assert set(every) - set(some) == {"joints.A.contact.damping"}
    assert {path: every[path] for path in some} == some


@pytest.mark.parametrize(
    "larger",
    [
        {"draws": draws(single=70)},
        {"draws": draws(healthy=11)},
        {"hypotheses": ["healthy", "singles", "pairs"]},
        {"hypotheses": ["healthy", "singles", "triples"]},
        {"sets": [["C", "A", "F"]]},
        {"speeds": [1.0, 0.5]},
        {"loads": [{"force": 0}, {"force": "50 N"}]},
        {"wide": {"draws": 0.5}},
    ],
)
def test_more_of_anything_extends(larger: dict[str, Any]) -> None:
    small, large = keys(plan_of()), keys(plan_of(**larger))
    assert set(small) < set(large)
    assert not plan_of().difference(plan_of(**larger), QUICK_RETURN)


@pytest.mark.parametrize("other", [{"seed": 2}, {"sample_rate": 14000}, {"uncertain": {}}, {"bands": {"orders": 30}}])
def test_other_numbers_are_other_entries(other: dict[str, Any]) -> None:
    assert not set(keys(plan_of())) & set(keys(plan_of(**other)))


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"clearance": {"low": "40 um"}}, "clearance"),
        ({"fits": {"low": "3 um", "high": "30 um"}}, "fits"),
        ({"fits": {"tight": 0}}, "fits"),
        ({"laws": "auto"}, "laws"),
        ({"uncertain": {"contact.friction": {"uniform": [0, 1]}}}, "uncertain.contact.damping"),
        ({"wide": {"draws": 0.5, "uncertain": {"frame.mass": {"lognormal": 1}}}}, "wide.uncertain.frame.inertia"),
    ],
)
def test_what_is_drawn_differently_is_named(change: dict[str, Any], name: str) -> None:
    assert plan_of(wide={"draws": 1}).difference(plan_of(**change), QUICK_RETURN) == name


def test_without_scatter_cases_still_differ_in_their_fits() -> None:
    entries = entries_of(plan_of(uncertain={}), QUICK_RETURN)
    assert counted(entries) == {"healthy": 3, **dict.fromkeys("ACEFO", 6)}
    assert all(not entry.parameters for entry in entries)
    assert len({entry.clearances for entry in entries}) == len(entries)


def test_drawn_numbers_have_their_distributions() -> None:
    entries = entries_of(plan_of(draws=draws(single=256), hypotheses=["singles"]), QUICK_RETURN)
    numbers = {path: np.array([e.parameters[path] for e in entries]) for path in entries[0].parameters}
    speed = numbers["drive.speed"] / QUICK_RETURN.drive.speed  # type: ignore[union-attr, operator]
    assert 0.97 <= speed.min() < 0.971
    assert 1.029 < speed.max() <= 1.03
    for joint in "ACEFO":
        assert abs(np.median(numbers[f"joints.{joint}.contact.friction"]) - 0.08) < 0.003
        logs = np.log(numbers[f"joints.{joint}.contact.stiffness"] / 1e7)
        assert abs(logs.mean()) < 0.02
        assert abs(logs.std() - STIFFNESS_SCATTER) < 0.03
    clearances = np.log([sizes_of(e)[e.worn[0]] for e in entries])
    counts = np.histogram(clearances, 32, (math.log(2.5e-5), math.log(4e-3)))[0]
    assert (counts == len(entries) / 32).all()  # 256 points of a Sobol sequence, a fault each


def test_numbers_of_one_draw_are_not_tied_to_each_other() -> None:
    many = plan_of(
        draws=draws(pair=512), sets=[["C", "F"]], hypotheses=["healthy"], wide={"draws": 1}, fits={"silent": 0}
    )
    entries = entries_of(many, QUICK_RETURN)
    for stratum in ("trusted", "wide"):
        some = [e for e in entries if e.worn == ("C", "F") and e.stratum == stratum]
        # Both supports share a factor, and both directions of each another one.
        own = [[value for path, value in e.parameters.items() if not path.startswith("supports")] for e in some]
        table = np.column_stack([np.log([e.clearances for e in some]), own])
        assert table.shape[1] == (28 if stratum == "trusted" else 47)
        ranks = table.argsort(axis=0).argsort(axis=0)
        off_diagonal = np.abs(np.corrcoef(ranks.T) - np.eye(table.shape[1]))
        # Measured: 0.09 of 378 pairs, 0.21 of 1081, half of whose draws are another sequence, and many of whose numbers
        # are of the day and drawn by chance; root mean square 0.016, 0.031. Independent draws: 0.15, 0.044.
        assert off_diagonal.max() < (0.15 if stratum == "trusted" else 0.25)
        assert np.sqrt(np.mean(off_diagonal**2)) < (0.03 if stratum == "trusted" else 0.038)


def test_laws_are_drawn_by_their_weights() -> None:
    entries = entries_of(
        plan_of(laws={"own": 3, "hertz": 1}, draws=draws(single=256), hypotheses=["singles"]), QUICK_RETURN
    )
    laws = Counter(entry.variant.law for entry in entries)
    assert laws == {"own": 960, "hertz": 320}
    for entry in entries:
        drawn = {path.split(".contact.")[1] for path in entry.parameters if ".contact." in path} - {"friction"}
        assert drawn == {"stiffness", "hysteresis" if entry.variant.law == "hertz" else "damping"}
    healthy = entries_of(plan_of(laws="auto", draws=draws(healthy=64), hypotheses=["healthy"]), QUICK_RETURN)
    assert Counter(entry.variant.law for entry in healthy) == {"own": 32, "hertz": 32}  # its fits are contacts, too


def test_each_joint_draws_its_own_contact_and_keeps_it_whatever_the_law() -> None:
    entries = entries_of(
        plan_of(laws={"own": 1, "hertz": 1}, draws=draws(healthy=64), hypotheses=["healthy"]), QUICK_RETURN
    )
    paths = [path for path in entries[0].parameters if path.endswith("contact.friction")]
    assert paths == [f"joints.{joint}.contact.friction" for joint in "ACEFO"]
    assert all(len({entry.parameters[path] for path in paths}) == 5 for entry in entries)
    # A number that a law does not have leaves its columns empty: the others of a draw are the same under any law.
    both = plan_of(laws={"own": 1, "hertz": 1}).spread(QUICK_RETURN, "trusted")
    hertz = entries_of(
        plan_of(
            laws={"own": 1e-9, "hertz": 1},
            uncertain=parse_plan({"uncertain": both}).content["uncertain"],
            draws=draws(healthy=64),
            hypotheses=["healthy"],
        ),
        QUICK_RETURN,
    )
    for entry, other in zip(entries, hertz, strict=True):
        assert other.variant.law == "hertz"
        assert (entry.key == other.key) == (entry.variant.law == "hertz")
        same = (*paths, "drive.speed")
        assert [entry.parameters[path] for path in same] == [other.parameters[path] for path in same]


def test_only_numbers_of_the_laws_that_are_drawn_are_uncertain() -> None:
    for law, number in (("hertz", "hysteresis"), ("linear", "damping"), ("own", "damping")):
        entries = entries_of(plan_of(laws={law: 1}, draws=draws(healthy=8), hypotheses=["healthy"]), QUICK_RETURN)
        drawn = {path.split(".contact.")[1] for path in entries[0].parameters if ".contact." in path}
        assert drawn == {"friction", "stiffness", number}


def test_a_fitted_law_is_as_stiff_at_a_usual_penetration() -> None:
    machine = Variant("hertz").machine(QUICK_RETURN)
    contact, own = machine.joints["A"].contact, QUICK_RETURN.joints["A"].contact  # type: ignore[union-attr]
    assert (contact.law, contact.friction) == ("hertz", own.friction)
    assert contact.stiffness * 40e-6**1.5 == pytest.approx(own.stiffness * 40e-6)
    back = Variant("linear").machine(machine).joints["A"].contact  # type: ignore[union-attr]
    assert back.stiffness == pytest.approx(own.stiffness)
    assert Variant("linear").machine(QUICK_RETURN) == QUICK_RETURN


def test_wide_draws_vary_the_machine_by_common_factors_and_each_mount_by_one_of_its_own() -> None:
    entries = entries_of(plan_of(hypotheses=["singles"], wide={"draws": 1}), QUICK_RETURN)
    wide = [entry for entry in entries if entry.stratum == "wide"]
    assert len(wide) == len(entries) // 2
    assert wide[0].variant == Variant("own", (1, 2, 3, 4, 6, 12), "ram", (1, 2, 3))
    for entry in wide:
        numbers = entry.parameters
        factors = {path: numbers[path] / nominal for path, nominal in MOUNTS.items()}
        x, y = (factors[f"supports.0.stiffness.{axis}"] / factors[f"supports.1.stiffness.{axis}"] for axis in (0, 1))
        assert x == pytest.approx(y, rel=1e-12)
        assert 0.85 / 1.15 <= x <= 1.15 / 0.85
        assert x != pytest.approx(1.0, abs=1e-6)
        assert factors["supports.0.stiffness.0"] != factors["supports.0.stiffness.1"]
        assert 0.7 * 0.85 <= factors["supports.0.stiffness.1"] <= 1.3 * 1.15
        assert 0.5 * 0.8 <= factors["supports.1.damping.1"] <= 2 * 1.25
        assert 1.01 <= abs(numbers["loads.0.force.0"]) <= 101
        assert abs(numbers["loads.1.force.0"]) <= 60.6
        assert {f"drive.ripple.{i}.amplitude" for i in range(12)} < set(numbers)
    # Machines as filed have the tolerances of their data, each mount its own, both ways the same.
    for entry in (entry for entry in entries if entry.stratum == "trusted"):
        factors = {path: entry.parameters[path] / nominal for path, nominal in MOUNTS.items()}
        assert factors["supports.0.stiffness.0"] == pytest.approx(factors["supports.0.stiffness.1"], rel=1e-12)
        assert factors["supports.0.stiffness.0"] != pytest.approx(factors["supports.1.stiffness.0"], abs=1e-6)
        assert all(
            abs(math.log(factor)) < 5.0 * (0.15 if "damping" in path else 0.05) for path, factor in factors.items()
        )
        assert 0.85 < entry.parameters["links.frame.mass"] / QUICK_RETURN.links["frame"].mass < 1.15
        assert not any(path.startswith(("loads", "drive.ripple")) for path in entry.parameters)


def test_a_drawn_ripple_and_load_are_those_of_a_file() -> None:
    """A variant with numbers of a case moves as a machine file that says the same."""
    tree = QUICK_RETURN.model_dump()
    tree["drive"]["ripple"] = [{"order": 2, "amplitude": 0.01, "phase": 0.7}]
    load = {"link": "ram", "at": tree["joints"]["G2"]["at"]}
    tree["loads"] = [{**load, "force": [30.0, 0.0]}, {**load, "force": [20.0, 0.0], "order": 2, "phase": 0.4}]
    settings = Settings(sample_rate=2000.0, duration=0.3)
    filed = simulate_batch(parse_machine(tree), [Case()], settings)[0]
    numbers = MachineNumbers(Variant("own", (2,), "ram", (1, 2)).machine(QUICK_RETURN))
    values = {"ripple.2.sin": 0.01 * math.cos(0.7), "ripple.2.cos": 0.01 * math.sin(0.7), "load": 30.0}
    values |= {"load.2.sin": 20.0 * math.cos(0.4), "load.2.cos": 20.0 * math.sin(0.4)}
    parameters = {
        target.path: value * target.share for path, value in values.items() for target in numbers.targets(path)
    }
    drawn = simulate_batch(
        Variant("own", (2,), "ram", (1, 2)).machine(QUICK_RETURN), [Case(parameters=parameters)], settings
    )[0]
    scale = np.abs(filed.displacement).max(axis=0)
    assert np.allclose(drawn.displacement, filed.displacement, rtol=0, atol=1e-6 * scale)


def test_a_plan_is_shown_in_words() -> None:
    lines = plan_lines(preset("standard"), QUICK_RETURN)
    resolved = preset("standard").resolve(QUICK_RETURN)
    assert lines[0] == f"plan standard, {resolved.hash[:12]}: 30528 cases (15264 trusted, 15264 wide)"
    assert lines[1] == "hypotheses: healthy, 5 of a single, 10 of a pair, 10 of a triple"
    assert (
        lines[2] == "draws: healthy 576, single 576, pair 576, larger 576; 288 of the healthy ones on another day, too"
    )
    assert lines[3] == (
        "clearance: worn 25-2000 um (one alone to 2 times that), fits 3-20 um, next to none in 10 % of "
        "them, none at all in 25 % of the machines"
    )
    assert lines[4] == "contact laws: own 1, hertz 1"
    assert "drive.speed x 0.97 to 1.03" in lines[5]
    assert "load +-1.01 to 101 (log)" in lines[6]
    assert "drive.speed" not in lines[6]
    assert not any("wide draws" in line for line in plan_lines(preset("quick"), QUICK_RETURN))


def test_one_draw_in_so_many_is_guarded() -> None:
    entries = entries_of(plan_of(draws=draws(single=101), hypotheses=["singles"]), QUICK_RETURN)
    assert {entry.draw for entry in entries if entry.guarded} == {0, 50, 100}
    assert not any(entry.guarded for entry in entries_of(plan_of(guard=0), QUICK_RETURN))


def test_factor_on_unequal_joints_keeps_their_ratio() -> None:
    text = shipped_machine_text("quick-return")
    tree = parse_machine(text).model_dump()
    tree["joints"]["A"]["contact"]["stiffness"] = 3e7
    machine = parse_machine(tree)
    entry = entries_of(plan_of(hypotheses=["singles"]), machine)[0]
    stiff, soft = (entry.parameters[f"joints.{joint}.contact.stiffness"] for joint in "AC")
    same = entries_of(plan_of(hypotheses=["singles"]), QUICK_RETURN)[0]
    assert stiff / soft == pytest.approx(
        3.0 * same.parameters["joints.A.contact.stiffness"] / same.parameters["joints.C.contact.stiffness"]
    )


def test_numbers_of_a_contact_law() -> None:
    """Restitution is drawn where a joint has one; the default scatter of a damping that no joint has draws nothing."""
    tree: dict[str, Any] = QUICK_RETURN.model_dump(mode="json")
    for name in QUICK_RETURN.turning_joints:
        tree["joints"][name]["contact"] = {"law": "flores", "stiffness": 1e10, "restitution": 0.8}
    tree["joints"]["C"]["contact"] = {"stiffness": 1e7, "damping": 0}
    machine = parse_machine(tree)
    uncertain = {"contact.restitution": {"uniform": [0.5, 0.9]}, "contact.damping": {"lognormal": 1.2}}
    entry = entries_of(plan_of(hypotheses=["singles"], uncertain=uncertain), machine)[0]
    drawn = {path: number for path, number in entry.parameters.items() if ".contact." in path}
    assert len({path.split(".")[1] for path in drawn}) == 5
    for joint in QUICK_RETURN.turning_joints:
        assert (f"joints.{joint}.contact.restitution" in drawn) == (joint != "C")
        assert 0.5 <= drawn.get(f"joints.{joint}.contact.restitution", 0.7) <= 0.9
        assert drawn.get(f"joints.{joint}.contact.damping") == (0 if joint == "C" else None)
    values = full_paths(machine, Case(entry.fault, entry.parameters))
    assert {path: values[path] for path in drawn} == drawn
    with pytest.raises(PlanError, match=r"uncertain\.contact\.restitution: is not a number of machine quick-return"):
        entries_of(plan_of(uncertain=uncertain), QUICK_RETURN)


def test_chosen_sets_are_lists_of_joints() -> None:
    plan = plan_of(hypotheses=["healthy"], sets=[["F", "A", "C"], ["O", "E"]])
    entries = entries_of(plan, QUICK_RETURN)
    assert counted(entries) == {"healthy": 3, "A+C+F": 5, "E+O": 4}
    assert {entry.worn for entry in entries} == {(), ("A", "C", "F"), ("E", "O")}
    with pytest.raises(
        PlanError, match=r"^plan: sets\.0: Z: is no joint of machine quick-return that can wear; these are A, C"
    ):
        entries_of(plan_of(sets=[["A", "Z"]]), QUICK_RETURN)


def test_recipe_covers_the_asked_time_and_revolutions() -> None:
    assert plan_of().recipe(QUICK_RETURN).revolutions == 5  # at least, 2.5 s at 2 Hz
    assert plan_of().recipe(shipped_machine("slider-crank")).revolutions == 10  # 1 s at 10 Hz
    assert plan_of(seconds=0).recipe(QUICK_RETURN).revolutions == 5


def test_plan_reads_back_and_hash_ignores_the_name() -> None:
    plan = plan_of(name="a", clearance={"low": "20 um", "high": "0.4 mm"}, speeds=[0.5, 1])
    assert parse_plan(plan.content) == plan
    assert parse_plan({**plan.content, "name": "b"}).hash == plan.hash
    assert parse_plan({**plan.content, "draws": {"single": 9}}).hash != plan.hash
    resolved = preset("standard").resolve(QUICK_RETURN)
    assert parse_plan(resolved.content) == resolved
    assert resolved.resolve(QUICK_RETURN) == resolved
    few = {"draws": DrawCounts(healthy=2, single=2, pair=2, larger=2)}
    assert keys(resolved.model_copy(update=few)) == keys(preset("standard").model_copy(update=few))


def test_a_recipe_reads_back_and_is_not_mixed_with_another() -> None:
    recipe = plan_of().recipe(QUICK_RETURN)
    assert Recipe.from_content(recipe.content) == recipe
    other = plan_of(accuracy="standard").recipe(QUICK_RETURN)
    with pytest.raises(CatalogueMismatchError, match="was built with accuracy draft, not standard: build into another"):
        recipe.check_same(other, "there")
