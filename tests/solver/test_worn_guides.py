"""Clearance of guides: a block between two walls against closed forms, conservation laws and the guide without play."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from laws import Tree, states, tree_of

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.history import History
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault, parse_fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.machines.restitution import effective_restitution
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.simulate import simulate

G = 9.81
MASS, INERTIA, LENGTH = 2.0, 0.01, 0.2
STIFF = {"stiffness": 1e6, "damping": 0.0, "friction": 0.0}
METHODS = pytest.mark.parametrize("method", ["adaptive", "gill"])


def block(
    contact: Tree, cg: tuple[float, float] = (0.0, 0.0), slope: float = 0.0, height: float = 0.0, **more: Any
) -> Machine:
    """A block of 2 kg in a guide of the fixed bed; its centre of gravity in its own axes."""
    c, s = math.cos(slope), math.sin(slope)
    place = [c * cg[0] - s * cg[1], s * cg[0] + c * cg[1]]
    guide = {
        "kind": "sliding", "links": ["block", "bed"], "at": [0, 0], "direction": [c, s],
        "length": LENGTH, "height": height, "contact": contact,
    }  # fmt: skip
    links = {"bed": {"fixed": True}, "block": {"mass": MASS, "inertia": INERTIA, "cg": place}}
    return parse_machine({"name": "block", "links": links, "joints": {"G": guide}} | more)


def run(machine: Machine, clearance: float, duration: float, **more: Any) -> History:
    settings = Settings(duration=duration, links=True, **{"sample_rate": 20_000, **more})
    found = simulate(machine, Case(Fault({"G": clearance})), settings)
    assert found.status == "ok", found.message
    return found


def displacement(history: History) -> np.ndarray:
    """Of the block, (n, 3)."""
    assert history.links is not None
    return history.links.displacement[:, 1]


@METHODS
@pytest.mark.parametrize("height", [0.0, 0.05])
def test_a_block_falls_freely_and_bounces_without_loss(method: str, height: float) -> None:
    """c = g t^2 / 2 to the wall without any force; then two corners push it back to where it came from."""
    clearance = 2e-3
    history = run(block(STIFF, height=height), clearance, 0.2, method=method, accuracy="reference")
    y, t = displacement(history)[:, 1], history.t
    falling = t < math.sqrt(2 * clearance / G)
    assert y[falling] == pytest.approx(-G * t[falling] ** 2 / 2, abs=1e-12)
    # m g (c + d) = 2 K d^2 / 2 at the deepest point.
    weight, stiffness = MASS * G, 2 * 1e6
    deepest = (weight + math.sqrt(weight**2 + 2 * stiffness * weight * clearance)) / stiffness
    assert y.min() == pytest.approx(-clearance - deepest, rel=1e-4)
    assert y[t > 0.02].max() == pytest.approx(0.0, abs=1e-6)
    assert np.abs(displacement(history)[:, ::2]).max() < 1e-12


@pytest.mark.parametrize("law", ["hunt-crossley", "flores", "gonthier", "lankarani-nikravesh"])
def test_it_bounces_with_the_restitution_of_its_law(law: str) -> None:
    """After the first impact it rises to e'^2 of the height it fell from; the corners remember how fast they came."""
    clearance, asked = 5e-3, 0.7
    history = run(block({"law": law, "stiffness": 1e13, "restitution": asked, "friction": 0}), clearance, 0.12)
    assert history.links is not None
    rising = history.links.velocity[:, 1, 1] > 0
    top = displacement(history)[np.argmax(rising) :, 1].max() + clearance
    assert top == pytest.approx(effective_restitution(law, asked) ** 2 * clearance, rel=2e-3)


@METHODS
@pytest.mark.parametrize("cg", [0.0, 0.06, 0.16])
def test_where_it_comes_to_rest(cg: float, method: str) -> None:
    """Corners share the weight as a beam's supports do: both below, or one below and one above where it tilts.

    Nothing holds the block along the line, so its centre of gravity stays where it is.
    """
    machine = block(STIFF | {"damping": 500.0}, cg=(cg, 0.0))
    history = run(machine, 1e-4, 1.0, method=method, accuracy="reference", sample_rate=4000)
    near, far = (MASS * G * (0.5 + sign * cg / LENGTH) for sign in (1, -1))
    ends = [-math.copysign(1e-4 + abs(force) / 1e6, force) for force in (far, near)]
    tilt = math.asin((ends[1] - ends[0]) / LENGTH)
    x, y, theta = displacement(history)[-1]
    assert theta == pytest.approx(tilt, abs=1e-9)
    assert y == pytest.approx(sum(ends) / 2 + cg * math.sin(tilt), abs=1e-10)
    assert x == pytest.approx(0.0, abs=1e-12)
    assert history.links is not None
    assert history.links.reactions["normal_G"][-1] == pytest.approx(MASS * G, rel=1e-4)
    assert history.links.reactions["couple_G"][-1] == pytest.approx(MASS * G * cg * math.cos(tilt), rel=1e-4, abs=1e-4)


def test_energy_is_kept_without_losses() -> None:
    """A block that rattles between the walls, tilted by its centre of gravity, and slides down the slope meanwhile."""
    machine = block(STIFF, cg=(0.03, 0.02), slope=0.3, height=0.04)
    history = run(machine, 5e-4, 0.3, rtol=1e-10)
    assert history.links is not None
    normal = history.links.reactions["normal_G"]
    assert np.count_nonzero(np.diff((normal != 0).astype(int)) > 0) > 20
    energy = np.array([state.energy({"G": 5e-4}) for state in states(machine, history.links, every=7)])
    assert np.ptp(energy) < 1e-8 * MASS * G * np.ptp(displacement(history)[:, 1])


def test_momentum_is_kept_through_impacts_and_friction() -> None:
    """Two free links, one rattling and rubbing in the guide of the other: forces meet at one point."""
    tree = block({"stiffness": 1e6, "damping": 100.0, "friction": 0.3, "friction_law": "bristle"}, (0.01, 0.02),
                 slope=0.4, height=0.03).model_dump(mode="json", exclude_none=True)  # fmt: skip
    tree["links"]["bed"] = {"mass": 5.0, "inertia": 0.05, "cg": [-0.1, -0.2]}
    tree |= {"gravity": 0, "frame": "bed", "initial": {"velocities": {"bed": {"omega": 3, "velocity": [0.1, 0.2]}}}}
    machine = parse_machine(tree)
    history = run(machine, 2e-4, 0.4, sample_rate=5000)
    assert history.links is not None
    turning, momentum = [], []
    for state in states(machine, history.links):
        momentum.append(state.momentum[:2])
        turning.append(state.momentum[2])
    assert np.ptp(momentum, axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(turning) < 1e-9 * abs(turning[0])
    normal = history.links.reactions["normal_G"]
    assert np.count_nonzero(np.diff((normal != 0).astype(int)) > 0) > 3


@pytest.mark.parametrize("method", ["adaptive", "gill"])
def test_friction_of_the_corners_holds_a_block_on_a_slope(method: str) -> None:
    """mu 0.5 at 20 degrees, where the tangent is 0.364: it falls on the wall, and stays there without a micrometre."""
    contact = {"stiffness": 1e6, "damping": 500.0, "friction": 0.5, "friction_law": "bristle"}
    machine = block(contact, slope=math.radians(20), height=0.03)
    place = displacement(run(machine, 1e-4, 2.0, sample_rate=1000, method=method))
    assert np.ptp(np.hypot(place[500:, 0], place[500:, 1])) < 1e-8
    assert math.hypot(*place[-1, :2]) < 1e-3


def test_a_block_slides_down_what_friction_cannot_hold() -> None:
    """g (sin a - mu cos a) once it lies on the wall; its centre of gravity is on the line of the corners."""
    slope, mu = math.radians(20), 0.2
    contact = {"stiffness": 1e6, "damping": 500.0, "friction": mu, "friction_law": "bristle"}
    history = run(block(contact, slope=slope), 1e-4, 1.0, sample_rate=1000)
    assert history.links is not None
    speed = np.hypot(*history.links.velocity[:, 1, :2].T)
    gained = (speed[-1] - speed[500]) / (history.t[-1] - history.t[500])
    assert gained == pytest.approx(G * (math.sin(slope) - mu * math.cos(slope)), rel=1e-4)


def crank(length: float = 0.06, **contact: Any) -> Machine:
    """The slider-crank that ships, with a block in its guide."""
    tree = tree_of("slider-crank")
    tree["joints"]["G1"] |= {"length": length, "height": 0.03, "contact": contact}
    return parse_machine(tree)


def test_little_play_between_hard_walls_is_none() -> None:
    """The frame's velocity tends to that of the guide without clearance, with the clearance."""
    machine = crank(stiffness=1e9, damping=3e4, friction=0.0)
    settings = Settings(duration=0.3, sample_rate=5000)
    ideal, *worn = (
        simulate(machine, Case(Fault({"G1": c} if c else {})), settings).velocity for c in (0, 1e-4, 1e-5, 1e-6)
    )
    away = [float(np.abs(each - ideal)[:, :2].max() / np.abs(ideal[:, :2]).max()) for each in worn]
    assert away[0] > 3 * away[1] > 9 * away[2]
    assert away[2] < 2e-3


@pytest.mark.parametrize("fault", ["G1=0.2mm", "B=0.1mm,G1=0.2mm", "A=0.1mm,B=0.1mm,G1=0.05mm,O=0.1mm"])
def test_methods_agree_on_a_worn_guide(fault: str) -> None:
    """Fixed and error-controlled steps, and the whole system of equations, until impacts part them."""
    machine = crank(friction=0.1, friction_law="tanh", friction_velocity=0.01)
    case = Case(parse_fault(fault, machine))
    options = [{"rtol": 1e-10}, {"method": "gill", "step": 5e-7}, {"method": "full", "step": 5e-7}]
    fine, gill, full = (simulate(machine, case, Settings(duration=0.01, sample_rate=5000, **each)) for each in options)
    assert fine.status == gill.status == full.status == "ok"
    size = np.abs(fine.velocity).max(axis=0)
    assert (np.abs(gill.velocity - fine.velocity) / size).max() < 1e-3
    assert (np.abs(full.velocity - gill.velocity) / size).max() < 1e-7


@pytest.mark.parametrize(
    "drive",
    [
        {"kind": "translation", "joint": "G", "harmonics": [{"frequency": 5.0, "amplitude": 0.02}]},
        {"kind": "force", "joint": "G", "force": 3.0},
    ],
)
def test_a_drive_along_a_worn_guide(drive: Tree) -> None:
    """The travel is that along the line, whatever the block does across it; so is the force."""
    machine = block(STIFF | {"damping": 200.0}, cg=(0.02, 0.0), drive=drive)
    history = run(machine, 1e-3, 0.4, sample_rate=2000)
    x, y, theta = displacement(history).T
    t = history.t
    if drive["kind"] == "force":
        assert x == pytest.approx(3.0 / MASS * t**2 / 2, abs=1e-9)
    else:
        assert x + 0.02 * (1 - np.cos(theta)) == pytest.approx(0.02 * np.sin(10 * math.pi * t), abs=1e-9)
    assert y.min() < -1e-3


def test_the_account_is_complete() -> None:
    for machine, fault in ((crank(), {"G1": 1e-4}), (crank(), {"G1": 1e-4, "B": 1e-4}), (block(STIFF), {"G": 1e-4})):
        sizes = account(machine, Fault(fault))
        kept = len(sizes.coordinates) + len(sizes.closures) + sum(out.unknowns for out in sizes.left_out)
        assert kept == sizes.full_unknowns + len(sizes.added)
        assert set(fault) <= set(sizes.clearance_joints)


def test_starting_in_equilibrium() -> None:
    """The block stands on the line of its guide, as pins do in their sockets; then it falls."""
    held = {"kind": "translation", "joint": "G", "speed": 0.0}
    history = run(block(STIFF, drive=held, initial={"pose": "equilibrium"}), 1e-3, 0.01)
    assert displacement(history)[0] == pytest.approx(0.0, abs=1e-12)
    assert displacement(history)[-1, 1] == pytest.approx(-G * 0.01**2 / 2, rel=1e-6)


def test_a_tight_guide_beside_it_leaves_no_play() -> None:
    """Two guides of the same links: with one worn, the other holds as both did."""
    tree = tree_of("slider-crank")
    tree["joints"]["G2"] = tree["joints"]["G1"] | {"at": [0.1, 0.05], "length": 0.05}
    machine = parse_machine(tree)
    settings = Settings(duration=0.05, sample_rate=5000)
    both, one = (simulate(machine, Case(Fault(fault)), settings) for fault in ({}, {"G2": 1e-4}))
    assert both.status == one.status == "ok"
    assert one.velocity == pytest.approx(both.velocity, abs=1e-9)
    assert (both.message, one.message) == ("", "clearance of G2 is without effect: other joints leave it no play")


def test_friction_of_the_guide_is_that_of_its_contact_once_it_is_worn() -> None:
    tree = tree_of("slider-crank")
    tree["joints"]["G1"] |= {"length": 0.06, "friction": 0.3, "friction_velocity": 0.01, "viscous": 50.0}
    machine = parse_machine(tree)
    tree["joints"]["G1"] |= {"friction": 0.0, "viscous": 0.0}
    fault, settings = Case(Fault({"G1": 1e-4})), Settings(duration=0.02, sample_rate=5000)
    rubbing, smooth = (simulate(each, fault, settings).velocity for each in (machine, parse_machine(tree)))
    assert np.array_equal(rubbing, smooth)
    # Numbers of the ideal guide are without effect there, those of the contact while it is ideal.
    worn, ideal = {"joints.G1.friction": 0.1}, {"joints.G1.contact.friction": 0.1}
    more = simulate(machine, Case(fault.fault, worn), settings).velocity
    assert np.array_equal(more, rubbing)
    linked = Settings(duration=0.02, sample_rate=5000, links=True)
    found = [simulate(machine, Case(Fault({}), each), linked).links for each in ({}, ideal, worn)]
    efforts = [each.reactions["drive_effort"] for each in found if each is not None]
    assert np.array_equal(efforts[0], efforts[1])
    assert not np.allclose(efforts[0], efforts[2], rtol=0.01)
    other = simulate(machine, Case(fault.fault, ideal), settings).velocity
    assert not np.array_equal(other, rubbing)


def test_clearance_of_a_file_is_its_fault() -> None:
    machine = crank()
    tree = machine.model_dump(mode="json")
    tree["joints"]["G1"]["clearance"] = "0.2 mm"
    filed = parse_machine(tree)
    assert filed.clearances == {"G1": pytest.approx(2e-4)}
    assert parse_fault(None, filed) == Fault({"G1": 2e-4})
    assert filed.without_clearances() == machine
    assert parse_machine(filed.canonical_json()) == filed


def test_a_file_that_says_nothing_of_a_block_keeps_its_key() -> None:
    """As it was before a file could; the guide has no contact in it."""
    machine = shipped_machine("slider-crank")
    key = "3562afd0833bbf108c727f4ebb5b2fe723a62709b78827eadb436ef00bebaf23"
    assert machine.content_key == key
    assert machine.wearing_joints == machine.turning_joints


@pytest.mark.parametrize(
    ("said", "line"),
    [
        ({"clearance": "0.1 mm"}, "joints.G1.length: is missing: clearance is that of a block of this length"),
        ({"contact": {"friction": 0.1}}, "joints.G1.length: is missing: contact is that of a block of this length"),
        ({"height": 0.1}, "joints.G1.length: is missing: height is that of a block of this length"),
        ({"length": 0}, "joints.G1.length: 0: must be greater than 0"),
        ({"length": "80 g"}, 'joints.G1.length: 80 g: "g" is a mass, must be a length, for example "0.2 mm"'),
        ({"length": 0.1, "clearance": 0}, "joints.G1.clearance: 0: must be greater than 0"),
        (
            {"length": 0.1, "contact": {"law": "flores", "stiffness": 1e9}},
            "joints.G1.contact.restitution: is missing; law flores needs it",
        ),
        (
            {"length": 0.1, "contact": {"law": "flores", "stiffness": "1 kN/mm", "restitution": 0.5}},
            "joints.G1.contact.stiffness: 1 kN/mm: must be a plain number: "
            "with this law it is in N/m^n, n the exponent",
        ),
    ],
)
def test_refusals_of_a_file(said: Tree, line: str) -> None:
    tree = tree_of("slider-crank")
    tree["joints"]["G1"] |= said
    with pytest.raises(MachineError) as refusal:
        parse_machine(tree, "my.yaml")
    assert str(refusal.value) == f"my.yaml: {line}"


@pytest.mark.parametrize(
    ("path", "rule"),
    [
        ("joints.G1.pin_radius", "no such number"),
        ("joints.G1.contact.exponent", "no such number"),
        ("joints.G1.contact.hysteresis", "the contact law of this joint has no hysteresis"),
    ],
)
def test_refusals_of_a_case(path: str, rule: str) -> None:
    with pytest.raises(MachineError, match=rule):
        simulate(crank(), Case(Fault({"G1": 1e-4}), {path: 2.0}))
