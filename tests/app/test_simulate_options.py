"""Options of ``jointplay simulate`` that depend on the machine's drive or on the method."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from jointplay.app.cli import main
from jointplay.solver.cases.case import Settings
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.simulation.simulate import simulate

SHORT = ("--duration", "20 ms", "--sample-rate", "5 kHz")


def invoke(machine: str | Path, output: Path, *options: str) -> Result:
    return CliRunner().invoke(main, ["simulate", str(machine), "-o", str(output), *options])


@pytest.fixture
def ram(tmp_path: Path) -> Path:
    """A file of a slide that is pushed along a floor; its drive is the last line."""
    path = tmp_path / "ram.yaml"
    path.write_text(
        "name: ram\nlinks:\n  bed: {mass: 20, inertia: 1, cg: [0, 0]}\n  slide: {mass: 1, inertia: 0.01, cg: [0, 0]}\n"
        "joints:\n  G: {kind: sliding, links: [slide, bed], at: [0, 0], direction: [1, 0]}\n"
        "supports:\n  - {kind: mount, link: bed, at: [-1, 0], stiffness: [1e5, 1e5]}\n"
        "  - {kind: mount, link: bed, at: [1, 0], stiffness: [1e5, 1e5]}\n"
        "drive: {kind: translation, joint: G, speed: 0.2}\n"
    )
    return path


def redriven(ram: Path, drive: str) -> None:
    lines = ram.read_text().splitlines()[:-1]
    ram.write_text("\n".join([*lines, *([f"drive: {drive}"] if drive else []), ""]))


def refusal(result: Result) -> str:
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1
    return result.stderr


def test_a_slide_takes_a_speed_of_sliding(ram: Path, tmp_path: Path) -> None:
    output = tmp_path / "o.npz"
    for speed, value in (("100 mm/s", 0.1), ("0.1m/s", 0.1), ("-0.1 m/s", -0.1)):
        result = invoke(ram, output, *SHORT, "--json", "--links", "--speed", speed)
        assert result.exit_code == 0, result.stderr
        with np.load(output) as packed:
            rates = dict(zip(packed["links"], packed["link_velocity"][-1, :, 0], strict=True))
        assert rates["slide"] - rates["bed"] == pytest.approx(value)
    assert '--speed: 60rpm: "rpm" is a speed of rotation, must be a speed' in refusal(
        invoke(ram, output, "--speed", "60rpm")
    )
    assert "--speed: 0.1: give a unit: 0.1m/s or 100mm/s?" in refusal(invoke(ram, output, "--speed", "0.1"))


@pytest.mark.parametrize(
    ("drive", "rule"),
    [
        (
            "{kind: force, joint: G, force: 10}",
            "ram has a force drive; only a rotation,",
        ),
        ("", "ram has no drive; only a rotation, translation or position drive has a speed"),
        ("{kind: translation, joint: G, speed: [[0, 0], [1, 0.1]]}", "the drive of ram runs up by a table"),
    ],
)
@pytest.mark.parametrize("command", ["simulate", "trade-off"])
def test_a_drive_without_one_speed_takes_none(ram: Path, tmp_path: Path, drive: str, rule: str, command: str) -> None:
    redriven(ram, drive)
    output = ["-o", str(tmp_path / "o.npz")] if command == "simulate" else []
    line = refusal(CliRunner().invoke(main, [command, str(ram), *output, "--speed", "60rpm"]))
    assert f"--speed: 60rpm: {rule}" in line


@pytest.mark.parametrize("method", ["gill-variable", "full"])
def test_methods_for_cross_checks_give_what_the_usual_one_gives(method: str, tmp_path: Path) -> None:
    found = {}
    for name in ("gill", method):
        output = tmp_path / f"{name}.npz"
        result = invoke(
            "slider-crank", output, *SHORT, "--fault", "B=0.2mm", "--method", name, "--accuracy", "reference"
        )
        assert result.exit_code == 0, result.stderr
        with np.load(output) as packed:
            found[name] = packed["frame_displacement"]
            assert json.loads(str(packed["attributes"]))["method"] == name
    # Measured: 7.3e-6 of the largest displacement, 3e-13 of `full`.
    largest = np.abs(found["gill"]).max(axis=0)
    assert (np.abs(found[method] - found["gill"]).max(axis=0) / largest).max() < 3e-5


@pytest.mark.parametrize(
    ("options", "rule"),
    [
        (("--speed", "0.1 m/s"), "must be a speed of rotation"),
        (("--step", "1 us", "--method", "adaptive"), "only gill and full have a fixed step; adaptive has rtol"),
        (("--method", "gill", "--rtol", "1e-6"), "rosenbrock and gill-variable have a tolerance; gill has a step"),
        (("--method", "full", "--links"), "links: method full gives the motion of the frame"),
        (("--method", "gill-variable", "--starts", "2"), "several starts are run by adaptive, rosenbrock or gill"),
        (("--method", "euler"), "euler"),
        (("--whole", "--decoupled"), "whole: a decoupled frame does not act back"),
        (("--step", "1 mm"), "must be a time"),
        (("--step", "0 s"), "0 s: must be greater than 0"),
        (("--step", "1 us", "--accuracy", "draft"), "not both"),
    ],
)
def test_refused(options: tuple[str, ...], rule: str, tmp_path: Path) -> None:
    assert rule in refusal(invoke("slider-crank", tmp_path / "o.npz", *options))


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        (("--method", "gill"), {"method": "gill"}),
        (("--method", "gill", "--accuracy", "draft"), {"method": "gill", "accuracy": "draft"}),
        (("--step", "10 us"), {"step": 1e-5}),
        (("--method", "adaptive"), {}),
    ],
)
def test_the_method_is_the_one_asked_for(options: tuple[str, ...], settings: dict[str, Any], tmp_path: Path) -> None:
    result = invoke("slider-crank", tmp_path / "o.npz", *SHORT, "--json", *options)
    assert result.exit_code == 0, result.stderr
    asked = Settings(duration=0.02, sample_rate=5000, **settings)
    assert json.loads(result.stdout)["step_s"] == simulate(shipped_machine("slider-crank"), settings=asked).step


def test_a_decoupled_frame_is_told(tmp_path: Path) -> None:
    result = invoke("slider-crank", tmp_path / "o.npz", *SHORT, "--decoupled")
    assert result.exit_code == 0, result.stderr
    assert "note: frame decoupled: links are 0.091 of the machine's inertia" in result.stdout
