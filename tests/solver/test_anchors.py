"""Ground that moves under springs, dampers and mounts: closed forms, energy, what comes round, what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from laws import Array, Tree, run, states, tree_of
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_simpson
from test_simulate import crank_at

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.equations.anchors import fastest_anchor, row_times
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.solver.machines.matrix import matrix_tree
from jointplay.solver.simulation.simulate import simulate, simulate_batch

M, K, C = 2.0, 800.0, 8.0  # 20 rad/s, a tenth of critical damping


def body(*supports: Tree, **more: Any) -> Machine:
    links = {"wall": {"fixed": True}, "body": {"mass": M, "inertia": 0.3, "cg": [0, 0]}}
    return parse_machine({"name": "m", "gravity": 0.0, "links": links, "supports": list(supports), **more})


def mount(motion: list[Tree], **more: Any) -> Tree:
    return {"kind": "mount", "link": "body", "at": [0, 0], "stiffness": [K, K], "damping": [C, C],
            "motion": motion, **more}  # fmt: skip


def along_y(motion: list[Tree]) -> list[Tree]:
    """The same as a spring and a damper of their own, and nothing that holds the body in x or its angle."""
    common = {"link": "body", "at": [0, 0], "anchor": [0, -0.5], "motion": motion}
    return [{"kind": "spring", "stiffness": K, **common}, {"kind": "damper", "damping": C, **common}]


@pytest.mark.parametrize("ratio", [0.3, 1.0, 1.7])
@pytest.mark.parametrize("line", [False, True], ids=["mount", "spring and damper"])
def test_an_oscillator_on_a_shaken_floor(ratio: float, line: bool) -> None:
    """Transmissibility (1 + 2 i z r) / (1 - r^2 + 2 i z r), amplitude and phase, once the start has decayed (e^-20)."""
    w, phase, a = 20.0 * ratio, 0.7, 1e-3
    motion = [{"displacement": [0, a], "frequency": w / (2 * math.pi), "phase": phase}]
    machine = body(*(along_y(motion) if line else [mount(motion)]))
    history, found = run(machine, {}, duration=11.0, sample_rate=100.0, rtol=1e-10)
    late = history.t > 10.0
    gain = (1 + 0.2j * ratio) / (1 - ratio**2 + 0.2j * ratio)
    expected = a * (gain * np.exp(1j * (w * history.t[late] + phase))).imag
    assert_allclose(found.displacement[late, 1, 1], expected, rtol=0, atol=2e-8 * a * abs(gain))
    assert not found.displacement[:, 1, 0].any()


def ramp(t: Array, v: float, stop: float) -> tuple[Array, Array]:
    """Displacement and velocity of the body over a floor that moves with v and then stands."""
    decay, swing = C / (2 * M), math.sqrt(K / M - (C / (2 * M)) ** 2)

    def freely(s: Array) -> tuple[Array, Array]:  # from rest to a velocity of 1, against the floor
        late = np.maximum(s, 0.0)
        wave, slope = np.sin(swing * late), swing * np.cos(swing * late)
        return np.exp(-decay * late) / swing * wave * (s >= 0), np.exp(-decay * late) / swing * (
            slope - decay * wave
        ) * (s >= 0)

    (y0, v0), (y1, v1) = freely(t), freely(t - stop)
    return v * np.minimum(t, stop) + v * (y1 - y0), v * (t < stop) + v * (v1 - v0)


@pytest.mark.parametrize("line", [False, True], ids=["mount", "spring and damper"])
def test_a_floor_that_moves_by_a_table(line: bool) -> None:
    """Its velocity jumps at the rows; samples lie before, between and behind them."""
    motion = [{"over_time": [[0, 0, 0], [0.1234567, 0, 0.1234567]]}]
    machine = body(*(along_y(motion) if line else [mount(motion)]))
    history, found = run(machine, {}, duration=0.4, sample_rate=1000.0, rtol=1e-10)
    place, rate = ramp(history.t, 1.0, 0.1234567)
    assert_allclose(found.displacement[:, 1, 1], place, rtol=0, atol=1e-9 * place.max())
    assert_allclose(found.velocity[:, 1, 1], rate, rtol=0, atol=1e-9 * np.abs(rate).max())


def test_steps_end_at_the_rows_of_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they do not, what jumps within a step passes error control by less than its tolerance, but many times more
    than smooth motion does: measured 2.5e-9 and less against 1e-7 and more at the tolerance asked for, 1e-6.
    """
    rows = [[0.0, 0, 0], [0.1234567, 0, 0.1234567e-2], [0.2, 0, 1e-3], [0.31, 0, 4e-3]]
    machine = body(mount([{"over_time": rows}]), {"kind": "damper", "link": "body", "at": [0, 0], "anchor": [0, 1],
                   "damping": 1.0, "motion": [{"over_time": rows}]})  # fmt: skip
    errors = []
    for times in (row_times(machine), []):
        monkeypatch.setattr("jointplay.solver.simulation.runs.row_times", lambda _, times=times: times)
        exact, found = (run(machine, {}, duration=0.4, sample_rate=1000.0, rtol=rtol)[1] for rtol in (1e-12, 1e-6))
        errors.append(float(np.abs(found.velocity - exact.velocity).max() / np.abs(exact.velocity).max()))
    assert row_times(machine) == [row[0] for row in rows]
    assert errors[0] < 0.1 * errors[1]


def test_a_run_up_with_ripple_is_as_accurate_as_other_runs() -> None:
    """Speed jumps its slope at every row; at 1e-6 asked for, velocities are within 1e-7 of the finest."""
    tree = tree_of("slider-crank")
    tree["drive"] = {
        "kind": "rotation", "joint": "O", "speed": [[0.0313, 20.0], [0.0729, 60.0], [0.1181, 35.0]],
        "ripple": [{"order": 2, "amplitude": 0.02}],
    }  # fmt: skip
    coarse, fine = (
        simulate(parse_machine(tree), {}, Settings(duration=0.2, sample_rate=5000.0, rtol=rtol))
        for rtol in (1e-6, 1e-11)
    )
    assert np.abs(coarse.velocity - fine.velocity).max() < 1e-7 * np.abs(fine.velocity).max()


TABLE = [[0.01, 0, 0], [0.03, 1e-3, 2e-3]]


def test_lanes_with_tables_change_nothing() -> None:
    """Every lane comes to the rows in steps of its own: bit for bit what the cases give alone."""
    machine = shaken([{"over_time": TABLE}])
    cases = [
        Case(Fault({"B": size}), {"links.frame.mass": mass}) for size in (1e-5, 1e-4) for mass in (18.0, 20.0, 25.0)
    ]
    settings = Settings(duration=0.05, sample_rate=5000.0)
    for case, together in zip(cases, simulate_batch(machine, cases, settings), strict=True):
        alone = simulate(machine, case, settings)
        assert together.step == alone.step
        assert np.array_equal(together.acceleration, alone.acceleration)


def shaken(pulled: list[Tree]) -> Machine:
    """The slider-crank on a floor that shakes, with a belt, and a damper whose other end is pulled."""
    tree = tree_of("slider-crank")
    floor = [{"displacement": ["0.1 mm", "0.2 mm"], "frequency": "20 Hz"}]
    tree["supports"][0]["motion"] = floor
    tree["supports"][1]["motion"] = [*floor, {"displacement": [2e-5, 0], "order": 3, "phase": "90 deg"}]
    belt = {"link": "frame", "at": [0, 0.1], "anchor": [0.4, 0.2]}
    tree["supports"] += [
        {"kind": "spring", "stiffness": 2e4, **belt, "motion": [{"order": 0.5, "displacement": [1e-3, 0]}]},
        {"kind": "damper", "damping": 80.0, **belt, "motion": pulled},
    ]
    return parse_machine(tree)


def test_energy_is_the_work_of_the_drive_and_of_the_ground() -> None:
    """What the ground does is the force of the element times the velocity of the anchor; losses are the dampers'."""
    machine = shaken([{"frequency": 7.0, "displacement": [1e-3, 2e-3]}])
    history, motion = run(machine, {}, duration=0.2, sample_rate=20_000.0, rtol=1e-11)
    crank, frame = (motion.links.index(link) for link in ("crank", "frame"))
    power = motion.reactions["drive_effort"] * (motion.velocity[:, crank, 2] - motion.velocity[:, frame, 2])
    energy = []
    for k, state in enumerate(states(machine, motion)):
        energy.append(state.energy({}, history.t[k]))
        for support in machine.supports:
            moved, pace = state.shift(support, history.t[k])
            start = np.array(support.at if support.kind == "mount" else support.anchor) + moved  # type: ignore[union-attr]
            gap, rate = state.point(frame, support.at) - start, state.velocity(frame, support.at) - pace
            along = gap / math.hypot(*gap) if support.kind != "mount" else gap
            if support.kind == "mount":
                lost = np.array(support.damping) * rate
                force = np.array(support.stiffness) * gap + lost
            elif support.kind == "damper":
                force = lost = support.damping * (along @ rate) * along
            else:
                lost, force = (
                    0.0 * gap,
                    support.stiffness * (math.hypot(*gap) - float(support.free_length or 0)) * along,
                )
            power[k] -= force @ pace + lost @ rate
    work = cumulative_simpson(power, x=history.t, initial=0)
    assert_allclose(np.array(energy) - energy[0], work, rtol=0, atol=1e-8 * np.ptp(work))


def test_an_order_of_the_drive_is_a_frequency_at_constant_speed() -> None:
    """At 10 Hz order 2 is 20 Hz; with the drive's angle the phase stays what it is as the speed changes."""
    tree = tree_of("slider-crank")
    runs = []
    for often in ({"order": 2}, {"frequency": 20.0}):
        tree["supports"][0]["motion"] = [{"displacement": [1e-4, 2e-4], "phase": 0.3, **often}]
        runs.append(run(parse_machine(tree), {}, duration=0.3, sample_rate=1000.0, rtol=1e-10)[1])
    assert_allclose(runs[0].velocity, runs[1].velocity, rtol=0, atol=1e-9 * np.abs(runs[1].velocity).max())


def test_a_torque_does_not_feel_what_a_gear_takes_up() -> None:
    """The anchor follows the angle of a driver that turns freely, which gets no force for it."""
    wheel = {"mass": 1.0, "inertia": 0.02, "cg": [0, 0]}
    machine = body(
        mount([{"order": 2, "displacement": [0, 1e-2]}]),
        links={"wall": {"fixed": True}, "body": {"mass": M, "inertia": 0.3, "cg": [0, 0]}, "wheel": wheel},
        joints={"O": {"kind": "turning", "links": ["wheel", "wall"], "at": [0, 0]}},
        drive={"kind": "torque", "joint": "O", "torque": 0.5},
    )
    history, found = run(machine, {}, duration=1.0, sample_rate=100.0, rtol=1e-10)
    wheel_at = found.links.index("wheel")
    assert_allclose(found.displacement[:, wheel_at, 2], 0.5 / 0.02 * history.t**2 / 2, rtol=1e-9, atol=1e-12)
    assert np.abs(found.displacement[:, 1, 1]).max() > 1e-3


def test_what_comes_round() -> None:
    tree = tree_of("slider-crank")
    for motion, comes in (
        ({"frequency": 20.0}, True), ({"order": 3}, True), ({"frequency": 5.0}, False), ({"frequency": 21.0}, False),
        ({"order": 0.37}, False), ({"over_time": [[0, 0, 0], [1, 0, 0.1]]}, False),
    ):  # fmt: skip
        shift: Tree = {} if "over_time" in motion else {"displacement": [0, 1e-4]}
        tree["supports"][1]["motion"] = [{**shift, **motion}]  # type: ignore[dict-item]
        machine = parse_machine(tree)
        if comes:
            assert repeating_frequency(machine, 20 * math.pi) == pytest.approx(10.0)
        else:
            with pytest.raises(SettingsError, match=r"supports\.1\.motion\.0: must repeat with the drive's revolution"):
                repeating_frequency(machine, 20 * math.pi)


def test_a_case_changes_how_far_the_ground_moves() -> None:
    """Twice as far by its file or by its case is the same; what starts in equilibrium starts over still ground."""
    tree = crank_at(1.0, drive={"kind": "rotation", "joint": "O", "speed": 60.0})
    tree["initial"] = {"pose": "equilibrium"}
    wide, narrow = (
        [{"displacement": [0, size], "order": 2, "phase": 1.0}] for size in (2e-4, 1e-4)
    )  # fmt: skip
    tree["supports"][0]["motion"] = wide
    path = "supports.0.motion.0.displacement.1"
    settings = Settings(duration=0.05, sample_rate=5000.0, rtol=1e-10)
    filed = simulate(parse_machine(tree), Case(Fault({"B": 1e-4})), settings)
    tree["supports"][0]["motion"] = narrow
    changed = simulate(parse_machine(tree), Case(Fault({"B": 1e-4}), {path: 2e-4}), settings)
    del tree["supports"][0]["motion"]
    still = simulate(parse_machine(tree), Case(Fault({"B": 1e-4})), settings)
    assert_allclose(changed.velocity, filed.velocity, rtol=0, atol=1e-7 * np.abs(filed.velocity).max())
    assert np.array_equal(filed.displacement[0], still.displacement[0])


def test_gill_sees_the_ground_too() -> None:
    """Its steps do not end at the rows, where a damper's force jumps: measured 2.4e-5 of the largest velocity."""
    machine = shaken([{"over_time": TABLE}])
    runs = [simulate(machine, {}, Settings(duration=0.05, sample_rate=5000.0, method=method)) for method in
            ("adaptive", "gill")]  # type: ignore[arg-type] # fmt: skip
    assert_allclose(runs[0].velocity, runs[1].velocity, rtol=0, atol=1e-4 * np.abs(runs[0].velocity).max())


def test_settled_worn_machines_repeat_on_ground_that_does() -> None:
    tree = tree_of("slider-crank")
    tree["supports"][0]["motion"] = [{"displacement": [0, 1e-5], "order": 2}]
    settings = Settings(revolutions=30, sample_rate=4000.0, settled=True, repeating=True, motion=False, transient=False)
    history = simulate(parse_machine(tree), Case(Fault({"A": 1e-5})), settings)
    assert history.status is Status.OK and history.period == 1


def test_a_machine_file_round_trip_and_its_key() -> None:
    """A file that says nothing of it keeps its key."""
    machine = shaken([{"over_time": TABLE}])
    assert parse_machine(machine.canonical_json()) == machine
    assert "motion" not in parse_machine(tree_of("slider-crank")).canonical_json()
    assert machine.supports[0].motion[0].displacement == (1e-4, 2e-4)
    assert row_times(machine) == [0.01, 0.03]
    assert fastest_anchor(machine, 20 * math.pi) == (pytest.approx(60 * math.pi), "supports.1.motion.1.order")
    assert parse_machine(matrix_tree(machine)) == machine


def test_ground_that_asks_for_steps_without_number_is_named() -> None:
    machine = body(mount([{"displacement": [0, 1e-6], "frequency": 1e9}]))
    with pytest.raises(MachineError, match=r"^m: supports\.0\.motion\.0\.frequency: .*: takes 1440 steps a revolution"):
        simulate(machine, {}, Settings(duration=100.0, sample_rate=100.0))


SINE: Tree = {"displacement": [0, 1e-3], "frequency": 5.0}


@pytest.mark.parametrize(
    ("motion", "line"),
    [
        ([{"displacement": [0, 1e-3]}], "motion.0: give one of frequency, order, over_time"),
        ([{**SINE, "order": 2}], "motion.0: give only one of frequency, order"),
        ([{**SINE, "over_time": TABLE}], "motion.0: give only one of frequency, over_time"),
        ([SINE, {"frequency": 5.0}], "motion.1.displacement: is missing"),
        ([{"over_time": TABLE, "displacement": [0, 1]}],
         "motion.0.displacement: [0, 1]: is of a sine, and there is a table"),
        ([{"over_time": TABLE, "phase": 1}], "motion.0.phase: 1: is of a sine, and there is a table"),
        ([{"over_time": [[1, 0, 0], [0, 0, 0]]}],
         "motion.0.over_time.1.0: must be greater than in the row before (1)"),
        ([{**SINE, "frequency": "300 rpm"}],
         'motion.0.frequency: 300 rpm: "rpm" is a speed of rotation, must be a frequency, for example "1.5 Hz"'),
        ([{**SINE, "displacement": [0, "1 N"]}],
         'motion.0.displacement.1: 1 N: "N" is a force, must be a length, for example "0.2 mm"'),
        ([{"displacement": [0, 1e-3], "order": 2}],
         "motion.0.order: 2: needs a rotation or torque drive: there is no drive angle"),
        ([{**SINE, "velocity": 1}], "motion.0.velocity: 1: unknown key; known: displacement, frequency, order, phase, "
         "over_time"),
    ],
)  # fmt: skip
def test_refusals(motion: list[Tree], line: str) -> None:
    with pytest.raises(MachineError) as refusal:
        body(mount(motion))
    assert str(refusal.value) == f"machine: supports.0.{line}"


def test_only_ground_moves() -> None:
    with pytest.raises(
        MachineError, match=r"supports\.0\.motion\.0: is of an end on the ground, and this one is on wall"
    ):
        body(mount([SINE], to_link="wall"))
