"""``import jointplay``: what it offers, what it costs, and that its page does what it says."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from recordings import unpacked

import jointplay as jp
from jointplay.catalogue.errors import MeasurementError

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "guide" / "python.md"
SOURCE = ROOT / "src" / "jointplay" / "__init__.py"


def test_every_name_is_there_and_known_to_type_checkers() -> None:
    for name in jp.__all__:
        assert getattr(jp, name) is not None
    assert set(dir(jp)) == set(jp.__all__)
    tree = ast.parse(SOURCE.read_text(encoding="utf-8"))
    imports = {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert set(jp.__all__) <= imports
    with pytest.raises(AttributeError, match="has no attribute 'simulat'"):
        jp.simulat  # type: ignore[attr-defined]  # noqa: B018


def test_nothing_is_imported_before_it_is_asked_for() -> None:
    code = "import sys; before = set(sys.modules); import jointplay; print(*set(sys.modules) - before)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert {name for name in loaded if "." not in name} <= {"jointplay"} | set(sys.stdlib_module_names)
    assert {name for name in loaded if name.startswith("jointplay.")} == {"jointplay.version"}


@pytest.mark.long
def test_the_page_does_what_it_says(
    shelf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) >= 4
    monkeypatch.chdir(tmp_path)
    # A catalogue that is complete: nothing is left to build.
    shutil.copytree(shelf / "slider-crank", "slider-crank-quick")
    plan = jp.Catalogue.open("slider-crank-quick").plan
    monkeypatch.setattr(jp, "load_plan", {"quick": plan}.__getitem__)
    Path("recording.csv").write_bytes(unpacked("slider-crank-03.csv"))
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("<History ok: B=0.2mm, ")
    assert printed[1].startswith("<Spectrum psd of acceleration, x, y, theta: ")
    assert printed[2].startswith("<Spectrum peak of displacement, x, y, theta: ")
    assert printed[3] == "30.0"
    assert printed[4].startswith("slider-crank ")
    assert {line.split()[0] for line in printed[5:]} == {"A", "B", "O"}
    assert Path("answer.png").stat().st_size > 10_000


@pytest.fixture(scope="module")
def history() -> object:
    settings = jp.Settings(accuracy="draft", sample_rate=4000, revolutions=5)
    return jp.simulate(jp.load_machine("slider-crank"), None, settings)


def test_results_compare_hash_and_convert(history) -> None:  # type: ignore[no-untyped-def]
    assert history == history
    assert history != jp.simulate(jp.load_machine("slider-crank"), None, jp.Settings(duration=0.1, sample_rate=4000))
    assert {history: 1}[history] == 1
    table, cube = history.to_pandas(), history.to_xarray()
    np.testing.assert_array_equal(table["velocity_theta"], history.velocity[:, 2])
    np.testing.assert_array_equal(cube["velocity"].sel(motion="theta"), history.velocity[:, 2])
    spectrum = history.spectrum()
    np.testing.assert_array_equal(spectrum.to_pandas()["y"], spectrum.values[:, 1])
    np.testing.assert_array_equal(spectrum.to_xarray().sel(channel="y"), spectrum.values[:, 1])
    assert len(jp.plot(history).axes) == 6
    short = jp.simulate(jp.load_machine("slider-crank"), None, jp.Settings(duration=0.05, sample_rate=4000))
    assert jp.plot(short).axes[1].texts[0].get_text().startswith("no spectrum: ")
    assert len(jp.plot(spectrum).axes) == 3


def test_recordings_of_arrays(history) -> None:  # type: ignore[no-untyped-def]
    found = jp.Recording.from_arrays(history.band_limited_acceleration / 9.80665, 4000, ["a", "b", "c"], unit="g")
    np.testing.assert_allclose(found.signal, history.band_limited_acceleration, rtol=1e-12)
    assert repr(found).startswith("<Recording recording: a, b, c, ")
    assert len(jp.plot(found).axes) == 3
    with pytest.raises(MeasurementError, match=r"an array of shape \(\d+, 3\): must be \(samples, 2\)"):
        jp.Recording.from_arrays(history.band_limited_acceleration, 4000, ["a", "b"])
    with pytest.raises(TypeError, match="int: must be a History, a Spectrum, a Recording or a Diagnosis"):
        jp.plot(3)
