"""Spectra that ``jointplay simulate --quantity --scaling`` writes, of a motion whose amplitudes are known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from command_line import assert_refused, invoke

from jointplay.app.commands.simulate import command
from jointplay.solver.cases.case import Settings
from jointplay.solver.cases.history import MOTION_LINES
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.spectrum import Quantity, Scaling

QUANTITIES, SCALINGS = get_args(Quantity), get_args(Scaling)
#: A slide of 1 kg swings by 20 mm along a free bed of 19 kg: the bed by a twentieth of that.
FREQUENCY, AMPLITUDE = 12.0, 1.0e-3
RAM = """
name: ram
links:
  bed: {mass: 19, inertia: 1, cg: [0, 0], locked: [y, theta]}
  slide: {mass: 1, inertia: 0.01, cg: [0, 0]}
joints:
  G: {kind: sliding, links: [slide, bed], at: [0, 0], direction: [1, 0]}
drive: {kind: translation, joint: G, speed: 0, harmonics: [{frequency: 12, amplitude: 20 mm, phase: 90 deg}]}
sensors:
  - {name: front, at: [0.2, 0], direction: [-1, 0]}
"""
UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}


@pytest.fixture(scope="module")
def ram(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ram") / "ram.yaml"
    path.write_text(RAM)
    return path


def written(ram: Path, output: Path, *options: str) -> tuple[dict[str, Any], dict[str, str], dict[str, Any]]:
    """Arrays, units and attributes; windows of four swings are whole samples."""
    result = invoke("simulate", ram, "--duration", "2 s", "--sample-rate", "1.2 kHz", "-o", output, *options)
    assert result.exit_code == 0, result.stderr
    with np.load(output) as packed:
        arrays = dict(packed)
    return arrays, json.loads(str(arrays.pop("units"))), json.loads(str(arrays.pop("attributes")))


@pytest.mark.parametrize("scaling", SCALINGS)
def test_a_swing_has_its_amplitude_in_every_quantity_and_scaling(ram: Path, tmp_path: Path, scaling: str) -> None:
    arrays, units, attributes = written(
        ram, tmp_path / "o.npz", "--quantity", ",".join(QUANTITIES), "--scaling", scaling
    )
    line = int(np.argmin(np.abs(arrays["f"] - FREQUENCY)))
    assert arrays["f"][line] == pytest.approx(FREQUENCY)
    for power, quantity in enumerate(QUANTITIES):
        peak = AMPLITUDE * (2 * np.pi * FREQUENCY) ** power
        square = peak**2 / 2
        expected = {"psd": square / attributes["noise_bandwidth_hz"], "power": square, "rms": square**0.5, "peak": peak}
        common = (quantity, scaling) == ("acceleration", "psd")
        frame = "psd_frame" if common else f"{scaling}_{quantity}_frame"
        sensor = "psd_sensor_front" if common else f"{scaling}_{quantity}_sensor_front"
        # The filter of the acceleration leaves 1.1e-6, the motion itself rounding.
        assert arrays[frame][line] == pytest.approx([expected[scaling], 0, 0], rel=5e-6)
        assert arrays[sensor][line] == pytest.approx(expected[scaling], rel=5e-6)
        ending = {"psd": "({})^2/Hz", "power": "({})^2", "rms": "{} rms", "peak": "{} peak"}[scaling]
        assert units[frame].split(",")[0] == units[sensor] == ending.format(UNITS[quantity])


def test_densities_hold_the_mean_square_of_the_motion(ram: Path, tmp_path: Path) -> None:
    arrays, _, attributes = written(ram, tmp_path / "o.npz", "--quantity", "displacement,velocity")
    for power, quantity in enumerate(("displacement", "velocity")):
        total = arrays[f"psd_{quantity}_frame"][:, 0].sum() * attributes["psd_resolution_hz"]
        # A window's three lines of a sine: converted from the acceleration by itself they would hold 26 % too much.
        assert total == pytest.approx((AMPLITUDE * (2 * np.pi * FREQUENCY) ** power) ** 2 / 2, rel=5e-6)


def test_what_is_not_asked_for_stays_as_it_was(ram: Path, tmp_path: Path) -> None:
    plain, plain_units, plain_attributes = written(ram, tmp_path / "a.npz")
    more, units, attributes = written(ram, tmp_path / "b.npz", "--scaling", "peak")
    assert set(more) - set(plain) == {"peak_acceleration_frame", "peak_acceleration_sensor_front"}
    assert all(np.array_equal(more[name], plain[name]) for name in plain)
    assert {name: units[name] for name in plain_units} == plain_units
    assert {name: attributes[name] for name in plain_attributes} == plain_attributes


def test_low_lines_from_the_motion_meet_those_from_the_acceleration() -> None:
    """At a worn machine's orders both say the same, and no step stands where one takes over from the other."""
    machine = shipped_machine("slider-crank")
    history = simulate(machine, {"B": 2e-4}, Settings(accuracy="draft"))
    for quantity in ("displacement", "velocity"):
        whole = history.spectrum(quantity=quantity, scaling="peak")  # type: ignore[arg-type]
        other = history.spectrum(
            history.band_limited_acceleration, channels=("x", "y", "theta"), quantity=quantity, scaling="peak"
        )  # type: ignore[call-overload]
        orders = np.arange(4, MOTION_LINES + 40, 4)
        assert np.array_equal(whole.values[MOTION_LINES:], other.values[MOTION_LINES:])
        assert whole.values[orders] == pytest.approx(other.values[orders], rel=0.02)


def test_a_history_without_motion_has_no_spectrum_of_it() -> None:
    settings = Settings(duration=2.0, sample_rate=1200, motion=False)
    history = simulate(parse_machine(RAM), settings=settings)
    assert history.spectrum(scaling="rms").scaling == "rms"
    with pytest.raises(SettingsError, match="spectrum: of the velocity: this history was made without the motion"):
        history.spectrum(quantity="velocity")


def test_choices_are_those_of_the_solver() -> None:
    options = {option.name: option for option in command.params}
    assert options["scaling"].type.choices == SCALINGS  # type: ignore[attr-defined]
    assert options["quantities"].metavar == ",".join(QUANTITIES)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (("--quantity", "jerk", "-o", "o.npz"), "jerk: must be one of displacement, velocity, acceleration"),
        (("--scaling", "loud", "-o", "o.npz"), "loud"),
        (("--scaling", "rms", "-o", "o.csv"), "--quantity, --scaling: o.csv holds no spectra: take .h5 or .npz"),
        (("--quantity", "velocity", "--starts", "2", "-o", "o.npz"),
         "--quantity, --scaling: several starts give the density of the acceleration alone"),
    ],
)  # fmt: skip
def test_what_stands_nowhere_is_refused(
    ram: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(invoke("simulate", ram, *options), 2, line)


def test_plots_have_three_rows_a_quantity(ram: Path, tmp_path: Path) -> None:
    heights = []
    for name, quantities in (("a", "velocity"), ("b", "displacement,acceleration")):
        plot = tmp_path / f"{name}.svg"
        written(ram, tmp_path / "o.npz", "--quantity", quantities, "--scaling", "peak", "--plot", str(plot))
        text = plot.read_text()
        heights.append(float(text.split('height="')[1].split("pt")[0]))
        assert all(f"<!-- {UNITS[quantity]} peak -->" in text for quantity in quantities.split(","))
    assert heights[1] == 2 * heights[0]
