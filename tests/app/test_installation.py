"""What an installation puts beside other packages: ``jointplay`` and nothing else, whatever else has names of ours."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder

import jointplay

ROOT = Path(__file__).parents[2]
USERS_OWN = ("app.py", "catalogue/__init__.py", "solver/errors.py")


def modules(folder: Path) -> set[str]:
    """Files in the three folders that belong into a wheel, without folders that are links."""
    found = {path for part in ("app", "catalogue", "solver") for path in (folder / part).rglob("*") if path.is_file()}
    return {str(path.relative_to(folder)) for path in found if "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(next(iter(WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("wheel"))))))


def test_a_wheel_holds_everything_under_one_name(wheel: Path) -> None:
    names = ZipFile(wheel).namelist()
    assert {name.partition("/")[0] for name in names} == {
        "jointplay",
        f"jointplay-{jointplay.__version__}.dist-info",
    }
    inside = {name.removeprefix("jointplay/") for name in names if name.startswith("jointplay/")}
    assert inside == modules(ROOT) | {"__init__.py", "version.py", "py.typed"}


def test_a_source_distribution_gives_the_same_wheel(wheel: Path, tmp_path: Path) -> None:
    archive = next(iter(SdistBuilder(str(ROOT)).build(directory=str(tmp_path))))
    subprocess.run(["tar", "xzf", archive, "-C", str(tmp_path)], check=True)
    (unpacked,) = (path for path in tmp_path.iterdir() if path.is_dir())
    again = next(iter(WheelBuilder(str(unpacked)).build(directory=str(tmp_path / "again"))))
    assert sorted(ZipFile(again).namelist()) == sorted(ZipFile(wheel).namelist())


def test_modules_of_the_same_names_do_no_harm(wheel: Path, tmp_path: Path) -> None:
    installed, own = tmp_path / "installed", tmp_path / "own"
    with ZipFile(wheel) as archive:
        archive.extractall(installed)
    for name in USERS_OWN:
        (own / name).parent.mkdir(parents=True, exist_ok=True)
        (own / name).write_text("raise RuntimeError('a module of the user')\n")
    plans = "from jointplay.catalogue.plans.plan import load_plan; load_plan('quick')"
    code = f"import jointplay; print(jointplay.__file__); {plans}; from jointplay.app.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "machines", "slider-crank"],
        cwd=own,
        env={**os.environ, "PYTHONPATH": f"{own}{os.pathsep}{installed}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    first, *printed = done.stdout.splitlines()
    assert Path(first) == installed / "jointplay" / "__init__.py"
    assert "name: slider-crank" in printed
