"""Cases as threads of a CUDA device, under Numba's simulator, against the lanes of the processor."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from device_cases import GONE_ON_WITH, TABLES, histories

from jointplay.solver.cases.history import History, Settings
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.simulation.simulate import Status, simulate

#: Differences as parts of the largest value. Both sides take the same steps; their sines round differently, and impacts
#: amplify that. What rounding can do was measured by moving speeds and clearances of each case 300 times by up to 1, 4
#: and 16 units in their last place, and between threads and lanes, compiled for AVX-512, AVX2 and SSE2 with libraries
#: to match: at most 7e-12, 1.9e-10, 1.4e-9, 9e-10, and 5e-11 at the end. About ten times that is allowed.
CLOSE = {"displacement": 7e-11, "velocity": 2e-9, "acceleration": 1.4e-8, "band_limited_acceleration": 1e-8}
CLOSE_END = 5e-10
#: The same where rounding decides one trial step among hundreds otherwise, which leaves errors of steps: 1.1e-10, 7e-9,
#: 2e-7, 5e-6, and 5e-6 at the end; the mean step 8e-3. As many trials may be otherwise ones, so one case is named.
LOOSE = {"displacement": 1e-9, "velocity": 7e-8, "acceleration": 2e-6, "band_limited_acceleration": 5e-5}
LOOSE_END = 5e-5
DECIDED_BY_ROUNDING = ("contacts that remember their impacts", 0)  # in a third to three quarters of those 300


def run(*command: str | Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A process in which Numba meets these variables when it is first imported."""
    return subprocess.run(
        [sys.executable, *map(str, command)], env=os.environ | environment, capture_output=True, text=True
    )


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[History]]:
    """The tables under the simulator."""
    path = tmp_path_factory.mktemp("device") / "histories"
    done = run(Path(__file__).with_name("device_cases.py"), path, NUMBA_ENABLE_CUDASIM="1")
    assert done.returncode == 0, done.stderr
    found: dict[str, list[History]] = pickle.loads(path.read_bytes())
    return found


@pytest.fixture(scope="module")
def expected() -> dict[str, list[History]]:
    return histories("cpu")


NAMES = [*TABLES, *(f"{name}, gone on with" for name in GONE_ON_WITH)]


@pytest.mark.parametrize("name", NAMES, ids=lambda name: name.replace(" ", "-"))
def test_threads_agree_with_lanes(
    name: str, simulated: dict[str, list[History]], expected: dict[str, list[History]]
) -> None:
    for number, (thread, lane) in enumerate(zip(simulated[name], expected[name], strict=True)):
        assert thread.case == lane.case
        assert (thread.status, thread.message, len(thread.t)) == (lane.status, lane.message, len(lane.t))
        alike = (name, number) != DECIDED_BY_ROUNDING
        if lane.status is not Status.JAMMED:  # rounding decides how often its last step is tried
            assert thread.step == pytest.approx(lane.step, rel=1e-12 if alike else 3e-2)
        bounds, bound_at_end = (CLOSE, CLOSE_END) if alike else (LOOSE, LOOSE_END)
        assert np.array_equal(thread.t, lane.t)
        for motion, bound in bounds.items():
            ours, theirs = getattr(thread, motion), getattr(lane, motion)
            assert ours.shape == theirs.shape
            gap, size = (np.abs(part).max(axis=0, initial=0.0) for part in (ours - theirs, theirs))
            assert (gap <= bound * size).all(), motion
        if lane.status in (Status.DIVERGED, Status.STEP_TOO_SMALL):  # its end is where rounding took it
            continue
        if lane.status is Status.CANNOT_ASSEMBLE:
            assert lane.end is thread.end is None
            continue
        for ours, theirs in ((thread.end.z, lane.end.z), (thread.end.v, lane.end.v)):
            assert np.abs(ours - theirs).max() < bound_at_end * np.abs(theirs).max()
        if lane.links is not None:
            assert thread.links is not None
            gap = np.abs(thread.links.displacement - lane.links.displacement)
            assert gap.max() < bounds["displacement"] * np.abs(lane.links.displacement).max()


def test_a_failing_case_is_a_status_and_its_neighbour_goes_on(simulated: dict[str, list[History]]) -> None:
    past, within = simulated["a slide driven past its reach"]
    assert past.status is Status.CANNOT_ASSEMBLE
    assert within.status is Status.OK


def test_a_jam_is_named(simulated: dict[str, list[History]]) -> None:
    rubbing, jammed = simulated["a guide that rubs, and one that jams"]
    assert rubbing.status is Status.OK
    assert jammed.status is Status.JAMMED
    assert "sliding joint G1" in jammed.message


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"device": "gpu"}, "device: gpu: must be cpu or cuda"),
        ({"device": "cuda", "method": "gill"}, "device: cuda: only the adaptive method runs there, not gill"),
        ({"device": "cuda", "step": 1e-5}, "device: cuda: only the adaptive method runs there, not gill"),
    ],
)
def test_settings(settings: dict[str, object], line: str) -> None:
    with pytest.raises(SettingsError) as refusal:
        Settings(**settings)  # type: ignore[arg-type]
    assert str(refusal.value) == line


def test_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("jointplay.solver.integrators.device", "jointplay.solver.simulation.device_runs"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.setitem(sys.modules, "numba.cuda", None)
    monkeypatch.delattr("numba.cuda", raising=False)
    with pytest.raises(
        SettingsError, match=r"^device: cuda: Numba has no CUDA here; install the extra jointplay\[cuda\]$"
    ):
        simulate(shipped_machine("slider-crank"), settings=Settings(device="cuda"))


SIMULATE = ["-m", "jointplay.app.cli", "simulate", "slider-crank", "--duration", "2 ms", "--sample-rate", "5 kHz"]


def test_the_command_without_a_device(tmp_path: Path) -> None:
    done = run(*SIMULATE, "--device", "cuda", "-o", tmp_path / "o.npz", NUMBA_DISABLE_CUDA="1")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.splitlines() == ["jointplay: device: cuda: no CUDA device that Numba can use was found"]


def test_the_command_with_a_device(tmp_path: Path) -> None:
    done = run(*SIMULATE, "--device", "cuda", "-o", tmp_path / "o.npz", NUMBA_ENABLE_CUDASIM="1")
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "o.npz") as written:
        assert len(written["t"]) == 11


def test_the_processor_never_imports_numbas_cuda(tmp_path: Path) -> None:
    asked = "atexit.register(lambda: print('numba.cuda' in sys.modules))"
    spy = f"import atexit, sys; from jointplay.app.cli import main; {asked}; main()"
    done = run("-c", spy, *SIMULATE[2:], "-o", tmp_path / "o.npz")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "False"
