"""Plans: what they ask for, how they extend each other, what they refuse."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from catalogue.draws import Distribution, rounded_levels, unit_draws
from catalogue.errors import PlanError
from catalogue.plan import Plan, load_plan, parse_plan, preset, preset_names, resolve_plan
from solver.cases.history import Case
from solver.cases.parameters import full_paths
from solver.machines.fault import FaultState
from solver.machines.machine import Machine, parse_machine, shipped_machine, shipped_machine_text

QUICK_RETURN = shipped_machine("quick-return")


def keys(plan: Plan, machine: Machine = QUICK_RETURN) -> list[str]:
    return [entry.key for entry in plan.entries(machine)]


def plan_of(**changes: Any) -> Plan:
    return parse_plan({"draws": 2, "healthy_draws": 3, "clearance": {"count": 3}, **changes})


def test_quick_preset_holds_every_single_at_24_clearances() -> None:
    entries = preset("quick").entries(QUICK_RETURN)
    counts: dict[str, int] = {}
    for entry in entries:
        counts[entry.hypothesis.label] = counts.get(entry.hypothesis.label, 0) + 1
    assert counts == {"healthy": 96, "as-new": 96, "A": 192, "C": 192, "E": 192, "F": 192, "O": 192}
    clearances = sorted({entry.clearances[0] for entry in entries if len(entry.joints) == 1})
    assert len(clearances) == 24
    assert (clearances[0], clearances[-1]) == (1e-5, 1e-3)
    assert np.allclose(np.diff(np.log(clearances)), math.log(100) / 23)


def test_each_preset_contains_the_smaller_one() -> None:
    smaller: set[str] = set()
    for name in preset_names():
        larger = set(keys(preset(name)))
        assert smaller < larger
        smaller = larger


def test_entries_are_unique_and_the_same_every_time() -> None:
    plan = plan_of(hypotheses=["healthy", "singles", "pairs", "as-new"], pairs={"count": 2, "draws": 1})
    first = keys(plan)
    assert first == keys(parse_plan(plan.content))
    assert len(set(first)) == len(first)


def test_entries_do_not_depend_on_the_order_of_the_machine_file() -> None:
    same = parse_machine(QUICK_RETURN.canonical_json())
    assert keys(preset("quick"), same) == keys(preset("quick"))


@pytest.mark.parametrize(
    "larger",
    [
        {"draws": 7},
        {"healthy_draws": 11},
        {"clearance": {"count": 5}},
        {"hypotheses": ["healthy", "singles", "pairs"]},
        {"speeds": [1.0, 0.5]},
    ],
)
def test_more_of_anything_extends(larger: dict[str, Any]) -> None:
    small, large = keys(plan_of()), keys(plan_of(**larger))
    assert set(small) < set(large)


@pytest.mark.parametrize("other", [{"seed": 2}, {"sample_rate": 14000}, {"uncertain": {}}, {"bands": {"orders": 30}}])
def test_other_numbers_are_other_entries(other: dict[str, Any]) -> None:
    assert not set(keys(plan_of())) & set(keys(plan_of(**other)))


def test_without_scatter_draws_do_not_repeat() -> None:
    entries = plan_of(uncertain={}).entries(QUICK_RETURN)
    assert len(entries) == 1 + 5 * 3
    assert all(not entry.parameters for entry in entries)


def test_drawn_numbers_have_their_distributions() -> None:
    entries = plan_of(draws=64, healthy_draws=1, clearance={"count": 4}).entries(QUICK_RETURN)[1:]
    numbers = {path: np.array([e.parameters[path] for e in entries]) for path in entries[0].parameters}
    speed = numbers["drive.speed"] / QUICK_RETURN.drive.speed  # type: ignore[union-attr, operator]
    assert 0.97 <= speed.min() < 0.971
    assert 1.029 < speed.max() <= 1.03
    assert abs(np.median(numbers["contact.friction"]) - 0.08) < 0.003
    logs = np.log(numbers["contact.stiffness"] / 1e7)
    assert abs(logs.mean()) < 0.02
    assert abs(logs.std() - 0.6) < 0.03


def test_numbers_of_one_draw_are_not_tied_to_each_other() -> None:
    entries = plan_of(draws=32, healthy_draws=1, clearance={"count": 8}).entries(QUICK_RETURN)[1:]
    table = np.array([[*e.clearances, *e.parameters.values()] for e in entries])
    off_diagonal = np.corrcoef(np.log(table).T) - np.eye(table.shape[1])
    assert np.abs(off_diagonal).max() < 0.08


def test_factor_on_unequal_joints_keeps_their_ratio() -> None:
    text = shipped_machine_text("quick-return")
    tree = parse_machine(text).model_dump()
    tree["joints"]["A"]["contact"]["stiffness"] = 3e7
    machine = parse_machine(tree)
    entry = plan_of().entries(machine)[0]
    stiff, soft = (entry.parameters[f"joints.{joint}.contact.stiffness"] for joint in "AC")
    assert stiff / soft == pytest.approx(3.0)
    assert "contact.stiffness" not in entry.parameters
    assert "contact.damping" in entry.parameters


def test_numbers_of_a_contact_law() -> None:
    """Restitution is drawn where a joint has one; the default scatter of a damping that no joint has draws nothing."""
    tree: dict[str, Any] = QUICK_RETURN.model_dump(mode="json")
    for name in QUICK_RETURN.turning_joints:
        tree["joints"][name]["contact"] = {"law": "flores", "stiffness": 1e10, "restitution": 0.8}
    tree["joints"]["C"]["contact"] = {"stiffness": 1e7, "damping": 0}
    machine = parse_machine(tree)
    uncertain = {"contact.restitution": {"uniform": [0.5, 0.9]}, "contact.damping": {"lognormal": 1.2}}
    entry = plan_of(hypotheses=["singles"], uncertain=uncertain).entries(machine)[0]
    assert 0.5 <= entry.parameters["contact.restitution"] <= 0.9
    assert entry.parameters["contact.damping"] == 0
    for joint in "AC":
        values = full_paths(machine, Case(FaultState({joint: 1e-4}), entry.parameters))
        assert (f"joints.{joint}.contact.restitution" in values) == (joint == "A")
    with pytest.raises(PlanError, match=r"uncertain\.contact\.restitution: is not a number of machine quick-return"):
        plan_of(uncertain=uncertain).entries(QUICK_RETURN)


def test_jitter_fills_the_gaps_between_levels_and_nothing_else_changes() -> None:
    exact = plan_of(draws=16).entries(QUICK_RETURN)
    moved = plan_of(draws=16, clearance={"count": 3, "jitter": 1.0}).entries(QUICK_RETURN)
    assert [e.parameters for e in exact] == [e.parameters for e in moved]
    spacing = math.log(10.0)
    for a, b in zip(exact, moved, strict=True):
        for level, clearance in zip(a.clearances, b.clearances, strict=True):
            assert abs(math.log(clearance / level)) <= spacing / 2
    distinct = {e.clearances for e in moved if e.hypothesis.label == "A"}
    assert len(distinct) == 3 * 16


def test_pairs_cover_their_grid_and_as_new_stays_in_its_range() -> None:
    plan = plan_of(hypotheses=["pairs", "as-new"], pairs={"count": 3, "draws": 1}, as_new={"draws": 40})
    entries = plan.entries(QUICK_RETURN)
    pairs = [e for e in entries if e.hypothesis.label != "as-new"]
    assert {e.hypothesis.label for e in pairs} == {"+".join(p) for p in itertools.combinations("ACEFO", 2)}
    assert len({e.clearances for e in pairs if e.hypothesis.label == "A+F"}) == 9
    fits = np.array([e.clearances for e in entries if e.hypothesis.label == "as-new"])
    assert fits.shape == (40, 5)
    assert fits.min() >= 3e-6
    assert fits.max() <= 2e-5
    assert np.abs(np.corrcoef(np.log(fits).T) - np.eye(5)).max() < 0.35


def test_recipe_covers_the_asked_time_and_revolutions() -> None:
    assert plan_of().recipe(QUICK_RETURN).revolutions == 5  # 2.5 s at 2 Hz
    assert plan_of().recipe(shipped_machine("slider-crank")).revolutions == 25  # 2.5 s at 10 Hz
    assert plan_of(seconds=0).recipe(QUICK_RETURN).revolutions == 5


def test_plan_reads_back_and_hash_ignores_the_name() -> None:
    plan = plan_of(name="a", clearance={"low": "20 um", "high": "0.4 mm", "count": 7}, speeds=[0.5, 1])
    assert parse_plan(plan.content) == plan
    assert parse_plan({**plan.content, "name": "b"}).hash == plan.hash
    assert parse_plan({**plan.content, "draws": 9}).hash != plan.hash


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("draw: 3", 'my.yaml: draw: 3: unknown key; did you mean "draws"?'),
        ("draws: 0", "my.yaml: draws: 0: must be greater than or equal to 1"),
        ("draws: 2.5", "my.yaml: draws: 2.5: must be a valid integer"),
        ("clearance: {low: 2 mm}", "my.yaml: clearance.high: 0.001: must be greater than low"),
        ("clearance: {low: -1 um}", "my.yaml: clearance.low: -1 um: must be greater than 0"),
        ("clearance: {high: 2 m}", "my.yaml: clearance.high: 2: must not be larger than 0.1 m"),
        ("clearance: {lo: 1 um}", 'my.yaml: clearance.lo: 1 um: unknown key; did you mean "low"?'),
        ("hypotheses: [single]", "my.yaml: hypotheses.0: single: must be healthy, singles, pairs or as-new"),
        ("hypotheses: []", "my.yaml: hypotheses: []: must name at least one, and each once"),
        ("speeds: [1, 1]", "my.yaml: speeds: [1, 1]: must name at least one, and each once"),
        (
            "uncertain: {contact.friction: {uniform: [2, 1]}}",
            "my.yaml: uncertain.contact.friction.uniform: [2, 1]: must be [low, high] with low <= high",
        ),
        (
            "uncertain: {contact.friction: {}}",
            "my.yaml: uncertain.contact.friction: {}: must give exactly one of uniform, factor_uniform, lognormal",
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


def test_paths_the_machine_does_not_have_are_refused() -> None:
    plan = parse_plan({"uncertain": {"contact.frictoin": {"uniform": [0, 1]}}})
    with pytest.raises(PlanError, match=r'^plan: uncertain\.contact\.frictoin: .*did you mean "contact\.friction"\?$'):
        plan.entries(QUICK_RETURN)


def test_joints_whose_names_make_two_hypotheses_of_one_name_are_refused() -> None:
    text = QUICK_RETURN.canonical_json().replace('"C"', '"E+F"')
    with pytest.raises(PlanError, match=r"^plan: hypotheses: E\+F: names two hypotheses of machine quick-return"):
        plan_of(hypotheses=["singles", "pairs"]).entries(parse_machine(text))


def test_machine_without_constant_speed_is_refused() -> None:
    tree = QUICK_RETURN.model_dump()
    tree["drive"]["speed"] = [[0, 0], [1, 10]]
    with pytest.raises(PlanError, match="a catalogue needs a drive of kind rotation with one speed"):
        plan_of().entries(parse_machine(tree))


def test_unknown_presets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match='did you mean "standard"'):
        resolve_plan("standart")
    with pytest.raises(PlanError, match="cannot be read"):
        resolve_plan(tmp_path)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**64 - 1), st.integers(1, 8), st.integers(1, 40), st.integers(0, 100))
def test_draws_continue(seed: int, dimensions: int, count: int, more: int) -> None:
    points = unit_draws(seed, dimensions, count)
    assert points.shape == (count, dimensions)
    assert np.array_equal(unit_draws(seed, dimensions, count + more)[:count], points)


def test_draws_fill_the_range_evenly() -> None:
    points = unit_draws(5, 4, 32)
    for column in points.T:
        assert len({int(32 * u) for u in column}) == 32


def test_nested_levels_share_their_numbers() -> None:
    assert set(rounded_levels(1e-5, 1e-3, 5)) <= set(rounded_levels(1e-5, 1e-3, 9))
    assert rounded_levels(1e-5, 1e-3, 1) == (1e-4,)


def test_quantiles() -> None:
    assert Distribution(uniform=(2.0, 4.0)).quantile(0.25) == 2.5
    assert Distribution(factor_uniform=(0.9, 1.1)).quantile(1.0) == pytest.approx(1.1)
    assert Distribution(lognormal=0.4).quantile(0.5) == pytest.approx(1.0)
    assert Distribution(lognormal=0.4).quantile(0.8413447460685429) == pytest.approx(math.exp(0.4))
    assert 0 < Distribution(lognormal=0.4).quantile(0.0) < 1 < Distribution(lognormal=0.4).quantile(1.0) < math.inf
