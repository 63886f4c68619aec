"""``jointplay trade-off``: table, JSON, plot, refusals."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from jointplay.app.cli import main
from jointplay.app.commands.trade_off import document, option_of, report
from jointplay.app.figures.plots import plot_trade_off
from jointplay.solver.cases.history import Case, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, shipped_machine
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
