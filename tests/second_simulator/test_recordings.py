"""Recordings: repeatable, converged in their step, like those of a third simulator, and what their protocols say."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from recordings import TRUTH, unpacked

from second_simulator import recording
from second_simulator.individual import Individual, drawn_individual
from second_simulator.lives import LAWS, VISITS, drawn_life
from second_simulator.machine import Array, Contact, Sensor
from second_simulator.machine_file import read
from second_simulator.orders import order_levels
from second_simulator.protocols import GROWN, PROTOCOLS, individual_before, individual_of
from second_simulator.sensors import FINE_RATE, RATE, Chain, decimated, logged, point_accelerations
from second_simulator.simulation import run

MACHINES = ("slider-crank", "four-bar", "quick-return")


def of(machine: str, protocol: str, number: int = 1, seed: int = 1) -> Individual:
    """The individual machine of a recording."""
    return individual_of(
        read(machine), protocol, number, lambda *parts: recording.stream(seed, machine, protocol, *parts)
    )


def frame_levels(individual: Individual, steps: int) -> Array:
    made = run(individual, recording.stream("levels"), steps)
    accelerations = np.diff(made.motion[:, 3:], axis=0) * FINE_RATE
    return order_levels(accelerations, FINE_RATE, individual.speed / (2 * math.pi))


@pytest.mark.long
def test_levels_do_not_change_with_half_the_step() -> None:
    individual = replace(of("slider-crank", "sound"), revolutions=15.0)
    individual.wear({"B": 3e-4})
    assert np.abs(frame_levels(individual, 20) - frame_levels(individual, 10)).mean() < 0.1


@pytest.mark.long
@pytest.mark.parametrize("name", ["slider-crank-02", "four-bar-04"])
def test_recordings_are_like_those_of_a_third_simulator(name: str) -> None:
    # Its joints that are not worn are ideal: very stiff contacts with hardly any play stand for them.
    truth = TRUTH[name]
    filed = read(truth["machine"])
    law = truth["contact"]
    worn = Contact("hertz", law["stiffness"], restitution=law["damping_or_restitution"], friction=law["friction"])
    ideal = Contact("linear", 5e8, 6e3, friction=0.0)
    machine = replace(filed, contacts={pin: worn if pin in truth["worn_um"] else ideal for pin in filed.pins})
    names, speed = [sensor.name for sensor in filed.sensors], truth["speed_rpm"] * math.pi / 30
    individual = Individual(
        filed=filed,
        machine=machine,
        clearances={pin: 1e-6 * truth["worn_um"].get(pin, 1.0) for pin in filed.pins},
        speed=speed,
        wander=np.zeros((0, 3)),
        chain=Chain(dict.fromkeys(names, 1.0), 1e-4, 0.0, 0.0),
        revolutions=20.0,
    )
    columns, _ = recording.recorded(individual, recording.stream("third"), 20)
    mine = np.column_stack([columns[each] for each in names])
    theirs = np.genfromtxt(io.BytesIO(unpacked(f"{name}.csv")), delimiter=",", skip_header=1)[:, 1:] / truth["gain"]
    turns = speed / (2 * math.pi)
    away = order_levels(mine, RATE, turns) - order_levels(theirs, RATE, turns)
    assert np.median(np.abs(away)) < 0.7
    assert np.quantile(np.abs(away), 0.9) < 2.5


@pytest.mark.long
def test_same_seed_same_recording_and_what_is_there_is_kept(tmp_path: Path) -> None:
    machine = read("slider-crank")
    for folder, seed in (("a", 1), ("b", 1), ("c", 2)):
        assert recording.write(machine, "singles", 1, seed, tmp_path / folder) == ("slider-crank-singles-01", True)
    a, b, c = (dict(np.load(tmp_path / folder / "slider-crank-singles-01.npz")) for folder in "abc")
    assert list(a) == ["units", "attributes", "time", *(sensor.name for sensor in machine.sensors)]
    assert all(np.array_equal(a[key], b[key]) for key in a)
    assert not np.array_equal(a["s1-x"][:1000], c["s1-x"][:1000])
    truth = json.loads((tmp_path / "a" / "truth.json").read_text())["slider-crank-singles-01"]
    assert len(truth["worn_um"]) == 1
    assert truth["duration_s"] == pytest.approx(40 * 60 / truth["speed_rpm"], rel=0.03)
    assert recording.write(machine, "singles", 1, 1, tmp_path / "a") == ("slider-crank-singles-01", False)


@pytest.mark.long
def test_once_more_at_another_speed(tmp_path: Path) -> None:
    """The same machine in the same state, by the same sensors; another speed, and other noise."""
    machine = read("slider-crank")
    names = [recording.write(machine, "pairs", 1, 1, tmp_path, factor=factor)[0] for factor in (1.0, 0.8)]
    assert names == ["slider-crank-pairs-01", "slider-crank-pairs-01-at-0.8"]
    first, again = (json.loads((tmp_path / "truth.json").read_text())[name] for name in names)
    assert again["of"] == names[0]
    assert "of" not in first
    assert again["speed_rpm"] == pytest.approx(0.8 * first["speed_rpm"], rel=0.05)
    for same in ("worn_um", "clearances_um", "contact", "frame_mass_factor", "gain"):
        assert again[same] == first[same]
    for other in ("noise_rms", "wander_max"):
        assert again[other] != first[other]


@pytest.mark.parametrize(
    "machine", [MACHINES[0], *(pytest.param(name, marks=pytest.mark.long) for name in MACHINES[1:])]
)
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_protocols_are_what_they_say(machine: str, protocol: str) -> None:
    counts = {"singles": 1, "pairs": 2, "triples": 3, "beyond-range": 1, "growing": 1, "disturbed-worn": 1}
    for number in range(1, 6):
        found = of(machine, protocol, number)
        sound = {name: each for name, each in found.clearances.items() if name not in found.worn}
        assert all(3e-6 <= each <= 15e-6 for each in sound.values())
        assert abs(found.speed / read(machine).drive.speed - 1) <= 0.02  # type: ignore[union-attr]
        if protocol in counts:
            assert len(found.worn) == counts[protocol]
        if protocol in ("singles", "pairs", "triples"):
            assert all(80e-6 <= each <= 800e-6 for each in found.worn.values())
        if protocol in ("sound", "disturbed-sound", "other-cause"):
            assert not found.worn
        if protocol != "lives":
            assert bool(found.causes) == (protocol in ("other-cause", "sensor-flaws"))
        assert bool(found.disturbance) == protocol.startswith("disturbed")


def test_eight_causes_come_in_eight_recordings() -> None:
    names = {of("four-bar", "other-cause", number).causes[0]["name"] for number in range(1, 9)}
    wanted = {"mount", "mounts", "unbalance", "mass", "load-constant", "load-cyclic", "mode", "ripple"}
    assert names == wanted


def test_growing_wear_is_of_one_machine() -> None:
    series = [of("four-bar", "growing", number) for number in range(1, GROWN + 1)]
    assert len({tuple(each.worn) for each in series}) == 1
    assert len({each.machine.contacts["O"].stiffness for each in series}) == 1
    sizes = [next(iter(each.worn.values())) for each in series]
    assert sizes[0] == pytest.approx(25e-6)
    assert sizes[-1] == pytest.approx(600e-6)
    assert all(low < high for low, high in pairwise(sizes))
    assert len({each.speed for each in series}) == GROWN


def lives(machine: str, numbers: range) -> list[list[Individual]]:
    """Every third visit of lives."""
    return [
        [of(machine, "lives", (life - 1) * VISITS + visit) for visit in range(1, VISITS + 1, 3)] for life in numbers
    ]


@pytest.mark.long
def test_a_life_is_of_one_machine_that_wears_and_never_heals_unless_repaired() -> None:
    worn_joints = []
    for visits in lives("slider-crank", range(1, 6)):
        notes = [each.notes["life"] for each in visits]
        assert len({each["number"] for each in notes}) == 1
        times = [each["measured_at"] for each in notes]
        assert times == sorted(times)
        assert len({each.machine.bodies["frame"].mass for each in visits}) == 1
        assert len({each.speed for each in visits}) == len(visits)
        for joint in visits[0].clearances:
            course = [each.clearances[joint] for each in visits]
            assert 3e-6 <= course[0] <= 15e-6
            falls = sum(later < earlier for earlier, later in pairwise(course))
            assert falls <= (joint in notes[0]["laws"])  # none but by the one repair
        worn_joints.append(len(notes[0]["laws"]))
    assert sorted(worn_joints) == [0, 1, 1, 2, 3]


def test_the_file_of_a_visit_says_when_it_was_made(tmp_path: Path) -> None:
    name, _ = recording.write(read("slider-crank"), "lives", 2, 1, tmp_path)
    said = json.loads(str(np.load(tmp_path / f"{name}.npz")["attributes"]))
    assert said == {"measured_at": json.loads((tmp_path / "truth.json").read_text())[name]["life"]["measured_at"]}


def test_what_else_befalls_a_machine_in_its_life() -> None:
    """A repair with what was found before it, a mount that loosens, sensors that move, files late and twice."""
    machine = read("slider-crank")
    drawn = []
    for number in range(1, 13):
        individual = drawn_individual(machine, recording.stream("individual", number))
        drawn.append(drawn_life(individual, number, recording.stream("life", number)))
    for life in drawn:
        for visit, joint in life.repairs.items():
            assert life.clearances[joint][visit - 1] > 75e-6
            assert 3e-6 <= life.clearances[joint][visit] <= 15e-6
            if visit in life.findings:
                found = life.findings[visit]
                assert found.joint == joint
                assert life.at[visit - 1] <= found.at < life.at[visit]
                assert found.measured == pytest.approx(life.clearances[joint][visit - 1], rel=0.25)
        assert set(life.arrivals) == set(range(VISITS))
        assert life.stiffness[0] == 1.0
        assert life.stiffness[-1] == pytest.approx(0.5 if life.mount >= 0 else 1.0)
    assert sum(bool(life.repairs) for life in drawn) >= 4
    assert any(life.findings for life in drawn)
    assert sum(life.mount >= 0 for life in drawn) == 4
    assert any(life.moved < VISITS for life in drawn)
    assert any(life.arrivals != sorted(life.arrivals) for life in drawn)
    assert any(len(life.arrivals) > VISITS for life in drawn)


def test_laws_of_wear_rise_from_nothing_to_all_of_it() -> None:
    age = np.linspace(0, 1, 101)
    for name, law in LAWS.items():
        part = law(age, recording.stream(name))
        assert (part[0], part[-1]) == (pytest.approx(0.0, abs=1e-12), pytest.approx(1.0, abs=1e-6))
        assert (np.diff(part) >= 0).all()


def test_model_errors_are_of_the_machine() -> None:
    """All visits have the same ones, and there are none unless they are asked for."""
    first, later = (
        individual_of(
            read("slider-crank"),
            "lives",
            number,
            lambda *parts: recording.stream(1, "slider-crank", "lives", *parts),
            model_errors=True,
        )
        for number in (1, 2)
    )
    assert first.notes["load_n"] == later.notes["load_n"]
    assert first.chain.gains == later.chain.gains
    assert len(first.ripple) == 2
    assert not of("slider-crank", "lives").ripple


@pytest.mark.parametrize("machine", ["slider-crank", pytest.param("four-bar", marks=pytest.mark.long)])
def test_joints_are_held_shut_by_the_first_load_and_not_by_the_second(machine: str) -> None:
    """Above 300 Hz, with noise of 0.1 m/s2: measured 0 to 3 dB more than a sound machine, and 8 dB and more."""

    def loudness(individual: Individual) -> float:
        made = run(replace(individual, revolutions=6.0), recording.stream("held"))
        total = 0.1**2
        fine = point_accelerations(individual.machine, made.motion, FINE_RATE)
        for signal in fine.values():
            kept = decimated(signal)[200:-200]
            power = np.abs(np.fft.rfft(kept * np.hanning(len(kept)))) ** 2 / len(kept) ** 2 / 0.1875
            total += power[np.fft.rfftfreq(len(kept), 1 / RATE) > 300].sum() / len(fine)
        return 10 * math.log10(total)

    for held in (True, False):
        individual = of(machine, "held-shut", 1 if held else 2)
        assert len(individual.worn) == 1
        sound = replace(individual, clearances={**individual.clearances, **dict.fromkeys(individual.worn, 8e-6)})
        added = loudness(individual) - loudness(sound)
        assert added < 4.0 if held else added > 6.0


def test_before_is_the_same_machine_in_order_on_another_day() -> None:
    now = of("four-bar", "other-cause", 1)
    before = individual_before(
        read("four-bar"), "other-cause", 1, lambda *parts: recording.stream(1, "four-bar", "other-cause", *parts)
    )
    assert now.causes and not before.causes and not before.worn
    assert before.clearances == now.clearances
    assert before.chain.gains == now.chain.gains
    assert before.machine.contacts == now.machine.contacts
    assert before.speed != now.speed


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_disturbances_shake_the_frame(number: int) -> None:
    found = of("quick-return", "disturbed-sound", number)
    assert found.shaking is not None
    shaking = found.shaking(found, np.arange(50_000) / FINE_RATE, recording.stream("shaking"))
    assert shaking.shape == (50_000, 3)
    assert np.isfinite(shaking).all()
    assert shaking[:, :2].std() > 0.1


def test_a_sensor_feels_where_it_sits() -> None:
    machine = replace(read("slider-crank"), sensors=(Sensor("r", (0.2, -0.1), (1.0, 0.0)),))
    t, spin = np.arange(2000) / FINE_RATE, 3.0
    motion = np.column_stack([0 * t, 0 * t, spin * t, 0 * t, 0 * t, spin + 0 * t])
    # Towards the centre, along an axis that turns with the frame.
    assert point_accelerations(machine, motion, FINE_RATE)["r"] == pytest.approx(-0.2 * spin**2, rel=1e-5)


def test_what_would_alias_is_filtered() -> None:
    t = np.arange(50_000) / FINE_RATE
    low, high = (decimated(np.sin(2 * math.pi * f * t))[200:-200] for f in (3000.0, 6000.0))
    assert low == pytest.approx(np.sin(2 * math.pi * 3000.0 * np.arange(10_000) / RATE)[200:-200], abs=1e-3)
    assert np.abs(high).max() < 1e-3


def test_flaws_and_clipping() -> None:
    draw = recording.stream("flaws")
    names = [sensor.name for sensor in read("four-bar").sensors]
    clean = {name: (1 + k) * np.sin(np.arange(20_000) * 0.1) for k, name in enumerate(names)}
    plain = Chain(dict.fromkeys(names, 1.0), 1e-3, 0.0, 0.0)
    flaws = {"s1-x": "s1-y", "s1-y": "s1-x", "s2-x": "inverted", "s2-y": "dead"}
    found = logged(clean, replace(plain, flaws=flaws), draw)
    assert found["s1-x"] == pytest.approx(clean["s1-y"], abs=0.01)
    assert found["s2-x"] == pytest.approx(-clean["s2-x"], abs=0.01)
    assert np.abs(found["s2-y"]).max() < 0.01
    clipped = logged(clean, replace(plain, clipped=0.05), draw)
    assert np.mean(np.abs(clipped["s2-y"]) >= 0.999 * np.abs(clipped["s2-y"]).max()) > 0.1


def test_individuals_differ() -> None:
    machine = read("four-bar")
    one, other = (drawn_individual(machine, recording.stream(seed)) for seed in (1, 2))
    assert one.machine.bodies["frame"].mass != other.machine.bodies["frame"].mass
    assert one.machine.bodies["frame"].mass == pytest.approx(20.0, rel=0.1)
