"""Machines that no motion is prescribed to: their limit cycle against closed forms, and what is said where none is."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from laws import Array, Tree, tree_of

from jointplay.app.figures.simulation_file import record
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.turning import cycles, turning_of, why_unsteady
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.solver.machines.parts import RotationDrive, TorqueDrive
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.spectrum import order_levels

NO_LOAD, STALL = 60.0, 6.0


def rotor(inertia: float, viscous: float = 0.0) -> Machine:
    """A balanced rotor in a standing frame, its motor's torque falling evenly from stall to no load."""
    return parse_machine(
        {
            "name": "rotor",
            "links": {"wall": {"fixed": True}, "rotor": {"mass": 2.0, "inertia": inertia, "cg": [0, 0]}},
            "joints": {"O": {"kind": "turning", "links": ["rotor", "wall"], "at": [0, 0], "viscous": viscous}},
            "drive": {"kind": "torque", "joint": "O", "curve": [[0, STALL], [2 * NO_LOAD, -STALL]]},
        }
    )


def motor(flywheel: float, *, fixed: bool = False, viscous: float = 0.0, **drive: Any) -> Machine:
    """The four-bar, a motor at its crank, and a flywheel on it."""
    tree: Tree = tree_of("four-bar")
    tree["drive"] = {"kind": "torque", "joint": "O", **(drive or {"curve": [[0, STALL], [2 * NO_LOAD, -STALL]]})}
    tree["links"]["crank"]["inertia"] += flywheel
    tree["links"]["frame"]["fixed"] = fixed
    tree["joints"]["O"]["viscous"] = viscous
    return parse_machine(tree)


@pytest.mark.parametrize("viscous", [0.0, 0.05])
def test_a_rotor_reaches_the_speed_at_which_torque_and_loss_are_equal(viscous: float) -> None:
    """T0 (1 - w/w0) = c w; from standstill exponentially, with I / (T0/w0 + c). Seen: 4e-5 and less of what is left."""
    inertia, slope = 0.2, STALL / NO_LOAD + viscous
    settled = simulate(rotor(inertia, viscous))
    final = STALL / slope
    assert settled.turning is not None and settled.turning.is_steady
    assert settled.drive_speed == pytest.approx(final, rel=1e-3)
    running = simulate(rotor(inertia, viscous), None, Settings(duration=1.0, sample_rate=1000.0))
    assert running.turning is not None and not running.turning.is_steady
    t, tau = running.t, inertia / slope
    assert running.turning.angle == pytest.approx(final * (t - tau * (1 - np.exp(-t / tau))), abs=1e-4)


def test_factors_on_torque_and_speeds_make_another_motor() -> None:
    """f T0 (1 - w / (s w0)) = c w, of the rotor; of a constant torque f T = c w."""
    f, s, viscous = 1.5, 0.8, 0.05
    machine = rotor(0.2, viscous)
    drive = machine.drive.model_copy(update={"effort_factor": f, "speed_factor": s})  # type: ignore[union-attr]
    final = f * STALL / (f * STALL / (s * NO_LOAD) + viscous)
    filed = simulate(machine.model_copy(update={"drive": drive}))
    assert filed.drive_speed == pytest.approx(final, rel=1e-3)
    drawn = simulate(machine, Case(parameters={"drive.effort_factor": f, "drive.speed_factor": s}))
    assert drawn.drive_speed == pytest.approx(final, rel=1e-3)
    constant = machine.model_copy(update={"drive": TorqueDrive(joint="O", torque=2.0, effort_factor=f)})
    assert simulate(constant).drive_speed == pytest.approx(f * 2.0 / viscous, rel=1e-3)


def test_factors_on_speeds_need_a_curve() -> None:
    with pytest.raises(MachineError, match="factor: 2: is of the speeds of a curve, and there is none"):
        motor(0.0, torque=1.0, speed_factor=2.0)
    with pytest.raises(MachineError, match="effort_factor: 0: must be greater than 0"):
        motor(0.0, torque=1.0, effort_factor=0)
    with pytest.raises(MachineError, match="effort_factor: -1"):
        simulate(motor(0.0), Case(parameters={"drive.effort_factor": -1.0}))


def test_the_mean_speed_of_a_linkage_follows_from_its_energy() -> None:
    """In a standing frame only motor and bearing work: over a revolution the mean of w over the angle is T0 / (k + c).

    Whatever linkage and flywheel do. Seen: 1e-7; the speed itself swings by a few per cent.
    """
    history = simulate(motor(0.02, fixed=True, viscous=0.03))
    assert history.turning is not None and history.turning.is_steady
    rate = np.gradient(history.turning.angle, history.t)
    ends = cycles(history.t, history.turning.angle, rotates=True)[0]
    inside = (history.t >= ends[0]) & (history.t <= ends[-1])
    turned = 2 * math.pi * (len(ends) - 1)
    mean = float(np.trapezoid(rate[inside] ** 2, history.t[inside])) / turned
    assert mean == pytest.approx(STALL / (STALL / NO_LOAD + 0.03), rel=1e-4)
    assert np.ptp(rate) > 0.02 * mean
    assert history.turning.speed == pytest.approx(turned / (ends[-1] - ends[0]), rel=1e-6)


@pytest.mark.parametrize("fault", [{}, {"A": 1e-4}])
def test_a_record_starts_in_the_limit_cycle(fault: dict[str, float]) -> None:
    """Two halves of it have the same level, the frame comes back every revolution, and there are orders."""
    machine, settings = motor(0.05), Settings()
    history = simulate(machine, fault, settings)
    assert history.status is Status.OK
    assert history.turning is not None and history.turning.is_steady
    assert history.turning.period == 1
    assert history.turning.scatter < 1e-4
    assert np.abs(history.steadiness_db).max() < 0.05
    assert history.message.startswith("limit cycle from ")
    assert "the frame comes back every revolution" in history.message
    assert history.t[0] > 2.0
    assert history.t[-1] - history.transient == pytest.approx(10 * 2 * math.pi / history.drive_speed, rel=1e-3)
    arrays = record(machine, history, settings, "0").arrays
    levels = np.asarray(arrays["order_level_frame"])[:, 1]
    assert levels[:5].max() > 5 * levels[5:].max()
    assert "cascade_speed" not in arrays
    longer = simulate(machine, fault, Settings(duration=history.t[-1] + 2.0, sample_rate=2000.0))
    assert longer.t[0] == 0.0
    assert longer.turning is not None
    assert longer.turning.angle[-1] / (2 * math.pi) > 50
    again = simulate(machine, fault, Settings(duration=1.0))
    assert again.turning is not None and not again.turning.is_steady


def test_a_run_up_is_told_and_gives_orders_over_speed() -> None:
    """A heavy flywheel, time constant 10 s: 20 s are not enough."""
    machine, settings = motor(1.0), Settings(duration=20.0, sample_rate=5000.0)
    history = simulate(machine, {}, settings)
    assert history.status is Status.OK
    assert history.drive_speed == 0.0
    assert history.message.startswith("no limit cycle: the mean speed is ")
    with pytest.raises(SettingsError, match="not steady"):
        history.spectrum()
    found = record(machine, history, settings, "0")
    assert found.missing.startswith("not steady: ")
    assert not {"psd_frame", "order_level_frame"} & set(found.arrays)
    assert found.attributes["limit_cycle"] is False
    speed = np.asarray(found.arrays["cascade_speed"])
    assert np.all(np.diff(speed) > 0)
    assert 0.8 * NO_LOAD < speed[-1] < NO_LOAD
    level = np.asarray(found.arrays["cascade_level_frame"])
    assert level.shape == (len(speed), 100, 3)
    # So slow a run-up is a row of steady states: at each speed the levels are those of a crank that turns evenly. Seen:
    # 0.04 and 0.24 dB apart; the third order lies in a resonance of the suspension here, which is swept.
    window = int(np.argmin(np.abs(speed - 40.0)))
    turned = machine.model_copy(update={"drive": RotationDrive(joint="O", speed=float(speed[window]))})
    even = simulate(turned, {}, Settings(sample_rate=5000.0))
    levels = order_levels(even.spectrum(), np.arange(1.0, 3.0))
    assert 20 * np.log10(level[window, :2, 0] / levels[:, 0]) == pytest.approx(0.0, abs=0.5)


def test_a_motor_that_cannot_lift_its_load_is_told() -> None:
    history = simulate(motor(0.0, torque=0.1, fixed=True), {}, Settings(duration=5.0, sample_rate=1000.0))
    assert history.turning is not None
    assert "too few to judge by" in history.turning.reason
    machine = motor(0.0, torque=0.1, fixed=True)
    assert "no four of them" in record(machine, history, Settings(), "0").missing


def test_a_force_drive_cycles_with_its_travel() -> None:
    """A slider that is pushed the way it goes, a flywheel, a crank that resists: its travel comes back."""
    tree = tree_of("slider-crank")
    guide = next(name for name, joint in tree["joints"].items() if joint["kind"] == "sliding")
    tree["drive"] = {"kind": "force", "joint": guide, "curve": [[-1, -40], [1, 40]]}
    crank = tree["joints"]["O"]["links"][0]
    tree["links"][crank]["inertia"] += 0.02
    tree["joints"]["O"]["viscous"] = 0.05
    tree["initial"] = {"velocities": {crank: {"omega": 20.0}}}
    history = simulate(parse_machine(tree))
    assert history.turning is not None and history.turning.is_steady
    assert history.turning.period == 1
    assert history.turning.revolutions >= 9


def ends_of(speeds: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(2 * math.pi / speeds)])


@pytest.mark.parametrize(
    ("speeds", "steady"),
    [
        (np.full(30, 60.0), True),
        (60 - 30 * np.exp(-np.arange(30) / 3), True),
        (60 - 30 * np.exp(-np.arange(30) / 10), False),
        (60 - 30 * np.exp(-np.arange(300) / 3000), False),  # hardly changes, and is far from its end
        (60 + 0.01 * np.arange(30), False),
        (60 - 30 * np.exp(-np.arange(300) / 20), True),
        (60 + np.random.default_rng(1).normal(size=300), True),
        (60 + np.random.default_rng(1).normal(size=30), False),  # too few to know the mean by
        (60 + np.random.default_rng(1).normal(size=300) + 0.02 * np.arange(300), False),
        (np.full(8, 60.0), False),
    ],
)
def test_steadiness_is_judged_by_what_the_mean_speed_will_change_yet(speeds: Array, steady: bool) -> None:
    assert (why_unsteady(ends_of(speeds)) == "") == steady


@pytest.mark.parametrize(("period", "says"), [(1, "every revolution"), (2, "every 2 revolutions"), (0, "chaotic")])
def test_what_comes_back_is_told_from_what_does_not(period: int, says: str) -> None:
    t = np.linspace(0.0, 10.0, 10001)
    order = {1: 1.0, 2: 0.5, 0: 1 / math.sqrt(2)}[period]
    frame = np.column_stack([np.cos(2 * math.pi * order * t), np.sin(2 * math.pi * t)])
    found = turning_of(t, 2 * math.pi * t, True, frame, 0.0)
    assert found.is_steady
    assert found.period == period
    assert found.speed == pytest.approx(2 * math.pi)
    assert says in found.say(0.0)


def test_a_clockwise_driver_has_a_negative_speed() -> None:
    t = np.linspace(0.0, 10.0, 10001)
    found = turning_of(t, -2 * math.pi * t - 0.05 * np.sin(2 * math.pi * t), True, np.zeros((10001, 0)), 0.0)
    assert found.speed == pytest.approx(-2 * math.pi)
    assert np.all(np.diff(found.angle) < 0)


def test_the_full_method_does_not_judge() -> None:
    history = simulate(rotor(0.2), {}, Settings(duration=0.1, method="full", sample_rate=1000.0))
    assert history.turning is None
    assert history.message == "method full does not say whether this is a limit cycle"


def test_a_fault_does_not_hide_a_failure_on_the_way() -> None:
    """What fails while it runs up fails in its record too, with the samples before."""
    machine = motor(0.05)
    history = simulate(machine, Case(Fault({"A": 1e-4})), Settings(most_trials=20))
    assert history.status is Status.STEP_TOO_SMALL
    assert len(history.t) > 0
