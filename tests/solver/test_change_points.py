"""Change points between the positions of a walk: what does not pass is refused, what passes says how."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from extremes.scenes import equal_legs, four_bar
from laws import run

from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.positions import change_point_remarks
from jointplay.solver.cases.start import walk
from jointplay.solver.equations.links import link_motion
from jointplay.solver.equations.model import build_model
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import check_assembly, simulate

CRANK, COUPLER, ROCKER, BASE = 0.06, 0.12, 0.14, 0.20
#: Crank angle as drawn, rad: the change point, at 180 deg, is between two positions of the walk.
DRAWN = 1.0


def grashof(short: float) -> Machine:
    """Crank and bed, the shortest and the longest link, are together longer by `short` than coupler and rocker, m."""
    return four_bar(CRANK, COUPLER, ROCKER - short, BASE, DRAWN)


def lined_up(short: float) -> float:
    """Drive angle at which coupler and rocker come to lie on one line, deg: the law of cosines."""
    reach = COUPLER + ROCKER - short
    return math.degrees(math.acos((CRANK**2 + BASE**2 - reach**2) / (2 * CRANK * BASE)) - DRAWN)


def numbers(line: str, text: str) -> float:
    found = re.search(text.replace("#", "([-0-9.e]+)"), line)
    assert found is not None, line
    return float(found[1])


def angles_of(machine: Machine) -> dict[str, np.ndarray]:
    """By link: how far it has turned at 120 positions of the drive, rad."""
    model = build_model(machine)
    p = model.vector({})
    poses = walk(model, p, p[model.parameters.index("drive.speed")], 120)
    t, z = np.array([at for at, _ in poses]), np.array([pose for _, pose in poses])
    return dict(zip(machine.links, link_motion(model, p, t, z, np.zeros_like(z)).displacement[:, :, 2].T, strict=True))


@pytest.mark.parametrize("short", [1e-9, 1e-6, 3e-6, 1e-5])
@pytest.mark.parametrize("worn", [(), ("A",), ("A", "B")])
def test_a_machine_that_just_does_not_turn_is_refused(short: float, worn: tuple[str, ...]) -> None:
    """It fails within a tenth of a degree to one and a half, where no position of the walk is."""
    with pytest.raises(AssemblyError) as refusal:
        change_point_remarks(grashof(short), worn, {})
    line = str(refusal.value)
    assert numbers(line, "at a drive angle of # deg") == pytest.approx(lined_up(short), abs=0.051)
    assert numbers(line, "stays # um open") == pytest.approx(short * 1e6, rel=1e-3)


def test_a_run_of_such_a_machine_is_refused_before_it_starts() -> None:
    history = simulate(grashof(1e-6), Case(), Settings(duration=0.1))
    assert history.status is Status.CANNOT_ASSEMBLE
    assert "a drive angle of 122.3 deg: a little further joint B stays 1 um open" in history.message


@pytest.mark.parametrize("beyond", [1e-9, 1e-6, 1e-5])
@pytest.mark.parametrize("worn", [(), ("A",), ("A", "B")])
def test_a_machine_that_just_turns_is_told_how_near_it_comes(beyond: float, worn: tuple[str, ...]) -> None:
    (line,) = change_point_remarks(grashof(-beyond), worn, {})
    assert numbers(line, "a change point at a drive angle of # deg") == pytest.approx(
        180 - math.degrees(DRAWN), abs=0.051
    )
    assert numbers(line, "comes within # um") == pytest.approx(beyond * 1e6, rel=1e-3)
    assert line.startswith("without clearance the machine" if worn else "the machine")


def test_one_that_misses_it_by_more_than_parts_are_made_to_is_told_nothing() -> None:
    assert change_point_remarks(grashof(-1e-4), (), {}) == []


@pytest.mark.parametrize("beyond", [1e-8, 1e-6, 1e-5])
def test_positions_stay_on_the_way_that_a_run_takes(beyond: float) -> None:
    """Next to a change point links change their speeds within a degree; further on, the other branch is far away."""
    machine = grashof(-beyond)
    history, motion = run(machine, {}, duration=2 * math.pi / 30, sample_rate=20_000)
    walked = angles_of(machine)
    for link in ("coupler", "rocker"):
        turned = np.diff(motion.displacement[:, [0, motion.links.index(link)], 2]).ravel()
        at = np.interp(np.arange(120) * math.pi / 60 / 30, history.t, turned)
        # Straight between samples of 0.09 deg; the other branch is 2 rad away.
        assert np.abs(at - walked[link]).max() < 1e-4


def test_a_parallelogram_says_its_branch_and_takes_it() -> None:
    """Crossed, the rocker turns against the crank by the ratio of base less crank to base plus crank, and back."""
    machine = four_bar(CRANK, BASE, CRANK, BASE, DRAWN)
    history, motion = run(machine, {}, duration=2 * math.pi / 30, sample_rate=2000)
    crossed = (BASE - CRANK) / (BASE + CRANK)
    lines = history.message.split("; ")
    assert lines == [
        f"the machine passes a change point at a drive angle of {angle - math.degrees(DRAWN):.1f} deg: rocker turns 1 "
        f"times as fast as the drive if it goes on as it came, {other:.3g} on the other branch, onto which errors of a "
        "run can bring it"
        for angle, other in ((180, -crossed), (360, -1 / crossed))
    ]
    assert motion.velocity[:, motion.links.index("rocker"), 2] == pytest.approx(30, abs=0.1)


def test_a_crossed_parallelogram_goes_on_crossed() -> None:
    """As far as its positions are walked; a run may leave it."""
    machine = four_bar(CRANK, BASE, CRANK, BASE, -DRAWN)
    first, second = change_point_remarks(machine, (), {})
    assert "rocker turns -1.86 times as fast as the drive if it goes on as it came, 1 on the other" in first
    assert "rocker turns -0.538 times as fast as the drive if it goes on as it came, 1 on the other" in second
    # The tangents of half its angle and of half the crank's are in the ratio of the first.
    crank, ratio = np.arange(120) * math.pi / 60 - DRAWN, (BASE + CRANK) / (BASE - CRANK)
    rocker = -2 * np.arctan2(ratio * np.sin(crank / 2), np.cos(crank / 2))
    assert np.abs(angles_of(machine)["rocker"] - (rocker - rocker[0])).max() < 1e-6


def test_a_rod_as_long_as_its_crank() -> None:
    tree = equal_legs()
    for line, angle in zip(change_point_remarks(parse_machine(tree), (), {}), (90, 270), strict=True):
        assert f"at a drive angle of {angle:.1f} deg: rod turns -1 times as fast" in line
        assert "if it goes on as it came, 1 on the other branch" in line
    tree["joints"]["B"]["at"] = tree["joints"]["G1"]["at"] = [0.1 - 1e-6, 0.05]
    with pytest.raises(
        AssemblyError, match=r"at a drive angle of 89\.6 deg: a little further joint G1 stays 1 um open"
    ):
        check_assembly(parse_machine(tree))


def driven_slide(longer: float, speed: float = -0.1) -> Machine:
    """The same, driven at its slider, drawn with the crank at 45 deg; the rod longer than it."""
    tree: dict[str, Any] = equal_legs()
    c = 0.05 / math.sqrt(2)
    tree["joints"]["A"]["at"] = [c, 0.05 + c]
    place = [c + math.sqrt((0.05 + longer) ** 2 - c**2), 0.05]
    tree["joints"]["B"]["at"] = tree["joints"]["G1"]["at"] = tree["links"]["slider"]["cg"] = place
    tree["drive"] = {"kind": "translation", "joint": "G1", "speed": speed}
    return parse_machine(tree)


def test_a_slide_passes_one_too() -> None:
    """The slider reaches the shaft only if both are equally long; there the crank could turn without it."""
    history = simulate(driven_slide(0.0), Case(), Settings(duration=0.8, sample_rate=2000))
    assert history.message == (
        "the machine passes a change point at a drive travel of -70.7 mm: it goes on as it came, not on the branch on "
        "which the drive stands"
    )
    for longer in (1e-6, -1e-6):
        refused = simulate(driven_slide(longer), Case(), Settings(duration=0.8))
        assert refused.status is Status.CANNOT_ASSEMBLE
        assert "at a drive travel of -70.7 mm: a little further joint G1 stays 1 um open" in refused.message
        # It may go up to there.
        assert simulate(driven_slide(longer), Case(), Settings(duration=0.7)).message == ""


def test_a_link_that_swings_freely_does_not_hide_it() -> None:
    for short, found in ((1e-6, None), (-1e-6, "comes within 1 um")):
        tree: dict[str, Any] = grashof(short).model_dump(mode="json")
        x, y = tree["joints"]["B"]["at"]
        tree["links"]["pendulum"] = {"mass": 0.1, "inertia": 1e-4, "cg": [x, y - 0.05]}
        tree["joints"]["P"] = {"kind": "turning", "links": ["pendulum", "coupler"], "at": [x, y]}
        if found:
            assert found in change_point_remarks(parse_machine(tree), (), {})[0]
        else:
            with pytest.raises(AssemblyError, match="joint B stays 1 um open"):
                check_assembly(parse_machine(tree))


@pytest.mark.parametrize("name", ["four-bar", "quick-return", "slider-crank"])
def test_machines_that_ship_come_near_none(name: str) -> None:
    machine = shipped_machine(name)
    for worn in ((), machine.turning_joints[:1], machine.turning_joints):
        assert change_point_remarks(machine, worn, {}) == []


def test_a_run_of_a_worn_machine_says_what_the_ideal_one_does() -> None:
    message = simulate(grashof(-1e-6), Case(Fault({"A": 1e-4})), Settings(duration=0.05)).message
    assert message.startswith("without clearance the machine comes within 1 um of a change point at a drive angle of")
