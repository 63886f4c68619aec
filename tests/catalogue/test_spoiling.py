"""What spoils recordings: that it is as it says, and that simulations do not depend on it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from jointplay.catalogue.errors import DiagnosisError, MeasurementError
from jointplay.catalogue.evaluation.protocols import GROUPS, PROTOCOLS, EvaluationProtocol, draw_truth
from jointplay.catalogue.evaluation.recordings import Recordings, recorded
from jointplay.catalogue.evaluation.spoiling import SPOILINGS, Clipped, DropOut, FlawedSensors, with_spoiling
from jointplay.catalogue.evaluation.truth import Blows, Bursts, Tones, Truth, transform_of
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.suspension import accelerance
from jointplay.solver.machines.machine import shipped_machine

FloatArray = NDArray[np.float64]

MACHINE = shipped_machine("four-bar")
NAMES = tuple(sensor.name for sensor in MACHINE.sensors)
SILENT = EvaluationProtocol("silent", frame_noise=(0.0, 0.0, 0.0), revolutions=15.0)
RATE = SILENT.sample_rate
TIME = np.arange(30_000) / RATE
WRENCH = (0.6, 0.8, 0.1)


def truth_of(name: str = "", number: int = 0) -> Truth:
    return with_spoiling(draw_truth(MACHINE, Hypothesis.of("A"), SILENT, 3, number), name, 3, number)


@cache
def ideal() -> FloatArray:
    ((_, signal),) = Recordings().ideal(SILENT, [truth_of()])
    assert signal is not None
    return signal


def signal_of(sensors: int = len(NAMES)) -> FloatArray:
    return np.random.default_rng(1).normal(size=(len(TIME), sensors))


def spectrum_of(signal: FloatArray) -> tuple[FloatArray, FloatArray]:
    amplitude = 2.0 * np.abs(np.fft.rfft(signal * np.hanning(len(signal))[:, None], axis=0)).max(axis=1) / len(signal)
    return np.fft.rfftfreq(len(signal), 1.0 / RATE), amplitude


@pytest.mark.parametrize("name", [*GROUPS["disturbed"], *GROUPS["sensor-flaws"], *GROUPS["drop-outs"]])
def test_what_spoils_a_recording_leaves_its_simulation_alone(name: str) -> None:
    spoiling = PROTOCOLS[name].spoiling
    plain, spoilt = truth_of(), truth_of(spoiling)
    assert spoilt == truth_of(spoiling)
    assert spoilt != truth_of(spoiling, number=1)
    assert (spoilt.disturbance is None) != (spoilt.flaw is None)
    assert replace(spoilt, disturbance=None, flaw=None) == plain
    assert Recordings().key(SILENT, spoilt) == Recordings().key(SILENT, plain)


def test_protocols_of_what_spoils_recordings_share_their_simulations(tmp_path: Path) -> None:
    kept = Recordings(tmp_path)
    for name in (*GROUPS["disturbed"], *GROUPS["sensor-flaws"]):
        protocol = replace(PROTOCOLS[name], revolutions=5.0)
        truth = with_spoiling(draw_truth(MACHINE, Hypothesis.of("A"), protocol, 3, 0), protocol.spoiling, 3, 0)
        assert len(list(kept.ideal(protocol, [truth]))) == 1
    assert len(list(tmp_path.glob("*.npy"))) == 1


@pytest.mark.parametrize("name", [name for name in SPOILINGS if not name.endswith("gap")])
def test_every_disturbance_changes_the_recording_of_a_machine(name: str) -> None:
    plain, spoilt = (recorded(SILENT, truth_of(each), ideal()).signal for each in ("", name))
    assert spoilt.shape == plain.shape
    assert np.isfinite(spoilt).all()
    assert np.abs(spoilt - plain).max() > 0.1 * plain.std()


def test_tones_have_their_frequencies_and_are_as_loud_as_they_say() -> None:
    tones = Tones((40.0, 80.0, 333.0), (1.0, 0.5, 0.25), (0.0, 1.0, 2.0), WRENCH, 0.5)
    signal = signal_of()
    sensed = tones.of(MACHINE, RATE, signal)
    assert sensed.std() == pytest.approx(0.5 * signal.std(), rel=0.01)
    frequency, amplitude = spectrum_of(sensed)
    loud = frequency[amplitude > 0.01 * amplitude.max()]
    assert {round(each) for each in loud} <= {39, 40, 41, 79, 80, 81, 332, 333, 334}
    # From one tone to another the force and what the frame makes of it change.
    moved = accelerance(MACHINE, {}, np.array([40.0, 80.0])) @ np.array(WRENCH)
    seen = np.abs(transform_of(MACHINE) @ (moved * [[1.0], [0.5]]).T)
    by_tone = [np.abs(np.exp(-2j * math.pi * f * TIME) @ sensed) for f in (40.0, 80.0)]
    assert by_tone[1] / by_tone[0] == pytest.approx(seen[:, 1] / seen[:, 0], rel=0.02)


def test_a_neighbour_has_five_harmonics_of_another_speed() -> None:
    for number in range(20):
        truth = truth_of("neighbour", number)
        assert isinstance(truth.disturbance, Tones)
        orders = np.array(truth.disturbance.frequencies) * 2.0 * math.pi / truth.parameters["drive.speed"]
        assert orders == pytest.approx(orders[0] * np.arange(1, 6))
        assert 0.55 <= orders[0] <= 1.8
        assert abs(orders[0] - 1.0) >= 0.05


def test_a_gear_has_its_teeth_their_double_and_sidebands() -> None:
    for number in range(20):
        truth = truth_of("gear-mesh", number)
        assert isinstance(truth.disturbance, Tones)
        orders = np.array(truth.disturbance.frequencies) * 2.0 * math.pi / truth.parameters["drive.speed"]
        teeth = orders[0]
        assert teeth == pytest.approx(round(teeth))
        assert 17 <= round(teeth) <= 41
        assert orders[1:] - [2 * teeth, teeth, teeth, 2 * teeth, 2 * teeth] == pytest.approx([0, -1, 1, -1, 1])


def test_blows_are_short_and_ring_as_the_frame_on_its_mounts_does() -> None:
    blows = Blows((0.25, 0.75), (1.0, 0.5), 0.004, WRENCH, 10.0)
    signal = signal_of()
    sensed = blows.of(MACHINE, RATE, signal)
    assert np.abs(sensed).max() == pytest.approx(10.0 * signal.std(), rel=0.01)
    before = sensed[: round(0.25 * len(TIME)) - 5]
    assert np.abs(before).max() < 1e-3 * np.abs(sensed).max()  # nothing comes round from the end
    start = round(0.25 * len(TIME))
    first, second = (np.abs(sensed[at : at + 100]).max() for at in (start, round(0.75 * len(TIME))))
    assert second / first == pytest.approx(0.5, rel=0.05)
    frequency, amplitude = spectrum_of(sensed[start + 50 : start + 5050])
    assert 10.0 < frequency[amplitude.argmax()] < 60.0


def test_bursts_ring_at_their_frequency_and_come_again_in_time() -> None:
    bursts = Bursts(0.0311, 0.01, 2000.0, 0.03, WRENCH, 0.7)
    signal = signal_of()
    sensed = bursts.of(MACHINE, RATE, signal)
    assert sensed.std() == pytest.approx(0.7 * signal.std(), rel=0.01)
    frequency, amplitude = spectrum_of(sensed)
    assert frequency[amplitude.argmax()] == pytest.approx(2000.0, rel=0.05)
    loud = np.flatnonzero(np.abs(sensed[:, 0]) > 0.5 * np.abs(sensed[:, 0]).max()) / RATE
    starts = loud[np.r_[True, np.diff(loud) > 0.01]]
    assert np.diff(starts) == pytest.approx(np.full(len(starts) - 1, 0.0311), abs=4e-4)
    for number in range(20):
        truth = truth_of("bursts", number)
        assert isinstance(truth.disturbance, Bursts)
        order = 2.0 * math.pi / (truth.disturbance.every * truth.parameters["drive.speed"])
        assert 2.2 <= order <= 7.8
        assert abs(order - round(order)) >= 0.19
        assert 1200.0 <= truth.disturbance.frequency <= 3500.0


def test_a_frame_that_stands_on_more_than_mounts_is_moved_as_if_it_floated() -> None:
    spring = {"kind": "spring", "link": "frame", "at": (0.0, 0.1), "anchor": (0.0, 0.5), "stiffness": 1e5}
    other = type(MACHINE).model_validate(
        {**MACHINE.model_dump(exclude_none=True), "supports": [*MACHINE.model_dump()["supports"], spring]}
    )
    tones = Tones((40.0, 80.0), (1.0, 1.0), (0.0, 0.0), (1.0, 0.0, 0.0), 1.0)
    sensed = tones.of(other, RATE, signal_of())
    at = [np.abs(np.exp(-2j * math.pi * f * TIME) @ sensed[:, 0]) for f in (40.0, 80.0)]
    assert at[0] == pytest.approx(at[1], rel=0.01)  # the same force, the same acceleration


def test_clipped_recordings_are_seen_to_be_clipped() -> None:
    for number in range(10):
        truth = truth_of("clipping", number)
        assert isinstance(truth.flaw, Clipped)
        assert 0.001 <= truth.flaw.share <= 0.02
        measured = recorded(SILENT, truth, ideal())
        full = np.abs(measured.signal).max()
        assert np.mean(np.abs(ideal()) >= full) == pytest.approx(truth.flaw.share, rel=0.05)
    assert any(flaw.kind == "clipped" for flaw in measured.flaws)


def test_flawed_sensors_are_those_that_are_named() -> None:
    signal = signal_of()
    swapped = FlawedSensors(("s1-x", "s2-y"), "swapped").of(NAMES, RATE, signal)
    assert np.array_equal(swapped, signal[:, [3, 1, 2, 0]])
    inverted = FlawedSensors(("s1-y",), "inverted").of(NAMES, RATE, signal)
    assert np.array_equal(inverted, signal * [1.0, -1.0, 1.0, 1.0])
    dead = FlawedSensors(("s2-x",), "dead").of(NAMES, RATE, signal)
    assert dead[:, 2].std() == pytest.approx(0.01 * signal.std(), rel=0.05)
    assert np.array_equal(np.delete(dead, 2, axis=1), np.delete(signal, 2, axis=1))
    for name, count in (("swapped", 2), ("inverted", 1), ("dead", 1)):
        flaw = truth_of(name).flaw
        assert flaw is not None
        assert len(set(flaw.sensors)) == count
        found = prepare(recorded(SILENT, truth_of(name), ideal()), MACHINE).flaws
        assert set(flaw.sensors) <= {sensor for each in found for sensor in each.sensors}


def test_a_single_sensor_cannot_be_swapped() -> None:
    alone = MACHINE.model_copy(update={"sensors": MACHINE.sensors[:1]})
    with pytest.raises(DiagnosisError, match="1 sensors: must be at least 2"):
        with_spoiling(replace(truth_of(), machine=alone), "swapped", 1, 0)


@pytest.mark.parametrize("filled", ["held", "zero"])
def test_samples_that_are_missing_are_seen_to_be(filled: str) -> None:
    gap = DropOut(0.4, 0.025, filled)  # type: ignore[arg-type]
    measured = recorded(SILENT, replace(truth_of(), flaw=gap), ideal())
    first = round(0.4 * len(ideal()))
    inside = measured.signal[first : first + 250]
    assert np.array_equal(inside, np.tile(ideal()[first - 1] if filled == "held" else np.zeros(4), (250, 1)))
    assert np.array_equal(np.delete(measured.signal, range(first, first + 250), 0)[:first], ideal()[:first])
    assert {flaw.channel for flaw in measured.flaws if flaw.kind == "dropout"} == set(NAMES)
    (found,) = [each for each in prepare(measured, MACHINE).disturbances if each.kind == "drop-out"]
    assert found.begin == pytest.approx(first / RATE, abs=0.01)


def test_samples_that_are_no_number_are_refused_as_those_of_a_file_are() -> None:
    with pytest.raises(MeasurementError, match="is not finite"):
        recorded(SILENT, replace(truth_of(), flaw=DropOut(0.4, 0.025, "nan")), ideal())


def test_drop_outs_are_filled_in_three_ways() -> None:
    for name, seconds in (("short-gap", 0.025), ("long-gap", 0.5)):
        flaws = [truth_of(name, number).flaw for number in range(30)]
        gaps = [flaw for flaw in flaws if isinstance(flaw, DropOut)]
        assert len(gaps) == len(flaws)
        assert {gap.filled for gap in gaps} == {"held", "zero", "nan"}
        assert {gap.seconds for gap in gaps} == {seconds}
        assert all(0.1 <= gap.begin <= 0.8 for gap in gaps)
