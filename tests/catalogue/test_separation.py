"""Suggestions: what they promise is what a classifier gains on entries that nobody has seen."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loaded import SHORT
from recordings import RECORDINGS

from jointplay.catalogue.building.build import build
from jointplay.catalogue.diagnosing.comparison import exact_sensing
from jointplay.catalogue.diagnosing.separation import Day, _more_sensors, _sensing, _Separation, foresee, suggest
from jointplay.catalogue.evaluation.protocols import draw_truth
from jointplay.catalogue.evaluation.recordings import Recordings
from jointplay.catalogue.evaluation.recordings import recorded as recording_of
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.matching.matcher import ClearanceEstimate, HypothesisMatch, MatchResult
from jointplay.catalogue.matching.observation import Sensing, observe
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.plans.day_load import DayLoad, loads_held
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.plans.plan import Plan, parse_plan
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.machines.parts import Load

PLAN = {
    "name": "speeds",
    "hypotheses": ["healthy", "singles"],
    "draws": {"healthy": 16, "single": 40},
    "clearance": {"low": "80 um", "high": "0.25 mm"},
    "seconds": 1.0,
    "speeds": [0.8, 1.0],
}


def recorded(catalogue: Catalogue, columns: tuple[int, ...], name: str = "slider-crank-02") -> PreparedMeasurement:
    """A recording with some of its columns."""
    whole = read_measurement(RECORDINGS / f"{name}.csv.gz")
    channels = tuple(whole.channels[column] for column in columns)
    signal = np.ascontiguousarray(whole.signal[:, list(columns)])
    part = Recording(name, whole.sample_rate, signal, channels, (), (), whole.sha256)
    return prepare(part, catalogue.machine, scheme=catalogue.scheme)


def answer(*hypotheses: tuple[str, float], low: float = 80e-6, high: float = 250e-6) -> MatchResult:
    """Hypotheses of one joint each with their probabilities."""
    nothing = np.zeros(0)
    return MatchResult(
        tuple(
            HypothesisMatch(
                label,
                () if label == "healthy" else (label,),
                probability,
                () if label == "healthy" else (ClearanceEstimate(label, math.sqrt(low * high), low, high),),
                1.0,
                1.0,
                nothing,
                nothing,
            )
            for label, probability in hypotheses
        )
    )


def test_what_a_second_axis_brings(small_catalogue: Catalogue) -> None:
    """One horizontal sensor: anything vertical tells A from B; more of the same does not."""
    found = suggest(small_catalogue, recorded(small_catalogue, (0,)), answer(("A", 0.6), ("B", 0.4)), count=20)
    assert found and list(found) == sorted(found, key=lambda each: -each.information_bits)
    best = found[0]
    assert best.hypotheses == ("A", "B") and best.error < 0.8 * best.error_now and best.separation > best.separation_now
    assert best.what.startswith("y at") or best.what in ("s1-y", "s2-y")
    for each in found:
        assert each.error_now == pytest.approx(0.4) and each.error < 0.95 * each.error_now
        assert 0.0 < each.information_bits < -0.6 * math.log2(0.6) - 0.4 * math.log2(0.4)
    assert not any(each.what == "s1-x" for each in found)
    kinds = {each.what: each.kind for each in found}
    assert all(kind == "sensor" for what, kind in kinds.items() if what.startswith("s"))
    assert len(suggest(small_catalogue, recorded(small_catalogue, (0,)), answer(("A", 0.6), ("B", 0.4)), count=2)) == 2


def test_nothing_to_suggest(small_catalogue: Catalogue) -> None:
    one = recorded(small_catalogue, (0, 1, 2, 3))
    assert suggest(small_catalogue, one, answer(("A", 1.0))) == ()
    # The whole frame is seen: healthy and 80 um and more are told apart in every case.
    assert suggest(small_catalogue, one, answer(("A", 0.9), ("healthy", 0.1))) == ()
    assert suggest(small_catalogue, one, answer(("A", 0.9), ("A+B", 0.1))) == ()


def nearest_entry_errs(catalogue: Catalogue, question: _Separation, sensing: Sensing) -> float:
    """Share of entries whose nearest other entry is of the other hypothesis."""
    draws = []
    for seed, match in enumerate(question.contenders):
        own = question.rows(match, Day(question.prepared.drive_speed))
        copies = np.full(len(own), 3, dtype=np.int64)
        draws.append(observe(catalogue.matrix.packed(own), sensing, Discrepancy(), copies, seed))
    wrong = total = 0
    for truth, (features, entry) in enumerate(draws):
        for feature, case in zip(features, entry, strict=True):
            nearest = []
            for label, (others, cases) in enumerate(draws):
                other = others[cases != case] if label == truth else others
                nearest.append(float(np.square(other - feature).mean(axis=1).min()))
            wrong += int(np.argmin(nearest) != truth)
            total += 1
    return wrong / total


def test_another_matcher_finds_what_was_promised(small_catalogue: Catalogue) -> None:
    """The nearest entry knows no direction of Fisher's and errs more; but what is promised to help helps it as well.

    Measured: promised 5.0 to 3.0 %, found 17 to 6 % with the best sensor; 15 % with the same sensor once more.
    """
    prepared, machine = recorded(small_catalogue, (0,)), small_catalogue.machine
    question = _Separation(small_catalogue, prepared, answer(("A", 0.5), ("B", 0.5)).hypotheses)
    now = exact_sensing(prepared)
    errors = [question.mistaken(question.squared_distances(sensing, Day(prepared.drive_speed))) for sensing in (now,)]
    ranked = sorted(
        (question.mistaken(question.squared_distances(sensing, Day(prepared.drive_speed))), number, sensing)
        for number, (_, _, sensing) in enumerate(_more_sensors(prepared, machine))
    )
    before, after = (nearest_entry_errs(small_catalogue, question, each) for each in (now, ranked[0][2]))
    assert errors[0] / 2.0 < before < 6.0 * errors[0]
    assert ranked[0][0] < 0.8 * errors[0] and after < 0.8 * before
    again = nearest_entry_errs(small_catalogue, question, _sensing(prepared, machine, prepared.sensing.transform[0]))
    assert again > 0.6 * before


def test_speeds_that_the_catalogue_holds(tmp_path: Path) -> None:
    build(shipped_machine("slider-crank"), parse_plan(PLAN), tmp_path / "speeds", workers=0)
    catalogue = Catalogue.open(tmp_path / "speeds")
    found = suggest(catalogue, recorded(catalogue, (0,)), answer(("A", 0.5), ("B", 0.5)), count=30)
    speeds = [each for each in found if each.kind == "speed"]
    assert [each.what for each in speeds] == ["480 rpm"]
    assert speeds[0].separation > speeds[0].separation_now
    # Recorded there as well, nothing is left to record at another speed.
    one = recorded(catalogue, (0,))
    other = replace(one, speed=replace(one.speed, speed=50.0))
    both = suggest(catalogue, recorded(catalogue, (0,)), answer(("A", 0.5), ("B", 0.5)), others=[other], count=30)
    assert not [each for each in both if each.kind == "speed"]
    assert {each.separation_now for each in both} == {speeds[0].separation}


def test_loads_that_the_catalogue_holds(tmp_path: Path) -> None:
    """A load that holds joints shut: the other one is suggested, and tells more; which a recording has is seen."""
    draws = {"healthy": 40, "single": 40}
    plan = parse_plan({**PLAN, "draws": draws, "speeds": [1.0], "loads": [{"force": "-330 N"}, {"force": "0 N"}]})
    machine = shipped_machine("slider-crank")
    build(machine, plan, tmp_path / "loads", workers=0)
    catalogue = Catalogue.open(tmp_path / "loads")
    held, free = plan.loads or ()
    matrix = catalogue.matrix
    undecided = answer(("healthy", 0.5), ("A", 0.5))
    shut = recorded_under(catalogue, -330.0)
    question = _Separation(catalogue, shut, undecided.hypotheses)
    assert np.bincount(question.load_of_rows[matrix.rows("A")]).tolist() == [40, 40]
    assert question.load_of_rows.min() == 0
    assert question.day_of(shut).load == held
    assert question.day_of(recorded(catalogue, (0, 1, 2, 3))).load == free
    found = {each.what: each for each in suggest(catalogue, shut, undecided, count=30) if each.kind == "load"}
    assert list(found) == ["0 N"]
    assert found["0 N"].separation > 1.5 * found["0 N"].separation_now and found["0 N"].error < 0.2
    # Under a load that lets joints rattle nothing more is to be had of one that holds them shut.
    rattling = suggest(catalogue, recorded(catalogue, (0, 1, 2, 3)), undecided, count=30)
    assert "load" not in {each.kind for each in rattling}
    both = suggest(catalogue, shut, undecided, others=[recorded(catalogue, (0, 1, 2, 3))], count=30)
    assert not [each for each in both if each.kind == "load"]


def test_loads_of_a_day_are_within_a_fifth() -> None:
    """What lies within the fifths of two is of the nearer one; only nothing at all is of none."""
    loads = [DayLoad(force=0.0), DayLoad(force=-330.0), DayLoad(force=-300.0), DayLoad(torque=50.0)]
    drawn = np.array([0.0, 1.0, -330.0, -396.0, -397.0, -310.0, -240.0, -239.0, 40.0, 60.0, 61.0])
    assert loads_held(loads, drawn).tolist() == [0, -1, 1, 1, -1, 2, 2, -1, 3, 3, -1]
    near = [DayLoad(torque=100.0), DayLoad(torque=150.0)]
    assert loads_held(near, np.array([119.0, 121.0, 126.0])).tolist() == [0, 1, 1]


def test_loads_that_no_entry_has_yet(small_catalogue: Catalogue) -> None:
    """A build that adds loads says so before it has simulated any."""
    prepared = recorded(small_catalogue, (0,))
    loads = (DayLoad(force=-330.0), DayLoad(force=0.0))
    extended = Extended(small_catalogue, small_catalogue.plan.model_copy(update={"loads": loads}))
    question = _Separation(extended, prepared, answer(("A", 0.5), ("B", 0.5)).hypotheses)  # type: ignore[arg-type]
    assert question.day_of(prepared) == Day(prepared.drive_speed)
    assert not list(question.other_loads([question.day_of(prepared)]))


class Extended:
    """A catalogue with another plan."""

    def __init__(self, catalogue: Catalogue, plan: Plan) -> None:
        self.plan, self.matrix, self.machine, self.recipe = plan, catalogue.matrix, catalogue.machine, catalogue.recipe


def recorded_under(catalogue: Catalogue, force: float) -> PreparedMeasurement:
    """A worn machine under a constant load on its output, recorded."""
    truth = draw_truth(catalogue.machine, Hypothesis.of(["A"]), SHORT, 5, 1)
    load = Load(link="slider", at=(0.2, 0.05), force=(force, 0.0))
    truth = replace(truth, machine=truth.machine.model_copy(update={"loads": (load,)}))
    ((_, ideal),) = Recordings().ideal(SHORT, [truth])
    assert ideal is not None
    return prepare(recording_of(SHORT, truth, ideal), catalogue.machine, scheme=catalogue.scheme)


def test_what_is_foreseen_of_two() -> None:
    """The best decision between two normal laws errs as often as in closed form; apart far enough, all is told."""
    for first, apart in ((0.5, 1.0), (0.7, 2.5), (0.95, 2.0), (0.95, 0.5)):
        odds = math.log(first / (1.0 - first))
        expected = first * phi(-0.5 * apart - odds / apart) + (1.0 - first) * phi(-0.5 * apart + odds / apart)
        error, information = foresee(np.array([first, 1.0 - first]), np.array([apart**2]))
        entropy = -first * math.log2(first) - (1.0 - first) * math.log2(1.0 - first)
        assert error == pytest.approx(expected, abs=0.004)
        assert 0.0 < information < entropy
    assert foresee(np.array([0.7, 0.3]), np.array([0.0])) == (pytest.approx(0.3), pytest.approx(0.0, abs=1e-12))
    error, information = foresee(np.array([0.7, 0.3]), np.array([400.0]))
    assert error < 1e-6 and information == pytest.approx(-0.7 * math.log2(0.7) - 0.3 * math.log2(0.3))


def test_what_is_foreseen_of_three() -> None:
    """As drawn: a true one by its probability, an observation about it, and who is the most probable then."""
    points = np.array([[0.0, 0.0], [1.5, 0.0], [0.4, 2.0]])
    squared = np.array([np.sum((points[i] - points[j]) ** 2) for i, j in ((0, 1), (0, 2), (1, 2))])
    probability, generator = np.array([0.5, 0.3, 0.2]), np.random.default_rng(3)
    true = generator.choice(3, size=200_000, p=probability)
    seen = points[true] + generator.normal(size=(200_000, 2))
    said = np.log(probability) - 0.5 * np.sum((seen[:, None] - points) ** 2, axis=2)
    assert foresee(probability, squared)[0] == pytest.approx(float(np.mean(said.argmax(axis=1) != true)), abs=0.004)


def phi(x: float) -> float:
    """Standard normal distribution."""
    return 0.5 * math.erfc(-x / math.sqrt(2.0))
