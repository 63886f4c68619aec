"""Evaluation on held-out simulations: truths, recordings, studies and sweeps."""

from __future__ import annotations

import errno
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sklearn.ensemble import RandomForestClassifier

from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.diagnosing.baseline_levels import OrderLevels
from jointplay.catalogue.diagnosing.diagnosis import answer
from jointplay.catalogue.diagnosing.separation import _more_sensors
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.evaluation import sweep
from jointplay.catalogue.evaluation.differences import with_differences
from jointplay.catalogue.evaluation.protocols import GROUPS, PROTOCOLS, EvaluationProtocol, draw_truth, protocols_of
from jointplay.catalogue.evaluation.recordings import Recordings, recorded
from jointplay.catalogue.evaluation.study import Setup, evaluate, setups_of
from jointplay.catalogue.evaluation.sweep import trade_off
from jointplay.catalogue.evaluation.truth import Response, Truth
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.suspension import with_filed_suspension
from jointplay.catalogue.storage.index import Index
from jointplay.catalogue.storage.leases import ChunkRow, ChunkStatus
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import Machine, shipped_machine
from jointplay.solver.machines.parts import RotationDrive

SHORT = replace(PROTOCOLS["matched"], revolutions=10.0, clearance=(80e-6, 700e-6))
MACHINE = shipped_machine("slider-crank")


def truth_of(*joints: str, protocol: EvaluationProtocol = SHORT, number: int = 0) -> Truth:
    return draw_truth(MACHINE, Hypothesis.of(joints), protocol, 3, number)


def ideal_of(truth: Truth, protocol: EvaluationProtocol = SHORT) -> np.ndarray:
    ((_, signal),) = Recordings().ideal(protocol, [truth])
    assert signal is not None
    return signal


@pytest.mark.long
def test_most_held_out_faults_are_found(small_catalogue: Catalogue) -> None:
    seen: list[tuple[int, int]] = []
    setups = setups_of(["gaussian", "nearest"], ["standard"], ["auto"])
    study = evaluate(
        small_catalogue, [SHORT], 16, seed=3, setups=setups, progress=lambda done, total: seen.append((done, total))
    )
    assert [row.setup.method for row in study.rows] == ["gaussian", "nearest"]
    found = study.rows[0].figures
    assert found.count == 16
    assert study.rows[0].failed == study.rows[0].refused == 0
    assert found.labels == found.columns == ("healthy", "A", "B", "O")
    assert [sum(row) for row in found.confusion] == [4, 4, 4, 4]
    assert found.top1 is not None
    assert found.top1 >= 14 / 16
    assert found.exact_set is not None
    assert found.exact_set >= 14 / 16
    assert found.log_loss is not None
    assert found.log_loss < 0.6
    assert found.clearance_median is not None
    assert found.clearance_median < 0.2
    assert found.set_coverage is not None
    assert found.set_coverage >= found.top1
    assert found.wrong_verdict is not None
    assert found.wrong_verdict <= 2 / 16
    assert sum(each.count for each in found.reliability) == 16
    assert [each.joint for each in found.joints] == ["A", "B", "O"]
    assert seen[-1] == (16, 16)
    assert json.loads(json.dumps(study.content()))["rows"][0]["protocol"]["name"] == "matched"


@pytest.mark.long
def test_a_classifier_of_scikit_learn_is_judged_beside_the_rest(small_catalogue: Catalogue) -> None:
    setups = [Setup(), Setup("forest")]
    forest = RandomForestClassifier(100, random_state=0)
    study = evaluate(small_catalogue, [SHORT], 8, seed=3, setups=setups, methods={"forest": forest})
    own, theirs = study.rows
    assert own.setup.method == "gaussian"
    assert theirs.setup.method == "forest"
    assert theirs.figures.top1 >= 0.5  # of four hypotheses
    with pytest.raises(DiagnosisError, match="method: forest: must be one of"):
        evaluate(small_catalogue, [SHORT], 8, setups=setups)


@pytest.mark.long
def test_a_foreign_cause_has_smaller_p_values_than_what_is_listed(small_catalogue: Catalogue) -> None:
    half_mount = replace(SHORT, name="half mount", kind="singles", differences=("half-mount",), foreign=True)
    (row,) = evaluate(small_catalogue, [half_mount], 8, seed=3).rows
    assert row.figures.auroc_trusted is not None
    assert row.figures.auroc_trusted > 0.8
    assert row.figures.auroc_deciding is not None


@pytest.mark.long
def test_negatives_of_unlisted_pairs_are_asked_of_the_same_catalogue(
    small_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    listed = (*small_catalogue.entries.hypotheses, Hypothesis.of(["A", "B"]))
    monkeypatch.setattr(type(small_catalogue.entries), "hypotheses", property(lambda _: listed))
    asked: list[tuple[str, ...]] = []

    def spied(*arguments: Any, **settings: Any) -> tuple[Diagnosis, MatchResult]:
        asked.append(settings["without"])
        return answer(*arguments, **settings)

    monkeypatch.setattr("jointplay.catalogue.evaluation.study.answer", spied)
    pairs = replace(SHORT, name="unlisted pair", kind="pairs", foreign=True, unlisted=True)
    (row,) = evaluate(small_catalogue, [pairs], 4, seed=3).rows
    assert asked == [("A+B",)] * 8
    assert row.figures.columns == ("healthy", "A", "B", "O")
    assert row.figures.auroc_deciding is not None


def test_truths_follow_from_the_seed_and_stay_within_the_protocol() -> None:
    protocol = PROTOCOLS["hard"]
    assert truth_of("A", protocol=protocol) == truth_of("A", protocol=protocol)
    for number in range(50):
        truth = truth_of("B", protocol=protocol, number=number)
        assert list(truth.clearances) == ["A", "B", "O"]
        assert protocol.clearance[0] <= truth.clearances["B"] <= protocol.clearance[1]
        assert all(protocol.fits[0] <= truth.clearances[joint] <= protocol.fits[1] for joint in "AO")
        assert abs(truth.parameters["drive.speed"] / MACHINE.drive.speed - 1.0) <= protocol.speed  # type: ignore[union-attr, operator]
        friction = [truth.parameters[f"joints.{joint}.contact.friction"] for joint in "ABO"]
        assert protocol.friction[0] <= min(friction) < max(friction) <= protocol.friction[1]
        assert truth.seconds * truth.parameters["drive.speed"] == pytest.approx(40.0 * 2.0 * math.pi)
    new = truth_of(protocol=protocol)
    assert list(new.clearances) == ["A", "B", "O"]
    assert protocol.fits[0] <= min(new.clearances.values()) <= max(new.clearances.values()) <= protocol.fits[1]


def test_protocols_that_differ_in_noise_share_their_truths() -> None:
    matched, hard = (truth_of("A", protocol=PROTOCOLS[name]) for name in ("matched", "hard"))
    assert matched == hard
    other = with_differences(truth_of("A", protocol=PROTOCOLS["model-error-d"]), ("gain",), 3, 0)
    assert replace(other, gains=matched.gains) == matched


def test_recordings_carry_noise_gains_and_structure_of_the_protocol() -> None:
    truth = truth_of()
    ideal = ideal_of(truth)
    clean = recorded(EvaluationProtocol("none", frame_noise=(0.0, 0.0, 0.0)), truth, ideal)
    assert clean.signal == pytest.approx(ideal)
    assert clean.channel_names == tuple(sensor.name for sensor in MACHINE.sensors)
    noisy = recorded(replace(SHORT, sensor_noise=0.1), truth, ideal)
    assert (noisy.signal - clean.signal).std(axis=0) == pytest.approx(0.1, rel=0.1)
    assert noisy.sha256 != clean.sha256
    quiet = EvaluationProtocol("gain", frame_noise=(0.0, 0.0, 0.0))
    gains = recorded(quiet, with_differences(truth, ("gain",), 1, 0), ideal).signal / clean.signal
    assert np.allclose(gains, gains[0])
    assert 0.005 < np.abs(gains[0] - 1.0).max() <= 0.15
    shaken = recorded(EvaluationProtocol("frame", frame_noise=(0.1, 0.0, 0.0)), truth, ideal).signal - ideal
    along_x = [sensor.direction[0] == 1.0 for sensor in MACHINE.sensors]
    assert shaken[:, along_x].std() == pytest.approx(0.1, rel=0.1)
    assert not shaken[:, np.logical_not(along_x)].any()


def test_noise_of_the_whole_frame_does_not_average_out_over_its_sensors() -> None:
    truth = truth_of()
    shaken = EvaluationProtocol("frame", frame_noise=(0.1, 0.1, 0.5))
    prepared = prepare(recorded(shaken, truth, ideal_of(truth)), MACHINE)
    width = np.diff(prepared.scheme.edges_hz(prepared.drive_speed))
    true = np.outer(width / (0.5 * shaken.sample_rate), np.square(shaken.frame_noise))
    # Of 1 s; were it taken to be each sensor's own, x and y would be 3 dB too low.
    assert np.abs(10.0 * np.log10(prepared.noise_power[-20:] / true[-20:])).max() < 1.0


def test_baselines_conversions_and_suggestions_know_the_noise_of_the_whole_frame() -> None:
    truth = truth_of()
    shaken = EvaluationProtocol("frame", frame_noise=(0.1, 0.1, 0.5))
    prepared = prepare(recorded(shaken, truth, ideal_of(truth)), MACHINE)
    sensors = len(prepared.sensing.sensors)
    levels = OrderLevels.of(prepared).noise.reshape(-1, sensors + 3)[:, sensors:]
    assert np.array_equal(levels, prepared.noise_power[: len(levels)])
    assert with_filed_suspension(prepared, MACHINE, {}).noise_power == pytest.approx(prepared.noise_power, rel=1e-6)
    # One more sensor averages its own noise, but not what moves them all.
    for _, _, more in _more_sensors(prepared, MACHINE):
        assert (more.noise[-10:, 0] > 0.8 * prepared.group_noise[-10:, 0]).all()


def test_a_mode_lifts_its_own_frequency_and_leaves_low_ones_alone() -> None:
    rate, count = 10_000.0, 20_000
    t = np.arange(count) / rate
    signal = np.stack([np.sin(2 * np.pi * f * t) for f in (5.0, 300.0)], axis=1)
    passed = Response(300.0, 0.02, (1.0, 1.0)).of(signal, rate)
    # At resonance |H| = |1 + 1 / (2 i z)| = 25; far below it is 1.
    assert passed.std(axis=0) / signal.std(axis=0) == pytest.approx([1.0, math.hypot(1.0, 25.0)], rel=1e-3)
    assert Response().of(signal, rate) is signal


def test_simulations_are_kept_and_found_again(tmp_path: Path) -> None:
    kept, truth = Recordings(tmp_path), truth_of("A")
    ((_, first),) = kept.ideal(SHORT, [truth])
    (stored,) = tmp_path.glob("*.npy")
    ((_, again),) = kept.ideal(replace(SHORT, sensor_noise=1.0), [truth])
    assert first is not None
    assert again is not None
    assert np.array_equal(again, first)  # figures do not depend on what was kept
    np.save(stored, np.zeros((2, 4), np.float32))
    ((_, from_disk),) = kept.ideal(SHORT, [truth])
    assert from_disk is not None
    assert not from_disk.any()
    for damaged in (b"damaged", b""):
        stored.write_bytes(damaged)
        ((_, anew),) = kept.ideal(SHORT, [truth])
        assert anew == pytest.approx(first)
    (tmp_path / "killed.tmp").write_bytes(b"half of a recording")
    list(Recordings(tmp_path, limit=1).ideal(SHORT, []))
    assert not list(tmp_path.iterdir())


def test_a_recording_that_cannot_be_kept_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("jointplay.catalogue.evaluation.recordings.np.save", full)
    with pytest.raises(OSError, match="No space left"):
        list(Recordings(tmp_path).ideal(SHORT, [truth_of("A")]))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("rpm", [12.0, 600.0, 3000.0])
def test_recordings_are_as_many_revolutions_whatever_the_speed(rpm: float) -> None:
    machine = MACHINE.model_copy(update={"drive": RotationDrive(joint="O", speed=rpm * math.pi / 30.0)})
    for name, revolutions in {"matched": 40.0, "hard": 40.0, "drop-out-short": 15.0, "drop-out-long": 50.0}.items():
        truth = draw_truth(machine, Hypothesis.of(("A",)), PROTOCOLS[name], 3, 0)
        assert truth.seconds * truth.parameters["drive.speed"] / (2.0 * math.pi) == pytest.approx(revolutions)


def test_protocols_by_name_and_by_group(small_catalogue: Catalogue) -> None:
    assert [each.name for each in protocols_of(["hard", "model-error", "hard"])] == ["hard", *GROUPS["model-error"]]
    assert len(GROUPS["model-error"]) == 7
    assert all(PROTOCOLS[name].foreign for name in GROUPS["other-cause"])
    assert {name: len(GROUPS[name]) for name in ("disturbed", "sensor-flaws", "drop-outs")} == {
        **{"disturbed": 5, "sensor-flaws": 3, "drop-outs": 2}
    }
    assert all(len(each.hypotheses(small_catalogue)) == 4 for each in protocols_of(["disturbed", "sensor-flaws"]))
    labels = [each.label for each in PROTOCOLS["pairs"].hypotheses(small_catalogue)]
    assert labels == ["A+B", "A+O", "B+O"]
    assert [each.label for each in PROTOCOLS["triples"].hypotheses(small_catalogue)] == ["A+B+O"]
    assert [each.label for each in PROTOCOLS["healthy"].hypotheses(small_catalogue)] == ["healthy"]
    assert [each.label for each in PROTOCOLS["hard"].hypotheses(small_catalogue)] == ["healthy", "A", "B", "O"]


def test_small_wear_is_of_any_set_of_joints_in_an_order_of_the_seed(small_catalogue: Catalogue) -> None:
    small = PROTOCOLS["small"]
    labels = [each.label for each in small.hypotheses(small_catalogue, seed=1)]
    assert sorted(labels) == ["A", "A+B", "A+B+O", "A+O", "B", "B+O", "O"]
    assert labels == [each.label for each in small.hypotheses(small_catalogue, seed=1)]
    assert labels != [each.label for each in small.hypotheses(small_catalogue, seed=2)]
    (row,) = evaluate(small_catalogue, [replace(small, revolutions=10.0)], 2, seed=3).rows  # fewer than sets
    assert row.figures.count + row.refused == 2
    assert set(row.figures.labels) <= {each.label for each in small.hypotheses(small_catalogue, seed=3)[:2]}


@pytest.mark.long
def test_wear_beyond_the_range_is_larger_than_what_the_catalogue_tells(small_catalogue: Catalogue) -> None:
    beyond = replace(PROTOCOLS["beyond-range"], revolutions=10.0)
    resolved = beyond.of(small_catalogue)
    assert resolved.clearance == pytest.approx((1.05 * 0.8e-3, 1.5 * 0.8e-3))
    assert SHORT.of(small_catalogue) is SHORT
    (row,) = evaluate(small_catalogue, [beyond], 8, seed=3).rows
    assert row.protocol == resolved
    assert row.figures.at_least is not None
    assert row.figures.at_least > 0.5
    (plain,) = evaluate(small_catalogue, [SHORT], 4, seed=3).rows
    assert plain.figures.at_least is None


@pytest.mark.long
def test_a_sweep_takes_the_first_draws_of_each_hypothesis(small_catalogue: Catalogue) -> None:
    found = trade_off(small_catalogue, [6, 1000], ["draft"], SHORT, 8, seed=3)
    assert [(point.accuracy, point.draws, point.entries) for point in found.points] == [
        ("draft", 6, 24),
        ("draft", 96, 352),
    ]
    few, many = found.points
    assert 0.0 < few.build_seconds < many.build_seconds
    assert few.figures.log_loss is not None
    assert many.figures.log_loss is not None
    assert many.figures.log_loss < few.figures.log_loss
    assert json.loads(json.dumps(found.content()))["points"][0]["draws"] == 6


@pytest.mark.long
def test_a_sweep_builds_other_accuracies_in_the_same_way_and_says_what_building_took(
    small_catalogue: Catalogue, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two pretended builds, of which each chunk took as many seconds as it has cases."""
    asked: list[str] = []

    def built(machine: Machine, plan: Plan, place: Path, **options: Any) -> None:
        asked.append(plan.accuracy)
        shutil.copytree(small_catalogue.path, place)

    monkeypatch.setattr(sweep, "build", built)
    rows = [ChunkRow(label, label, 4, ChunkStatus.DONE, seconds=4.0) for label in small_catalogue.hypotheses]
    monkeypatch.setattr(Index, "chunks", lambda _: rows)
    found = trade_off(small_catalogue, [6], ["draft", "standard"], SHORT, 8, seed=3, folder=tmp_path)
    assert asked == ["standard"]
    assert [point.build_seconds for point in found.points] == [24.0, 24.0]
    monkeypatch.setattr(Index, "chunks", lambda _: [])
    with pytest.raises(DiagnosisError, match="its index does not know what building it took"):
        trade_off(small_catalogue, [6], ["draft"], SHORT, 8, seed=3)


def test_refuses_what_it_cannot_do(small_catalogue: Catalogue) -> None:
    with pytest.raises(DiagnosisError, match="protocol: easy: must be one of matched, noisy, hard"):
        evaluate(small_catalogue, ["easy"])
    with pytest.raises(DiagnosisError, match="count: 3: must be at least 4, one a hypothesis of protocol matched"):
        evaluate(small_catalogue, ["matched"], 3)
    with pytest.raises(DiagnosisError, match="protocol mine: difference colour: must be one of law"):
        evaluate(small_catalogue, [EvaluationProtocol("mine", differences=("colour",))])
    with pytest.raises(DiagnosisError, match="protocol mine: spoiling rust: must be one of shocks"):
        evaluate(small_catalogue, [EvaluationProtocol("mine", spoiling="rust")])
    with pytest.raises(DiagnosisError, match="method: best: must be one of gaussian"):
        setups_of(["best"], ["standard"], ["auto"])
    with pytest.raises(DiagnosisError, match="protocol: model-error: stands for 7 protocols, must be one"):
        trade_off(small_catalogue, [4], ["draft"], "model-error")
    with pytest.raises(DiagnosisError, match="draws: 2: must be at least 3"):
        trade_off(small_catalogue, [2], ["draft"], SHORT)
    assert setups_of(["nearest"], ["fast", "thorough"], ["auto"]) == (Setup("nearest"),)
