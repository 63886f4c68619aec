"""A link whose position in space is prescribed: closed forms, the same machine driven otherwise, what is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from laws import Tree, run, states, tree_of
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_simpson

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.remarks import find_remarks
from jointplay.solver.equations.drive import repeating_frequency
from jointplay.solver.errors import MachineError, SettingsError
from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.machine import Machine, machine_json_schema, parse_machine
from jointplay.solver.machines.matrix import matrix_tree
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.ensemble import Ensemble, simulate_ensemble
from jointplay.solver.simulation.simulate import check_assembly, simulate, start_of
from jointplay.solver.simulation.tradeoff import measure

SWING: Tree = {"frequency": 5.0, "amplitude": 0.01, "phase": 0.4}
W = 2 * math.pi * SWING["frequency"]


def driven(link: str, direction: list[float], **more: Any) -> Tree:
    return {"kind": "position", "link": link, "direction": direction, **({"harmonics": [SWING]} | more)}


def swing(t: np.ndarray) -> np.ndarray:
    return np.asarray(0.01 * (np.sin(W * t + 0.4) - math.sin(0.4)))


def upright(drive: Tree, frame: Tree | None = None, degrees: float = 90.0) -> Machine:
    """A slider-crank, its crank at 60 degrees of its stroke, turned as a whole; its frame is fixed unless given."""
    turn = complex(math.cos(math.radians(degrees)), math.sin(math.radians(degrees)))

    def at(x: float, y: float) -> list[float]:
        moved = complex(x, y) * turn
        return [moved.real, moved.imag]

    pin = (0.05 * math.cos(1.0), 0.05 * math.sin(1.0))
    end = pin[0] + math.sqrt(0.15**2 - pin[1] ** 2)
    links = {
        "frame": frame or {"fixed": True},
        "crank": {"mass": 0.3, "inertia": 1e-4, "cg": at(0.5 * pin[0], 0.5 * pin[1])},
        "rod": {"mass": 0.25, "inertia": 6e-4, "cg": at(0.5 * (pin[0] + end), 0.5 * pin[1])},
        "slider": {"mass": 0.5, "inertia": 1e-4, "cg": at(end, 0.0)},
    }
    joints = {
        "O": {"kind": "turning", "links": ["crank", "frame"], "at": [0, 0], "viscous": 0.01},
        "A": {"kind": "turning", "links": ["rod", "crank"], "at": at(*pin)},
        "B": {"kind": "turning", "links": ["rod", "slider"], "at": at(end, 0.0)},
        "G": {"kind": "sliding", "links": ["slider", "frame"], "at": at(end, 0.0), "direction": at(1, 0)},
    }
    foot = {"kind": "mount", "link": "frame", "stiffness": [2e5, 4e5], "damping": [200, 300]}
    supports = [] if frame is None else [{**foot, "at": [-0.2, -0.1]}, {**foot, "at": [0.2, -0.1]}]
    return parse_machine({"name": "m", "links": links, "joints": joints, "drive": drive, "supports": supports})


@pytest.mark.parametrize("degrees", [0.0, 90.0, 217.0])
@pytest.mark.parametrize("worn", [{}, {"A": 1e-4}], ids=["healthy", "worn"])
def test_on_a_fixed_frame_a_guide_that_is_driven_does_the_same(degrees: float, worn: dict[str, float]) -> None:
    """Also the same force: the centre of gravity lies on the guide's line. A worn pin amplifies what steps miss: forces
    differ by 4e-4 of the largest at most.
    """
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    along = {"kind": "translation", "joint": "G", "harmonics": [SWING]}
    (t, first), (_, second) = (
        (history.t, links)
        for history, links in (
            run(upright(drive, degrees=degrees), worn, duration=0.3, sample_rate=1000.0, rtol=1e-10)
            for drive in (driven("slider", [c, s]), along)
        )
    )
    assert_allclose(first.displacement[:, 3, :2], np.outer(swing(t), [c, s]), rtol=0, atol=1e-11)
    part = 2e-3 if worn else 1e-9
    for name, force in second.reactions.items():
        scale = max(1.0, float(np.abs(force).max()))
        assert_allclose(first.reactions[name], force, rtol=0, atol=part * scale, err_msg=name)


def test_a_crank_driven_by_x_of_its_pin() -> None:
    """x = r cos phi + s(t) prescribes the angle; the force does I phi'' + m g r cos phi over the arm -r sin phi."""
    r, m, inertia, phi = 0.05, 0.7, 2e-3, 1.2
    crank = {"mass": m, "inertia": inertia, "cg": [r * math.cos(phi), r * math.sin(phi)]}
    tree = {
        "name": "m", "links": {"wall": {"fixed": True}, "crank": crank},
        "joints": {"O": {"kind": "turning", "links": ["crank", "wall"], "at": [0, 0]}},
        "drive": driven("crank", [1, 0]),
    }  # fmt: skip
    history, motion = run(parse_machine(tree), {}, duration=0.4, sample_rate=500.0, rtol=1e-10)
    t = history.t
    x, v, a = r * math.cos(phi) + swing(t), 0.01 * W * np.cos(W * t + 0.4), -0.01 * W * W * np.sin(W * t + 0.4)
    angle = np.arccos(x / r)
    rate = -v / (r * np.sin(angle))
    acceleration = -(a + r * rate**2 * np.cos(angle)) / (r * np.sin(angle))
    effort = (inertia + m * r * r) * acceleration + m * 9.81 * r * np.cos(angle)
    assert_allclose(motion.displacement[:, 1, 2], angle - phi, rtol=0, atol=1e-9)
    assert_allclose(motion.reactions["drive_effort"], -effort / (r * np.sin(angle)), rtol=1e-8)


def test_a_free_body_follows_along_and_not_across() -> None:
    """Along the direction m a and its share of the weight; across it falls."""
    body = {"mass": 2.0, "inertia": 0.3, "cg": [0.1, 0.2]}
    hold = {"kind": "mount", "link": "body", "at": [0, 0], "stiffness": [0, 0]}
    drive = driven("body", [0.6, 0.8], harmonics=[], speed=[[0, 1.0], [0.1, 3.0], [0.2, 0.0]])
    tree = {"name": "m", "links": {"wall": {"fixed": True}, "body": body}, "supports": [hold], "drive": drive}
    history, motion = run(parse_machine(tree), {}, duration=0.3, sample_rate=100.0)
    slope = np.select([history.t < 0.1 - 1e-9, history.t < 0.2 - 1e-9], [20.0, -30.0], 0.0)
    assert_allclose(motion.reactions["drive_effort"], 2.0 * (slope + 0.8 * 9.81), rtol=1e-11)
    across = motion.displacement[:, 1, :2] @ [-0.8, 0.6]
    assert_allclose(across, -0.6 * 9.81 * history.t**2 / 2, rtol=0, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_driven_frame_shakes_what_stands_on_it(axis: int) -> None:
    """As a floor that moves does, which begins where it was drawn, too: the head on its spring feels no difference."""
    direction = [float(axis == k) for k in range(2)]
    head = {"mass": 1.5, "inertia": 0.01, "cg": [0, 0.3]}
    spring = {"kind": "mount", "link": "head", "at": [0, 0.3], "stiffness": [900, 1600], "damping": [3, 5]}
    table = {"mass": 4.0, "inertia": 0.1, "cg": [0, 0], "locked": ["theta", "yx"[axis]]}
    floor = [
        {"displacement": [0.01 * part for part in direction], "frequency": 5.0, "phase": 0.4},
        {"over_time": [[0, *(-0.01 * math.sin(0.4) * part for part in direction)]]},
    ]
    trees: list[Tree] = [
        {"links": {"table": table, "head": head}, "supports": [{**spring, "to_link": "table"}],
         "drive": driven("table", direction)},
        {"links": {"wall": {"fixed": True}, "head": head}, "supports": [{**spring, "motion": floor}]},
    ]  # fmt: skip
    rest = {"velocities": {"head": {"velocity": [0, 0], "omega": 0}}}
    machines = [parse_machine({"name": "m", "initial": rest, **tree}) for tree in trees]
    first, second = (run(each, {}, duration=1.0, sample_rate=200.0, rtol=1e-10)[1] for each in machines)
    size = np.abs(second.displacement).max()
    assert_allclose(first.displacement[:, 1], second.displacement[:, 1], rtol=0, atol=1e-8 * size)
    assert_allclose(first.displacement[:, 0, axis], swing(np.arange(201) / 200.0), rtol=0, atol=1e-11)


def test_the_work_of_the_drive_is_all_that_comes_in() -> None:
    """A sprung frame, losses in its feet and in a journal: energy is what the force has done, less those."""
    machine = upright(driven("slider", [0, 1]), {"mass": 20, "inertia": 0.5, "cg": [0, 0]})
    history, motion = run(machine, {}, duration=0.4, sample_rate=20_000.0, rtol=1e-10)
    found = states(machine, motion)
    energy = np.array([state.energy({}) for state in found])
    power = motion.reactions["drive_effort"] * motion.velocity[:, 3, 1]
    rates = np.array([[state.velocity(0, (x, -0.1)) for x in (-0.2, 0.2)] for state in found])
    power -= (rates**2 @ [200, 300]).sum(axis=1)
    power -= 0.01 * (motion.velocity[:, 1, 2] - motion.velocity[:, 0, 2]) ** 2
    work = cumulative_simpson(power, x=history.t, initial=0)
    assert_allclose(energy - energy[0], work, rtol=0, atol=1e-9 * np.ptp(work))


def test_on_a_sprung_frame_it_comes_round_and_settles() -> None:
    """The position is that in space, whatever the frame does; a worn case starts settled and is seen to repeat."""
    machine = upright(driven("slider", [0, 1]), {"mass": 20, "inertia": 0.5, "cg": [0, 0]})
    assert repeating_frequency(machine, W) == pytest.approx(5.0)
    _, motion = run(machine, {}, duration=0.5, sample_rate=500.0)
    assert np.abs(motion.displacement[:, 0, 1]).max() > 1e-5
    assert_allclose(motion.displacement[:, 3, 1], swing(np.arange(251) / 500.0), rtol=0, atol=1e-9)
    settings = Settings(revolutions=30, sample_rate=2000.0, settled=True, repeating=True, motion=False, transient=False)
    history = simulate(machine, Case(Fault({"O": 1e-6})), settings)
    assert history.status is Status.OK and "as drawn" not in history.message
    assert history.period == 1


def test_the_suspension_goes_round_a_link_that_is_held_in_space() -> None:
    """A table that is driven up and down keeps swinging to and fro: one motion less, and the others as they are."""
    table = {"mass": 4.0, "inertia": 0.1, "cg": [0, 0]}
    legs = {"kind": "mount", "link": "table", "stiffness": [5e3, 7e3], "damping": [8, 8]}
    tree = {"name": "m", "links": {"table": table}, "supports": [{**legs, "at": [x, 0]} for x in (-0.3, 0.3)]}
    machine = parse_machine({**tree, "drive": driven("table", [0, 1])})
    assert find_remarks(machine) == []
    history = simulate(machine, {})
    decay = 2 * 8 / (2 * 4.0)  # of x; y is prescribed, and theta decays faster
    assert history.transient == pytest.approx(0.2 * math.ceil(math.log(100) / decay / 0.2))


def test_what_check_says() -> None:
    machine = upright(driven("slider", [0, 1]), {"mass": 20, "inertia": 0.5, "cg": [0, 0]})
    found = account(machine, HEALTHY)
    assert (found.freedoms, found.integrated) == (4, 3)
    assert found.closures[-1] == "slider.drive" and "slider.drive" in found.added
    assert find_remarks(machine) == []


def test_a_machine_file_round_trip() -> None:
    machine = upright(driven("slider", [0, 2]))
    assert machine.drive is not None and machine.drive.kind == "position"
    assert machine.drive.direction == (0.0, 1.0)
    assert parse_machine(machine.canonical_json()) == machine
    assert parse_machine(matrix_tree(machine)) == machine
    assert (machine.driven_link, machine.driven_joint) == ("slider", "")
    assert "PositionDrive" in machine_json_schema()["$defs"]


@pytest.mark.parametrize(
    ("drive", "line"),
    [
        (driven("frame", [0, 1]), "drive.link: frame: is fixed and cannot be driven"),
        (driven("slidr", [0, 1]), 'drive.link: slidr: is not a link of this machine; did you mean "slider"?'),
        (driven("slider", [0, 0]), "drive.direction: [0, 0]: must not be the zero vector"),
        (driven("slider", [1, 0]),
         "drive.link: slider: cannot be driven so from the drawn pose: a dead centre, or a direction in which it is "
         "held"),
        (driven("slider", [0, 1], harmonics=[{**SWING, "amplitude": -0.1}]),
         "drive.link: cannot be assembled at a drive travel of 29 mm: a little further link slider, driven, stays"),
        (driven("slider", [0, 1], harmonics=[], speed=0.2),
         "drive.link: cannot be assembled at a drive travel of 29 mm: a little further link slider, driven, stays"),
        ({**driven("slider", [0, 1]), "joint": "G"}, "drive.joint: G: unknown key"),
    ],
)  # fmt: skip
def test_refusals(drive: Tree, line: str) -> None:
    try:
        machine = upright(drive)
        check_assembly(machine)
        message = simulate(machine, {}, Settings(duration=0.5)).message
    except MachineError as error:
        message = str(error)
    assert line in message.removeprefix("machine: ")
    assert "\n" not in message


def test_a_locked_direction_is_refused() -> None:
    tree = tree_of("slider-crank")
    tree["links"]["slider"]["locked"] = ["y"]
    with pytest.raises(MachineError, match=r"drive\.direction: \[0, 1\]: is a direction in which slider is locked"):
        parse_machine({**tree, "drive": driven("slider", [0, 1])})


def test_as_drawn_at_a_dead_centre_it_is_refused_on_a_frame_that_could_give_way() -> None:
    """Its springs would let the frame follow in place of the crank: that is not what a drive is for."""
    drawn = tree_of("slider-crank")
    machine = parse_machine({**drawn, "drive": driven("slider", [1, 0])})
    with pytest.raises(MachineError, match=r"drive\.link: slider: cannot be driven so from the drawn pose"):
        check_assembly(machine)


def test_what_a_worn_pin_alone_would_let_follow_is_refused() -> None:
    """Where the ideal machine holds the link, its play is not there to be driven through."""
    tree = tree_of("slider-crank")
    machine = parse_machine({**tree, "drive": driven("rod", [1, 0])})
    with pytest.raises(MachineError, match=r"drive\.link: rod: cannot be driven so from the drawn pose"):
        start_of(machine, Case(Fault({"A": 1e-4, "B": 1e-4})))


@pytest.mark.parametrize("kind", ["phase", "perturbation"])
def test_starts_that_differ_by_where_a_driven_frame_is_are_refused(kind: Any) -> None:
    machine = upright(driven("frame", [0, 1]), {"mass": 20, "inertia": 0.5, "cg": [0, 0]})
    with pytest.raises(SettingsError, match=r"drive\.link: frame: starts differ by where the frame is"):
        simulate_ensemble(machine, Case(HEALTHY), Ensemble(starts=2, kind=kind))
    with pytest.raises(SettingsError, match=r"drive\.link: frame: runs differ by where the frame is"):
        measure(machine)
