"""``jointplay trade-off``: table, JSON, plot, refusals."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from jointplay.app.cli import main
from jointplay.app.commands.trade_off import describe_choices, document, option_of, report, report_choices
from jointplay.app.figures.plots import plot_trade_off
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, shipped_machine
from jointplay.solver.simulation.choices import ModelChoice, ModelChoices
from jointplay.solver.simulation.tradeoff import TradeOff, measure

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "simulation.md"


def invoke(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["trade-off", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def machine() -> Machine:
    return shipped_machine("slider-crank")


def measured(machine: Machine, parameters: dict[str, float], *rungs: Settings) -> TradeOff:
    found = measure(machine, Case(Fault({"B": 2e-4}), parameters), rungs=rungs)
    assert isinstance(found, TradeOff)
    return found


def test_json_is_as_documented_and_the_plot_is_drawn(tmp_path: Path) -> None:
    result = invoke("slider-crank", "--speed", "1200 rpm", "--json", "--plot", tmp_path / "plot.png")
    assert result.exit_code == 0, result.stderr
    assert "settings" in result.stderr.splitlines()[0]  # progress
    found = json.loads(result.stdout)
    # The block of the page that shows the shape, its comments taken off.
    block = re.search(r"```json\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert block is not None
    shape = json.loads(re.sub(r"//.*", "", block[1]))
    assert set(found) == set(shape)
    assert set(found["reference"]) == set(shape["reference"])
    assert all(set(entry) == set(shape["settings"][0]) for entry in found["settings"])
    assert found["recommended"] in found["settings"]
    assert found["drive_frequency_hz"] == pytest.approx(20)
    assert {entry["method"] for entry in found["settings"]} == {"adaptive", "gill"}
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_the_table_names_setting_error_and_recommendation(machine: Machine) -> None:
    found = measured(machine, {}, Settings(rtol=1e-6), Settings(rtol=1e-7))
    advice = found.recommend(0.5)
    assert advice.point is not None
    text = report(machine, found, advice, 0.5)
    assert re.search(r"adaptive, rtol 1e-06 +standard +0\.00012 s ", text)
    assert f"recommended for 0.5 dB: {option_of(advice.point)}; the cheapest" in text
    assert found.computer in text
    assert "no recommendation for 1e-09 dB: the reference itself" in report(machine, found, found.recommend(1e-9), 1e-9)


def test_chaos_is_shown(machine: Machine, tmp_path: Path) -> None:
    found = measured(machine, {"contact.friction": 0.0, "contact.damping": 30.0}, Settings(rtol=1e-6))
    advice = found.recommend(0.1)
    text = report(machine, found, advice, 0.1)
    assert "chaotic: a perturbation grows by" in text
    assert "more does not pay" in text
    shown = document(machine, found, advice, 0.1, None)
    assert shown["measure"] == "one-order bands"
    assert shown["spread_db"] == found.spread_db
    plot_trade_off(machine, found, 0.1, tmp_path / "plot.svg")
    assert "spread of single runs" in (tmp_path / "plot.svg").read_text()


def test_choices_of_the_model_stand_beside_the_tolerances(machine: Machine, tmp_path: Path) -> None:
    choices = ModelChoices(
        0.004, 1e-6, False,
        (
            ModelChoice("friction", "{friction: 0}", Status.OK, 0.002, 5.9),
            ModelChoice("sampling", "--sample-rate 40000Hz", Status.OK, 0.006, 1e-7),
            ModelChoice("contact", "{law: hertz}", Status.STEP_TOO_SMALL, math.nan, math.nan),
        ),
    )  # fmt: skip
    text = report_choices(choices)
    assert re.search(r"\{friction: 0\} +0\.50 +5\.9 dB", text)
    assert re.search(r"--sample-rate 40000Hz +1\.50 +< 1e-06 dB", text)
    assert re.search(r"\{law: hertz\} +- +step_too_small", text)
    found: Any = describe_choices(choices)["choices"]
    assert found["choices"][2]["difference_db"] is None
    block = re.search(r"```json\n(\{\"choices\".*?)```", PAGE.read_text(), re.DOTALL)
    assert block is not None
    shape = json.loads(re.sub(r"//.*", "", block[1]))["choices"]
    assert set(found) == set(shape)
    assert set(found["choices"][0]) == set(shape["choices"][0])
    plot_trade_off(machine, measured(machine, {}, Settings(rtol=1e-6)), 0.1, tmp_path / "plot.svg", choices)
    drawn = (tmp_path / "plot.svg").read_text()
    assert "{friction: 0}" in drawn
    assert "40000Hz" not in drawn


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["slider-crank", "--error", "0 dB"], "greater than 0"),
        (["slider-crank", "--error", "1 mm"], "must be a number of dB"),
        (["slider-crank", "--plot", "x.gif"], "must end in .png, .svg or .pdf"),
        (["slider-crank", "--fault", "Z=1mm"], "fault.Z"),
        (["slider-crank", "--speed", "0 rpm"], "turn at a constant speed"),
    ],
)
def test_refusals(arguments: list[str], text: str) -> None:
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert text in result.stderr.splitlines()[-1]
