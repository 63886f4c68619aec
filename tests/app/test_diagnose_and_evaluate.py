"""What `diagnose` and `evaluate` print, and what they refuse."""

from __future__ import annotations

import csv
import gzip
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from command_line import assert_refused, invoke
from small_service import spoiled

from jointplay.app.cli import main
from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.evaluation import lives, study


@pytest.fixture
def recording(worn: bytes, tmp_path: Path) -> Path:
    path = tmp_path / "worn.csv"
    path.write_bytes(worn)
    return path


def test_diagnose_finds_the_worn_joint(shelf: Path, recording: Path, tmp_path: Path) -> None:
    catalogue = shelf / "slider-crank"
    result = invoke("diagnose", recording, "--catalogue", catalogue, "--plot", tmp_path / "plot.png")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.startswith("Joint B is worn: radial clearance ")
    assert "hypothesis  probability" in result.stdout
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
    document = json.loads(invoke("diagnose", recording, "--catalogue", catalogue, "--json").stdout)
    assert document["verdict"] == "worn"
    assert document["hypotheses"][0]["joints"].keys() == {"B"}
    assert document["mode"]["used"] == "trusted"
    assert "The machine is taken to be as simulated (trusted)." in result.stdout
    assert document["baseline"] is None
    itself = json.loads(
        invoke("diagnose", recording, "--catalogue", catalogue, "--baseline", recording, "--json").stdout
    )
    assert itself["baseline"] is None
    assert f"baseline {recording.name}: is what is diagnosed: left out" in itself["warnings"]
    robust = invoke("diagnose", recording, "--catalogue", catalogue, "--mode", "robust", "--effort", "thorough").stdout
    assert "The machine is taken to differ from its model (robust)." in robust
    assert "simulated anew: " in robust


def test_diagnose_takes_columns_units_and_rate(shelf: Path, recording: Path, tmp_path: Path) -> None:
    rows = recording.read_text().splitlines()[1:]
    bare = tmp_path / "bare.csv"
    bare.write_text("left,right,three,four\n" + "\n".join(row.partition(",")[2] for row in rows))
    sensors = [sensor["name"] for sensor in sensors_of("slider-crank")]
    columns = ["left", "right", "three", "four"]
    options = [f"--map={column}={sensor}" for column, sensor in zip(columns, sensors, strict=True)]
    options += [f"--unit={column}=m/s2" for column in columns]
    result = invoke(
        "diagnose", bare, "--catalogue", shelf / "slider-crank", "--sample-rate", "10 kHz", "--speed", "606.8 rpm",
        "--effort", "fast", *options,
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert result.stdout.startswith("Joint B is worn")


def test_diagnose_reads_what_simulate_writes_and_a_pipe(shelf: Path, tmp_path: Path) -> None:
    output = tmp_path / "simulated.csv"
    made = invoke(
        "simulate", "slider-crank", "--fault", "B=0.2mm", "--duration", "3 s", "--accuracy", "draft", "-o", output
    )
    assert made.exit_code == 0, made.stderr
    asked = ("--catalogue", shelf / "slider-crank", "--effort", "fast", "--json")
    from_file = invoke("diagnose", output, *asked)
    assert from_file.exit_code == 0, from_file.stderr
    answer = json.loads(from_file.stdout)
    assert answer["hypotheses"][0]["joints"].keys() == {"B"}
    assert not any("not used" in warning for warning in answer["warnings"])
    for content in (output.read_bytes(), gzip.compress(output.read_bytes())):
        piped = CliRunner().invoke(main, [str(each) for each in ("diagnose", "-", *asked)], input=content)
        assert piped.exit_code == 0, piped.stderr
        assert json.loads(piped.stdout)["hypotheses"] == answer["hypotheses"]


def test_a_recording_with_noisy_times_and_missing_rows_has_the_same_answer(
    shelf: Path, recording: Path, tmp_path: Path
) -> None:
    head, *rows = recording.read_text().splitlines()
    asked = ("--catalogue", shelf / "slider-crank", "--effort", "fast", "--json")
    wanted = json.loads(invoke("diagnose", recording, *asked).stdout)["joints"]["B"]
    draw = np.random.default_rng(1)
    noisy, missing = tmp_path / "noisy.csv", tmp_path / "missing.csv"
    times = [f"{float(row.partition(',')[0]) + draw.normal(0.0, 20e-6):.9f}" for row in rows]
    noisy.write_text("\n".join([head, *(f"{t},{row.partition(',')[2]}" for t, row in zip(times, rows, strict=True))]))
    kept = sorted(draw.choice(len(rows), len(rows) - 300, replace=False))
    missing.write_text("\n".join([head, *(rows[index] for index in kept)]))
    for file, said in ((noisy, "samples are taken as even"), (missing, "rows are missing")):
        result = invoke("diagnose", file, *asked)
        assert result.exit_code == 0, result.stderr
        answer = json.loads(result.stdout)
        assert answer["joints"]["B"]["clearance_um"] == pytest.approx(wanted["clearance_um"], rel=0.05)
        assert any(said in warning for warning in answer["warnings"])


def test_diagnose_takes_volts_and_pulses(shelf: Path, recording: Path, tmp_path: Path) -> None:
    head, *rows = recording.read_text().splitlines()
    names = [name.split()[0] for name in head.split(",")]
    lines = []
    for number, row in enumerate(rows):
        time, *values = row.split(",")
        volts = [f"{float(value) / 98.0665:.9f}" for value in values]  # 100 mV/g
        lines.append(",".join([time, *volts, str(int(number % 989 < 100))]))
    path = tmp_path / "volts.csv"
    path.write_text("\n".join([",".join([names[0], *(f"{name} [V]" for name in names[1:]), "key"]), *lines]))
    catalogue = ("--catalogue", shelf / "slider-crank", "--unit", f"{names[0]}=s", "--effort", "fast")
    assert_refused(invoke("diagnose", path, *catalogue, "--tacho", "key"), 2, "sensitivity, such as")
    told = ("--sensitivity", "*=100 mV/g", "--tacho", "key")
    result = invoke("diagnose", path, *catalogue, *told, "--json")
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["hypotheses"][0]["joints"].keys() == {"B"}
    assert document["drive_speed_rpm"] == pytest.approx(60 * 10_000 / 989, rel=1e-4)
    assert_refused(invoke("diagnose", path, *catalogue, "--pulses", "2"), 2, "'--pulses': says something of a tacho")
    assert_refused(invoke("diagnose", path, *catalogue, *told, "--pulses", "two"), 2, "'--pulses': two: ")
    (tmp_path / "volts.csv.yaml").write_text("tacho: {column: key}\n")
    beside = invoke("diagnose", path, *catalogue, *told[:2], "--json")
    assert json.loads(beside.stdout)["drive_speed_rpm"] == document["drive_speed_rpm"]


def sensors_of(name: str) -> list[dict[str, str]]:
    sensors: list[dict[str, str]] = json.loads(invoke("machines", name, "--json").stdout)["sensors"]
    return sensors


@pytest.mark.parametrize(
    ("kind", "text"),
    [("no number", "line 301"), ("infinite", "line 301"), ("short", "samples"), ("missing", "cannot be read")],
)
def test_diagnose_refuses_bad_recordings(kind: str, text: str, shelf: Path, worn: bytes, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    if kind != "missing":
        path.write_bytes(spoiled(worn, kind))
    assert_refused(invoke("diagnose", path, "--catalogue", shelf / "slider-crank"), 2, text)


def test_many_files_have_a_table_of_answers(
    shelf: Path, recording: Path, in_order: bytes, worn: bytes, tmp_path: Path
) -> None:
    (tmp_path / "new.csv").write_bytes(in_order)
    (tmp_path / "bad.csv").write_bytes(spoiled(worn, "infinite"))
    files = (recording, tmp_path / "bad.csv", tmp_path / "new.csv", tmp_path / "none.csv")
    asked = ("diagnose", *files, "--catalogue", shelf / "slider-crank", "--effort", "fast")
    moments = [f"--measured-at=2026-11-2{day}T10:00:00Z" for day in range(4)]
    result = invoke(*asked, *moments, "--out", tmp_path / "table.csv")
    assert result.exit_code == 1
    last = result.stderr.splitlines()[-1]
    assert last == f"jointplay: 2 of 4 measurements were refused; {tmp_path / 'table.csv'} says why"
    assert "worn" in result.stdout and "refused" in result.stdout
    with open(tmp_path / "table.csv", encoding="utf-8", newline="") as table:
        rows = list(csv.DictReader(table))
    assert [row["file"] for row in rows] == [str(file) for file in files]
    assert [row["verdict"] for row in rows] == ["worn", "", "in_order", ""]
    assert "line 301" in rows[1]["refusal"]
    assert "cannot be read" in rows[3]["refusal"]
    assert [row["sha256"] for row in rows] == [hashlib.sha256(each).hexdigest() for each in (
        worn, spoiled(worn, "infinite"), in_order)] + [""]  # fmt: skip
    assert rows[2]["measured_at"] == "2026-11-22T10:00:00+00:00"
    alone = json.loads(invoke("diagnose", recording, *asked[5:], "--json").stdout)
    assert float(rows[0]["drive_speed_rpm"]) == alone["drive_speed_rpm"]
    assert (rows[0]["first"], float(rows[0]["probability"])) == ("B", alone["hypotheses"][0]["probability"])
    state = alone["joints"]["B"]
    assert [float(rows[0][f"B_{name}"]) for name in ("p_worn", "clearance_um", "low_um", "high_um")] == [
        *(state["p_worn"], state["clearance_um"], *state["interval_um"])
    ]
    good = invoke(*asked[:2], *asked[3:4], *asked[5:], "--out", tmp_path / "table.json", "--json")
    assert good.exit_code == 0, good.stderr
    rows = json.loads((tmp_path / "table.json").read_text())
    assert rows == json.loads(good.stdout)
    assert rows[0]["joints"] == alone["joints"]


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (("--out", "table.xls"), "'--out': table.xls: must end in .csv or .json"),
        (("--out", "missing/table.csv"), "there is no folder missing"),
        (("again.csv", "--out", "again.csv"), "'--out': again.csv: is one of the recordings"),
        (("--out", "table.csv", "--plot", "x.png"), "--plot: is of one answer"),
        (("--out", "table.csv", "--speed", "600 rpm", "--speed", "610 rpm"), "2 for 1 measurements"),
    ],
)
def test_a_table_that_cannot_be_is_refused_before(
    more: tuple[str, ...], text: str, shelf: Path, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert_refused(invoke("diagnose", recording, "--catalogue", shelf / "slider-crank", *more), 2, text)
    assert not (tmp_path / "table.csv").exists()


@pytest.mark.long
def test_evaluate_prints_figures_and_confusion(shelf: Path, tmp_path: Path) -> None:
    arguments = [
        "evaluate",
        "--catalogue",
        shelf / "slider-crank",
        "--protocol",
        "matched",
        "--count",
        "8",
        "--seed",
        "3",
    ]
    document = json.loads(invoke(*arguments, "--json").stdout)
    assert document["count"] == 8
    (row,) = document["rows"]
    assert row["setup"] == {"method": "gaussian", "effort": "standard", "mode": "auto"}
    assert sum(map(sum, row["figures"]["confusion"])) == 8
    assert row["figures"]["top1"] >= 0.75  # three joints of a machine that is told apart nearly always
    plot = tmp_path / "reliability.svg"
    printed = invoke(*arguments, "--methods", "gaussian,nearest", "--plot", plot).stdout
    assert "8 recordings a protocol, seed 3" in printed
    assert f"matched   gaussian  standard  auto  {100 * row['figures']['top1']:.1f} %" in printed
    assert "matched   nearest   standard  auto" in printed
    assert "truth (rows) against the first hypothesis (columns)" in printed
    assert plot.stat().st_size > 1000


@pytest.mark.long
def test_evaluate_says_why_recordings_are_refused(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lengths = iter([2.41, 2.38, None, None, None, 1.02, None, None] * 2)

    def refusing(*given: Any, **more: Any) -> Any:
        short = next(lengths)
        if short is not None:
            raise MeasurementError(f"recording: {short} s are too few revolutions")
        return prepare(*given, **more)

    prepare = study.prepare
    monkeypatch.setattr(study, "prepare", refusing)
    asked = ("evaluate", "--catalogue", shelf / "slider-crank", "--protocol", "matched", "--count", "8", "--seed", "3")
    (row,) = json.loads(invoke(*asked, "--json").stdout)["rows"]
    assert (row["refused"], row["figures"]["count"]) == (3, 5)
    assert row["reasons"] == {"recording: 2.41 s are too few revolutions": 3}
    assert "  refused 3 times: recording: 2.41 s are too few revolutions" in invoke(*asked).stdout


@pytest.mark.long
def test_evaluate_prints_figures_of_lives(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lives, "VISITS", 8)
    monkeypatch.setattr(lives, "_PROTOCOL", replace(lives._PROTOCOL, revolutions=10.0))
    arguments = ["evaluate", "--catalogue", shelf / "slider-crank", "--protocol", "lives", "--count", "1"]
    printed = invoke(*arguments).stdout
    assert "slider-crank; 1 machines of 8 visits, seed 1" in printed
    document = json.loads(invoke(*arguments, "--json").stdout)
    for figure in document["figures"]:
        assert figure["name"] in printed
    assert document["figures"][0]["of"] == 8


@pytest.mark.parametrize(
    ("more", "text"),
    [
        (("--protocol", "lives,hard"), "--protocol: lives: stands by itself"),
        (("--protocol", "lives", "--modes", "robust"), "--modes: means nothing with --protocol lives"),
        (("--protocol", "lives", "--draws", "48"), "--draws: means nothing with --protocol lives"),
    ],
)
def test_lives_stand_by_themselves(more: tuple[str, ...], text: str, shelf: Path) -> None:
    assert_refused(invoke("evaluate", "--catalogue", shelf / "slider-crank", *more), 2, text)


@pytest.mark.long
def test_evaluate_names_the_p_values_that_tell_foreign_causes(shelf: Path) -> None:
    arguments = ["evaluate", "--catalogue", shelf / "slider-crank", "--protocol", "other-cause-half-mount"]
    printed = invoke(*arguments, "--count", "4", "--modes", "auto,robust").stdout.splitlines()
    (place,) = [k for k, line in enumerate(printed) if line.startswith("what the catalogue does not hold")]
    head, auto, robust, *_ = printed[place + 1 :]
    assert re.split(r"  +", head.strip())[4:] == [
        "AUROC, deciding p",
        "AUROC, trusted p",
        "rejected at 5 % false alarms",
    ]
    deciding, trusted, rejected = re.split(r"  +", auto.strip())[4:]
    # One mount at half its stiffness is foreign to the trusted model; measured: 1.000.
    assert float(trusted) > 0.8
    assert 0.0 <= float(deciding) <= 1.0
    assert rejected.endswith(" %")
    assert re.split(r"  +", robust.strip())[5] == "-"
    plain = invoke("evaluate", "--catalogue", shelf / "slider-crank", "--protocol", "matched", "--count", "4").stdout
    assert "AUROC" not in plain


@pytest.mark.long
def test_evaluate_says_what_is_told_of_joints_and_sensors_and_what_is_refused(shelf: Path) -> None:
    arguments = ["evaluate", "--catalogue", shelf / "slider-crank", "--protocol", "sensor-flaw-inverted,drop-out-long"]
    printed = invoke(*arguments, "--count", "8").stdout.splitlines()
    rows = {}
    for title in ("every joint by itself:", "what else is said:"):
        head, flawed, gaps, *_ = printed[printed.index(title) + 1 :]
        names = re.split(r"  +", head.strip())
        rows[title] = [dict(zip(names, re.split(r"  +", row.strip()), strict=True)) for row in (flawed, gaps)]
    flawed, gaps = rows["what else is said:"]
    assert float(flawed["sensors right"].removesuffix(" %")) >= 75.0  # four sensors of a frame that moves in three ways
    assert (flawed["refused"], flawed["cause right"], gaps["sensors right"]) == ("0", "-", "-")
    assert int(gaps["refused"]) > 0  # those with no numbers in place of samples
    flawed, gaps = rows["every joint by itself:"]
    assert 0.0 <= float(flawed["log-loss"]) < 5.0
    assert flawed["ranks off by (of)"].endswith("(6)")  # worn joints of 8 recordings, two of them in order
    assert flawed["coverage off by (of)"].endswith("(8)")


def test_evaluate_asks_for_machines_among_others_unless_said() -> None:
    printed = " ".join(invoke("evaluate", "--help").stdout.split())
    assert "[default: hard]" in printed
    for name in ("small", "beyond-range", "cyclic-load", "disturbed", "sensor-flaws", "drop-outs"):
        assert name in printed


@pytest.mark.long
def test_evaluate_sweeps_draws(shelf: Path, tmp_path: Path) -> None:
    plot = tmp_path / "sweep.svg"
    arguments = ["evaluate", "--catalogue", shelf / "slider-crank", "--protocol", "matched", "--count", "4"]
    printed = invoke(*arguments, "--sweep", "--draws", "4,8", "--accuracies", "draft", "--plot", plot).stdout
    assert "slider-crank, protocol matched, 4 recordings, seed 1" in printed
    assert [line.split()[:2] for line in printed.splitlines() if line.startswith("  draft")] == [
        ["draft", "4"],
        ["draft", "8"],
    ]
    assert plot.stat().st_size > 1000


def test_evaluate_refuses_what_means_nothing(shelf: Path, tmp_path: Path) -> None:
    assert_refused(invoke("evaluate", "--catalogue", tmp_path), 2, "is not a catalogue")
    catalogue = shelf / "slider-crank"
    assert_refused(invoke("evaluate", "--catalogue", catalogue, "--count", "1"), 2, "count: 1: must be at least")
    assert_refused(invoke("evaluate", "--catalogue", catalogue, "--protocol", "soft"), 2, "soft")


@pytest.mark.parametrize("option", ["--draws=25", "--accuracies=draft", "--workers=1"])
def test_evaluate_refuses_options_of_a_sweep_without_one(option: str, shelf: Path) -> None:
    result = invoke("evaluate", "--catalogue", shelf / "slider-crank", "--count", "4", option)
    assert_refused(result, 2, f"{option.split('=')[0]}: means something with --sweep only")


@pytest.mark.parametrize(
    ("protocols", "text"),
    [
        ("noisy,hard", "--protocol: noisy, hard: --sweep takes one"),
        ("model-error", "model-error: stands for 7 protocols"),
    ],
)
def test_a_sweep_refuses_several_protocols(protocols: str, text: str, shelf: Path) -> None:
    arguments = ["evaluate", "--catalogue", shelf / "slider-crank", "--count", "4", "--draws", "4"]
    assert_refused(invoke(*arguments, "--sweep", "--protocol", protocols), 2, text)


@pytest.mark.long
def test_noise_takes_the_place_of_the_protocols(shelf: Path) -> None:
    arguments = ["evaluate", "--catalogue", shelf / "slider-crank", "--count", "4", "--protocol", "hard,noisy"]
    result = invoke(*arguments, "--noise", "20 mm/s2", "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    hard, noisy = (row["protocol"] for row in found["rows"])
    assert (hard["name"], hard["sensor_noise"]) == ("hard, 0.02 m/s2", 0.0)
    assert hard["frame_noise"] == pytest.approx([0.02, 0.02, 0.1])
    assert (noisy["name"], noisy["frame_noise"], noisy["sensor_noise"]) == ("noisy, 0.02 m/s2", [0, 0, 0], 0.02)
    assert_refused(invoke(*arguments, "--noise=-1 m/s2"), 2, "noise: -1 m/s2: must be a finite number, at least 0")


def test_diagnose_refuses_cases_that_are_not_simulated(shelf: Path, recording: Path) -> None:
    result = invoke("diagnose", recording, "--catalogue", shelf / "slider-crank", "--cases", "100")
    assert_refused(result, 2, "--cases: means something with --effort thorough only")


@pytest.mark.parametrize("option", ["--map", "--unit"])
def test_diagnose_refuses_a_column_named_twice(option: str, shelf: Path, recording: Path) -> None:
    arguments = ["diagnose", recording, "--catalogue", shelf / "slider-crank", option, "a=s1-x", option, "a=s1-y"]
    assert_refused(invoke(*arguments), 2, f"'{option}': a: is given twice")


def test_diagnose_refuses_what_is_no_catalogue(recording: Path, tmp_path: Path) -> None:
    assert_refused(invoke("diagnose", recording, "--catalogue", tmp_path), 2, "is not a catalogue")
