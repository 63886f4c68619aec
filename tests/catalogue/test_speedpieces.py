"""Recordings whose speed changes: what course is found, what pieces are cut, and what is left out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from recordings import RECORDINGS, TRUTH

from jointplay.catalogue.building.build import build
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.diagnosing.together import diagnose_together
from jointplay.catalogue.measurements import speedcourse
from jointplay.catalogue.measurements.measurement import Recording, read_measurement
from jointplay.catalogue.measurements.speedcourse import find_course
from jointplay.catalogue.measurements.waveform import ChannelFlaw
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.signals import speedpieces
from jointplay.catalogue.signals.speedpieces import COVERED, LEAST_REVOLUTIONS, Cut, cut_by_speed, fastest_change
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import parse_fault
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate

MACHINE = shipped_machine("slider-crank")
SPEED = 62.831853072
SPEEDS = (0.8 * SPEED, SPEED, 1.2 * SPEED)
FS = 4000.0
Course = list[tuple[float, float]]


def turned(course: Course) -> tuple[Recording, np.ndarray]:
    """Random orders at all sensors while the speed follows times [s] and factors; and the revolutions (n,)."""
    draw = np.random.default_rng(3)
    time = np.arange(0.0, course[-1][0], 1.0 / FS)
    angle = np.cumsum(SPEED * np.interp(time, *zip(*course, strict=True))) / FS
    names = [sensor.name for sensor in MACHINE.sensors]
    signal = 0.3 * draw.normal(size=(len(time), len(names)))
    for order in range(1, 25):
        phases, sizes = draw.uniform(0, 2 * np.pi, len(names)), draw.lognormal(0, 1, len(names)) / order**0.7
        signal += sizes * np.cos(order * angle[:, None] + phases)
    return Recording.from_arrays(signal, FS, names, name="r"), angle / (2 * np.pi)


def place(piece: Recording, whole: Recording) -> int:
    """First sample of a piece."""
    starts = np.flatnonzero(whole.signal[:, 0] == piece.signal[0, 0])
    return next(int(start) for start in starts if (whole.signal[start : start + 50] == piece.signal[:50]).all())


UP = [(0.0, 0.7), (20.0, 1.3)]


def test_the_course_of_a_run_up() -> None:
    recording, _ = turned(UP)
    course = find_course(recording.signal, FS, 0.7 * SPEED, 1.35 * SPEED)
    assert np.isfinite(course.speed).all()
    away = course.speed / (SPEED * np.interp(course.time, *zip(*UP, strict=True))) - 1.0
    # Speeds are tried 0.13 % apart, and windows are six revolutions long.
    assert np.abs(away).max() < 0.01
    assert np.sqrt(np.mean(away**2)) < 0.004


def test_noise_has_no_course() -> None:
    noise = np.random.default_rng(1).normal(size=(60_000, 4))
    assert not np.isfinite(find_course(noise, FS, 0.7 * SPEED, 1.35 * SPEED).speed).any()
    assert not len(find_course(noise[:100], FS, 0.7 * SPEED, 1.35 * SPEED).time)


@pytest.mark.parametrize("course", [UP, [(0.0, 1.3), (20.0, 0.7)]], ids=["up", "down"])
def test_pieces_of_a_run_up(course: Course) -> None:
    recording, revolutions = turned(course)
    cut = cut_by_speed(recording, MACHINE, SPEEDS)
    assert len(cut.pieces) == 3
    assert not cut.left_out
    assert len({recording.sha256, *(piece.sha256 for piece in cut.pieces)}) == 4
    assert cut.pieces[0].warnings[-1].startswith("its speed changes: ")
    speeds = SPEEDS if course is UP else SPEEDS[::-1]
    for piece, speed in zip(cut.pieces, speeds, strict=True):
        first = place(piece, recording)
        inside = np.gradient(revolutions[first : first + len(piece.signal)]) * FS * 2 * np.pi / speed
        assert np.abs(inside - 1.0).max() < COVERED + 0.01
        assert piece.turns is not None and len(piece.turns) - 1 >= LEAST_REVOLUTIONS
        phase = np.interp(first + piece.turns, np.arange(len(revolutions)), revolutions) - np.arange(len(piece.turns))
        # A fiftieth of a revolution is less than half a turn of order 20.
        assert np.ptp(phase) < 0.02
        rpm = 60 * (len(piece.turns) - 1) * FS / (piece.turns[-1] - piece.turns[0])
        assert piece.name.startswith(f"r, {rpm:.4g} rpm, {first / FS:.3g} to ")


def test_a_tacho_that_misses_a_pulse_cuts_nothing() -> None:
    recording, revolutions = turned([(0.0, 1.0), (20.0, 1.0)])
    turns = np.interp(np.arange(1.0, revolutions[-1]), revolutions, np.arange(len(revolutions)))
    for wrong in (np.delete(turns, 60), np.insert(turns, 60, 0.5 * (turns[59] + turns[60]))):
        told = replace(recording, turns=wrong)
        assert cut_by_speed(told, MACHINE, SPEEDS) == Cut((told,))


def test_a_tacho_says_the_same() -> None:
    recording, revolutions = turned(UP)
    turns = np.interp(np.arange(1.0, revolutions[-1]), revolutions, np.arange(len(revolutions)))
    by_orders, by_pulses = (
        cut_by_speed(each, MACHINE, SPEEDS).pieces for each in (recording, replace(recording, turns=turns))
    )
    for one, other in zip(by_orders, by_pulses, strict=True):
        assert place(one, recording) == pytest.approx(place(other, recording), abs=0.3 * FS)
        assert other.turns is not None
        assert np.isin(np.round(other.turns + place(other, recording), 6), np.round(turns, 6)).all()


@pytest.mark.parametrize("name", sorted(TRUTH))
def test_steady_recordings_stay_as_they_are(name: str) -> None:
    recording = read_measurement(RECORDINGS / f"{name}.csv.gz")
    machine = shipped_machine(TRUTH[name]["machine"])
    speed = machine.drive.speed  # type: ignore[union-attr]
    assert isinstance(speed, float)
    for speeds in ((speed,), (0.8 * speed, speed, 1.2 * speed)):
        assert cut_by_speed(recording, machine, speeds).pieces == (recording,)


@pytest.mark.parametrize(("loud", "pieces"), [(0.02, 2), (1.0, 1), (10.0, 1), (50.0, 1)])
def test_a_noise_in_what_is_steady_does_not_cut_it_and_a_standstill_does(loud: float, pieces: int) -> None:
    """Orders are not seen while something else is louder, nor while the machine stands."""
    recording, _ = turned([(0.0, 1.0), (30.0, 1.0)])
    signal = recording.signal.copy()
    there = slice(round(14.0 * FS), round(15.5 * FS))
    noise = loud * np.random.default_rng(5).normal(size=signal[there].shape)
    signal[there] = noise + (signal[there] if loud > 0.1 else 0.0)
    course = find_course(signal, FS, 0.7 * SPEED, 1.35 * SPEED)
    assert np.isfinite(course.speed).all() == (loud == 1.0)
    assert len(cut_by_speed(replace(recording, signal=signal), MACHINE, SPEEDS).pieces) == pieces


@pytest.mark.parametrize(("course", "searches"), [([(0.0, 1.0), (4.0, 1.01)], 1), (UP, 2)], ids=["steady", "up"])
def test_what_is_steady_is_looked_at_as_it_is_alone(
    course: Course, searches: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, _ = turned(course)
    looks, cut = [], []
    contrasts, piece = speedcourse._contrasts, speedpieces._piece
    monkeypatch.setattr(speedcourse, "_contrasts", lambda *told: looks.append(told[-1]) or contrasts(*told))
    monkeypatch.setattr(speedpieces, "_piece", lambda *told: cut.append(told) or piece(*told))
    found = cut_by_speed(recording, MACHINE, SPEEDS)
    assert len({len(each) for each in looks}) == searches
    assert (found.pieces == (recording,)) == (not cut) == (searches == 1)
    monkeypatch.setattr(speedcourse, "CHANGES", (0.0, -1.0e-9, *speedcourse.CHANGES[1:]))  # nothing is as even as that
    assert len(cut_by_speed(recording, MACHINE, SPEEDS).pieces) == len(found.pieces)


def test_steps_are_pieces_once_the_suspension_has_forgotten_them() -> None:
    recording, _ = turned([(0.0, 0.8), (3.0, 0.8), (3.1, 1.0), (6.0, 1.0), (6.1, 1.2), (9.0, 1.2)])
    cut = cut_by_speed(recording, MACHINE, SPEEDS)
    assert len(cut.pieces) == 3
    _, decay = fastest_change(MACHINE)
    for piece, (begin, end) in zip(
        cut.pieces, ((0.0, 3.0), (3.1 + 3 * decay, 6.0), (6.1 + 3 * decay, 9.0)), strict=True
    ):
        first = place(piece, recording) / FS
        assert first >= begin
        assert first + piece.duration <= end
        assert piece.duration > 1.5


def test_where_it_stays_counts_though_no_stored_speed_is_that_near() -> None:
    """The machine runs up, past 0.8 of its speed, and stays 4 % above it: further off than draws are."""
    recording, _ = turned([(0.0, 0.7), (10.0, 1.04), (16.0, 1.04)])
    cut = cut_by_speed(recording, MACHINE, SPEEDS)
    assert len(cut.pieces) == 2
    assert cut.pieces[1].duration > 5.0


def test_one_speed_of_a_catalogue() -> None:
    """Of a run-up the piece about it; where the machine stays about it, the recording, whose ends are cut off later."""
    recording, _ = turned(UP)
    (piece,) = cut_by_speed(recording, MACHINE, [SPEED]).pieces
    assert 1.0 < piece.duration < 3.0
    recording, _ = turned([(0.0, 0.7), (3.0, 1.0), (8.0, 1.0)])
    assert cut_by_speed(recording, MACHINE, [SPEED]).pieces == (recording,)


def test_what_is_left_out_is_said() -> None:
    recording, revolutions = turned([(0.0, 0.7), (4.0, 1.0), (8.0, 1.0), (10.0, 1.2), (14.0, 1.2)])
    turns = np.interp(np.arange(1.0, revolutions[-1]), revolutions, np.arange(len(revolutions)))
    (line,) = cut_by_speed(replace(recording, turns=turns), MACHINE, SPEEDS).left_out
    assert "about 480 rpm: left out: " in line
    assert "revolutions; at least 6 are needed of a speed that changes" in line


def test_a_speed_is_passed_many_times() -> None:
    recording, _ = turned([(0.0, 0.9), (8.0, 1.3), (16.0, 0.9), (30.0, 1.3)])
    cut = cut_by_speed(recording, MACHINE, SPEEDS[1:])
    assert len(cut.pieces) == 4
    assert sum("others about this speed are longer" in line for line in cut.left_out) == 2
    assert max(piece.duration for piece in cut.pieces) == cut.pieces[-1].duration


def test_swept_faster_than_the_suspension_follows() -> None:
    """With a tenth of its damping the frame rings while the speed passes its modes, and long after."""
    tree = MACHINE.model_dump(mode="json")
    for support in tree["supports"]:
        support["damping"] = [0.1 * each for each in support["damping"]]
    light = parse_machine(tree)
    recording, _ = turned(UP)
    cut = cut_by_speed(recording, light, SPEEDS)
    assert cut.pieces == (recording,)
    change, decay = fastest_change(MACHINE)
    # The slowest mode swings in one direction, and hardly faster without its dampers.
    assert fastest_change(light)[0] == pytest.approx(0.01 * change, rel=0.02)
    assert fastest_change(light)[1] == pytest.approx(10 * decay, rel=0.02)


def test_drop_outs_move_with_the_piece() -> None:
    recording, _ = turned(UP)
    middle = cut_by_speed(recording, MACHINE, SPEEDS).pieces[1]
    first = place(middle, recording)
    flaws = tuple(ChannelFlaw("s1-x", "dropout", at, at + 40) for at in (100, first + 500))
    found = cut_by_speed(replace(recording, flaws=flaws), MACHINE, SPEEDS).pieces[1]
    assert found.flaws == (ChannelFlaw("s1-x", "dropout", 500, 540),)


PLAN = {
    "name": "two-speeds",
    "clearance": {"low": "40 um", "high": "0.8 mm", "beyond": 1},
    "fits": {"silent": 0.25},
    "draws": {"healthy": 48, "single": 64},
    "seconds": 1.0,
    "speeds": [0.8, 1.0],
    "sample_rate": "10 kHz",
}


@pytest.fixture(scope="module")
def two_speeds(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    folder = tmp_path_factory.mktemp("two-speeds") / "slider-crank"
    build(MACHINE, parse_plan(PLAN), folder, workers=0)
    return Catalogue.open(folder)


def simulated(fault: str, course: Course) -> Recording:
    """A recording at the machine's sensors, with noise."""
    tree = MACHINE.model_dump(mode="json")
    tree["drive"]["speed"] = [[0.0, course[0][1] * SPEED], *([2.0 + at, factor * SPEED] for at, factor in course)]
    running = parse_machine(tree)
    settings = Settings(sample_rate=10_000.0, accuracy="draft", duration=2.0 + course[-1][0])
    history = simulate(running, Case(parse_fault(fault, running)), settings)
    signal = history.at_sensors(running)[20_000:]
    signal = signal + np.random.default_rng(1).normal(0.0, 0.03, signal.shape)
    return Recording.from_arrays(signal, 10_000.0, [sensor.name for sensor in running.sensors], name="press.csv")


@pytest.mark.long
def test_a_run_up_has_one_answer(two_speeds: Catalogue) -> None:
    recording = simulated("A=0.2mm", [(0.0, 0.72), (10.0, 1.08)])
    answer = diagnose(recording, two_speeds)
    assert answer.verdict == "worn"
    assert answer.hypotheses[0].label == "A"
    assert [round(share.drive_speed_rpm / 60) for share in answer.recordings] == [8, 10]
    assert all(share.measurement.startswith("press.csv, ") for share in answer.recordings)
    assert all(share.measurement.endswith(" s") and share.weight > 0.5 for share in answer.recordings)
    assert len({share.sha256 for share in answer.recordings}) == 2
    assert diagnose_together([recording, recording], two_speeds).hypotheses == answer.hypotheses
    # A speed that is given is the speed of all of it.
    assert not diagnose(recording, two_speeds, speed=SPEED).recordings


@pytest.mark.long
def test_it_is_no_worse_than_its_steady_part_alone(two_speeds: Catalogue) -> None:
    """Of what is true, over a machine in order and each worn joint; a run-up that says nothing would cost that."""
    alone, together = 0.0, 0.0
    for fault, label in (("O=8um,A=8um,B=8um", "healthy"), ("O=0.15mm", "O"), ("A=0.15mm", "A"), ("B=0.15mm", "B")):
        recording = simulated(fault, [(0.0, 0.72), (9.0, 1.0), (13.0, 1.0)])
        steady = recording.signal[90_000:]
        names = recording.channel_names
        one = diagnose(Recording.from_arrays(steady, 10_000.0, names), two_speeds)
        both = diagnose(recording, two_speeds)
        assert len(both.recordings) == 2
        alone -= math.log(next(each.probability for each in one.hypotheses if each.label == label))
        together -= math.log(next(each.probability for each in both.hypotheses if each.label == label))
    assert together < alone + 0.02
