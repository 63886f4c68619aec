"""Drive speed from pulses: course and mean, and pulses that are missing."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import RECORDINGS, unpacked

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.import_profile import ImportProfile, Tacho
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.measurements.tacho import misses_pulses, pulses, track_of, turns_of
from jointplay.catalogue.plans.driving import nominal_drive_speed
from jointplay.catalogue.signals.features import prepare
from jointplay.solver.machines.machine import shipped_machine

RATE = 10_000.0


def pulsed(speed: float, count: int, each: int = 1) -> np.ndarray:
    angle = speed * np.arange(count) / RATE
    return 5.0 * (np.mod(each * angle / (2.0 * np.pi) + 0.3, 1.0) < 0.1)


def with_tacho(speed: float) -> Recording:
    lines = unpacked("slider-crank-04.csv").decode().splitlines()
    signal = pulsed(speed, len(lines) - 1)
    rows = [f"{line},{value:g}" for line, value in zip(lines[1:], signal, strict=True)]
    data = "\n".join([lines[0] + ",key [V]", *rows, ""]).encode()
    return read_measurement(data, name="r.csv", profile=ImportProfile(tacho=Tacho(column="key")))


@pytest.mark.parametrize("each", [1, 4])
def test_the_speed_of_even_pulses(each: int) -> None:
    turns = turns_of(pulsed(60.0, 30_000, each), each, None, False, "r", "key")
    track = track_of(turns, RATE, 0, 30_000, "r")
    assert track.estimate.speed == pytest.approx(60.0, rel=1e-4) and not track.estimate.given
    assert 0 < track.estimate.uncertainty < 1e-4 * 60.0 and track.estimate.wander < 2e-3


def test_noise_on_an_edge_makes_no_second_pulse() -> None:
    signal = np.tile([0.0, 0.0, 2.6, 2.4, 2.6, 5.0, 5.0, 0.0], 10)
    assert len(pulses(signal, None, False)) == 10


def test_a_missing_pulse_is_named() -> None:
    signal = pulsed(60.0, 30_000)
    signal[9_000:10_000] = 0.0
    turns = turns_of(signal, 1, None, False, "r", "key")
    # Pulses rise at 0.7 turns, and every 1047 samples: the one after 8064 is missing.
    with pytest.raises(MeasurementError, match="r: tacho: a pulse is missing or too many at sample 8064"):
        track_of(turns, RATE, 0, 30_000, "r")
    assert track_of(turns, RATE, 10_000, 30_000, "r").estimate.speed == pytest.approx(60.0, rel=1e-4)
    with pytest.raises(MeasurementError, match="at least 3 are needed"):
        turns_of(signal[:2_000], 1, None, False, "r", "key")


def test_a_revolution_unlike_those_beside_it_misses_a_pulse() -> None:
    even = np.cumsum(np.full(40, 1047.0))
    run_up = np.cumsum(4000.0 / np.arange(4.0, 40.0))
    assert not misses_pulses(even) and not misses_pulses(run_up) and not misses_pulses(even[:5])
    assert misses_pulses(np.delete(even, 20)) and misses_pulses(np.insert(even, 20, 0.5 * (even[19] + even[20])))
    assert misses_pulses(np.delete(run_up, 20))


def test_slow_turns_of_a_run_up_are_no_missing_pulses() -> None:
    time = np.arange(40_000) / RATE
    angle = 60.0 * np.where(time < 1.0, 0.5 * time**2, time - 0.5)  # a second from standstill to 60 rad/s
    signal = 5.0 * (np.mod(angle / (2.0 * np.pi) + 0.3, 1.0) < 0.1)
    turns = turns_of(signal, 1, None, False, "r", "key")
    assert np.ptp(np.diff(turns)) > np.median(np.diff(turns))
    assert track_of(turns, RATE, 10_000, 40_000, "r").estimate.speed == pytest.approx(60.0, rel=1e-4)


def test_a_recording_with_a_tacho_is_compared_at_its_speed() -> None:
    machine = shipped_machine("slider-crank")
    plain = prepare(read_measurement(RECORDINGS / "slider-crank-04.csv.gz"), machine)
    found = with_tacho(plain.drive_speed)
    assert found.channel_names == ("s1-x", "s1-y", "s2-x", "s2-y") and found.turns is not None
    assert any("tacho 'key'" in line for line in found.import_report)
    assert prepare(found, machine).drive_speed == pytest.approx(plain.drive_speed, rel=2e-4)
    # The pulses are believed, not the orders.
    assert prepare(with_tacho(1.01 * plain.drive_speed), machine).drive_speed > 1.009 * plain.drive_speed
    with pytest.raises(MeasurementError, match="is to be the tacho; columns are"):
        read_measurement(RECORDINGS / "slider-crank-04.csv.gz", profile=ImportProfile(tacho=Tacho(column="pulse")))


@pytest.mark.parametrize("factor", [0.6, 1.4])
def test_the_steady_part_is_looked_for_at_the_speed_of_the_pulses(factor: float) -> None:
    machine = shipped_machine("slider-crank")
    assert machine.drive is not None
    drive = machine.drive.model_copy(update={"speed": factor * nominal_drive_speed(machine)})
    found = with_tacho(63.05)
    as_filed, otherwise = (prepare(found, each) for each in (machine, machine.model_copy(update={"drive": drive})))
    assert as_filed.steps[1].found == otherwise.steps[1].found == "0 to 2.5 s of 2.5 s"
    assert otherwise.drive_speed == as_filed.drive_speed
    assert any("is far from the nominal" in line for line in otherwise.warnings)
