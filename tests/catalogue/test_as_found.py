"""The machine as found: a load told by low orders, and sets of joints simulated with it for one recording."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from loaded import LOADS, asked, prepared_of

from jointplay.catalogue.diagnosing import as_found, stroke_loads
from jointplay.catalogue.diagnosing.as_found import LEAST_CASES, Refined, networks_of, refine, sets_to_simulate
from jointplay.catalogue.diagnosing.diagnosis import answer
from jointplay.catalogue.diagnosing.found_cases import draw_cases, simulate_cases
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.stroke_loads import StrokeLoads, find_load
from jointplay.catalogue.matching.learning import Learning, training_set
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.network_shelf import Networks
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import shipped_machine


def of_likely(prepared: PreparedMeasurement, result: MatchResult) -> list[tuple[PreparedMeasurement, str, float]]:
    return [(prepared, match.label, match.probability) for match in result.hypotheses[:3]]


@pytest.fixture(scope="module")
def loaded(small_catalogue: Catalogue) -> PreparedMeasurement:
    return prepared_of(small_catalogue, "B", LOADS)


@pytest.fixture(scope="module")
def found(small_catalogue: Catalogue, loaded: PreparedMeasurement) -> Refined:
    return refined(small_catalogue, loaded)


def refined(catalogue: Catalogue, prepared: PreparedMeasurement, cases: int = 4 * 120) -> Refined:
    observed, result = asked(catalogue, prepared)
    return refine(prepared, observed, catalogue, result, result.set(0.95).labels, cases=cases)


@pytest.mark.parametrize("name", ["slider-crank", "four-bar", "quick-return"])
def test_unit_loads_share_the_strokes(name: str) -> None:
    """Together they are a constant force along the way, whose table is as near as asked; none begins at once."""
    machine = shipped_machine(name)
    loads = StrokeLoads.of(machine, machine.drive.speed)  # type: ignore[union-attr, arg-type]
    assert loads is not None
    np.testing.assert_allclose(np.linalg.norm(loads.force.sum(axis=0), axis=1), 1.0, atol=1e-9)
    size = np.linalg.norm(loads.force, axis=2)
    assert (np.diff(size, axis=1) < 0.2).all()
    assert (size.max(axis=1) > 0.999).all()
    for load, force in zip(loads.machine(machine).loads[-2:], loads.force, strict=True):
        assert load.over_angle is not None
        angle, x, y, torque = np.array(load.over_angle).T
        drawn = np.column_stack([np.interp(loads.angle, angle, each, period=2.0 * math.pi) for each in (x, y)])
        assert np.abs(drawn - force).max() < 0.02
        assert not torque.any()
        assert len(angle) < 20


@pytest.mark.long
def test_the_load_of_a_stroke_is_found(small_catalogue: Catalogue, loaded: PreparedMeasurement) -> None:
    """On a slide only what one stroke has more than the other shakes the frame; the rest is as uncertain as ever."""
    _, result = asked(small_catalogue, loaded)
    load = find_load(small_catalogue, of_likely(loaded, result), small_catalogue.recipe.nominal_drive_speed)
    assert load is not None
    assert load.mean[0] - load.mean[1] == pytest.approx(LOADS[0] - LOADS[1], abs=12.0)
    assert math.sqrt(load.covariance.sum() / 4.0) > 20.0
    cause = load.cause(0.9)
    assert cause is not None
    assert cause.name == "load on one stroke"
    assert load.paths == ("loads.0.over_angle", "loads.1.over_angle")


def test_of_a_drive_that_bears_no_load_none_is_looked_for(
    small_catalogue: Catalogue, loaded: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, result = asked(small_catalogue, loaded)
    monkeypatch.setattr(stroke_loads, "load_scale", lambda machine: 0.0)
    assert find_load(small_catalogue, of_likely(loaded, result), small_catalogue.recipe.nominal_drive_speed) is None


@pytest.mark.long
def test_a_loaded_machine_is_simulated_with_its_load(
    small_catalogue: Catalogue, loaded: PreparedMeasurement, found: Refined
) -> None:
    """It speaks for the joint that is worn, which a catalogue without the load gives one in a thousand."""
    _, before = asked(small_catalogue, loaded)
    assert found.result.probability("B") > 2.0 * before.probability("B")
    assert found.simulations == 4 * 120
    assert found.generations == 2
    assert "loads of" in found.reason
    assert "effective sample size" in found.reason
    assert sum(match.probability for match in found.result.hypotheses) == pytest.approx(1.0)
    assert found.cause is not None
    assert found.cause.size == pytest.approx(LOADS[0] - LOADS[1], abs=12.0)


@pytest.mark.long
def test_a_loaded_machine_is_worn_beside_its_load(small_catalogue: Catalogue, loaded: PreparedMeasurement) -> None:
    """Which of three joints so few draws cannot say; that something is worn, they do."""
    question = Question(effort="thorough", cases=4 * 120)
    thorough, _ = answer(loaded, "0" * 64, small_catalogue, question)
    assert thorough.verdict == "worn"
    assert thorough.causes[0].name == "load on one stroke"
    assert thorough.effort_spent.simulations == 4 * 120


@pytest.mark.long
def test_a_network_that_has_learned_the_cases_knows_more_than_curves(
    small_catalogue: Catalogue, loaded: PreparedMeasurement
) -> None:
    """Of draws that neither has seen; where there are too few cases there is none."""
    observed, _ = asked(small_catalogue, loaded)
    learning, speed = Learning.of("trusted"), small_catalogue.recipe.nominal_drive_speed
    sets = [tuple(joints) for joints in ("AB", "AO", "ABO")]
    machine, drawn = draw_cases(small_catalogue, speed, sets, None, 260)
    every = simulate_cases(small_catalogue, machine, drawn)
    few, shown, fresh = (
        every.kept([row for row, entry in enumerate(every.entries) if entry.draw in draws])
        for draws in (range(150), range(220), range(220, 260))
    )
    assert networks_of(few, observed).get(observed.sensing, learning, observed.speed) is None
    networks = networks_of(shown, observed).every(observed.sensing, learning, observed.speed)
    asked_of = training_set(fresh, observed.sensing, observed.watched, replace(learning, rows=40))
    features, truth = asked_of.stack()
    losses = []
    for known in (Networks(), networks):
        model = ModelLibrary(shown).fit(observed, learning, known)
        assert model.labels == asked_of.labels
        losses.append(-float(np.log(model.posterior(features)[np.arange(len(truth)), truth]).mean()))
    assert losses[1] < losses[0]  # 0.29 and 0.22 where it was measured


@pytest.mark.long
def test_the_same_question_has_the_same_answer(
    small_catalogue: Catalogue, loaded: PreparedMeasurement, found: Refined
) -> None:
    again = refined(small_catalogue, loaded)
    assert again.reason == found.reason
    for one, two in zip(again.result.hypotheses, found.result.hypotheses, strict=True):
        assert (one.probability, one.clearances) == (two.probability, two.clearances)


@pytest.mark.long
def test_a_machine_that_does_not_explain_the_recording_says_little(
    small_catalogue: Catalogue, loaded: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It moves probabilities a little; clearances, levels and p-values stay the catalogue's."""
    monkeypatch.setattr(as_found, "weight_as_filed", lambda p_value: 0.1)
    _, before = asked(small_catalogue, loaded)
    doubted = refined(small_catalogue, loaded)
    assert "does not explain the recording either" in doubted.reason
    assert doubted.cause is None
    own = {match.label: match for match in before.hypotheses}
    for match in doubted.result.hypotheses:
        assert (match.clearances, match.p_value) == (own[match.label].clearances, own[match.label].p_value)
        assert match.probability == pytest.approx(own[match.label].probability, abs=0.1)


@pytest.mark.long
def test_candidate_sets_are_by_the_law_of_the_catalogue(
    small_catalogue: Catalogue, loaded: PreparedMeasurement
) -> None:
    """So is whether the machine's own past was heard, which a load that is told does not end."""
    observed, result = asked(small_catalogue, loaded)
    result = replace(result, beside=True)
    found = refine(loaded, observed, small_catalogue, result, result.set(0.95).labels, cases=4 * 120)
    assert found.cause is not None
    assert found.result.conformal is result.conformal
    assert found.result.beside


@pytest.mark.long
def test_without_a_load_the_machines_own_past_says_more(
    small_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was simulated counts for a third beside it, where it knows nothing of the machine but its file."""
    prepared = prepared_of(small_catalogue, "B")
    observed, result = asked(small_catalogue, prepared)
    even = tuple(replace(match, probability=0.25) for match in result.hypotheses)
    says = {"B": 0.4, "A": 0.2, "O": 0.2, "healthy": 0.2}
    said = tuple(replace(match, probability=says[match.label]) for match in result.hypotheses)
    monkeypatch.setattr(as_found, "answer_by", lambda *_, **__: replace(result, hypotheses=said, trusted_p_value=1.0))
    monkeypatch.setattr(as_found, "weight_as_filed", lambda p_value: 1.0)
    odds = []
    for heard in (False, True):
        vague = replace(result, hypotheses=even, trusted_p_value=1.0, beside=heard)
        found = refine(prepared, observed, small_catalogue, vague, ["A", "B"], cases=1).result
        odds.append(math.log(found.probability("B") / found.probability("A")))
    assert odds[1] == pytest.approx(0.5 * odds[0], rel=0.1)


def test_a_machine_that_is_not_taken_for_its_file_is_not_simulated(
    small_catalogue: Catalogue, loaded: PreparedMeasurement
) -> None:
    observed, result = asked(small_catalogue, loaded)
    left = refine(loaded, observed, small_catalogue, result, result.set(0.95).labels, mode="robust", cases=480)
    assert (left.simulations, left.result) == (0, result)


def test_nothing_is_simulated_where_it_cannot_change_the_answer(small_catalogue: Catalogue) -> None:
    prepared = prepared_of(small_catalogue, "B")
    observed, result = asked(small_catalogue, prepared)
    sure = replace(result, trusted_p_value=1.0)
    left = refine(prepared, observed, small_catalogue, sure, [sure.best.label], cases=10)
    assert left.simulations == 0
    assert left.result is sure
    assert "certain already" in left.reason


def test_open_questions_are_simulated_without_a_load(small_catalogue: Catalogue) -> None:
    """As few as are needed to draw a curve, however few are asked for; the answer is no surer than both together."""
    prepared = prepared_of(small_catalogue, "B")
    observed, result = asked(small_catalogue, prepared)
    matches = tuple(replace(match, probability=0.25) for match in result.hypotheses)
    vague = replace(result, hypotheses=matches, trusted_p_value=1.0)
    told: list[tuple[int, int]] = []
    answered = refine(
        prepared, observed, small_catalogue, vague, ["A", "B"], cases=1, progress=lambda *done: told.append(done)
    )
    assert answered.simulations == 4 * LEAST_CASES
    assert told == sorted(told) and told[-1] == (4 * LEAST_CASES, 4 * LEAST_CASES)
    assert answered.result.best.label == "B"
    assert answered.result.best.probability < 0.1 * 0.25 + 0.9
    assert answered.cause is None
    assert "loads" not in answered.reason


def test_likely_sets_come_first_then_neighbours(small_catalogue: Catalogue) -> None:
    _, result = asked(small_catalogue, prepared_of(small_catalogue, "B"))
    by_label = {match.label: match for match in result.hypotheses}
    sets = {"A+B": ("A", "B"), "A+O": ("A", "O"), "A": ("A",), "B": ("B",), "O": ("O",), "healthy": ()}
    probabilities = (0.6, 0.38, 0.009, 0.008, 0.002, 0.001)
    matches = [
        replace(by_label["A"], label=label, joints=joints, probability=probability)
        for (label, joints), probability in zip(sets.items(), probabilities, strict=True)
    ]
    chosen = [match.label for match in sets_to_simulate(replace(result, hypotheses=tuple(matches)))]
    assert chosen == ["A+B", "A+O", "A", "B", "O", "healthy"]  # which is two joints away from both
