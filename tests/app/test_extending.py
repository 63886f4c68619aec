"""A package of somebody else adds a contact law, a reader and a method of matching by being installed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from jointplay.solver.machines.restitution import CONTACT_LAWS

MODULE = """
import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.evaluation.nearest_entry import NearestEntry
from jointplay.catalogue.measurements.readers.raw import RawColumn, RawRecording


def hysteresis(e):
    return 1.5 * (1 - e * e)


def read(data, source, limits):
    if not data.startswith(b"xyz"):
        raise MeasurementError(source, rule="does not begin with xyz")
    values = np.frombuffer(data[3:], np.float64).reshape(-1, 1)
    return RawRecording(source, (RawColumn("s", "s", "m/s2", "column 1"),), values, sample_rate=100.0)


class Method(NearestEntry):
    pass
"""
ENTRY_POINTS = """
[jointplay.contact_laws]
others-law = others:hysteresis
flores = others:hysteresis
hertz = others:hysteresis

[jointplay.readers]
xyz = others:read
DAT = others:read
h5 = others:read

[jointplay.matchers]
others-forest = sklearn.ensemble:RandomForestClassifier
others-method = others:Method
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as an installation leaves it."""
    folder = tmp_path_factory.mktemp("site-packages")
    (folder / "others.py").write_text(MODULE)
    told = folder / "others-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: others\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text(ENTRY_POINTS)
    return folder


def run(package: Path, code: str) -> str:
    path = os.pathsep.join([str(package), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long
def test_a_contact_law(package: Path) -> None:
    code = """
import json
import jointplay as jp
from jointplay.solver.machines.restitution import CONTACT_LAWS, hysteresis_factor

machine = jp.load_machine("slider-crank").model_dump()
contact = {"law": "others-law", "stiffness": 1e8, "restitution": 0.8}
machine["joints"]["B"]["contact"] = contact
settings = jp.Settings(duration=0.2, accuracy="draft")
found = jp.simulate(jp.Machine.model_validate(machine), {"B": 2e-4}, settings)
factors = [hysteresis_factor(name, 0.8) for name in ("flores", "others-law")]
print(json.dumps([found.status, len(found.t), *factors, list(CONTACT_LAWS)]))
"""
    status, samples, ours, theirs, laws = json.loads(run(package, code))
    assert (status, samples) == ("ok", 4001)
    assert ours == pytest.approx(0.4)  # a name of ours keeps its formula
    assert theirs == pytest.approx(0.54)
    assert laws == [*CONTACT_LAWS, "others-law"]


def test_a_reader(package: Path) -> None:
    code = """
import numpy as np
import jointplay as jp
from jointplay.catalogue.errors import MeasurementError

values = np.sin(np.arange(300.0))
for name in ("run.xyz", "run.DAT"):
    print(np.array_equal(jp.read_recording(b"xyz" + values.tobytes(), name=name).signal[:, 0], values))
try:
    jp.read_recording(b"abc", name="run.xyz")
except MeasurementError as error:
    print(error)
"""
    assert run(package, code).splitlines() == ["True", "True", "run.xyz: does not begin with xyz"]


def test_a_method(package: Path) -> None:
    code = """
from jointplay.catalogue.evaluation.cross_checks import METHODS

forest = METHODS["others-forest"]()
print(list(METHODS), type(METHODS["others-method"]()).__name__, forest.name, type(forest.classifier).__name__)
"""
    names = ["others-forest", "others-method", "gaussian", "cosine", "nearest", "extra-trees"]
    assert run(package, code).strip() == f"{names} Method others-forest RandomForestClassifier"


def test_nothing_is_there_without_it() -> None:
    code = "from jointplay.solver.machines.restitution import CONTACT_LAWS; print(len(CONTACT_LAWS))"
    assert run(Path(), code).strip() == "6"
