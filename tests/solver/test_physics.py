"""Laws that hold whatever the equations look like: energy, momentum, limits, frames of reference.

Nothing here knows a right answer of a case; energies and momenta are computed from the motion of all links by hand.
"""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
from laws import Array, Tree, drawn, impacts, run, states, tree_of
from scipy.integrate import cumulative_simpson

from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine

METHODS = pytest.mark.parametrize("method", ["gill", "adaptive"])


# Energy ---------------------------------------------------------------------------------------------------------------


def lossless(drive: Tree) -> Machine:
    """The slider-crank without dampers, contact damping or friction."""
    tree = tree_of("slider-crank", damping=0.0, friction=0.0)
    tree["drive"] = drive
    for support in tree["supports"]:
        support["damping"] = [0.0, 0.0]
    return parse_machine(tree)


@pytest.mark.parametrize(
    # Largest drift of 21 J; measured 1.2e-7 J at 1 us (1.0e-2 of a radian of the contact), 7e-8 and 1e-9 J.
    ("settings", "drift"),
    [({"step": 1e-6}, 3e-7), ({"rtol": 1e-8}, 3e-7), ({"rtol": 1e-10}, 5e-9)],
)
def test_energy_is_the_work_of_a_constant_torque(settings: dict[str, float], drift: float) -> None:
    """70 impacts in two pins; the work is torque times angle, without any quadrature."""
    machine = lossless({"kind": "torque", "joint": "O", "torque": 2.0})
    fault = {"A": 1e-4, "B": 2e-4}
    _, motion = run(machine, fault, duration=0.12, sample_rate=5000, **settings)
    turn = motion.displacement[:, :, 2]
    work = 2.0 * (turn[:, motion.links.index("crank")] - turn[:, motion.links.index("frame")])
    energy = np.array([state.energy(fault) for state in states(machine, motion)])
    assert np.ptp(energy - work) < drift
    assert np.ptp(work) > 20.0
    assert impacts(motion, "A") > 10
    assert impacts(motion, "B") > 10


def test_energy_is_the_work_of_a_prescribed_rotation() -> None:
    """The effort that the solver reports does the work; Simpson over samples of 1 us (1e-2 rad of the contact)."""
    machine = lossless({"kind": "rotation", "joint": "O", "speed": 62.8})
    fault = {"B": 2e-4}
    _, motion = run(machine, fault, duration=0.03, sample_rate=1e6, rtol=1e-9)
    work = cumulative_simpson(motion.reactions["drive_effort"] * 62.8, dx=1e-6, initial=0)
    energy = np.array([state.energy(fault) for state in states(machine, motion, every=500)])
    assert np.ptp(energy - work[::500]) < 2e-6 * np.ptp(work)
    assert impacts(motion, "B") > 10


@METHODS
def test_contacts_only_ever_take_energy(method: str) -> None:
    """A free machine with damped, rubbing contacts: less energy at every sample, never more."""
    machine, fault = free_machine()
    _, motion = run(machine, fault, duration=0.2, sample_rate=5000, method=method)
    energy = np.array([state.energy(fault) for state in states(machine, motion)])
    assert np.diff(energy).max() < 0
    assert energy[-1] > 0.5 * energy[0]


# Momentum -------------------------------------------------------------------------------------------------------------


def free_machine() -> tuple[Machine, dict[str, float]]:
    """The quick-return mechanism thrown into free space: no springs, gravity, drive; three worn joints that rub."""
    tree = tree_of("quick-return", gravity=0.0, damping=500.0, friction=0.3, viscous=2.0)
    tree |= {"supports": [], "drive": None}
    tree["joints"]["O"]["viscous"], tree["joints"]["G1"]["viscous"] = 0.01, 3.0
    tree["initial"] = {"velocities": {"frame": {"velocity": [0.4, -0.3], "omega": 0.5}, "crank": {"omega": 20}}}
    return parse_machine(tree), {"A": 2e-4, "C": 1.5e-4, "F": 1e-4}


@METHODS
def test_momentum_of_a_free_machine(method: str) -> None:
    """Linear and angular momentum to rounding, through impacts and friction at pins of 8 mm radius.

    The contact's two forces act at one point, or the angular momentum would drift: 1e-3 of it in this run.
    """
    machine, fault = free_machine()
    _, motion = run(machine, fault, duration=0.2, sample_rate=2000, method=method)
    mass, inertia = (np.array([getattr(link, key) for link in machine.links.values()]) for key in ("mass", "inertia"))
    x, v = motion.displacement + drawn(machine), motion.velocity
    linear = np.einsum("i,tik->tk", mass, v[:, :, :2])
    angular = (x[:, :, 0] * v[:, :, 1] - x[:, :, 1] * v[:, :, 0]) @ mass + v[:, :, 2] @ inertia
    assert np.ptp(linear, axis=0).max() < 1e-9  # of 29 kg m/s
    assert np.ptp(angular) < 2e-10  # of 1.9 kg m2/s
    assert all(impacts(motion, joint) > 5 for joint in fault)


def test_forces_inside_a_machine_cancel() -> None:
    """Sum of m a and of r x m a + I alpha, at every sample, of the same machine: no integrator involved."""
    machine, fault = free_machine()
    _, motion = run(machine, fault, duration=0.05, sample_rate=2000)
    mass, inertia = (np.array([getattr(link, key) for link in machine.links.values()]) for key in ("mass", "inertia"))
    x, a = motion.displacement + drawn(machine), motion.acceleration
    forces = mass[:, None] * a[:, :, :2]
    moments = mass * (x[:, :, 0] * a[:, :, 1] - x[:, :, 1] * a[:, :, 0]) + inertia * a[:, :, 2]
    assert np.abs(forces.sum(axis=1)).max() < 1e-12 * np.abs(forces).max()
    assert np.abs(moments.sum(axis=1)).max() < 1e-12 * np.abs(moments).max()


# Limits (vanishing clearance: tests/extremes) -------------------------------------------------------------------------


def test_stiffness_of_the_contact_is_felt_as_compliance() -> None:
    """Without play, a tenth of the stiffness brings the frame ten times as far from where the ideal joint has it."""
    ideal, _ = run(shipped_machine("slider-crank"), {}, duration=0.3, sample_rate=5000, rtol=1e-9)
    distance = []
    for stiffness in (1e7, 1e8):
        machine = parse_machine(tree_of("slider-crank", stiffness=stiffness, damping=1e-5 * stiffness))
        worn, _ = run(machine, {"B": 1e-12}, duration=0.3, sample_rate=5000, rtol=1e-9)
        distance.append(np.abs(worn.displacement - ideal.displacement).max(axis=0)[:2])
    assert distance[0] / distance[1] == pytest.approx([10, 10], rel=0.01)


# Frames of reference --------------------------------------------------------------------------------------------------


def turned(tree: Tree, rotation: Array, shift: tuple[float, float]) -> Machine:
    """The whole drawing, turned and moved; mounts must be equally stiff in x and y."""
    tree = copy.deepcopy(tree)

    def point(p: list[float]) -> list[float]:
        return [float(x) for x in rotation @ p + shift]

    for link in tree["links"].values():
        link["cg"] = point(link["cg"])
    for joint in tree["joints"].values():
        joint["at"] = point(joint["at"])
        if joint["kind"] == "sliding":
            joint["direction"] = [float(x) for x in rotation @ joint["direction"]]
    for support in tree["supports"]:
        support["at"] = point(support["at"])
    tree["sensors"] = []
    return parse_machine(tree)


@METHODS
@pytest.mark.parametrize(("name", "joint"), [("slider-crank", "B"), ("quick-return", "F")])
def test_a_turned_drawing_gives_the_turned_motion(name: str, joint: str, method: str) -> None:
    """37 and 143 degrees, and a quarter turn exactly: guides become vertical, where tan and sec are singular.

    Without gravity only rounding differs, amplified by 0.15 s of impacts.
    """
    tree = tree_of(name, gravity=0.0)
    for support in tree["supports"]:
        support |= {"stiffness": [3e5, 3e5], "damping": [250.0, 250.0]}
    settings = {"duration": 0.15, "sample_rate": 2000, "method": method}
    base, motion = run(parse_machine(tree), {joint: 1e-4}, **settings)
    assert impacts(motion, joint) >= 3
    c, s = math.cos(math.radians(37)), math.sin(math.radians(37))
    for rotation in (np.array([[c, -s], [s, c]]), np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([[-c, -s], [s, -c]])):
        machine = turned(tree, rotation, (0.3, -0.2))
        other, _ = run(machine, {joint: 1e-4}, **settings)
        slides = [j.direction for j in machine.joints.values() if isinstance(j, SlidingJoint)]
        assert rotation[0, 0] != 0 or any(direction[0] == 0 for direction in slides)
        for ours, theirs, limit in (
            (base.displacement, other.displacement, 1e-12),
            (base.velocity, other.velocity, 1e-8),
        ):
            back = np.column_stack([theirs[:, :2] @ rotation, theirs[:, 2]])
            assert np.abs(back - ours).max() < limit


@METHODS
def test_a_moving_observer_sees_the_same(method: str) -> None:
    """A free machine given another 1 m/s, 2 m/s: every link has just that more, impacts and all.

    Impacts amplify rounding: measured 2e-12 m after 0.05 s, and up to 1e-7 m after twice that.
    """
    machine, fault = free_machine()
    tree: Tree = machine.model_dump(mode="json")
    tree["initial"]["velocities"]["frame"]["velocity"] = [1.4, 1.7]
    settings = {"duration": 0.05, "sample_rate": 2000, "method": method}
    history, standing = run(machine, fault, **settings)
    _, moving = run(parse_machine(tree), fault, **settings)
    expected = standing.displacement + np.array([1.0, 2.0, 0.0]) * history.t[:, None, None]
    assert np.abs(moving.displacement - expected).max() < 1e-9
    assert impacts(standing, "A") > 5
