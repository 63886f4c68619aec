"""Run-ups and coast-downs found in simulations of whole runs, and nothing found in steady recordings."""

from __future__ import annotations

import math

import numpy as np
import pytest
from levels import levels_of
from recordings import RECORDINGS, TRUTH

from jointplay.catalogue.measurements.measurement import Channel, Recording, read_measurement
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.steadiness import Stretch, steady_stretch
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import parse_fault
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.sensor import sensor_transform

FS = 10_000.0


def whole_run(name: str, fault: str, up: float, seconds: float) -> tuple[np.ndarray, float]:
    """Frame acceleration from standstill to full speed after `up` s, and a coast-down in the last second; its speed."""
    made_of = shipped_machine(name)
    tree = made_of.model_dump(mode="json")
    speed = float(tree["drive"]["speed"])
    tree["drive"]["speed"] = [[0, 0], [up, speed], [seconds - 1.0, speed], [seconds, 0.3 * speed]]
    running = parse_machine(tree)
    history = simulate(
        running, Case(parse_fault(fault, running)), Settings(sample_rate=FS, accuracy="draft", duration=seconds)
    )
    noise = np.random.default_rng(0).normal(0.0, 0.02, history.band_limited_acceleration.shape)
    return history.band_limited_acceleration + noise, speed


@pytest.mark.parametrize(
    ("name", "fault", "up", "seconds"),
    [
        ("four-bar", "", 1.0, 4.0),
        ("four-bar", "A=0.2mm", 1.0, 4.0),
        ("slider-crank", "A=0.2mm", 0.8, 3.0),
        ("quick-return", "", 1.5, 7.0),
    ],
)
def test_run_up_and_coast_down_are_cut_off(name: str, fault: str, up: float, seconds: float) -> None:
    signal, speed = whole_run(name, fault, up, seconds)
    found = steady_stretch(signal, FS, speed)
    turn = 2 * math.pi / speed
    # To a revolution, which is as long as a window is; ringing after the run-up may go as well.
    assert up - turn < found.first / FS < up + 2.5 * turn
    assert seconds - 1.0 - 2.5 * turn < found.last / FS < seconds - 1.0 + turn
    assert len(found.findings) == 2 and all("left out" in finding for finding in found.findings)
    assert "its speed changes" in found.findings[1]


@pytest.mark.parametrize("name", sorted(TRUTH))
def test_steady_recordings_stay_whole(name: str) -> None:
    recording = read_measurement(RECORDINGS / f"{name}.csv.gz")
    nominal = shipped_machine(TRUTH[name]["machine"]).drive.speed  # type: ignore[union-attr]
    assert steady_stretch(recording.signal, recording.sample_rate, nominal) == Stretch(0, len(recording.signal))


@pytest.mark.long
def test_a_recording_that_begins_at_standstill_is_prepared_as_if_it_had_not() -> None:
    signal, speed = whole_run("four-bar", "", 1.0, 4.0)
    made_of = shipped_machine("four-bar")
    sensors = made_of.sensors
    transform = sensor_transform(
        [s.at for s in sensors], [s.direction for s in sensors], made_of.links[made_of.frame].cg
    )
    columns = tuple(Channel(s.name, "m/s2", "acceleration") for s in sensors)
    seen = signal @ transform.T
    whole = prepare(Recording("whole", FS, seen, columns, (), (), "0" * 64), made_of)
    steady = prepare(Recording("steady", FS, seen[12_000:30_000], columns, (), (), "0" * 64), made_of)
    assert any("not steady at its beginning" in warning for warning in whole.warnings)
    assert not any("not steady" in warning for warning in steady.warnings)
    # The frame still rings after the run-up, at a frequency of its own: 0.02 % of the speed.
    assert whole.drive_speed == pytest.approx(speed, rel=5e-4)
    assert steady.drive_speed == pytest.approx(speed, rel=5e-4)
    orders = slice(0, 60)
    # Measured 1.1 dB, at an order that the noise nearly covers; with the run-up left in, 25 dB.
    assert np.abs(levels_of(whole)[orders] - levels_of(steady)[orders]).max() < 2.0
    part = next(step for step in whole.steps if step.name == "steady part")
    assert "left out" in part.found and part.parameters["speed_deviation"] == 0.03


def test_standstill_is_told_by_its_level() -> None:
    recording = read_measurement(RECORDINGS / "slider-crank-04.csv.gz")
    quiet = 0.02 * np.random.default_rng(0).normal(size=(6000, 4))
    found = steady_stretch(np.concatenate([quiet, recording.signal]), FS, 20 * math.pi)
    assert 5000 < found.first < 7600 and found.last == len(recording.signal) + 6000
    assert found.findings[0].startswith("not steady at its beginning (") and "dB off" in found.findings[0]


def test_a_break_in_between_is_said_and_kept() -> None:
    recording = read_measurement(RECORDINGS / "slider-crank-04.csv.gz")
    signal = recording.signal.copy()
    signal[12_000:13_000] *= 5.0
    found = steady_stretch(signal, FS, 20 * math.pi)
    assert (found.first, found.last) == (0, len(signal))
    assert len(found.findings) == 1 and found.findings[0].startswith("not steady at 1.")


def test_what_cannot_be_judged_stays() -> None:
    noise = np.random.default_rng(0).normal(size=(3000, 2))
    assert steady_stretch(noise[:1500], 1000.0, 4 * math.pi) == Stretch(0, 1500)
    assert steady_stretch(noise, 1000.0, 2000 * math.pi) == Stretch(0, 3000)
    bursts = noise * np.where(np.arange(3000) % 500 < 250, 0.01, 20.0)[:, None]
    found = steady_stretch(bursts, 1000.0, 4 * math.pi)
    assert found == Stretch(0, 3000, ("no part of three revolutions is steady: nothing was cut off",))
