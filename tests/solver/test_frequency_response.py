"""Frames with a measured frequency response: their sensors, their files, refusals."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frame_responses import FORCES, LINES, accelerances, harmonics, transform_of, tree_of

from jointplay.catalogue.building.chunk import Chunk, mean_difference_db, simulate_chunk
from jointplay.catalogue.errors import PlanError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import parse_plan, preset
from jointplay.catalogue.plans.plan_check import check_plan
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.machine import Machine, load_machine, parse_machine, shipped_machine
from jointplay.solver.simulation.ensemble import simulate_ensemble
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.band_power import band_matrix


def with_response(machine: Machine, frequency: Any = LINES, quantity: str = "accelerance") -> Machine:
    times = {"accelerance": 0, "mobility": 1, "receptance": 2}[quantity]
    answers = accelerances(machine, frequency) / (2j * np.pi * np.asarray(frequency)[:, None, None]) ** times
    return parse_machine(machine.model_dump() | {"response": tree_of(machine, frequency, answers, quantity)})


def write_table(path: Path, machine: Machine, unit: str = "m/s2") -> None:
    answers = accelerances(machine, LINES)
    heads, columns = ["frequency [Hz]"], [LINES]
    for i, sensor in enumerate(machine.sensors):
        for j, (force, per) in enumerate(zip(FORCES, ("N", "N", "(N m)"), strict=True)):
            heads += [f"{sensor.name} {force} {part} [{unit}/{per}]" for part in ("re", "im")]
            columns += [answers[:, i, j].real, answers[:, i, j].imag]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([heads, *np.column_stack(columns).tolist()])


@pytest.mark.parametrize("quantity", ["accelerance", "mobility", "receptance"])
@pytest.mark.parametrize("worn", [{}, {"B": 2e-4}])
def test_the_response_of_its_own_supports_is_the_decoupled_frame(quantity: str, worn: dict[str, float]) -> None:
    """Every harmonic that stands on a line, when the frame's own transient is over; measured 4e-5 of the largest."""
    machine = with_response(shipped_machine("slider-crank"), quantity=quantity)
    history = simulate(machine, worn, Settings(sample_rate=5000.0, duration=2.2))
    assert "frame decoupled" in history.message
    ours = harmonics(history.at_sensors(machine), history, 1.7)
    expected = harmonics(history.band_limited_acceleration @ transform_of(machine).T, history, 1.7)
    assert np.abs(ours - expected).max() < 1e-4 * np.abs(expected).max()
    # Four sensors see all motions: the rigid motion behind them is the frame's own.
    rigid, own = (harmonics(x, history, 1.7) for x in (history.as_rigid(machine), history.band_limited_acceleration))
    assert np.abs(rigid - own).max() < 1e-4 * np.abs(own).max()
    assert history.at_sensors(machine, instantaneous=True) == pytest.approx(history.at_sensors(machine))


def test_mass_and_supports_of_the_file_cancel() -> None:
    """Sensors answer to the wrench: other numbers, none at all, change nothing; measured 1.3e-6 of the largest."""
    machine = with_response(shipped_machine("slider-crank"))
    frame = machine.links["frame"].model_copy(update={"mass": 31.0, "inertia": 0.9})
    other = machine.model_copy(update={"links": {**machine.links, "frame": frame}, "supports": ()})
    runs = [simulate(m, {}, Settings(sample_rate=5000.0)) for m in (machine, other)]
    one, two = (harmonics(run.at_sensors(machine), run) for run in runs)
    assert np.abs(two - one).max() < 1e-5 * np.abs(one).max()


def test_one_period_is_answered_like_a_long_run() -> None:
    machine = with_response(shipped_machine("slider-crank"))
    long = simulate(machine, {"A": 1e-4}, Settings(sample_rate=5000.0))
    one = simulate(machine, {"A": 1e-4}, Settings(sample_rate=5000.0, motion=False, repeating=True))
    assert one.period
    rms = [np.sqrt(np.mean(run.at_sensors(machine)[run.t >= run.transient] ** 2, axis=0)) for run in (long, one)]
    assert rms[1] == pytest.approx(rms[0], rel=0.01)


def test_a_table_beside_the_file(tmp_path: Path) -> None:
    plain = shipped_machine("slider-crank")
    write_table(tmp_path / "frame.csv", plain)
    tree = plain.canonical_json()
    (tmp_path / "machine.json").write_text(tree[:-1] + ',"response":{"file":"frame.csv"}}')
    found, inline = load_machine(tmp_path / "machine.json"), with_response(plain)
    assert found.decoupled and found.content_key == inline.content_key != plain.content_key
    assert parse_machine(found.canonical_json()).content_key == found.content_key


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("frequency [Hz]", "f [Hz]"), "line 1: f [Hz]: must be frequency [Hz]"),
        (lambda text: text.replace("s1-x fx re [m/s2/N]", "s1-x fx [m/s2/N]"), "must be like s1-x fx re"),
        (lambda text: text.replace("s1-x fx re [m/s2/N]", "s1-x fx re [g/N]"), "must be like s1-x fx re"),
        (lambda text: text.replace("s1-x fx re [m/s2/N]", "s1-x fx re [m/N]"), "must be one quantity"),
        (lambda text: text.replace("s1-x fx re", "s1-x fy re"), "misses the column s1-x fx re"),
        (lambda text: text.replace("\r\n4.0,", "\r\nfour,"), "line 3, frequency [Hz]: four: must be a number"),
        (lambda text: text.replace("\r\n4.0,", "\r\n4.0,1,"), "line 3: 26 cells: must have 25, as the heads"),
        (lambda text: text.replace("\r\n4.0,", "\r\n1.0,"), "response.frequency.1: 1: must be greater"),
        (lambda text: text.replace("s2-y", "s3-y"), "response.sensors: misses s2-y, a sensor of this machine"),
        (lambda text: text[:40], "two of numbers at least"),
        (lambda text: None, "frame.csv: cannot be read: No such file"),
    ],
)
def test_tables_that_are_refused(change: Any, message: str, tmp_path: Path) -> None:
    plain = shipped_machine("slider-crank")
    path = tmp_path / "frame.csv"
    write_table(path, plain)
    text = change(path.read_text().replace("\n", "\r\n"))
    path.unlink()
    if text is not None:
        path.write_bytes(text.encode())
    (tmp_path / "m.json").write_text(plain.canonical_json()[:-1] + ',"response":{"file":"frame.csv"}}')
    with pytest.raises(MachineError) as caught:
        load_machine(tmp_path / "m.json")
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda tree: tree | {"frequency": [5.0]}, "response.frequency: [5]: must be a list of two"),
        (lambda tree: tree | {"sensors": tree["sensors"] | {"s9": tree["sensors"]["s1-x"]}}, "response.sensors.s9"),
        (lambda tree: tree | {"frequency": tree["frequency"][:-1]}, "must be as many as frequencies, 999"),
        (lambda tree: tree | {"file": "frame.csv"}, "response: give either file or the numbers"),
        (lambda tree: {"file": "frame.csv"}, "response.file: frame.csv: cannot be found from here"),
        (lambda tree: tree | {"sensors": {"s1-x": {**tree["sensors"]["s1-x"], "fx": [[1, "a"]]}}}, "fx.0"),
    ],
)
def test_responses_that_are_refused(change: Any, message: str) -> None:
    machine = shipped_machine("slider-crank")
    tree = change(tree_of(machine, LINES, accelerances(machine, LINES)))
    with pytest.raises(MachineError) as caught:
        parse_machine(machine.model_dump() | {"response": tree})
    assert message in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_asked_of_it_is_refused() -> None:
    machine = with_response(shipped_machine("slider-crank"))
    with pytest.raises(SettingsError, match=r"sample rate: 20000 Hz: .* ends at 2000 Hz; take 5000 Hz or less"):
        simulate(machine)
    late = with_response(shipped_machine("slider-crank"), LINES[5:])
    with pytest.raises(MachineError, match=r"response.frequency.0: 12 Hz: must not be above 10 Hz"):
        simulate(late, {}, Settings(sample_rate=5000.0))
    with pytest.raises(SettingsError, match="whole: slider-crank"):
        simulate(machine, {}, Settings(sample_rate=5000.0, whole=True))
    with pytest.raises(SettingsError, match="slider-crank: response: several starts"):
        simulate_ensemble(machine)
    with pytest.raises(PlanError, match=r"response.frequency: .*ends at 2000 Hz"):
        check_plan(preset("quick"), machine)
    wide = with_response(shipped_machine("slider-crank"), np.arange(5.0, 4001.0, 5.0))
    check_plan(preset("quick"), wide)
    answers = {name: wide.response.sensors[name] for name in ("s1-x", "s1-y")}  # type: ignore[union-attr]
    few = {"sensors": wide.sensors[:2], "response": wide.response.model_copy(update={"sensors": answers})}  # type: ignore[union-attr]
    with pytest.raises(PlanError, match=r"response.sensors: s1-x, s1-y: .* three sensors or more"):
        check_plan(preset("quick"), wide.model_copy(update=few))


def test_an_entry_of_a_catalogue_is_what_sensors_take_for_a_rigid_frame() -> None:
    """Its levels are those at the sensors, of a bed on softer springs than the file's; measured 0.047 dB."""
    own = shipped_machine("slider-crank")
    soft = tuple(support.model_copy(update={"stiffness": (1e5, 1.5e5)}) for support in own.supports)
    lines = np.arange(5.0, 4001.0, 5.0)
    tree = tree_of(own, lines, accelerances(own.model_copy(update={"supports": soft}), lines))
    machine = parse_machine(own.model_dump() | {"response": tree})
    plan = parse_plan({"hypotheses": ["healthy"], "sets": [["B"]], "laws": {"own": 1}, "guard": 0, "seconds": 1.0,
                       "seed": 2, "draws": {"healthy": 48, "single": 48}})  # fmt: skip
    entry = next(each for each in entries_of(plan, machine) if each.hypothesis.label == "B")
    recipe = plan.recipe(machine)
    (outcome,) = simulate_chunk(Chunk(machine.canonical_json(), recipe, (entry,)))
    assert outcome.power is not None
    variant = entry.variant.machine(machine)
    settings = Settings(sample_rate=recipe.sample_rate, revolutions=recipe.revolutions + 2, accuracy=recipe.accuracy)
    history = simulate(variant, Case(entry.fault, entry.parameters), settings)
    seen, centre = (
        band_matrix(signal[history.t >= history.transient], recipe.sample_rate, history.drive_speed, recipe.scheme)
        for signal in (history.as_rigid(variant), history.band_limited_acceleration)
    )
    assert mean_difference_db(outcome.power, seen.power) < 0.15
    assert mean_difference_db(outcome.power, centre.power) > 0.4


def test_a_motor_turns_within_the_band() -> None:
    """Its speed is known after its run alone: 555 rpm or so, so that order 1 is at 9 Hz."""
    motor = load_machine(Path(__file__).parents[1] / "data" / "machines" / "motor-four-bar.yaml")
    settings = Settings(sample_rate=4000.0, revolutions=4)
    found = simulate(with_response(motor), {}, settings)
    assert "frame decoupled" in found.message
    assert np.isfinite(found.at_sensors(with_response(motor))).all()
    with pytest.raises(MachineError, match=r"response\.frequency\.0: 50 Hz: must not be above 9\.\d+ Hz"):
        simulate(with_response(motor, np.arange(50.0, 2001.0, 2.0)), {}, settings)
