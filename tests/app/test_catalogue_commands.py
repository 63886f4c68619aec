"""Commands that check, remake and export a catalogue."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest
from command_line import assert_refused, invoke

from jointplay import solver
from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.store import Catalogue


@pytest.fixture
def folder(shelf: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "c"
    shutil.copytree(shelf / "slider-crank", copy)
    return copy


def test_reindex(folder: Path) -> None:
    shutil.rmtree(CatalogueDirectory(folder).matrices)
    result = invoke("reindex", "--catalogue", folder)
    assert result.exit_code == 0
    assert f"{folder}: index and matrix made again: " in result.stdout
    assert CatalogueDirectory(folder).matrices.is_dir()
    shown = json.loads(invoke("reindex", "--catalogue", folder, "--json").stdout)
    assert (shown["sound"], shown["lost_entries"], shown["findings"]) == (True, 0, [])


def test_other_numbers_are_one_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = invoke("verify", "--catalogue", folder).stdout.splitlines()
    assert json.loads(invoke("verify", "--catalogue", folder, "--json").stdout)["other_numbers"] is None
    held = solver.NUMBERS_VERSION
    monkeypatch.setattr(solver, "NUMBERS_VERSION", 99)
    rule = f"{folder}: holds numbers of version {held}, this program computes version 99"
    told = invoke("verify", "--catalogue", folder)
    assert told.exit_code == 0
    assert told.stdout.splitlines() == [*plain, f"{rule}: diagnoses go on with it, builds do not"]
    shown = json.loads(invoke("verify", "--catalogue", folder, "--json").stdout)
    assert f"{folder}: {shown['other_numbers']}" == rule
    arguments = ["build", "slider-crank", "--catalogue", folder, "--plan", "quick", "--workers", "1"]
    built = invoke(*arguments)  # which shows the plan first
    assert built.exit_code == 2
    assert built.stderr.splitlines()[-1] == f"jointplay: {rule}: build into another folder"


def test_damaged_matrix_is_one_line_that_says_what_to_do(folder: Path) -> None:
    catalogue = Catalogue.open(folder)
    path = CatalogueDirectory(folder).matrix(catalogue.id) / "clearance.npy"
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    out = folder.parent / "x.csv"
    assert_refused(
        invoke("export", "--catalogue", folder, "--out", out), 1, "`jointplay reindex` makes the matrix again"
    )
    assert not out.exists()
    assert invoke("reindex", "--catalogue", folder).exit_code == 0
    assert invoke("export", "--catalogue", folder, "--out", out).exit_code == 0


def test_regenerate(folder: Path) -> None:
    result = invoke("regenerate", "--catalogue", folder, "--sample", "4", "--workers", "1")
    assert result.exit_code == 0
    assert f"{folder}: 4 of 4 cases identical, mean difference 0.00 dB" in result.stdout
    shown = json.loads(invoke("regenerate", "--catalogue", folder, "--sample", "3", "--workers", "1", "--json").stdout)
    assert (len(shown["cases"]), shown["identical"], shown["changed"], shown["agrees"]) == (3, 3, 0, True)


@pytest.mark.parametrize("name", ["x.csv", "x.h5", "x.npz"])
def test_export(folder: Path, name: str) -> None:
    out = folder.parent / name
    shown = json.loads(invoke("export", "--catalogue", folder, "--out", out, "--json").stdout)
    catalogue = Catalogue.open(folder)
    assert shown["cases"] == len(catalogue.entries) + len(catalogue.failed)
    assert shown["size_bytes"] == out.stat().st_size
    if name == "x.csv":
        with open(out, encoding="utf-8", newline="") as file:
            assert len(list(csv.reader(file))) == shown["cases"] + 1


def test_export_refuses(folder: Path) -> None:
    export = ("export", "--catalogue", folder)
    assert_refused(invoke(*export, "--out", folder / "x.txt"), 2, "must end in .h5, .csv or .npz")
    assert_refused(invoke(*export, "--out", folder / "no" / "x.h5"), 2, "does not exist")
    refused = invoke(*export, "--out", folder / "x.h5", "--hypothesis", "Z")
    assert_refused(refused, 2, "--hypothesis Z: is not one of healthy, A, B, O")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "uncertain: {contact.frictoin: {uniform: [0, 1]}}",
            "uncertain.contact.frictoin: 0 to 1: is not a number of machine slider-crank; "
            'did you mean "contact.friction"?',
        ),
        (
            "wide: {draws: 0.5, uncertain: {frame.mas: {lognormal: 0.1}}}",
            "wide.uncertain.frame.mas: x exp(0.1 N(0, 1)): is not a number of machine slider-crank; "
            'did you mean "frame.mass"?',
        ),
        (
            "uncertain: {sensors.0.at.0: {uniform: [0, 1]}}",
            "uncertain.sensors.0.at.0: 0 to 1: no equation of this machine holds such a number",
        ),
        ("sets: [[Z, A]]", "sets.0: Z: is no joint of machine slider-crank that can wear; these are A, B, O"),
    ],
)
def test_plan_that_does_not_fit_the_machine_is_one_line(tmp_path: Path, text: str, line: str) -> None:
    plan, folder = tmp_path / "my.yaml", tmp_path / "c"
    plan.write_text(text)
    result = invoke("build", "slider-crank", "--catalogue", folder, "--plan", plan)
    assert_refused(result, 2, f"{plan}: {line}")
    assert not folder.exists()
