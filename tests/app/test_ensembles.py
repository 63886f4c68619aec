"""``jointplay simulate`` with several starts."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from jointplay.app.cli import main
from jointplay.catalogue.storage.hdf5 import read_arrays
from jointplay.solver.simulation import averages

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "simulation.md"
WORN = ("slider-crank", "--fault", "B=0.2mm", "--sample-rate", "5 kHz")


def invoke(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["simulate", *(str(argument) for argument in arguments)])


def test_files_hold_mean_and_spread(tmp_path: Path) -> None:
    for ending in ("h5", "npz"):
        result = invoke(*WORN, "--starts", "4", "--converged", "0.2dB", "-o", tmp_path / f"o.{ending}")
        assert result.exit_code == 0, result.stderr
        assert "simulating: " in result.stderr
    arrays, attributes = read_arrays(tmp_path / "o.h5")
    with np.load(tmp_path / "o.npz") as packed:
        assert set(packed) == set(arrays) | {"units", "attributes"}
        units = json.loads(str(packed["units"]))
    count, orders = len(arrays["f"]), len(arrays["orders"])
    assert arrays["psd_frame"].shape == arrays["psd_frame_spread_db"].shape == (count, 3)
    for name in ("order_level_frame", "order_level_frame_spread_db", "order_level_frame_error_db"):
        assert arrays[name].shape == (orders, 3)
    assert arrays["psd_sensor_s1-y"].shape == arrays["psd_sensor_s1-y_spread_db"].shape == (count,)
    assert [str(status) for status in arrays["member_status"]] == ["ok"] * 4
    assert units["psd_frame_spread_db"] == units["order_level_frame_error_db"] == "dB"
    assert units["order_level_frame"] == "m/s2 rms,m/s2 rms,rad/s2 rms"
    assert attributes["ensemble_starts"] == 4
    assert attributes["ensemble_starts_by"] == "perturbation"
    assert attributes["ensemble_converged"]
    assert attributes["fault"] == "B=0.2mm"
    # Every name is explained on the page.
    page = PAGE.read_text()
    assert all(name in page for name in arrays if "sensor" not in name)
    assert all(name.removeprefix("ensemble_") in page for name in attributes if name.startswith("ensemble_"))


def test_json_is_as_documented_and_the_plot_is_drawn(tmp_path: Path) -> None:
    result = invoke(
        *WORN, "--starts", "2", "--starts-by", "phase", "--duration", "1.2 s", "-o", tmp_path / "o.npz", "--json",
        "--plot", tmp_path / "p.png",
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    blocks = re.findall(r"```json\n(.*?)```", PAGE.read_text(), re.DOTALL)
    shape = json.loads(re.sub(r"//.*", "", next(block for block in blocks if '"ensemble"' in block)))
    assert set(found) == set(shape)
    assert set(found["ensemble"]) == set(shape["ensemble"])
    assert set(found["members"][0]) == set(shape["members"][0])
    assert found["ensemble"]["converged"] is None
    assert found["ensemble"]["revolutions"] == 12  # of 12, 2 dropped, in blocks of 4: rounded up
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


def test_an_error_that_is_not_known_is_null(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(averages, "has_settled", lambda *given: False)
    asked = (*WORN, "--starts", "2", "-o", tmp_path / "o.npz")
    result = invoke(*asked, "--json")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert found["ensemble"]["error_db"] is None
    assert "order_level_frame_error_db" not in found["datasets"]
    with np.load(tmp_path / "o.npz") as packed:
        assert "ensemble_error_db" not in json.loads(str(packed["attributes"]))
    assert "the mean is not known how well" in invoke(*asked).stdout


def test_the_report_says_how_well_the_mean_is_known(tmp_path: Path) -> None:
    result = invoke(*WORN, "--converged", "0.3dB", "--accuracy", "draft", "-o", tmp_path / "o.h5")
    assert result.exit_code == 0, result.stderr
    assert "8 of 8 members from the healthy machine's steady state" in result.stdout
    assert "converged to the 0.3 dB asked for" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["-o", "o.csv"], "take .h5 or .npz"),
        (["-o", "o.h5", "--links"], "spectra of the frame only"),
        (["-o", "o.h5", "--duration", "2 s"], "give either --duration or --converged"),
        (["-o", "o.h5", "--converged", "much"], "must be a number of dB"),
        (["-o", "o.h5", "--starts", "1"], "1"),
        (["-o", "o.h5", "--speed", "0 rpm"], "turn at a constant speed"),
        (["-o", "o.h5", "--seed=-1"], "--seed"),
        (["-o", "o.h5", "--most-revolutions", "11"], "must be a number of at least 12"),
    ],
)
def test_refusals(arguments: list[str], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = invoke("slider-crank", "--converged", "0.2dB", *arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    lines = result.stderr.splitlines()
    assert len(lines) == 1 and text in lines[0]
    assert not list(tmp_path.iterdir())
