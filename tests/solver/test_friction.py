"""Laws of dry friction: what holds, what creeps, and Coulomb's law in closed form."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.history import History
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.solver.simulation.simulate import simulate

G = 9.81
#: 20 degrees; its tangent is 0.364.
SLOPE = math.radians(20)
BED = {"fixed": True}


def block(friction: float, speed: float = 0.0, **law: Any) -> Machine:
    """A block of 2 kg on an incline, started up (+) or down it."""
    along = [math.cos(SLOPE), math.sin(SLOPE)]
    guide = {"kind": "sliding", "links": ["block", "bed"], "at": [0, 0], "direction": along, "friction": friction}
    return parse_machine(
        {
            "name": "block",
            "links": {"bed": BED, "block": {"mass": 2.0, "inertia": 0.01, "cg": [0.1, 0.05]}},
            "joints": {"G": {**guide, **law}},
            "initial": {"velocities": {"block": {"velocity": [speed * along[0], speed * along[1]]}}},
        }
    )


def sprung(friction: float, speed: float) -> Machine:
    """A block of 1 kg on a level guide, held by a spring of 400 N/m, pushed off at a speed."""
    guide = {"kind": "sliding", "links": ["block", "bed"], "at": [0, 0], "direction": [1, 0], "friction_law": "bristle"}
    mount = {"kind": "mount", "link": "block", "at": [0, 0], "stiffness": [400.0, 0.0], "damping": [0.0, 0.0]}
    return parse_machine(
        {
            "name": "sprung",
            "links": {"bed": BED, "block": {"mass": 1.0, "inertia": 0.01, "cg": [0, 0]}},
            "joints": {"G": {**guide, "friction": friction}},
            "supports": [mount],
            "initial": {"velocities": {"block": {"velocity": [speed, 0.0]}}},
        }
    )


def pendulum(law: dict[str, Any]) -> Machine:
    """A bob whose weight lies 4 mm off a worn pin of 10 mm: within the circle of friction, r sin atan 0.57 = 5 mm."""
    contact = {"stiffness": 1e7, "damping": 300.0, "friction": 0.57, **law}
    pin = {"kind": "turning", "links": ["bob", "bed"], "at": [0, 0], "pin_radius": 0.01, "contact": contact}
    bob = {"mass": 2.0, "inertia": 1e-3, "cg": [0.004, 0.0]}
    return parse_machine({"name": "pendulum", "links": {"bed": BED, "bob": bob}, "joints": {"P": pin}})


def run(machine: Machine, duration: float, fault: dict[str, float] | None = None, **more: Any) -> History:
    found = simulate(machine, Case(Fault(fault)), Settings(duration=duration, links=True, sample_rate=1000, **more))
    assert found.status == "ok"
    return found


def travel(history: History) -> np.ndarray:
    """Of the second link's centre of gravity, m, (n,)."""
    assert history.links is not None
    return np.hypot(*history.links.displacement[:, 1, :2].T)


@pytest.mark.parametrize(("speed", "distance"), [(0.0, 0.0), (1.0, 0.06277929), (-1.0, 0.39873213)])
def test_what_comes_to_rest_on_an_incline_stays(speed: float, distance: float) -> None:
    """v^2 / 2 g (mu cos a +- sin a), then ten seconds without a micrometre; 0.02 um seen."""
    history = run(block(0.5, speed, friction_law="bristle"), 11.0)
    moved = travel(history)
    assert moved[-1] == pytest.approx(distance, rel=1e-6, abs=1e-7)
    assert np.ptp(moved[1000:]) < 1e-7
    assert history.message == ""


def test_too_steep_an_incline_lets_go() -> None:
    """Half g (sin a - mu cos a) t^2, but for the speed it has once its bristles are bent: presliding over 10 us."""
    history = run(block(0.3, friction_law="bristle"), 1.0)
    exact = 0.5 * G * (math.sin(SLOPE) - 0.3 * math.cos(SLOPE))
    assert exact < travel(history)[-1] < exact + 3e-9 / 1e-5


@pytest.mark.parametrize(("law", "creep"), [("tanh", math.atanh(0.36397023 / 0.5)), ("threshold", 0.1 + 0.9 * 0.72794)])
def test_other_laws_creep_as_they_say(law: str, creep: float) -> None:
    history = run(block(0.5, friction_law=law, friction_velocity=1e-3), 2.0)
    assert history.links is not None
    speed = np.hypot(*history.links.velocity[-1, 1, :2])
    assert speed == pytest.approx(1e-3 * creep, rel=1e-3)
    assert "sticks" in history.message


def test_a_sprung_block_loses_four_mu_n_over_k_a_period_and_stops_within_its_dead_zone() -> None:
    """Coulomb's decay, half period by half period: piecewise cosines about +-mu N/k (Den Hartog 1931)."""
    friction, speed, stiffness = 0.1, 1.0, 400.0
    omega, shift = math.sqrt(stiffness), friction * G / stiffness
    history = run(sprung(friction, speed), 3.0)
    assert history.links is not None
    x = history.links.displacement[:, 1, 0]
    first = math.hypot(shift, speed / omega) - shift  # where it turns round the first time
    turns = [first]
    while abs(turns[-1]) > shift:
        turns.append(-turns[-1] + math.copysign(2 * shift, turns[-1]))
    assert x.max() == pytest.approx(first, rel=1e-4)
    assert x[-1] == pytest.approx(turns[-1], abs=2e-6)  # 1e-6 seen, ten turns at 1e-7 each
    assert len(turns) == 11
    # What errors of steps move bristles at rest by: 0.3 to 1.2e-8 for starts at 0.97 to 1.04 m/s.
    assert np.ptp(x[-1000:]) < 3e-8


def test_a_pin_within_the_circle_of_friction_holds_its_pendulum() -> None:
    """It rolls to and fro in the socket for good, but does not let go; under tanh it ends plumb."""
    held, creeping = (
        run(pendulum(law), 10.0, {"P": 1e-4}) for law in ({"friction_law": "bristle"}, {"friction_velocity": 0.01})
    )
    assert held.links is not None and creeping.links is not None
    angle = held.links.displacement[:, 1, 2]
    second = np.array([angle[k * 1000 : (k + 1) * 1000].mean() for k in range(1, 10)])
    assert abs(second).max() < 0.1
    assert np.ptp(second) * 0.004 < 1e-6
    assert creeping.links.displacement[-1, 1, 2] == pytest.approx(-math.pi / 2, abs=0.05)


@pytest.mark.parametrize("method", ["adaptive", "gill"])
def test_a_wheel_on_a_dry_journal_coasts_down_evenly_and_stands(method: str) -> None:
    """mu r m g over its inertia, 0.2 x 0.01 m x 2 kg x 9.81 / 0.004 kg m2: from 10 rad/s 1.02 s and 5.1 rad."""
    contact = {"friction_law": "bristle", "presliding": 1e-7}
    pin = {"kind": "turning", "links": ["wheel", "bed"], "at": [0, 0], "pin_radius": 0.01, "contact": contact}
    machine = parse_machine(
        {
            "name": "wheel",
            "links": {"bed": BED, "wheel": {"mass": 2.0, "inertia": 4e-3, "cg": [0, 0]}},
            "joints": {"P": {**pin, "journal_friction": 0.2}},
            "initial": {"velocities": {"wheel": {"omega": 10.0}}},
        }
    )
    rate = 0.2 * 0.01 * 2.0 * G / 4e-3
    history = run(machine, 2.0, method=method)
    assert history.links is not None
    speed, angle = history.links.velocity[:, 1, 2], history.links.displacement[:, 1, 2]
    assert speed[500] == pytest.approx(10.0 - rate * 0.5, rel=1e-9)
    assert angle[-1] == pytest.approx(0.5 * 100.0 / rate, rel=1e-4)
    assert abs(speed[-500:]).max() < 1e-3


def test_a_journal_needs_an_arm() -> None:
    tree: dict[str, Any] = pendulum({}).model_dump(exclude_none=True)
    tree["joints"]["P"] |= {"pin_radius": 0.0, "journal_friction": 0.1}
    with pytest.raises(MachineError, match=r"joints.P.journal_friction: 0.1: needs a pin_radius"):
        parse_machine(tree)


def test_both_methods_stop_alike() -> None:
    """Fixed steps meet no instant: they end within a part in a thousand of the way."""
    machine = block(0.5, -1.0, friction_law="bristle", presliding=1e-6)
    ends = [travel(run(machine, 1.0, method=method))[-1] for method in ("adaptive", "gill")]
    assert ends[1] == pytest.approx(ends[0], rel=1e-3)


def test_a_run_that_goes_on_at_rest_stays_at_rest() -> None:
    machine, settings = block(0.5, friction_law="bristle"), Settings(duration=0.5, links=True, sample_rate=1000)
    first = simulate(machine, Case(), settings)
    assert first.end is not None
    assert 0 < abs(first.end.memory[0]) < 1
    assert first.end.memory[1] == 0


@pytest.mark.parametrize(
    ("said", "law"),
    [({}, "bristle"), ({"friction_velocity": 0.02}, "tanh"), ({"presliding": 1e-8}, "bristle")],
)
def test_a_number_says_which_law(said: dict[str, float], law: str) -> None:
    joint: Any = block(0.5, **said).joints["G"]
    assert joint.friction_law == law


def test_a_joint_takes_over_friction_of_the_same_law_alone() -> None:
    tree: dict[str, Any] = pendulum({"presliding": 1e-7}).model_dump(exclude_none=True)
    tree["defaults"] = {"contact": {"friction": 0.3, "friction_velocity": 0.02}}
    tree["joints"]["P"]["contact"] = {"presliding": 1e-7}
    contact: Any = parse_machine(tree).joints["P"]
    assert (contact.contact.friction_law, contact.contact.friction) == ("bristle", 0.3)
    assert "friction_velocity" not in contact.contact.model_dump()


def test_numbers_of_another_law_are_refused() -> None:
    with pytest.raises(MachineError, match=r"joints.G.presliding: 1e-08: friction law tanh has no presliding"):
        block(0.5, friction_law="tanh", presliding=1e-8)
