"""Diagnosis from end to end: recordings of independent code against a catalogue of real simulations."""

from __future__ import annotations

import gzip
import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import RECORDINGS, TRUTH
from second_simulator.machine_file import read
from second_simulator.recording import write

from jointplay.catalogue.building.build import build
from jointplay.catalogue.diagnosing.answer import Diagnosis, EffortSpent
from jointplay.catalogue.diagnosing.answer_of_baseline import FittedNumber
from jointplay.catalogue.diagnosing.baseline import Baseline
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.diagnosing.joint_states import edge_warnings
from jointplay.catalogue.diagnosing.together import diagnose_together
from jointplay.catalogue.diagnosing.verdict import number_warnings
from jointplay.catalogue.errors import DiagnosisError, MeasurementError
from jointplay.catalogue.evaluation.cross_checks import MethodLibrary
from jointplay.catalogue.evaluation.nearest_entry import NearestEntry
from jointplay.catalogue.matching.gaussian import NAME
from jointplay.catalogue.matching.matcher import ClearanceEstimate, HypothesisMatch, MatchResult
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.measurements.import_profile import ImportProfile
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import shipped_machine


def recording(number: int) -> Recording:
    return read_measurement(RECORDINGS / f"slider-crank-{number:02}.csv.gz")


def disturbed(measurement: Recording, added: FloatArray) -> Recording:
    signal = measurement.signal + added
    return replace(measurement, signal=signal, sha256=hashlib.sha256(signal.tobytes()).hexdigest())


@pytest.fixture(scope="module")
def worn(small_catalogue: Catalogue) -> Diagnosis:
    return diagnose(recording(2), small_catalogue)


@pytest.mark.parametrize("number", [2, 3, 4])
def test_finds_the_worn_joint_in_recordings_of_other_code(number: int, small_catalogue: Catalogue) -> None:
    truth = TRUTH[f"slider-crank-{number:02}"]
    ((joint, clearance_um),) = truth["worn_um"].items()
    answer = diagnose(recording(number), small_catalogue)
    assert answer.verdict == "worn"
    best = answer.hypotheses[0]
    assert best.label == joint
    assert best.probability > 0.9
    assert answer.candidate_set == (joint,)
    assert best.joints[joint].clearance_um == pytest.approx(clearance_um, rel=0.35)
    assert answer.drive_speed_rpm == pytest.approx(truth["speed_rpm"], rel=2e-3)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_machine_in_order_is_in_order(number: int, small_catalogue: Catalogue, tmp_path: Path) -> None:
    """Two machines with the play of fits by the second simulator, and one without any, which is nearly a silent one."""
    found = recording(1)
    if number:
        name, _ = write(read("slider-crank"), "sound", number, 1, tmp_path)
        found = read_measurement(tmp_path / f"{name}.npz")
    answer = diagnose(found, small_catalogue)
    assert answer.verdict == "in_order"
    assert answer.hypotheses[0].label == "healthy"
    assert answer.hypotheses[0].joints == {}
    assert sum(answer.joint_probabilities.values()) < 0.1


def test_foreign_force_is_neither_wear_nor_in_order(small_catalogue: Catalogue) -> None:
    healthy = recording(1)
    speed = TRUTH["slider-crank-01"]["speed_rpm"] * np.pi / 30.0
    time = np.arange(len(healthy.signal)) / healthy.sample_rate
    rocking = 30.0 * np.sin(3.0 * speed * time)[:, None] * np.array([1.0, 0.3, 1.0, 0.3])
    answer = diagnose(disturbed(healthy, rocking), small_catalogue)
    assert answer.verdict == "changed"
    assert answer.goodness_of_fit.p_value < 0.02
    worst = max(answer.evidence.orders, key=lambda item: abs(item.z))
    assert worst.order == 3.0


def test_what_is_larger_than_a_catalogue_tells_is_at_least_so_large(
    small_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = small_catalogue.plan.clearance.model_copy(update={"high": 2e-4, "beyond": 4.0})
    plan = small_catalogue.plan.model_copy(update={"clearance": told})
    monkeypatch.setattr(Catalogue, "plan", property(lambda _: plan))
    answer = diagnose(recording(3), small_catalogue)  # A, 310 um
    assert answer.hypotheses[0].label == "A"
    assert answer.joints["A"].bound == "at_least"
    assert any(line.startswith("clearance of A reaches the catalogue's largest, 200 um") for line in answer.warnings)


def test_every_band_says_what_it_decides(worn: Diagnosis) -> None:
    found = [*worn.evidence.orders, *worn.evidence.bands]
    best = worn.hypotheses[0]
    rival = next(entry for entry in worn.hypotheses if set(entry.joints) != set(best.joints))
    assert worn.evidence.rival == rival.label
    off = np.array([band.measured_db - (band.rival_db or 0.0) for band in found])
    assert np.sqrt(np.mean(off**2)) == pytest.approx(rival.distance_db, rel=0.05)
    assert sum(band.favours_best or 0.0 for band in found) > 0.0


def test_json_has_the_documented_shape(worn: Diagnosis, small_catalogue: Catalogue) -> None:
    content = json.loads(worn.to_json())
    documented = {
        "id", "machine", "catalogue", "drive_speed_rpm", "effort", "verdict", "hypotheses", "joint_probabilities",
        "candidate_set", "coverage", "widened", "goodness_of_fit", "evidence", "warnings", "joints", "causes",
        "sensors", "prior",
    }  # fmt: skip
    assert set(content) == documented | {
        "mode",
        "effort_spent",
        "baseline",
        "past",
        "suggestions",
        "provenance",
        "hash",
        "recordings",
    }
    first = content["hypotheses"][0]
    assert set(first) == {"label", "joints", "probability", "distance_db"}
    assert set(first["joints"]["B"]) == {"clearance_um", "interval_um"}
    low, high = first["joints"]["B"]["interval_um"]
    assert low < first["joints"]["B"]["clearance_um"] < high
    assert set(content["joints"]) == {"A", "B", "O"}
    assert set(content["joints"]["B"]) == {
        "condition", "p_worn", "p_over_limit", "limit_um", "clearance_um", "interval_um", "bound", "detectable_from_um",
    }  # fmt: skip
    assert set(content["evidence"]) == {"orders", "bands", "rival"}
    assert set(content["evidence"]["bands"][0]) == {
        "order", "low_hz", "high_hz", "channel", "measured_db", "predicted_db", "spread_db", "z", "rival_db",
        "favours_best",
    }  # fmt: skip
    assert [item["order"] for item in content["evidence"]["orders"][:6]] == [1, 1, 1, 2, 2, 2]
    assert {item["channel"] for item in content["evidence"]["bands"]} == {"x", "y", "theta"}
    assert content["machine"] == "slider-crank"
    assert content["catalogue"] == "slider-crank"
    assert set(content["joint_probabilities"]) == {"A", "B", "O"}
    probabilities = [item["probability"] for item in content["hypotheses"]]
    assert sum(probabilities) == pytest.approx(1.0)
    assert probabilities == sorted(probabilities, reverse=True)
    assert content["provenance"]["measurement_sha256"] == recording(2).sha256
    assert content["provenance"]["catalogue_sha256"] == small_catalogue.id
    assert content["provenance"]["matcher"]["name"] == NAME
    assert Diagnosis.model_validate_json(worn.to_json()) == worn


def test_same_question_same_answer_whatever_was_asked_before(worn: Diagnosis, small_catalogue: Catalogue) -> None:
    library = ModelLibrary(small_catalogue.matrix)
    diagnose(recording(3), small_catalogue, library=library)
    again = diagnose(recording(2), small_catalogue, library=library)
    assert again == worn
    content = worn.model_dump(mode="json", exclude={"hash"})
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    assert worn.hash == hashlib.sha256(text.encode()).hexdigest()
    other = diagnose(recording(2), small_catalogue, coverage=0.9, library=library)
    assert other.id != worn.id


def test_more_noise_makes_less_sure(worn: Diagnosis, small_catalogue: Catalogue) -> None:
    """Measured, three seeds of the noise: wear of B at 0.992 to 0.9995 against 1.0000 without, seen from 96 um on
    against 42.
    """
    loud = np.random.default_rng(1).normal(0.0, 4.0, recording(2).signal.shape)
    answer = diagnose(disturbed(recording(2), loud), small_catalogue)
    assert answer.hypotheses[0].label == "B"
    assert 1.0 - answer.joints["B"].p_worn > 1e-4 > 1.0 - worn.joints["B"].p_worn
    before, after = (each.joints["B"].detectable_from_um for each in (worn, answer))
    assert before is not None and after is not None
    assert before < after


def test_one_corner_or_one_sensor_is_enough_to_be_compared(small_catalogue: Catalogue) -> None:
    whole = recording(2)
    corner = replace(whole, signal=whole.signal[:, :2], channels=whole.channels[:2])
    answer = diagnose(corner, small_catalogue)
    assert answer.hypotheses[0].label == "B"
    assert {item.channel for item in answer.evidence.orders} == {"s1-x", "s1-y"}
    assert any("one by one" in line for line in answer.warnings)
    renamed = replace(whole, signal=whole.signal[:, :1], channels=(replace(whole.channels[0], name="channel 7"),))
    single = diagnose(renamed, small_catalogue, mapping={"channel 7": "s1-x"})
    assert {item.channel for item in single.evidence.orders} == {"s1-x"}
    with pytest.raises(MeasurementError, match="no column is a sensor"):
        diagnose(renamed, small_catalogue)


def test_effort_is_reported_as_used(small_catalogue: Catalogue, worn: Diagnosis) -> None:
    fast = diagnose(recording(2), small_catalogue, effort="fast")
    assert fast.effort == "fast"
    assert fast.hypotheses[0].label == "B"
    assert fast.effort_spent.simulations == 0
    thorough = diagnose(recording(2), small_catalogue, effort="thorough")
    assert thorough.effort == "thorough"
    assert "certain already" in thorough.effort_spent.note
    assert thorough.hypotheses == worn.hypotheses
    assert thorough.id != worn.id
    other = diagnose(
        recording(2), small_catalogue, effort="thorough", library=MethodLibrary(small_catalogue.matrix, NearestEntry())
    )
    assert other.effort_spent == EffortSpent(simulations=0, generations=0, note="")  # nothing replaces its answer


def test_a_recording_of_the_machine_in_order_takes_gain_errors_out(small_catalogue: Catalogue, worn: Diagnosis) -> None:
    assert worn.baseline is None
    gains = np.array([1.07, 1.0, 1.0, 0.94])

    def by_wrong_sensors(number: int) -> Recording:
        measurement = recording(number)
        signal = measurement.signal * gains
        return replace(measurement, signal=signal, sha256=hashlib.sha256(signal.tobytes()).hexdigest())

    found = diagnose(by_wrong_sensors(2), small_catalogue, baseline=by_wrong_sensors(1))
    assert found.hypotheses[0].label == "B"
    assert found.baseline is not None
    assert found.baseline.used
    assert found.baseline.measurement_sha256 == by_wrong_sensors(1).sha256
    assert found.baseline.p_after >= found.baseline.p_before
    # Beside its own past the worn machine has changed: joints rattle in the bands above the orders.
    assert found.past is not None and found.past.p_value < 0.005 and found.past.changed
    # The recordings' own gains are up to 5 % off, too, and the fit expects gains to be within some per cent.
    fitted = [found.baseline.gains[name].factor for name in ("s1-x", "s1-y", "s2-x", "s2-y")]
    true = gains * np.array(TRUTH["slider-crank-01"]["gain"])
    assert np.corrcoef(np.log(fitted), np.log(true))[0, 1] > 0.9
    assert found.id != diagnose(by_wrong_sensors(2), small_catalogue).id


def test_a_baseline_whose_sensors_contradict_each_other_is_left_out_and_its_warnings_are_told(
    small_catalogue: Catalogue, worn: Diagnosis
) -> None:
    sound = recording(1)
    wrong = replace(sound, signal=sound.signal * [-1.0, -1.0, 1.0, 1.0], name="inverted", sha256="1" * 64)
    found = diagnose(recording(2), small_catalogue, baseline=[wrong])
    assert found.baseline is None and found.past is None and found.hypotheses == worn.hypotheses
    (told,) = (line for line in found.warnings if line.startswith("baseline"))
    assert told.startswith("baseline inverted: sensors s1-x, s1-y") and told.endswith(": left out")
    short = replace(sound, signal=sound.signal[:5000], name="short", sha256="2" * 64)
    shorter = replace(sound, signal=sound.signal[:4999], name="shorter", sha256="3" * 64)
    found = diagnose(recording(2), small_catalogue, baseline=[wrong, short, shorter])
    assert found.baseline is not None and found.baseline.measurement == "short" and len(found.baseline.further) == 1
    (few,) = (line for line in found.warnings if "revolutions" in line)
    assert few.startswith("baseline short, shorter: only ")


def test_a_recording_is_not_compared_with_itself(small_catalogue: Catalogue, worn: Diagnosis) -> None:
    found = diagnose(recording(2), small_catalogue, baseline=[recording(2)])
    assert found.baseline is None and found.hypotheses == worn.hypotheses
    assert f"baseline {recording(2).name}: is what is diagnosed: left out" in found.warnings
    with pytest.raises(DiagnosisError, match=r"^baseline: slider-crank-02.*: must be none of those that are compared"):
        diagnose_together([recording(2), recording(3)], small_catalogue, baseline=recording(2))


def test_what_would_tell_hypotheses_apart_is_said_where_they_are_not(small_catalogue: Catalogue) -> None:
    loud = np.random.default_rng(1).normal(0.0, 3.0, (len(recording(2).signal), 1))
    whole = disturbed(recording(2), np.tile(loud, 4))
    single = replace(whole, signal=whole.signal[:, :1], channels=whole.channels[:1])
    answer = diagnose(single, small_catalogue, mode="trusted")
    assert answer.hypotheses[0].probability < 0.99
    assert answer.verdict == "worn"
    assert answer.suggestions
    for suggestion in answer.suggestions:
        assert suggestion.error < suggestion.error_now
        assert set(suggestion.hypotheses) <= {each.label for each in answer.hypotheses}
    assert diagnose(single, small_catalogue, mode="trusted", effort="fast").suggestions == ()


@pytest.mark.parametrize("number", [3, 5, 6])
@pytest.mark.parametrize("rpm", [590.0, 600.0, 620.0, 120.0])
def test_a_recording_of_another_machine_has_no_cause_in_this_one(
    number: int, rpm: float, small_catalogue: Catalogue
) -> None:
    foreign = read_measurement(RECORDINGS / f"quick-return-{number:02}.csv.gz")
    answer = diagnose(foreign, small_catalogue, speed=rpm * np.pi / 30.0)
    assert (answer.verdict, answer.causes) == ("unknown", ())


def test_warns_of_what_the_catalogue_does_not_cover(small_catalogue: Catalogue) -> None:
    measurement = recording(4)
    speed = TRUTH["slider-crank-04"]["speed_rpm"] * np.pi / 30.0
    faster = replace(measurement, sample_rate=measurement.sample_rate * 1.05)
    answer = diagnose(faster, small_catalogue, speed=1.05 * speed)
    assert any("outside the catalogue's" in line for line in answer.warnings)
    assert answer.drive_speed_rpm == pytest.approx(1.05 * TRUTH["slider-crank-04"]["speed_rpm"])


@pytest.mark.parametrize(
    ("low", "high", "told"),
    [
        (0.01, 0.5, "smallest"),
        (-0.2, 0.5, "smallest"),
        (0.5, 0.99, "largest"),
        (0.5, 1.2, "largest"),
        (0.2, 0.8, ""),
    ],
)
def test_warns_of_a_clearance_at_the_end_of_its_range(
    small_catalogue: Catalogue, low: float, high: float, told: str
) -> None:
    span = np.log(small_catalogue.matrix.ranges.clearance["A"])
    ends = np.exp(span[0] + np.array([low, high]) * (span[1] - span[0]))
    (match,) = answer_of(A=(1.0, 0.5)).hypotheses
    found = ClearanceEstimate("A", float(np.sqrt(ends[0] * ends[1])), float(ends[0]), float(ends[1]))
    warnings = edge_warnings(replace(match, clearances=(found,)), small_catalogue)
    assert len(warnings) == bool(told)
    assert all(line.startswith(f"clearance of A reaches the catalogue's {told}") for line in warnings)


def test_warns_of_fitted_numbers_that_no_entry_has(small_catalogue: Catalogue) -> None:
    path = "joints.A.contact.friction"
    low, high = small_catalogue.matrix.ranges.parameters[path]
    for factor, warned in ((0.9 * low, True), (low, False), (high, False), (1.1 * high, True)):
        numbers = {
            path: FittedNumber(factor=factor, scatter=0.01),
            "frame.mass": FittedNumber(factor=9.0, scatter=0.01),
        }
        paths = {path: {path: 1.0}, "frame.mass": {"links.base.mass": 10.0}}
        warnings = number_warnings(Baseline("b", numbers, {}, 1.0, 1.0, {}, paths=paths), small_catalogue)
        assert len(warnings) == warned
        assert all(path in line and "outside the catalogue's" in line for line in warnings)


def test_refuses_settings_and_catalogues_it_cannot_use(small_catalogue: Catalogue, tmp_path: Path) -> None:
    with pytest.raises(DiagnosisError, match=r"coverage: 1\.0: must be between 0 and 1"):
        diagnose(recording(2), small_catalogue, coverage=1.0)
    with pytest.raises(DiagnosisError, match="effort: most: must be fast, standard or thorough"):
        diagnose(recording(2), small_catalogue, effort="most")  # type: ignore[arg-type]
    with pytest.raises(DiagnosisError, match="mode: brave: must be auto, trusted or robust"):
        diagnose(recording(2), small_catalogue, mode="brave")  # type: ignore[arg-type]
    plan = parse_plan({"hypotheses": ["healthy"], "draws": {"healthy": 2}, "seconds": 0.5})
    build(shipped_machine("slider-crank"), plan, tmp_path / "sparse", workers=0)
    with pytest.raises(DiagnosisError, match="2 entries of hypothesis healthy: at least 3 needed"):
        diagnose(recording(2), Catalogue.open(tmp_path / "sparse"))


def answer_of(**hypotheses: tuple[float, float]) -> MatchResult:
    nothing = np.zeros(1)
    matches = [
        HypothesisMatch(label, () if label == "healthy" else (label,), probability, (), 1.0, p_value, nothing, nothing)
        for label, (probability, p_value) in hypotheses.items()
    ]
    return MatchResult(tuple(sorted(matches, key=lambda match: -match.probability)))


def test_the_p_value_that_decides_on_the_mode_is_told_whatever_coverage_is_asked(small_catalogue: Catalogue) -> None:
    decided: list[float | None] = []

    class Doubtful(ModelLibrary):
        def answer(self, *arguments: Any, **settings: Any) -> MatchResult:
            found = super().answer(*arguments, **settings)
            decided.append(found.trusted_p_value)
            first, second, *_ = found.hypotheses
            both = (replace(first, probability=0.7, p_value=0.03), replace(second, probability=0.3, p_value=0.5))
            return replace(found, hypotheses=both, conformal=None)

    library = Doubtful(small_catalogue.matrix)
    wide, narrow = (
        diagnose(recording(2), small_catalogue, effort="fast", mode="trusted", coverage=each, library=library)
        for each in (0.95, 0.5)
    )
    assert (wide.goodness_of_fit.p_value, narrow.goodness_of_fit.p_value) == (0.5, 0.03)
    assert wide.mode.trusted_p_value == narrow.mode.trusted_p_value == decided[0] == decided[1]


def test_what_was_said_of_a_file_belongs_to_the_question(small_catalogue: Catalogue) -> None:
    packed = (RECORDINGS / "slider-crank-04.csv.gz").read_bytes()
    volts = gzip.decompress(packed).replace(b"[m/s2]", b"[V]")
    first, again, other = (
        diagnose(
            read_measurement(volts, name="v.csv", profile=ImportProfile(sensitivity={"*": said})),
            small_catalogue,
            effort="fast",
        )
        for said in ("100 mV/g", "100 mV/g", "101 mV/g")
    )
    assert (first.id, first.hash) == (again.id, again.hash)
    # A hundredth more or less shows in no finding of the recipe, but in the answer.
    assert first.provenance == other.provenance
    assert first.id != other.id and first.hash != other.hash
