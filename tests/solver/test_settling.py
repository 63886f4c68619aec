"""Worn machines that start with their suspension settled."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any, Literal

import numpy as np
import pytest
from extremes.scenes import four_bar

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import History
from jointplay.solver.cases.preparation import Prepared
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation import simulate as module
from jointplay.solver.simulation.averages import healthy_revolution
from jointplay.solver.simulation.runs import adaptive_runs, gill_runs
from jointplay.solver.simulation.simulate import settle, simulate, simulate_batch, start_of
from jointplay.solver.spectra.harmonics import harmonic_levels, mean_difference_db

WEAR = Fault({"B": 2e-4})
AT_ONCE = Settings(settled=True, revolutions=4.0)
SHORT = Settings(settled=True, revolutions=1.0, sample_rate=2000.0, accuracy="draft", motion=False)


def tree_of(name: str = "slider-crank") -> dict[str, Any]:
    return shipped_machine(name).model_dump(mode="json")


def same(first: History, second: History) -> bool:
    return np.array_equal(first.band_limited_acceleration, second.band_limited_acceleration)


def revolutions(history: History) -> float:
    return history.transient * abs(history.drive_speed) / (2 * math.pi)


def prepared(machine: Machine, case: Case, settings: Settings = AT_ONCE) -> tuple[Prepared, Prepared]:
    """As drawn and settled."""
    group = next(groups(machine, [case], settings))
    runs = gill_runs if settings.integrator == "gill" else adaptive_runs
    return group.ready[0], settle(machine, group.model, [case], group.ready, settings, runs)[0]


def backwards() -> Machine:
    tree = tree_of()
    tree["drive"]["speed"] *= -1
    return parse_machine(tree)


def without_x() -> Machine:
    tree = tree_of()
    tree["links"][tree["frame"]]["locked"] = ["x"]
    return parse_machine(tree)


def pushed() -> Machine:
    """The slider pushed to and fro by a prescribed translation; drawn away from the dead centres."""
    tree = tree_of()
    crank, height, reach = 0.05, 0.05, 0.2
    x, y = crank * math.cos(1.0), height + crank * math.sin(1.0)
    end = x + math.sqrt(reach**2 - (y - height) ** 2)
    for joint, at in (("A", [x, y]), ("B", [end, height]), ("G1", [end, height])):
        tree["joints"][joint]["at"] = at
    tree["links"]["crank"]["cg"], tree["links"]["rod"]["cg"] = (
        [x / 2, (y + height) / 2],
        [(x + end) / 2, (y + height) / 2],
    )
    tree["links"]["slider"]["cg"] = [end, height]
    tree["drive"] = {"kind": "translation", "joint": "G1"}
    tree["drive"]["harmonics"] = [{"frequency": 10.0, "amplitude": 0.02, "phase": 0.3}]
    return parse_machine(tree)


@pytest.mark.parametrize(
    ("machine", "fault", "left"),
    [
        (shipped_machine("slider-crank"), {"B": 2e-4}, (6, 2)),
        (shipped_machine("quick-return"), {"F": 2e-4}, (4, 1)),
        (shipped_machine("four-bar"), {"A": 1e-4}, (3, 1)),
        (backwards(), {"B": 2e-4}, (6, 2)),
        (without_x(), {"B": 2e-4}, (4, 1)),
        (pushed(), {"B": 2e-4}, (6, 2)),
    ],
)
@pytest.mark.parametrize("settings", [AT_ONCE, replace(AT_ONCE, sample_rate=57.0), replace(AT_ONCE, method="gill")])
def test_the_frame_moves_as_that_of_the_healthy_machine(
    machine: Machine, fault: dict[str, float], left: tuple[int, int], settings: Settings
) -> None:
    """To the 1 % that is left of a transient at its end, of each motion's swing (measured 0.5 %).

    Samples of 57 Hz lie a sixth of a revolution of the slider-crank apart; a cubic between them adds to that (1.7 %).
    """
    tolerance = 0.02 if settings.sample_rate < 100 else 0.01
    case = Case(Fault(fault), {"supports.0.stiffness.1": 3.5e5})
    before, after = prepared(machine, case, settings)
    revolution = 2 * math.pi / abs(after.speed)
    assert (before.transient / revolution, after.transient / revolution) == pytest.approx(left)
    assert before.duration - after.duration == pytest.approx((left[0] - left[1]) * revolution)
    model = next(groups(machine, [case], settings)).model
    gaps, jacobian, drift = model.constraint(0.0, after.z, after.v, after.vector)
    assert np.abs(gaps.full()).max() < 1e-11  # closures, and pins concentric
    assert np.abs(jacobian.full() @ after.v + drift.full()[:, 0]).max() < 1e-8  # and staying so
    steady = healthy_revolution(machine, case, Settings())
    columns = [column for column, index in enumerate(model.frame_indices) if index is not None]
    frame = [index for index in model.frame_indices if index is not None]
    for at_start, at_rest, motion in (
        (after.z, before.z, steady.displacement),
        (after.v, before.v, steady.velocity),
    ):
        wanted, swing = motion[0, columns], np.ptp(motion[:, columns], axis=0)
        assert (np.abs(at_start[frame] - wanted) < tolerance * swing).all()
        assert (np.abs(at_rest[frame] - wanted) > tolerance * swing).any()


@pytest.mark.parametrize(("name", "fault"), [("slider-crank", {"B": 2e-4}), ("quick-return", {"F": 2e-4})])
def test_what_follows_is_the_steady_state(name: str, fault: dict[str, float]) -> None:
    """Harmonics of four revolutions against those after twenty: measured 0.02 and 0.10 dB, as drawn 1.2 and 2.7.

    Both after the revolutions that are dropped.
    """
    machine, case = shipped_machine(name), Case(Fault(fault))
    frequency = machine.drive.speed / (2 * math.pi)  # type: ignore[union-attr, operator]
    rate, samples = 2000 * frequency, 8000
    late = simulate(machine, case, Settings(sample_rate=rate, duration=24 / frequency))
    at_once = simulate(machine, case, Settings(sample_rate=rate, revolutions=4.0, settled=True, transient=False))
    dropped = 2000 * round(revolutions(at_once))

    def levels(signal: Any) -> Any:
        return harmonic_levels(signal[:samples], rate, frequency)

    wanted = levels(late.band_limited_acceleration[-samples - 1 : -1, 1])
    drawn = levels(late.band_limited_acceleration[dropped : dropped + samples, 1])
    away = mean_difference_db(levels(at_once.band_limited_acceleration[:, 1]), wanted)
    assert away < 0.2
    assert mean_difference_db(drawn, wanted) > 5 * away


def test_a_slow_suspension_is_given_longer() -> None:
    """What the wear adds to the frame's motion decays with the suspension: a quarter of its transient is dropped."""
    tree = tree_of("quick-return")
    for mount in tree["supports"]:
        mount["damping"] = [damping / 5 for damping in mount["damping"]]
    before, after = prepared(parse_machine(tree), Case(Fault({"F": 2e-4})))
    revolution = 2 * math.pi / before.speed
    assert round(before.transient / revolution) == 19
    assert round(after.transient / revolution) == 5


def mixture() -> tuple[list[Case], list[Literal["draft", "standard"]]]:
    generator = np.random.default_rng(1)
    faults = [{}, {"B": 2e-4}, {"A": 1e-4, "B": 5e-5}, {"O": 1e-4}]
    cases: list[Case] = []
    for i in range(14):
        numbers = {"drive.speed": 62.8 * generator.uniform(0.9, 1.1)}
        numbers["supports.0.stiffness.1"] = 4e5 * generator.uniform(0.8, 1.2)
        if i % 3 == 0:
            numbers["links.rod.mass"] = 0.25 * generator.uniform(0.9, 1.1)
        cases.append(Case(Fault(faults[i % 4]), numbers))
    return cases, ["standard" if i % 5 == 0 else "draft" for i in range(14)]


def test_a_case_does_not_depend_on_those_beside_it() -> None:
    machine, (cases, accuracies) = shipped_machine("slider-crank"), mixture()
    together = simulate_batch(machine, cases, SHORT, accuracies=accuracies)
    for case, accuracy, history in zip(cases, accuracies, together, strict=True):
        assert same(history, simulate(machine, case, replace(SHORT, accuracy=accuracy)))
        assert history.status is Status.OK
        assert round(revolutions(history)) == (2 if case.fault else 6)


def test_healthy_runs_that_fail_leave_the_others_alone() -> None:
    """Friction that jams or stalls the healthy machine, between cases whose friction does not."""
    tree = tree_of()
    tree["joints"]["G1"]["friction"] = 0.1
    machine = parse_machine(tree)
    frictions = [0.1, 8.0, 0.2, 4.0, 0.15]
    cases = [
        case
        for i, friction in enumerate(frictions)
        for case in (Case(), Case(WEAR, {"joints.G1.friction": friction, "drive.speed": 60.0 + i}))
    ]
    settings = replace(SHORT, most_trials=200_000)
    worn = simulate_batch(machine, cases, settings)[1::2]
    for friction, case, history in zip(frictions, cases[1::2], worn, strict=True):
        alone = simulate(machine, case, settings)
        assert same(history, alone)
        assert history.message == alone.message
        assert (round(revolutions(history)) == 2) == (friction < 1)


def test_the_processor_time_of_the_healthy_run_counts() -> None:
    before, after = prepared(shipped_machine("slider-crank"), Case(WEAR))
    assert before.spent == 0 < after.spent


def started_as_drawn(machine: Machine, case: Case, settings: Settings = AT_ONCE) -> bool:
    before, after = prepared(machine, case, settings)
    kept = {field.name for field in fields(before)} - {"v"}
    return all(np.array_equal(getattr(before, name), getattr(after, name)) for name in kept)


def changed(**parts: Any) -> Machine:
    return parse_machine({**tree_of(), **parts})


def on_the_ground() -> Machine:
    tree = tree_of()
    tree["links"][tree["frame"]]["locked"] = ["x", "y", "theta"]
    return parse_machine(tree)


def with_a_swinging_arm() -> Machine:
    """Nothing but gravity moves it against the frame."""
    tree = tree_of()
    tree["links"]["arm"] = {"mass": 0.5, "inertia": 0.01, "cg": [0.1, -0.3]}
    tree["joints"]["P"] = {"kind": "turning", "links": ["arm", tree["frame"]], "at": [0.1, -0.2]}
    return parse_machine(tree)


def with_ripple(order: float) -> Machine:
    return changed(drive={**tree_of()["drive"], "ripple": [{"order": order, "amplitude": 0.0, "phase": 0.0}]})


RIPPLED = Case(WEAR, {"drive.ripple.0.amplitude": 0.01})
IN_TIME = [{"link": "slider", "at": [0.2, 0.05], "over_time": [[0, 0, 0, 0], [1, -5, 0, 0]]}]


@pytest.mark.parametrize(
    ("machine", "case", "settings"),
    [
        (shipped_machine("slider-crank"), Case(), AT_ONCE),
        (shipped_machine("slider-crank"), Case(WEAR), Settings(settled=True, duration=1.5)),
        (shipped_machine("slider-crank"), Case(WEAR, {"drive.speed": 0.0}), AT_ONCE),
        (on_the_ground(), Case(WEAR), AT_ONCE),
        (with_a_swinging_arm(), Case(WEAR), AT_ONCE),
        (changed(supports=[]), Case(WEAR), AT_ONCE),
        (changed(loads=IN_TIME), Case(WEAR), AT_ONCE),
        (with_ripple(2.5), RIPPLED, AT_ONCE),
        (pushed(), Case(WEAR, {"drive.speed": 0.002}), AT_ONCE),
    ],
)
def test_without_a_steady_state_of_the_frame_alone_it_starts_as_drawn(
    machine: Machine, case: Case, settings: Settings
) -> None:
    assert started_as_drawn(machine, case, settings)


def test_ripple_of_whole_orders_comes_round() -> None:
    assert not started_as_drawn(with_ripple(2.0), RIPPLED)


def test_numbers_of_a_worn_joint_alone_are_no_matter_to_the_healthy_machine() -> None:
    """Viscous resistance acts in closed joints only, and no equation has it where the machine file has none."""
    before, after = prepared(shipped_machine("slider-crank"), Case(WEAR, {"joints.B.viscous": 0.1}))
    assert after.transient < before.transient


def test_a_given_start_is_not_settled() -> None:
    machine, case = shipped_machine("slider-crank"), Case(WEAR)
    start = start_of(machine, case)
    given, own = simulate_batch(machine, [case, case], SHORT, starts=[start, None])
    assert same(given, simulate(machine, case, replace(SHORT, settled=False)))
    assert round(revolutions(given)) == 6
    assert same(own, simulate(machine, case, SHORT))


def test_started_as_drawn_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """A parallelogram passes a change point, where only the worn machine can go on; and frames that do not close."""
    machine = four_bar(0.06, 0.20, 0.06, 0.20, 0.0)
    case = Case(Fault({"A": 1e-4}))
    table = [Case(), case]
    group = list(groups(machine, table, SHORT))[1]
    (only,) = settle(machine, group.model, table, group.ready, SHORT, adaptive_runs)
    assert (only.index, "started as drawn" in only.remark) == (1, True)
    history = simulate_batch(machine, table, SHORT)[1]
    assert "started as drawn: the healthy machine gave no settled start (" in history.message
    assert same(history, simulate(machine, case, replace(SHORT, settled=False)))

    def open_joint(*_: object) -> None:
        raise AssemblyError("slider-crank", "joints.B", None, "does not close")

    monkeypatch.setattr(module, "start_with_frame", open_joint)
    history = simulate(shipped_machine("slider-crank"), Case(WEAR), SHORT)
    assert "no settled start (slider-crank: joints.B: does not close)" in history.message
