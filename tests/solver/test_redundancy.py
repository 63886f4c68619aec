"""Machines that hold together more than there is to hold: parallel guides, parallel cranks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from oracle.dense import solve
from oracle.sketch import random_state

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.positions import change_point_remarks
from jointplay.solver.equations.links import LinkMotion, link_motion
from jointplay.solver.equations.model import build_model
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.fault import HEALTHY, Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.simulate import check_assembly, simulate

#: Places of the cranks' bearings, m: with all of them on a line the cranks have change points, else they have none.
LINE = ((0.0, 0.0), (0.2, 0.0), (0.45, 0.0))
TRIANGLE = ((0.0, 0.0), (0.2, 0.05), (0.45, -0.1))
WORN = {"B": 2e-4}


def crosshead(guides: int = 1, direction: tuple[float, float] = (1.0, 0.0), **guide: Any) -> Machine:
    """The slider-crank with more guides along its own; `guide` says more of the last one."""
    tree: dict[str, Any] = shipped_machine("slider-crank").model_dump(mode="json")
    for k in range(1, guides):
        at = [0.2 + 0.1 * k, 0.05]
        tree["joints"][f"G{k + 1}"] = {"kind": "sliding", "links": ["slider", "frame"], "at": at, "direction": [1, 0]}
    tree["joints"][f"G{guides}"] |= {"direction": list(direction), **guide}
    return parse_machine(tree)


def cranks(places: tuple[tuple[float, float], ...], longer: float = 0.0, angle: float = 63.0) -> Machine:
    """Parallel cranks of 60 mm that turn one rod, the first driven, the last one longer."""
    mass, length = {"mass": 0.3, "inertia": 1e-4}, [0.06] * len(places)
    length[-1] += longer
    tips = [
        (x + r * math.cos(math.radians(angle)), y + r * math.sin(math.radians(angle)))
        for (x, y), r in zip(places, length, strict=True)
    ]
    names = range(1, len(places) + 1)
    return parse_machine(
        {
            "name": "cranks",
            "links": {
                "bed": {"mass": 20, "inertia": 0.5, "cg": [0.1, 0]},
                "rod": {"mass": 0.8, "inertia": 4e-3, "cg": [tips[0][0] + 0.15, tips[0][1]]},
                **{f"crank{k}": {**mass, "cg": list(at)} for k, at in zip(names, tips, strict=True)},
            },
            "joints": {
                f"{kind}{k}": {"kind": "turning", "links": [f"crank{k}", other], "at": list(at)}
                for kind, other, points in (("O", "bed", places), ("A", "rod", tips))
                for k, at in zip(names, points, strict=True)
            },
            "drive": {"kind": "rotation", "joint": "O1", "speed": 30},
            "supports": [
                {"kind": "mount", "link": "bed", "at": [x, -0.1], "stiffness": [2e5, 4e5], "damping": [200, 300]}
                for x in (-0.1, 0.3)
            ],
        },
        "cranks",
    )


def without_the_last(machine: Machine) -> Machine:
    """Two cranks that move the frame as three do: the last one's mass on the bed, its inertia on the first.

    For a last crank whose centre of gravity is its bearing.
    """
    tree: dict[str, Any] = machine.model_dump(mode="json", exclude_none=True)
    at, bed, last = np.array(tree["joints"]["O3"]["at"]), tree["links"]["bed"], tree["links"].pop("crank3")
    del tree["joints"]["O3"], tree["joints"]["A3"]
    centre = (bed["mass"] * np.array(bed["cg"]) + last["mass"] * at) / (bed["mass"] + last["mass"])
    bed["inertia"] += bed["mass"] * math.dist(centre, bed["cg"]) ** 2 + last["mass"] * math.dist(centre, at) ** 2
    bed["mass"], bed["cg"] = bed["mass"] + last["mass"], centre.tolist()
    tree["links"]["crank1"]["inertia"] += last["inertia"]
    return parse_machine(tree, "two cranks")


def balanced(machine: Machine) -> Machine:
    """The last crank with its centre of gravity in its bearing."""
    at = machine.joints["O3"].at
    links = {**machine.links, "crank3": machine.links["crank3"].model_copy(update={"cg": at})}
    return machine.model_copy(update={"links": links})


def frame_of(machine: Machine, fault: dict[str, float], **settings: Any) -> Any:
    """Motion of the frame at one point, whichever link data the machine has; accelerations (n, 3) and all else."""
    history = simulate(machine, Case(Fault(fault)), Settings(**{"duration": 0.3, "motion": True, **settings}))
    assert history.status is Status.OK, history.message
    return history


@pytest.mark.parametrize("guides", [2, 3])
def test_further_guides_along_the_first_change_nothing(guides: int) -> None:
    one, more = frame_of(crosshead(), {}), frame_of(crosshead(guides), {})
    assert np.array_equal(one.displacement, more.displacement)
    assert np.array_equal(one.acceleration, more.acceleration)
    sizes = account(crosshead(guides), HEALTHY)
    why = "repeats G1: how they share the load is open, the frame does not feel it"
    names = [f"G{k}" for k in range(2, guides + 1)]
    left = {out.what: out.why for out in sizes.left_out}
    assert [left[f"normal force of {name}"] for name in names] == [f"{name} {why}" for name in names]
    assert sizes.open_reactions == ("G1", *names)
    assert sizes.closures == account(crosshead(), HEALTHY).closures


def test_a_second_guide_changes_nothing_where_the_gudgeon_pin_is_worn() -> None:
    """The same equations in another order: impacts make the difference of rounding grow, to 1e-9 in 50 ms."""
    one, more = (frame_of(crosshead(k), WORN, duration=0.05, accuracy="reference") for k in (1, 2))
    assert np.abs(one.displacement - more.displacement).max() < 1e-7 * np.abs(one.displacement).max()


def test_guides_of_the_same_links_rub_as_one() -> None:
    rubbing = crosshead(2, friction=0.1, friction_velocity=0.01)
    rule = r"joints\.G2\.friction: 0\.1: must be the friction of G1, 0: both guide the same links, and rub as one"
    with pytest.raises(AssemblyError, match=rule):
        build_model(rubbing)
    joints = {**rubbing.joints, "G1": rubbing.joints["G1"].model_copy(update={"friction": 0.1})}
    both, one = rubbing.model_copy(update={"joints": joints}), crosshead(1, friction=0.1)
    assert np.array_equal(frame_of(both, {}).displacement, frame_of(one, {}).displacement)


def test_friction_without_a_normal_force_is_refused() -> None:
    """A slider that a fixed link locks: what presses the guide is open."""
    machine = crosshead(1, friction=0.1)
    links = {**machine.links, "slider": machine.links["slider"].model_copy(update={"locked": ("y",)})}
    frame = links["frame"].model_copy(update={"fixed": True})
    with pytest.raises(AssemblyError, match=r"joints\.G1\.friction: 0\.1: no force to rub by: how G1, slider"):
        build_model(machine.model_copy(update={"links": {**links, "frame": frame}}))


def test_reactions_that_are_open_are_marked() -> None:
    motion = frame_of(crosshead(2), {}, links=True, duration=0.01).links
    assert motion.open == ("normal_G1", "normal_G2", "couple_G1", "couple_G2")
    alone = frame_of(crosshead(), {}, links=True, duration=0.01).links
    assert alone.open == ()
    assert not motion.reactions["normal_G2"].any()
    assert np.array_equal(motion.reactions["normal_G1"], alone.reactions["normal_G1"])


@pytest.mark.parametrize("places", [LINE, TRIANGLE])
def test_three_cranks_move_the_frame_as_two_do(places: tuple[tuple[float, float], ...]) -> None:
    """Cranks on a line pass a change point on the way. What is left follows the tolerance: at 1e-9 it is 4e-8, up to
    1e-7 as sums are rounded.
    """
    three = balanced(cranks(places))
    two = without_the_last(three)
    histories = [frame_of(machine, {}, accuracy="reference") for machine in (three, two)]
    # Compared at one point of the bed: the centre of gravity is another one.
    shift = np.subtract(two.links["bed"].cg, three.links["bed"].cg)
    moved = histories[0].displacement.copy()
    turn = moved[:, 2]
    moved[:, 0] += (np.cos(turn) - 1) * shift[0] - np.sin(turn) * shift[1]
    moved[:, 1] += np.sin(turn) * shift[0] + (np.cos(turn) - 1) * shift[1]
    largest = np.abs(histories[1].displacement).max(axis=0)
    assert (np.abs(moved - histories[1].displacement).max(axis=0) < 3e-7 * largest).all()
    sizes = account(three, HEALTHY)
    assert sizes.open_reactions == ("O1", "O2", "O3", "A1", "A2", "A3")
    assert sizes.freedoms == 4
    assert any("1 of their equations follow from the others" in out.why for out in sizes.left_out)


def agree(machine: Machine, clearances: dict[str, float], t: float, motion: LinkMotion, k: int) -> None:
    """Accelerations of all links are those of the dense equations; least squares have no choice in them."""
    drawn = np.array([(*link.cg, 0.0) for link in machine.links.values()])
    at, rate = motion.displacement[k] + drawn, motion.velocity[k]
    dense = solve(machine, clearances, t, at, rate, redundant=not clearances)
    gap = np.abs(motion.acceleration[k] - dense.accelerations)
    assert gap[:, :2].max() < 1e-10 * dense.scale[0]  # as for random machines; seen: 2e-15
    assert gap[:, 2].max() < 1e-10 * dense.scale[1]


@pytest.mark.parametrize("places", [LINE, TRIANGLE])
def test_three_cranks_agree_with_the_dense_equations(places: tuple[tuple[float, float], ...]) -> None:
    machine = cranks(places)
    model = build_model(machine)
    assert model.repeats.shared == 1
    p, compared = model.vector({}), 0
    for scene in (random_state(model, p, seed) for seed in range(12)):
        if scene is not None:
            t, z, v = scene
            agree(machine, {}, t, link_motion(model, p, np.array([t]), z[None], v[None]), 0)
            compared += 1
    assert compared >= 6


@pytest.mark.parametrize("places", [LINE, TRIANGLE])
@pytest.mark.parametrize("joint", ["A3", "O2"])
def test_a_worn_crank_of_three_runs(places: tuple[tuple[float, float], ...], joint: str) -> None:
    """Once a pin has play nothing is held twice; at 117 deg two cranks on a line are at a change point."""
    machine = cranks(places)
    history = frame_of(machine, {joint: 1e-4}, links=True, duration=0.25)
    assert history.links.open == ()
    lagging = history.links.displacement[:, list(machine.links).index("crank3"), 2]
    assert np.abs(lagging - 30.0 * history.t - history.displacement[:, 2]).max() < 0.01  # 0.1 mm of 60 mm and more
    for k in range(0, len(history.t), 500):
        agree(machine, {joint: 1e-4}, history.t[k], history.links, k)


@pytest.mark.parametrize("worn", [(), ("A3",), ("O2",)])
def test_cranks_on_a_line_are_told_of_their_change_points(worn: tuple[str, ...]) -> None:
    lines = change_point_remarks(cranks(LINE), worn, {})
    told = " passes a change point at a drive angle of {} deg: crank3 turns 1 times as fast as the drive if it goes on"
    assert [told.format(angle) in line for angle, line in zip(("117.0", "297.0"), lines, strict=True)] == [True, True]
    assert change_point_remarks(cranks(TRIANGLE), worn, {}) == []


@pytest.mark.parametrize(
    ("machine", "joint"),
    [
        (crosshead(2, (math.cos(0.02), math.sin(0.02))), "G2"),
        (crosshead(2, (1.0, 1e-6)), "G2"),
        (cranks(LINE, longer=1e-3), "A[23]"),
    ],
)
def test_a_joint_that_does_not_fit_is_refused_with_its_gap(machine: Machine, joint: str) -> None:
    """It fits as drawn, and may even let go to first order; a little further it does not."""
    rule = rf"joints\.{joint}: cannot be assembled at a drive angle of [0-9.]+ deg: a little further joint {joint} "
    with pytest.raises(AssemblyError, match=rule + r"stays [0-9.e-]+ [mu]m open"):
        check_assembly(machine)


def test_an_equilibrium_does_not_mind_a_second_guide() -> None:
    still = {"pose": "equilibrium"}
    trees = [crosshead(k).model_dump(mode="json") | {"initial": still} for k in (1, 2)]
    one, two = (frame_of(parse_machine(tree), {}, duration=0.01) for tree in trees)
    assert one.displacement[0] == pytest.approx(two.displacement[0], abs=1e-15)
