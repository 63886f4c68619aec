"""The film of oil around a pin against closed forms, conservation laws, and at the ends of what numbers may be."""

from __future__ import annotations

import math
from typing import Any, Literal

import casadi as ca
import numpy as np
import pytest
from laws import states, tree_of
from machine_trees import changed

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.groups import groups
from jointplay.solver.cases.history import History
from jointplay.solver.cases.remarks import find_remarks
from jointplay.solver.equations.film import Film
from jointplay.solver.equations.geometry import Complex
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.simulate import simulate

VISCOSITY, RADIUS, LENGTH, CLEARANCE = 0.1, 0.01, 0.012, 1e-4
UNIT = VISCOSITY * RADIUS * LENGTH**3 / CLEARANCE**3
OIL = {"viscosity": VISCOSITY, "length": LENGTH, "roughness": 1e-7}


def film(roughness: float = 1e-7, most: float = math.inf) -> ca.Function:
    """(e, e', omegas) -> (force, shear torque) of the film alone."""
    e, rate, omegas = (ca.SX.sym(name, 2) for name in ("e", "rate", "omegas"))
    oil = Film(VISCOSITY, RADIUS, LENGTH, CLEARANCE, roughness, most)
    size = ca.sqrt(ca.fmax(ca.dot(e, e), 1e-60))
    force, shear = oil.force(Complex(e[0], e[1]), size, Complex(rate[0], rate[1]), (omegas[0], omegas[1]))
    return ca.Function("film", [e, rate, omegas], [force.column, shear])


def pushed(function: ca.Function, e: Any, rate: Any, omegas: Any = (0, 0)) -> tuple[np.ndarray, float]:
    force, shear = function(e, rate, omegas)
    return np.asarray(force).ravel(), float(shear)


@pytest.mark.parametrize("ratio", [0.01, 0.3, 0.6, 0.9, 0.99])
def test_the_load_of_a_steady_journal(ratio: float) -> None:
    """Ocvirk: W = mu R L^3 w e / (4 c^2 D^2) sqrt(16 e^2 + pi^2 D), tan phi = pi sqrt(D) / (4 e), D = 1 - e^2."""
    omega, rest = 70.0, 1 - ratio**2
    force, shear = pushed(film(), [ratio * CLEARANCE, 0], [0, 0], [omega, 0])
    load = UNIT * CLEARANCE * omega * ratio / (4 * rest**2) * math.sqrt(16 * ratio**2 + math.pi**2 * rest)
    assert math.hypot(*force) == pytest.approx(load, rel=1e-12)
    assert force[0] < 0 < force[1]  # pushed back from the wall, and on in the sense of the rotation
    assert force[1] / -force[0] == pytest.approx(math.pi * math.sqrt(rest) / (4 * ratio), rel=1e-12)
    petrov = 2 * math.pi * VISCOSITY * RADIUS**3 * LENGTH * omega / CLEARANCE
    assert shear == pytest.approx(-petrov / math.sqrt(rest), rel=1e-12)
    # A load that turns at half the speed of the journal finds no wedge.
    still, _ = pushed(film(), [ratio * CLEARANCE, 0], [0, ratio * CLEARANCE * omega / 2], [omega, 0])
    assert math.hypot(*still) < 1e-12 * load


@pytest.mark.parametrize("ratio", [0.0, 0.5, 0.95])
def test_damping(ratio: float) -> None:
    """Toward the wall, away from it and along it: integrals of cos^2, cos^2 and sin^2 over (1 - e cos)^3."""
    rest = 1 - ratio**2
    opening = math.acos(-ratio)
    toward = opening * (1 + 2 * ratio**2) / rest**2.5 + 3 * ratio / rest**2
    away = (math.pi - opening) * (1 + 2 * ratio**2) / rest**2.5 - 3 * ratio / rest**2
    along = math.pi / 2 / rest**1.5
    for rate, expected in (([1, 0], [-toward, 0]), ([-1, 0], [away, 0]), ([0, 1], [-2 * ratio / rest**2, -along])):
        force, _ = pushed(film(), [ratio * CLEARANCE, 0], rate)
        assert force / UNIT == pytest.approx(expected, rel=1e-10, abs=1e-10)


def test_it_only_takes_energy() -> None:
    """F.e' and the torques times the speeds of both links, at any state, up to the wall and beyond."""
    rng, functions = np.random.default_rng(3), (film(), film(1e-5, 100.0))
    for k in range(2000):
        e = rng.uniform(0, 1.2) * CLEARANCE * np.array([math.cos(k), math.sin(k)])
        rate, omegas = rng.normal(size=2) * 10.0 ** rng.uniform(-6, 1), rng.normal(size=2) * 100
        force, shear = pushed(functions[k % 2], e, rate, omegas)
        half = (e[0] * force[1] - e[1] * force[0]) / 2
        terms = np.array([*(force * rate), (shear - half) * omegas[0], (-shear - half) * omegas[1]])
        assert terms.sum() <= 1e-11 * np.abs(terms).max()


@pytest.mark.parametrize("place", [0.0, 1e-40, CLEARANCE, CLEARANCE + 5e-8, 2 * CLEARANCE])
@pytest.mark.parametrize("rate", [0.0, 1e-300, 1.0])
def test_there_are_numbers_everywhere(place: float, rate: float) -> None:
    """So are derivatives, which start and steps are found by; beyond the wall by a roughness there is no film."""
    function = film(most=1e5)
    arguments = ([place, 0], [0, rate], [0, 0])
    assert np.isfinite(pushed(function, *arguments)[0]).all()
    jacobian = function.jacobian()(*arguments, *function(*arguments))
    assert all(np.isfinite(np.asarray(part)).all() for part in jacobian)
    force, shear = pushed(function, [place, 0], [1, 0], [5, 0])
    if place > CLEARANCE + 1e-7:
        assert not force.any() and not shear
    else:
        assert 0 < math.hypot(*force) <= 1.0001e5


def journal(**more: Any) -> Machine:
    """A journal of 2 kg that a drive turns in a fixed bearing, without weight."""
    joint = {
        "kind": "turning", "links": ["journal", "bed"], "at": [0, 0], "pin_radius": RADIUS, "film": OIL,
        "contact": {"friction": 0},
    }  # fmt: skip
    links = {"bed": {"fixed": True}, "journal": {"mass": 2.0, "inertia": 1e-3, "cg": [0, 0]}}
    drive = {"kind": "rotation", "joint": "B", "speed": 0.0}
    return parse_machine({"name": "j", "gravity": 0, "links": links, "joints": {"B": joint}, "drive": drive} | more)


def run(machine: Machine, fault: dict[str, float], duration: float, **more: Any) -> History:
    found = simulate(machine, Case(Fault(fault)), Settings(duration=duration, links=True, **more))
    assert found.status == "ok", found.message
    assert found.links is not None
    return found


def test_the_time_of_approach() -> None:
    """A light journal that 120 N press from the middle: t = (mu R L^3 / c^2 W) (e A / D^1.5 + 1 / D - 1)."""
    links = {"bed": {"fixed": True}, "journal": {"mass": 0.2, "inertia": 1e-3, "cg": [0, 0]}}
    load = {"link": "journal", "at": [0, 0], "force": [120, 0]}
    history = run(journal(links=links, loads=[load]), {"B": CLEARANCE}, 0.02, rtol=1e-8, sample_rate=50_000)
    assert history.links is not None
    ratio = history.links.displacement[:, 1, 0] / CLEARANCE
    rest = 1 - ratio**2
    exact = UNIT * CLEARANCE / 120 * (ratio * np.arccos(-ratio) / rest**1.5 + 1 / rest - 1)
    seen = (ratio > 0.3) & (ratio < 0.9)
    assert ratio[-1] > 0.8
    # Its mass takes m c^3 / mu R L^3 = 0.1 ms to come to speed, and as long to fall behind where the film stiffens.
    assert np.abs(exact - history.t)[seen].max() < 2e-4


def test_a_steady_load_is_carried_where_ocvirk_says() -> None:
    """30 N on a slow journal: it spirals to its place on the locus, and stays."""
    load = {"link": "journal", "at": [0, 0], "force": [0, -30]}
    drive = {"kind": "rotation", "joint": "B", "speed": 40.0}
    history = run(journal(loads=[load], drive=drive), {"B": CLEARANCE}, 1.0, rtol=1e-8)
    assert history.links is not None
    x, y, _ = history.links.displacement[-1, 1] / CLEARANCE
    ratio = math.hypot(x, y)
    rest = 1 - ratio**2
    carried = UNIT * CLEARANCE * 40 * ratio / (4 * rest**2) * math.sqrt(16 * ratio**2 + math.pi**2 * rest)
    assert carried == pytest.approx(30.0, rel=1e-6)
    assert math.atan2(x, -y) == pytest.approx(math.atan2(math.pi * math.sqrt(rest), 4 * ratio), rel=1e-6)


def turning_load(order: int, size: float, along: float = 0.0) -> list[dict[str, Any]]:
    """A force of this size that turns `order` times as fast as the journal, and a constant one."""
    at = {"link": "journal", "at": [0, 0]}
    cos = {**at, "force": [size, 0], "order": abs(order), "phase": math.pi / 2}
    sin = {**at, "force": [0, math.copysign(size, order)], "order": abs(order)}
    return [cos, sin, {**at, "force": [along, 0]}]


def seen(machine: Machine, order: float, omega: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Time, and place of the journal in clearances as seen from axes that turn `order` times as fast as it."""
    history = run(machine, {"B": CLEARANCE}, duration, rtol=1e-8)
    assert history.links is not None
    place = history.links.displacement[:, 1, :2] @ np.array([1, 1j]) / CLEARANCE
    return history.t, place * np.exp(-1j * order * omega * history.t)


@pytest.mark.parametrize("order", [-1, 1, 2])
def test_a_load_that_turns(order: int) -> None:
    """It is carried in a circle, as a steady one at a speed of omega (1 - 2 order); what the circle throws off with it.

    J. F. Booker (J. Basic Eng. 87, 1965) has the rule; with order 1 the load is an unbalance.
    """
    omega, mass, size = 40.0, 20.0, 60.0
    links = {"bed": {"fixed": True}, "journal": {"mass": mass, "inertia": 1e-3, "cg": [0, 0]}}
    drive = {"kind": "rotation", "joint": "B", "speed": omega}
    _, place = seen(journal(links=links, loads=turning_load(order, size), drive=drive), order, omega, 1.0)
    ratio = abs(place[-1])
    rest, speed = 1 - ratio**2, omega * (1 - 2 * order)
    film = UNIT * CLEARANCE * ratio * complex(-abs(speed) * ratio / rest**2, speed * math.pi / (4 * rest**1.5))
    thrown = mass * (order * omega) ** 2 * CLEARANCE * ratio
    assert thrown > 0.03 * size
    assert np.abs(place[-1000:] - place[-1]).max() < 1e-6
    # Measured: 2.6e-6, 7.9e-6, 3.9e-6.
    assert abs(size + (film + thrown) * place[-1] / ratio) < 3e-5 * size


def test_a_weight_and_an_unbalance_as_large() -> None:
    """They add up to a load along a line that turns half as fast as the journal: no wedge, oil is squeezed to and fro.

    The time of approach gives the orbit of a journal without mass: out for half a turn, then back beyond the middle.
    """
    omega, size, places = 200.0, 50.0, []
    drive = {"kind": "rotation", "joint": "B", "speed": omega}
    for mass in (0.04, 0.02):
        links = {"bed": {"fixed": True}, "journal": {"mass": mass, "inertia": 1e-3, "cg": [0, 0]}}
        machine = journal(links=links, loads=turning_load(1, size, size), drive=drive)
        t, place = seen(machine, 0.5, omega, 3 * math.pi / omega)
        places.append(place)

    grid = np.linspace(-0.9, 0.9, 20_001)
    squeezed = grid * np.arccos(-grid) / (1 - grid**2) ** 1.5 + 1 / (1 - grid**2)
    most = 4 * size / (omega * UNIT * CLEARANCE)
    push = most * np.sin(omega * t / 2)
    far = np.interp(1 + most, squeezed, grid)
    back = np.interp(-far, grid, squeezed) + most - push
    exact = np.where(omega * t < math.pi, np.interp(1 + push, squeezed, grid), -np.interp(back, squeezed, grid))
    assert exact.max() > 0.7 and exact.min() < -0.75
    # What a mass adds goes with the mass, measured: 8.6e-3 and 4.3e-3; without it 2.6e-4 are left, a fifth of what
    # twice these masses leave.
    assert np.abs(places[1] - exact).max() < 5e-3
    assert np.abs(2 * places[1] - places[0] - exact).max() < 5e-4


def test_momentum_is_kept() -> None:
    """Two free links, spinning and drifting apart in the oil: what a film does to one it does to the other."""
    tree = journal().model_dump(mode="json", exclude_none=True)
    tree["links"] = {
        "bed": {"mass": 5.0, "inertia": 0.05, "cg": [-0.1, -0.2]},
        "journal": {"mass": 2.0, "inertia": 0.01, "cg": [0.03, 0.01]},
    }
    motion = {"bed": {"omega": 3, "velocity": [0.1, 0.2]}, "journal": {"omega": -20, "velocity": [-0.3, -0.1]}}
    machine = parse_machine(tree | {"drive": None, "frame": "bed", "initial": {"velocities": motion}})
    # Explicit steps keep sums as they are.
    history = run(machine, {"B": CLEARANCE}, 0.2, sample_rate=5000, method="adaptive")
    assert history.links is not None
    assert np.ptp(history.links.reactions["force_B_on_pin"], axis=0).max() > 1.0
    turning, momentum, energy = [], [], []
    for state in states(machine, history.links):
        momentum.append(state.momentum[:2])
        turning.append(state.momentum[2])
        energy.append(state.energy({"B": CLEARANCE}))
    assert np.ptp(momentum, axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(turning) < 1e-9
    assert np.diff(energy).max() < 1e-9 * energy[0]
    assert energy[-1] < 0.998 * energy[0]


def oiled(viscosity: float = 0.1, **contact: float) -> Machine:
    tree = tree_of("slider-crank", **contact)
    tree["joints"]["B"]["film"] = {"viscosity": viscosity, "length": "16 mm"}
    return parse_machine(tree)


@pytest.mark.parametrize("viscosity", [1e-4, 10.0])
@pytest.mark.parametrize("clearance", [5e-6, 1e-3])
@pytest.mark.parametrize("method", ["adaptive", "rosenbrock", "gill"])
def test_the_ends_of_what_numbers_may_be(viscosity: float, clearance: float, method: str) -> None:
    settings = Settings(duration=0.02, accuracy="draft", method=method)  # type: ignore[arg-type]
    history = simulate(oiled(viscosity), Case(Fault({"B": clearance})), settings)
    assert history.status == "ok", history.message
    assert all(np.isfinite(part).all() for part in (history.displacement, history.velocity, history.acceleration))


def test_thick_oil_makes_an_ideal_joint() -> None:
    """What is left between the frame's motions is less, the thicker the oil."""
    settings = Settings(duration=0.1, rtol=1e-8)
    ideal = simulate(shipped_machine("slider-crank"), {}, settings).velocity
    dry = simulate(shipped_machine("slider-crank"), {"B": 5e-5}, settings).velocity
    left = [np.abs(simulate(oiled(mu), {"B": 5e-5}, settings).velocity - ideal).max() for mu in (1.0, 0.1)]
    assert 2 * left[0] < left[1] < np.abs(dry - ideal).max() / 4


@pytest.mark.parametrize("method", ["adaptive", "rosenbrock"])
def test_a_joint_that_runs_dry(method: Literal["adaptive", "rosenbrock"]) -> None:
    """Without its oil it is what it would be without a film."""
    # Without rtol steps of a film are a hundredth as coarse; those of a dry joint are not.
    settings = Settings(duration=0.05, rtol=1e-8 if method == "rosenbrock" else None, method=method)
    dry = simulate(shipped_machine("slider-crank"), {"B": 2e-4}, settings)
    found = simulate(oiled(), Case(Fault({"B": 2e-4}), {"film.viscosity": 0.0}), settings)
    # Measured: the same digits, and 2e-12.
    assert np.abs(found.velocity - dry.velocity).max() < 1e-10 * np.abs(dry.velocity).max()


@pytest.mark.parametrize(
    ("viscosity", "clearance", "sample_rate", "implicit"),
    [
        (0.03, 5e-6, 1e4, True),
        (0.1, 2e-4, 1e4, True),
        (0.001, 1e-3, 1e4, True),
        (0.001, 2e-3, 1e4, False),  # next to dry: explicit steps are no dearer
        (0.0, 5e-6, 1e4, False),
        (0.03, 5e-6, 1e7, False),  # 2.9e8 1/s are to be seen in samples so dense
    ],
)
def test_which_films_are_stepped_implicitly(
    viscosity: float, clearance: float, sample_rate: float, implicit: bool
) -> None:
    case = Case(Fault({"B": clearance}), {"film.viscosity": viscosity})
    ready = next(groups(oiled(), [case], Settings(sample_rate=sample_rate, duration=0.1))).ready[0]
    assert (ready.implicit is not None) == implicit
    assert not implicit or "because of joints.B.film.viscosity: " in str(ready.implicit)


def test_films_of_fits() -> None:
    """Oil in all joints, one worn: explicit steps would be some millions, implicit ones are right as finely as asked.

    Measured, largest error of the frame's velocity in parts of the largest: 1.5e-4 and 1e-5, of theta.
    """
    tree = tree_of("slider-crank")
    for joint in "OAB":
        tree["joints"][joint]["film"] = {"viscosity": 0.03, "length": "16 mm"}
    machine, fault = parse_machine(tree), {"O": 9e-6, "A": 4e-6, "B": 2e-4}
    finest, *found = (
        simulate(machine, fault, Settings(duration=0.1, most_trials=20_000, **more))
        for more in ({"rtol": 1e-9}, {"accuracy": "draft"}, {"accuracy": "standard"})
    )
    assert all("rosenbrock" in history.message and history.status == "ok" for history in (finest, *found))
    for history, tolerance in zip(found, (5e-4, 4e-5), strict=True):
        error = np.abs(history.velocity - finest.velocity).max(axis=0) / np.abs(finest.velocity).max(axis=0)
        assert error.max() < tolerance


def test_a_run_that_is_too_long_names_the_oil() -> None:
    rule = r"joints\.B\.film\.viscosity: 10.0: holds an effective mass of .* kg at .* 1/s; take less, or a heavier link"
    with pytest.raises(MachineError, match=rule):
        simulate(oiled(10.0), Case(Fault({"B": 5e-6})), Settings(duration=90, sample_rate=1000, method="adaptive"))


def test_what_a_film_costs() -> None:
    dry, oil = (
        account(machine, Fault({"B": 2e-4})).operations for machine in (shipped_machine("slider-crank"), oiled())
    )
    assert (dry, oil) == (414, 544)
    closed = account(oiled(), Fault({}))
    assert closed.operations == 308
    assert [part.what for part in closed.left_out if "film" in part.what] == ["film of B"]


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("viscosity", 0, "film.viscosity: 0: must be greater than 0"),
        ("viscosity", 100, "film.viscosity: 100: must not be greater than 20"),
        ("viscosity", "0.1 mm", '"mm" is a length, must be a dynamic viscosity, for example "0.1 Pa s"'),
        ("length", "-2 mm", "film.length: -2 mm: must be greater than 0"),
        ("roughness", 0.01, "film.roughness: 0.01: must not be greater than 0.001"),
        ("thickness", 1, "film.thickness: 1: unknown key"),
    ],
)
def test_refusals(path: str, value: object, message: str) -> None:
    tree = changed("joints.B.film", {"viscosity": "100 cP", "length": "16 mm", path: value})
    with pytest.raises(MachineError) as refused:
        parse_machine(tree)
    assert message in str(refused.value) and "joints.B." in str(refused.value)


def test_a_film_needs_a_journal() -> None:
    tree = changed("joints.B.film", {"viscosity": "100 mPa s", "length": "16 mm"})
    assert parse_machine(tree).joints["B"].film.viscosity == pytest.approx(0.1)  # type: ignore[union-attr]
    del tree["joints"]["B"]["pin_radius"]
    with pytest.raises(MachineError, match=r"joints\.B\.pin_radius: is missing: film is the oil around a journal"):
        parse_machine(tree)


def test_a_long_bearing_is_remarked() -> None:
    for length, lines in ((0.016, 0), (0.0161, 1)):
        tree = changed("joints.B.film", {"viscosity": 0.1, "length": length})
        found = [line for line in find_remarks(parse_machine(tree)) if "film" in line]
        assert len(found) == lines
        history = simulate(parse_machine(tree), {"B": 1e-4}, Settings(duration=0.01))
        assert ("diameters long" in history.message) == bool(lines)


def test_a_start_at_rest() -> None:
    """It is looked for with the pin in the middle, where a film without clearance would have no numbers."""
    joints = journal().model_dump(mode="json", exclude_none=True)["joints"]
    mount = {"kind": "mount", "link": "bed", "at": [0, 0], "stiffness": [1e6, 1e6], "damping": [1e3, 1e3]}
    bed = {"mass": 5, "inertia": 0.1, "cg": [0, 0], "locked": ["theta"]}
    links = {"bed": bed, "journal": {"mass": 2, "inertia": 1e-3, "cg": [0, 0]}}
    more = {"gravity": 9.81, "links": links, "joints": joints, "supports": [mount], "initial": {"pose": "equilibrium"}}
    history = run(journal(**more), {"B": CLEARANCE}, 0.01)
    assert history.links is not None
    assert history.links.displacement[0, :, 1] == pytest.approx(-7 * 9.81 / 1e6, rel=1e-9)


def test_a_case_gives_another_oil() -> None:
    settings, fault = Settings(duration=0.02), Fault({"B": 1e-4})
    expected = simulate(oiled(1.0), Case(fault), settings).velocity
    for path in ("film.viscosity", "joints.B.film.viscosity"):
        found = simulate(oiled(0.1), Case(fault, {path: 1.0}), settings).velocity
        assert np.array_equal(found, expected)
        with pytest.raises(MachineError, match=r"film\.viscosity: -1: must not be negative"):
            simulate(oiled(), Case(fault, {path: -1}), settings)
        with pytest.raises(MachineError, match=r"no contact law of this machine has|of this joint has no viscosity"):
            simulate(shipped_machine("slider-crank"), Case(fault, {path: 1.0}), settings)
