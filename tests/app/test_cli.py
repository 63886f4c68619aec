"""What the command line prints, and how it ends."""

from __future__ import annotations

import itertools
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import numpy as np
import pytest
from command_line import JOINTPLAY, assert_refused, invoke

from jointplay.app.cli import COMMANDS
from jointplay.app.commands.progress import clock
from jointplay.catalogue.storage.hdf5 import read_arrays


def unpacked(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as packed:
        return dict(packed)


def test_help_lists_every_command() -> None:
    result = invoke("--help")
    assert result.exit_code == 0
    assert all(name in result.stdout for name in COMMANDS)


def test_help_imports_nothing_heavy() -> None:
    heavy = ("numpy", "scipy", "casadi", "numba", "matplotlib", "fastapi", "sqlalchemy", "pydantic", "h5py")
    code = f"import sys, jointplay.app.cli; print([name for name in {heavy!r} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


def test_options_of_no_command_import_numbers() -> None:
    heavy = ("numpy", "scipy", "casadi", "numba", "matplotlib", "sqlalchemy", "h5py")
    modules = ", ".join(f"jointplay.app.commands.{name.replace('-', '_')}" for name in sorted(COMMANDS))
    code = f"import sys, {modules}; print([name for name in {heavy!r} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_explains_itself(name: str) -> None:
    result = invoke(name, "--help")
    assert result.exit_code == 0
    assert "Usage:" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["nonsense"], "No such command 'nonsense'"),
        (["diagnoze"], "No such command 'diagnoze'. Did you mean 'diagnose'?"),
        (["machines", "--nonsense"], "No such option '--nonsense'"),
        (["machines", "quick-retrun"], "did you mean"),
        (["check", "nowhere.yaml"], "is neither a file nor a shipped machine"),
        (["check", "quick-return", "--fault", "Z=1mm"], "fault.Z"),
        (["check", "quick-return", "--fault", "A=1kg"], "must be a length"),
        (["check", "quick-return", "--drawing", "x.gif"], "must end in .svg, .png or .pdf"),
        (["simulate", "quick-return"], "Missing option"),
        (["simulate", "quick-return", "-o", "x.txt"], "must end in .h5, .csv or .npz"),
        (["simulate", "quick-return", "-o", "nowhere/x.h5"], "the folder nowhere does not exist"),
        (["simulate", "quick-return", "-o", "x.h5", "--speed", "3 kg"], "must be a speed of rotation"),
        (["simulate", "quick-return", "-o", "x.h5", "--speed", "600"], "600: give a unit: 600rpm or 62.8rad/s?"),
        (["trade-off", "quick-return", "--speed", "600"], "600: give a unit: 600rpm or 62.8rad/s?"),
        (["diagnose", "x.csv", "--catalogue", "c", "--speed", "600"], "600: give a unit: 600rpm or 62.8rad/s?"),
        (["simulate", "quick-return", "-o", "x.h5", "--duration", "-1"], "must be greater than 0"),
        (["simulate", "quick-return", "-o", "x.h5", "--accuracy", "best"], "best"),
        (["build", "quick-return", "--catalogue", "c", "--plan", "nonsense"], "nonsense"),
        (["diagnose", "x.csv", "--catalogue", "c", "--map", "left"], "must be COLUMN=SENSOR"),
        (["diagnose", "x.csv", "--catalogue", "c", "--speed", "0 rpm"], "must be greater than 0"),
        (["serve", "--port", "99999"], "99999"),
        (["keys", "create", "x", "--scope", "all"], "all"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(invoke(*arguments), 2, text)


def test_simulate_writes_the_same_in_every_format(tmp_path: Path) -> None:
    common = (
        "slider-crank",
        "--fault",
        "B=0.2mm",
        "--accuracy",
        "draft",
        "--sample-rate",
        "5 kHz",
        "--duration",
        "1.5 s",
    )
    for ending in ("h5", "npz", "csv"):
        result = invoke("simulate", *common, "-o", tmp_path / f"out.{ending}", "--plot", tmp_path / "plot.png")
        assert result.exit_code == 0, result.stderr
        assert result.stdout.startswith("slider-crank, B=0.2mm: O at 600 rpm\n")
    arrays, attributes = read_arrays(tmp_path / "out.h5")
    expected = {"t", "frame_displacement", "frame_velocity", "frame_acceleration", "f", "psd_frame"}
    expected |= {"orders", "order_level_frame"}
    sensors = {name for name in arrays if name.startswith("sensor_")}
    assert sensors
    assert set(arrays) == expected | sensors | {f"psd_{name}" for name in sensors}
    assert arrays["frame_acceleration"].shape == (len(arrays["t"]), 3)
    assert attributes["status"] == "ok"
    assert attributes["fault"] == "B=0.2mm"
    assert float(arrays["f"][-1]) <= 0.4 * 5000
    packed = unpacked(tmp_path / "out.npz")
    assert set(packed) == set(arrays) | {"units", "attributes"}
    assert all(np.array_equal(packed[name], arrays[name]) for name in arrays)
    assert json.loads(str(packed["units"]))["frame_velocity"] == "m/s,m/s,rad/s"
    head, *rows = (tmp_path / "out.csv").read_text().splitlines()
    assert head.startswith("t [s],frame_displacement_x [m]")
    assert len(rows) == len(arrays["t"])
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_level_by_order_is_what_the_density_holds(tmp_path: Path) -> None:
    invoke("simulate", "slider-crank", "--accuracy", "draft", "--sample-rate", "5kHz", "-o", tmp_path / "o.h5")
    arrays, attributes = read_arrays(tmp_path / "o.h5")
    base = float(attributes["drive_speed_rad_per_s"]) / (2 * np.pi)
    line = (arrays["f"] > 1.5 * base) & (arrays["f"] < 2.5 * base)
    power = arrays["psd_frame"][line].sum(axis=0) * float(attributes["psd_resolution_hz"])
    assert arrays["order_level_frame"][1] == pytest.approx(np.sqrt(power), rel=0.02)


@pytest.mark.parametrize("command", ["check", "simulate"])
def test_a_machine_that_cannot_be_assembled_is_bad_input(command: str, tmp_path: Path) -> None:
    text = invoke("machines", "quick-return").stdout
    moved = text.replace(
        "C:  {kind: turning, links: [rocker, frame], at: [0.0, -0.15]",
        "C:  {kind: turning, links: [rocker, frame], at: [0.0, 0.05]",
    )
    assert moved != text
    (tmp_path / "m.yaml").write_text(moved)
    more = ("-o", tmp_path / "o.csv", "--accuracy", "draft", "--duration", "0.1 s") if command == "simulate" else ()
    assert_refused(invoke(command, tmp_path / "m.yaml", *more), 2, "cannot be assembled at a drive angle of")


def test_a_short_simulation_says_that_it_has_no_spectra(tmp_path: Path) -> None:
    result = invoke(
        "simulate", "slider-crank", "--accuracy", "draft", "--duration", "50 ms", "-o", tmp_path / "o.h5",
        "--plot", tmp_path / "o.svg",
    )  # fmt: skip
    assert result.exit_code == 0
    assert "no levels, no spectra" in result.stdout and "rms" not in result.stdout
    arrays, attributes = read_arrays(tmp_path / "o.h5")
    assert "f" not in arrays
    assert str(attributes["spectra"]).startswith("none: ")


def test_build_and_verify(shelf: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(
        "{clearance: {low: 30 um, high: 0.8 mm}, draws: {single: 72, healthy: 36}, laws: {own: 1}, seconds: 1}"
    )
    result = invoke("build", "slider-crank", "--catalogue", shelf / "slider-crank", "--plan", plan, "--json")
    assert result.exit_code == 0, result.stderr
    report = json.loads(result.stdout)
    assert report["added"] == 0
    assert report["present"] == 36 + 3 * 12 * 6
    worn = tmp_path / "worn.yaml"
    worn.write_text(invoke("machines", "slider-crank").stdout.replace("pin: rod", "clearance: 0.2 mm, pin: rod", 1))
    again = invoke("build", worn, "--catalogue", shelf / "slider-crank", "--plan", plan, "--json")
    assert {**json.loads(again.stdout), "elapsed_s": 0} == {**report, "elapsed_s": 0}
    assert "note: A=0.2mm of the file is left aside: the plan says what is worn" in again.stderr.splitlines()
    verified = invoke("verify", "--catalogue", shelf / "slider-crank")
    assert verified.exit_code == 0
    assert "in order: 252 cases" in verified.stdout


@pytest.mark.parametrize("command", ["verify", "reindex", "regenerate", "export"])
def test_commands_refuse_what_is_no_catalogue(command: str, tmp_path: Path) -> None:
    more = ["--out", tmp_path / "x.csv"] if command == "export" else []
    assert_refused(invoke(command, "--catalogue", tmp_path, *more), 2, "is not a catalogue")


def test_time_left_is_said_as_people_read_it() -> None:
    said = [clock(seconds) for seconds in (0.2, 59, 61, 3599.4, 7505)]
    assert said == ["0 s", "59 s", "1:01 min", "59:59 min", "2:05 h"]


def test_cluster_has_its_own_workers(tmp_path: Path) -> None:
    arguments = ("quick-return", "--catalogue", tmp_path / "c", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1")
    assert_refused(invoke("build", *arguments), 2, "--workers is for processes here; a cluster has its own")


def test_no_address_of_a_scheduler_is_bad_input_and_ends(tmp_path: Path) -> None:
    """In a process of its own: a client of Dask with a bad address keeps its process from ending."""
    folder = tmp_path / "c"
    arguments = ["build", "quick-return", "--catalogue", str(folder), "--scheduler", "foo"]
    ended = subprocess.run([*JOINTPLAY, *arguments], capture_output=True, text=True, timeout=300, check=False)
    assert ended.returncode == 2
    assert ended.stderr.startswith("jointplay: foo: is no address of a scheduler, tcp://host:8786 (")
    assert ended.stderr.count("\n") == 1
    assert not folder.exists()


@pytest.mark.long
def test_scheduler_that_does_not_answer_is_not_waited_for_in_silence(tmp_path: Path) -> None:
    arguments = ("quick-return", "--catalogue", tmp_path / "c", "--plan", "quick", "--scheduler", "tcp://127.0.0.1:1")
    result = invoke("build", *arguments)
    assert result.exit_code == 1
    assert result.stderr.splitlines()[-2:] == [
        "waiting for the scheduler tcp://127.0.0.1:1, up to 10 s",
        "jointplay: tcp://127.0.0.1:1: no scheduler answers within 10 s",
    ]


@pytest.mark.long
@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_ends_with_130(tmp_path: Path) -> None:
    arguments = ["build", "quick-return", "--catalogue", str(tmp_path / "c"), "--workers", "1", "--plan", "standard"]
    with subprocess.Popen([*JOINTPLAY, *arguments], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        shown = list(itertools.takewhile(lambda line: not line.startswith("building: 0 of "), process.stderr))
        process.send_signal(signal.SIGINT)
        assert process.wait(300) == 130
        assert re.fullmatch(r"plan standard, [0-9a-f]{12}: 30528 cases \(15264 trusted, 15264 wide\)\n", shown[0])
        assert "hypotheses: healthy, 5 of a single, 10 of a pair, 10 of a triple\n" in shown
        assert process.stderr.read().splitlines()[-1] == "jointplay: interrupted"


def test_a_closed_pipe_is_no_error() -> None:
    command = f"{sys.executable} -m jointplay.app.cli machines quick-return | head -n 1"
    result = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=True)
    assert len(result.stdout.splitlines()) == 1
    assert result.stderr == ""


def test_links_and_reactions(tmp_path: Path) -> None:
    common = ["slider-crank", "--fault=B=0.2mm", "--rtol=1e-4", "--sample-rate=5 kHz", "--duration=0.2 s", "--links"]
    for ending in ("h5", "npz"):
        result = invoke("simulate", *common, "-o", tmp_path / f"out.{ending}")
        assert result.exit_code == 0, result.stderr
    arrays, attributes = read_arrays(tmp_path / "out.h5")
    packed = unpacked(tmp_path / "out.npz")
    links = [str(name) for name in arrays["links"]]
    assert links == [str(name) for name in packed["links"]]
    samples = len(arrays["t"])
    for name in ("displacement", "velocity", "acceleration"):
        assert arrays[f"link_{name}"].shape == (samples, len(links), 3)
    frame = links.index(str(attributes["frame"]))
    assert arrays["link_displacement"][:, frame] == pytest.approx(arrays["frame_displacement"], abs=1e-9)
    assert arrays["link_velocity"][:, frame] == pytest.approx(arrays["frame_velocity"], abs=1e-6)
    assert arrays["force_B_on_pin"].shape == (samples, 2)
    assert arrays["force_O"].shape == (samples, 2)
    assert arrays["normal_G1"].shape == arrays["couple_G1"].shape == arrays["drive_effort"].shape == (samples,)
    units = json.loads(str(packed["units"]))
    assert units["drive_effort"] == units["couple_G1"] == "N m"
    assert units["force_O"] == "N,N"


def test_accuracy_and_tolerance_exclude_each_other(tmp_path: Path) -> None:
    result = invoke("simulate", "slider-crank", "--accuracy=draft", "--rtol=1e-4", "-o", tmp_path / "o.h5")
    assert_refused(result, 2, "not both")


@pytest.mark.long
@pytest.mark.usefixtures("ctrl_c")
def test_serve_runs_until_ctrl_c(tmp_path: Path) -> None:
    command = [*JOINTPLAY, "serve", "--port", "0", "--data", str(tmp_path / "data"), "--catalogues", str(tmp_path)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        address = next(line for line in lines if "serving" in line).split()[-1]
        assert next(line for line in lines if "startup complete" in line)
        assert httpx.get(f"{address}/healthz", timeout=300).json() == {"status": "ok"}
        taken = subprocess.run(
            [*JOINTPLAY, "serve", "--port", address.rpartition(":")[2]], capture_output=True, text=True, cwd=tmp_path
        )
        assert taken.returncode == 1
        assert "in use" in taken.stderr.splitlines()[-1]
        process.send_signal(signal.SIGINT)
        assert process.wait(300) == 130
