"""Batches: grouping and lanes change nothing; bad input is refused, failures are statuses."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.steps import Accuracy
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate, simulate_batch

QR = shipped_machine("quick-return")
SHORT = Settings(duration=0.05, sample_rate=10_000, accuracy="draft")


@pytest.mark.parametrize("method", ["adaptive", "gill"])
def test_lanes_and_groups_change_nothing(method: Literal["adaptive", "gill"]) -> None:
    """A mixed table gives bit for bit what its cases give alone, in the order asked for."""
    cases = [
        Case(Fault({"A": 1e-4}), {"contact.stiffness": 2e7}),
        Case(),
        Case(Fault({"F": 3e-4}), {"contact.friction": 0.1}),
        Case(Fault({"A": 3e-4}), {"contact.friction": 0.02, "drive.speed": 12.9}),
        Case(parameters={"links.frame.mass": 66.0}),
        Case(Fault({"A": 2e-5})),
        Case(Fault({"A": 1e-4, "F": 1e-4})),
    ]
    settings = Settings(duration=0.05, sample_rate=10_000, accuracy="draft", method=method)
    together = simulate_batch(QR, cases, settings)
    for case, history in zip(cases, together, strict=True):
        assert history.case == case
        assert history.status is Status.OK
        alone = simulate(QR, case, settings)
        assert alone.step == history.step
        assert np.array_equal(alone.displacement, history.displacement)
        assert np.array_equal(alone.band_limited_acceleration, history.band_limited_acceleration)


def test_more_cases_than_lanes() -> None:
    clearances = np.geomspace(2e-5, 5e-4, 11)
    cases = [Case(Fault({"C": float(c)})) for c in clearances]
    histories = simulate_batch(QR, cases, SHORT)
    assert [h.case for h in histories] == cases
    assert len({h.displacement[-1].tobytes() for h in histories}) == 11


@pytest.mark.parametrize("method", ["adaptive", "gill"])
def test_accuracies_side_by_side_change_nothing(method: Literal["adaptive", "gill"]) -> None:
    cases = [Case(Fault({"A": 2e-4}), {"drive.speed": speed}) for speed in (12.0, 12.5, 13.0)]
    accuracies: list[Accuracy] = ["draft", "standard", "draft"]
    settings = Settings(duration=0.05, sample_rate=10_000, method=method)
    together = simulate_batch(QR, cases, settings, accuracies=accuracies)
    for case, accuracy, found in zip(cases, accuracies, together, strict=True):
        alone = simulate(QR, case, replace(settings, accuracy=accuracy))
        assert np.array_equal(found.acceleration, alone.acceleration)
    coarse = simulate(QR, cases[1], replace(settings, accuracy="draft"))
    assert together[1].step < coarse.step


@pytest.mark.parametrize("given", [{"starts": [None]}, {"accuracies": ["draft", "draft", "standard"]}])
def test_lists_of_another_length_than_the_cases_are_refused(given: dict[str, Any]) -> None:
    (name, values), *_ = given.items()
    with pytest.raises(SettingsError, match=rf"^{name}: {len(values)} for 2 cases: must be one a case$"):
        simulate_batch(QR, [Case(), Case()], SHORT, **given)


def test_progress_counts_every_case() -> None:
    seen: list[int] = []
    simulate_batch(QR, [Case(Fault({"C": 1e-4}))] * 10 + [Case()], SHORT, progress=seen.append)
    assert seen == list(range(1, 12))


def test_parameters_are_those_of_a_changed_machine() -> None:
    """A parameter by path does what the same number in the file does."""
    tree = QR.model_dump(mode="json")
    tree["links"]["ram"]["mass"] = 2.5
    tree["supports"][0]["stiffness"][1] = 3.1e5
    tree["joints"]["F"]["contact"]["damping"] = 500.0
    fault = Fault({"F": 2e-4})
    values = {"links.ram.mass": 2.5, "supports.0.stiffness.1": 3.1e5, "contact.damping": 500.0}
    settings = Settings(duration=0.05, sample_rate=10_000, step=2e-5)
    by_parameter = simulate(QR, Case(fault, values), settings)
    by_file = simulate(parse_machine(tree), Case(fault), settings)
    # Folding a constant rounds differently; impacts amplify that over 0.05 s.
    assert np.abs(by_parameter.displacement - by_file.displacement).max() < 1e-12


def test_default_duration_is_transient_and_revolutions() -> None:
    history = simulate(QR, Case(), Settings(sample_rate=2000, accuracy="draft", revolutions=3))
    period = 2 * np.pi / 12.566370614
    # The slowest mode, x coupled to the rotation, decays at 2.56 per second: 1.80 s to 0.01, the fourth revolution.
    assert history.transient == pytest.approx(4 * period)
    assert history.t[-1] == pytest.approx(history.transient + 3 * period, abs=1e-3)
    assert history.message == ""
    # Three whole revolutions of a periodic motion: both halves differ only by being halves.
    assert history.steadiness_db.shape == (3,)


@pytest.mark.parametrize(
    ("parameters", "line"),
    [
        ({"links.frme.mass": 1.0}, "quick-return: links.frme.mass: no equation of this machine holds such a number"),
        ({"links.frame.mass": float("nan")}, "quick-return: links.frame.mass: nan: must be finite"),
        ({"loads.7.torque": 1.0}, "quick-return: loads.7.torque: no equation of this machine holds such a number"),
        ({"links.frame.mass": -1.0}, "quick-return: links.frame.mass: -1.0: must be greater than 0"),
        ({"contact.stiffness": -1e7}, "quick-return: contact.stiffness: -10000000.0: must be greater than 0"),
        ({"supports.0.damping.1": -1.0}, "quick-return: supports.0.damping.1: -1.0: must not be negative"),
        (
            {"joints.A.contact.stifness": 1e7},
            'quick-return: joints.A.contact.stifness: 10000000.0: no such number; did you mean "contact.stiffness"?',
        ),
        ({"joints.A.viscous": 1.0}, "quick-return: joints.A.viscous: no equation of this machine holds such a number"),
    ],
)  # fmt: skip
def test_parameters_that_mean_nothing(parameters: dict[str, float], line: str) -> None:
    with pytest.raises(MachineError) as refusal:
        simulate(QR, Case(parameters=parameters), SHORT)
    assert str(refusal.value) == line


def test_fault_on_a_sliding_joint() -> None:
    with pytest.raises(MachineError, match=r"joints\.G1\.length: is missing"):
        simulate(QR, Case(Fault({"G1": 1e-4})), SHORT)


@pytest.mark.parametrize(
    ("settings", "line"),
    [
        ({"duration": -1.0}, "duration: -1.0: must be a finite number greater than 0"),
        ({"step": float("nan")}, "step: nan: must be a finite number greater than 0"),
        ({"sample_rate": 0.0}, "sample_rate: 0.0: must be a finite number greater than 0"),
        ({"accuracy": "fine"}, "accuracy: fine: must be one of draft, standard, reference"),
    ],
)
def test_settings(settings: dict[str, object], line: str) -> None:
    with pytest.raises(SettingsError) as refusal:
        Settings(**settings)  # type: ignore[arg-type]
    assert str(refusal.value) == line


def test_a_run_of_days_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"^duration: 1e\+09 s: 2e\+13 samples need more than 2 GB of records"):
        simulate(QR, Case(), Settings(duration=1e9))
    with pytest.raises(SettingsError, match=r"^duration: 1e\+07 s: needs more than 2e\+09 steps of"):
        simulate(QR, Case(), Settings(duration=1e7, sample_rate=1))


def test_a_case_that_blows_up_is_a_status() -> None:
    """A step far beyond stability: the failing lane ends finite, its neighbours do not notice."""
    stiff = Case(Fault({"A": 1e-4}), {"contact.damping": 1e6})
    gentle = Case(Fault({"A": 1e-4}))
    settings = Settings(duration=0.05, sample_rate=10_000, step=5e-5)
    bad, good = simulate_batch(QR, [stiff, gentle], settings)
    assert good.status is Status.OK
    assert bad.status is Status.DIVERGED
    assert bad.message.startswith("left all bounds at")  # beside its status, it does not repeat it
    assert 0 < len(bad.t) < len(good.t)
    for array in (bad.displacement, bad.velocity, bad.acceleration, bad.band_limited_acceleration):
        assert len(array) == len(bad.t)
        assert np.isfinite(array).all()
    assert np.array_equal(good.displacement, simulate(QR, gentle, settings).displacement)


def test_contact_numbers_by_joint_reach_that_joint() -> None:
    fault = Fault({"A": 2e-4})
    plain, dragged, elsewhere = (
        simulate(QR, Case(fault, parameters), SHORT)
        for parameters in ({}, {"joints.A.contact.viscous": 50.0}, {"joints.F.contact.viscous": 50.0})
    )
    assert not np.array_equal(plain.displacement, dragged.displacement)
    assert np.array_equal(plain.displacement, elsewhere.displacement)  # F has no clearance in this case


def crank_at(angle: float, **changes: object) -> dict[str, object]:
    """A slider-crank on a frame of its own, drawn at a crank angle; crank 50 mm, rod 150 mm."""
    x, y = 0.05 * np.cos(angle), 0.05 * np.sin(angle)
    slider = float(x + np.sqrt(0.15**2 - y**2))
    tree: dict[str, object] = {
        "name": "slider-crank",
        "links": {
            "frame": {"mass": 20, "inertia": 0.5, "cg": [0, 0]},
            "crank": {"mass": 0.3, "inertia": 1e-4, "cg": [x / 2, y / 2]},
            "rod": {"mass": 0.25, "inertia": 6e-4, "cg": [(x + slider) / 2, y / 2]},
            "slider": {"mass": 0.5, "inertia": 1e-4, "cg": [slider, 0]},
        },
        "joints": {
            "O": {"kind": "turning", "links": ["crank", "frame"], "at": [0, 0]},
            "A": {"kind": "turning", "links": ["rod", "crank"], "at": [x, y]},
            "B": {"kind": "turning", "links": ["rod", "slider"], "at": [slider, 0]},
            "G": {"kind": "sliding", "links": ["slider", "frame"], "at": [slider, 0], "direction": [1, 0]},
        },
        "supports": [
            {"kind": "mount", "link": "frame", "at": [s, -0.1], "stiffness": [2e5, 4e5], "damping": [200, 300]}
            for s in (-0.25, 0.25)
        ],
    }
    return {**tree, **changes}


@pytest.mark.parametrize(
    "drive",
    [
        {"speed": 0.1},
        {"speed": [[0, 0.0], [1, 0.2]]},
        {"speed": 0.05, "harmonics": [{"frequency": 3, "amplitude": 0.005, "phase": 0}]},
    ],
    ids=["steady", "run-up", "swinging"],
)
@pytest.mark.parametrize("worn", [{}, {"B": 1e-4}], ids=["healthy", "worn"])
def test_a_slide_driven_past_its_reach_is_refused(drive: dict[str, object], worn: dict[str, float]) -> None:
    """The ram reaches 200 mm from its drawn 171 mm; it goes there in all these ways, but not within 50 ms."""
    machine = parse_machine(crank_at(1.0, drive={"kind": "translation", "joint": "G", **drive}))
    case, reach = Case(Fault(worn)), 1e3 * (0.2 - machine.links["slider"].cg[0])
    refused = simulate(machine, case, Settings(duration=1.0, sample_rate=2000))
    assert refused.status is Status.CANNOT_ASSEMBLE
    travel = re.search(r"cannot be assembled at a drive travel of ([\d.]+) mm", refused.message)
    assert travel is not None
    assert float(travel[1]) == pytest.approx(reach, abs=0.05)  # shown to three digits
    assert simulate(machine, case, Settings(duration=0.05, sample_rate=2000)).status is Status.OK


def test_a_driven_slide_swings_about_its_drawn_place() -> None:
    drive = {"kind": "translation", "joint": "G", "harmonics": [{"frequency": 4, "amplitude": -0.01, "phase": 0}]}
    machine = parse_machine(crank_at(1.0, drive=drive))
    history = simulate(machine, Case(), Settings(sample_rate=2000, revolutions=4, links=True))
    assert history.status is Status.OK
    assert history.drive_speed == pytest.approx(2 * np.pi * 4)
    assert history.links is not None
    frame, slider = (history.links.displacement[:, history.links.links.index(k)] for k in ("frame", "slider"))
    travel = slider[:, 0] - frame[:, 0]
    # The frame tilts by some 1e-3 rad about its own centre: 0.2 m from there that turns x by less than 1e-6 m.
    assert np.abs(travel + 0.01 * np.sin(8 * np.pi * history.t)).max() < 1e-5
