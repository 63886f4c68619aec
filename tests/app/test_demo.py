"""What the demo ships: recordings that can be read, and what they were made with."""

from __future__ import annotations

from importlib import resources

import pytest

from jointplay.app.demo.__main__ import truth_sentence
from jointplay.app.shelves.built_in import content_of, read_truths
from jointplay.catalogue.measurements.measurement import read_measurement
from jointplay.solver.machines.machine import shipped_machine

NAMES = sorted(read_truths())


@pytest.mark.parametrize("name", NAMES)
def test_a_recording_fits_the_machine(name: str) -> None:
    measurement = read_measurement(content_of(name), name=f"{name}.csv.gz")
    machine = shipped_machine("quick-return")
    assert set(measurement.channel_names) == {sensor.name for sensor in machine.sensors}
    assert measurement.duration == pytest.approx(5.0)
    assert set(read_truths()[name]["worn_um"]) <= set(machine.turning_joints)


def test_every_file_is_described() -> None:
    folder = resources.files("jointplay.app.demo") / "recordings"
    files = {entry.name for entry in folder.iterdir() if entry.name.endswith(".csv.gz")}
    assert files == {f"{name}.csv.gz" for name in NAMES}
    described = (folder / "README.md").read_text(encoding="utf-8")
    assert all(f"`{name}`" in described for name in files)


def test_the_truth_in_words() -> None:
    assert truth_sentence({"worn_um": {}, "speed_rpm": 120.38}) == "no worn joint (120.38 rpm)"
    assert truth_sentence({"worn_um": {"E": 340.0}, "speed_rpm": 120.0}) == "E worn, 340 µm (120 rpm)"
