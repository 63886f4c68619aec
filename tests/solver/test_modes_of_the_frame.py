"""Modes of the frame against closed forms, machines that must move alike, and what a machine file may say of them."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bent_frames import bending_mode, bent
from laws import drawn
from oracle.state import State
from scipy.optimize import brentq

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.history import History
from jointplay.solver.cases.preparation import standing_model
from jointplay.solver.cases.steps import smooth_eigenvalues
from jointplay.solver.equations.model import build_model
from jointplay.solver.errors import AssemblyError, MachineError
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.machines.yamlfile import read_tree
from jointplay.solver.simulation.account import account
from jointplay.solver.simulation.ensemble import Ensemble, simulate_ensemble
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.sensor import sensor_signals, sensor_transform

TIGHT = {"accuracy": "reference", "rtol": 1e-11}


def run(machine: Machine, worn: dict[str, float] | None = None, **settings: Any) -> History:
    found = simulate(machine, Case(Fault(worn or {})), Settings(**settings))
    assert found.status == "ok", found.message
    return found


@pytest.mark.parametrize("ratio", [0.5, 0.98, 3.0])
def test_a_rotating_unbalance_shakes_a_mode_as_one_degree_of_freedom(ratio: float) -> None:
    """(M + m) q'' + 2 z M w q' + M w^2 q = m e s^2 sin(s t + p): amplitude and phase at the sensor."""
    mass, small, arm, w, damping, share = 12.0, 0.5, 0.02, 2 * math.pi * 40, 0.03, 0.6
    speed = ratio * w * math.sqrt(mass / (mass + small))
    tree = {
        "name": "unbalance", "gravity": 0.0,
        "links": {"bed": {"fixed": True}, "disc": {"mass": small, "inertia": 1e-4, "cg": [arm, 0]}},
        "joints": {"O": {"kind": "turning", "links": ["disc", "bed"], "at": [0, 0]}},
        "drive": {"kind": "rotation", "joint": "O", "speed": speed},
        "sensors": [{"name": "y", "at": [0.3, 0], "direction": [0, 1]}],
        "modes": [{"frequency": 40, "damping": damping, "mass": mass, "shape": [
            {"at": [0, 0], "displacement": [0, 1]}, {"at": [0.3, 0], "displacement": [0, share]}]}],
    }  # fmt: skip
    history = run(parse_machine(tree), duration=2.0, **TIGHT)
    late = history.t > 1.0 + 1e-9
    seen = history.at_sensors(parse_machine(tree), instantaneous=True)[late, 0]
    # Whole revolutions, so that nothing leaks; the start has decayed to 1e-3 of itself and is fitted as well.
    decay, free = -damping * w, w * math.sqrt(1 - damping**2)
    t = history.t[late]
    basis = [np.sin(speed * t), np.cos(speed * t), *(np.exp(decay * t) * f(free * t) for f in (np.sin, np.cos))]
    a, b = np.linalg.lstsq(np.array(basis).T, seen, rcond=None)[0][:2]
    response = -(speed**2) / (mass * w**2 - (mass + small) * speed**2 + 2j * damping * mass * w * speed)
    assert complex(a, b) == pytest.approx(share * small * arm * speed**2 * response, rel=2e-4)


def carried(frame: dict[str, Any], **more: Any) -> Machine:
    """The slider-crank, without gravity, on a frame that can go up and down alone."""
    tree = shipped_machine("slider-crank").model_dump() | {"gravity": 0.0, "supports": (), "modes": ()} | more
    tree["links"] = tree["links"] | {"frame": {"cg": [0, 0], **frame}}
    return parse_machine(tree)


@pytest.mark.parametrize("worn", [{}, {"B": 2e-4}])
def test_a_mode_that_does_not_bend_is_a_support(worn: dict[str, float]) -> None:
    """A frame nailed down whose one mode lifts all of it moves as a frame of that mass on a spring and a damper."""
    mass, frequency, damping = 8.0, 35.0, 0.05
    w = 2 * math.pi * frequency
    points = dict.fromkeys(at for _, at in shipped_machine("slider-crank").frame_points)
    mode = {"frequency": frequency, "damping": damping, "mass": mass / 4,
            "shape": [{"at": at, "displacement": [0, 0.5]} for at in points]}  # fmt: skip
    mount = {"kind": "mount", "link": "frame", "at": [0, 0], "stiffness": [0, mass * w**2],
             "damping": [0, 2 * damping * mass * w]}  # fmt: skip
    lifted = carried({"fixed": True}, modes=[mode])
    sprung = carried({"mass": mass, "inertia": 1.0, "locked": ["x", "theta"]}, supports=[mount])
    here, there = (run(machine, worn, duration=0.15, **TIGHT) for machine in (lifted, sprung))
    assert here.modes is not None
    np.testing.assert_allclose(0.5 * here.modes.displacement[:, 0], there.displacement[:, 1], atol=1e-9 * 1e-2)
    signals = [each.at_sensors(lifted) for each in (here, there)]
    assert np.abs(signals[0] - signals[1]).max() < 1e-5 * np.abs(signals[1]).max()


def test_energy_is_kept() -> None:
    """Of a worn machine that floats, without anything that loses some."""
    machine = bent(120.0, 300.0, damping=0.0)
    tree = machine.model_dump()
    tree["drive"] = None
    tree["defaults"]["contact"] |= {"damping": 0.0, "friction": 0.0}
    for name in machine.turning_joints:
        tree["joints"][name]["contact"] |= {"damping": 0.0, "friction": 0.0}
    for support in tree["supports"]:
        support["damping"] = (0.0, 0.0)
    tree["initial"] = {"velocities": {"crank": {"omega": 40.0}}}
    machine = parse_machine(tree)
    clearances = {"B": 2e-4}
    history = run(machine, clearances, duration=0.2, links=True, **TIGHT)
    assert history.links is not None
    assert history.modes is not None
    start = drawn(machine)
    found = [
        State(machine, history.links.displacement[i] + start, history.links.velocity[i],
              bent=np.column_stack([history.modes.displacement[i], history.modes.velocity[i]])).energy(clearances)
        for i in range(0, len(history.t), 97)
    ]  # fmt: skip
    moved = [0.5 * np.sum((2 * math.pi * m.frequency * history.modes.displacement[:, k]) ** 2 * m.mass).max()
             for k, m in enumerate(machine.modes)]  # fmt: skip
    assert min(moved) > 0
    assert np.ptp(found) < 1e-7 * max(np.abs(found))


def test_a_stiff_frame_is_rigid() -> None:
    """What a mode adds falls with the square of its frequency: it is bent by forces over its stiffness."""
    rigid = run(shipped_machine("slider-crank"), duration=0.4, rtol=1e-9)
    late, apart = rigid.t > 0.3, []
    for frequency in (1500.0, 3000.0, 6000.0):
        machine = bent(frequency, damping=0.2)
        history = run(machine, duration=0.4, rtol=1e-9)
        difference = history.at_sensors(machine) - rigid.at_sensors(machine)
        apart.append(float(np.std(difference[late])))
    assert apart[0] < 2e-3 * float(np.std(rigid.at_sensors(machine)[late]))
    assert apart[0] / apart[1] == pytest.approx(4.0, rel=0.1)
    assert apart[1] / apart[2] == pytest.approx(4.0, rel=0.1)


def beam(count: int, stiffness: float) -> Machine:
    """A uniform beam of steel, 1 m, in y alone, on a spring at each end, by its first modes with both ends free."""
    length, mass, bending = 1.0, 10.0, 2000.0
    shape = []
    for k in range(count):
        # cos(b) cosh(b) = 1; at its ends the shape is 2 / sqrt(mass) whatever the mode, w'' = b^2 sqrt(EI / (m L^3)).
        b = brentq(lambda b: math.cos(b) - 1 / math.cosh(b), (k + 1.3) * math.pi, (k + 1.7) * math.pi)
        frequency = b**2 * math.sqrt(bending / (mass * length**3)) / (2 * math.pi)
        ends = [{"at": [x, 0], "displacement": [0, 2 * side**k]} for x, side in ((-0.5, 1), (0.5, -1))]
        shape.append({"frequency": frequency, "damping": 0.0, "mass": mass, "shape": ends})
    supports = [{"kind": "mount", "link": "beam", "at": [x, 0], "stiffness": [0, stiffness]} for x in (-0.5, 0.5)]
    links = {"beam": {"mass": mass, "inertia": mass * length**2 / 12, "cg": [0, 0], "locked": ["x"]}}
    tree = {"name": "beam", "gravity": 0.0, "links": links, "supports": supports, "modes": shape}
    return parse_machine(tree)


def test_a_beam_on_two_springs() -> None:
    """Symmetric motions cos(b x) + A cosh(b x): no moment at the ends, and EI w''' = k w there (Euler, Bernoulli)."""
    stiffness, half = 2e4, 0.5

    def open_end(b: float) -> float:
        c, s, ch, sh = (f(b * half) for f in (math.cos, math.sin, math.cosh, math.sinh))
        share = c / ch
        return 2000.0 * b**3 * (s + share * sh) - stiffness * (c + share * ch)

    exact = sorted(
        b**2 * math.sqrt(2000.0 / 10.0) for low, high in ((0.5, 3.0), (4.0, 7.0)) for b in [brentq(open_end, low, high)]
    )

    def errors(count: int) -> list[float]:
        model = standing_model(beam(count, stiffness), (), ())
        found = sorted(set(np.round(smooth_eigenvalues(model, model.vector({})).imag, 9)))
        return [min(abs(w / each - 1) for w in found) for each in exact]

    # Each mode less is a few times the error: 8 %, 0.3 %, 0.06 % and 0.02 % of the lowest, measured.
    bounds = {0: 0.1, 1: 4e-3, 3: 8e-4, 5: 3e-4}
    lowest = [errors(count)[0] for count in bounds]
    assert all(error < bound for error, bound in zip(lowest, bounds.values(), strict=True))
    assert lowest[0] > 20 * lowest[1] > 60 * lowest[2] > 100 * lowest[3]
    assert errors(3)[1] < 2e-4


def test_what_sensors_feel_is_where_they_go() -> None:
    """Second differences of the place of a point that moves along a curve on a turning, bending frame."""
    t = np.arange(2001) * 1e-4
    angle, q = 0.3 * np.sin(20 * t), 0.01 * np.cos(70 * t)
    rates = 6 * np.cos(20 * t), -0.7 * np.sin(70 * t)
    accelerations = -120 * np.sin(20 * t), -49 * np.cos(70 * t)
    zero = np.zeros_like(t)
    shape = np.array([[[0.4, -1.3]]])
    arm = complex(0.3, 0.2) + q * complex(*shape[0, 0])
    place = np.exp(1j * angle) * arm
    seen = (place[2:] - 2 * place[1:-1] + place[:-2]) / 1e-8 * np.exp(-1j * angle[1:-1])
    frame = [np.column_stack([zero, zero, part]) for part in (angle, rates[0], accelerations[0])]
    bending = (shape, q[:, None], rates[1][:, None], accelerations[1][:, None])
    found = sensor_signals(*frame, [(0.3, 0.2)], [(0, 1)], (0, 0), bending)
    np.testing.assert_allclose(found[1:-1, 0], seen.imag, atol=2e-4 * np.abs(seen).max())


def test_the_whole_system_of_equations_agrees() -> None:
    """Another choice of coordinates, same steps: as closely as without modes."""
    machine = bent()
    ours, theirs = (run(machine, {"B": 2e-4}, duration=0.02, step=2e-6, method=method) for method in ("gill", "full"))
    assert ours.modes is not None
    assert theirs.modes is not None
    for one, other in ((ours, theirs), (ours.modes, theirs.modes)):
        assert np.abs(one.velocity - other.velocity).max() < 1e-8 * np.abs(one.velocity).max()


def test_the_static_equilibrium_is_bent() -> None:
    """Far below its modes a frame under a weight bends by the static law: q = phi W / (M w^2)."""
    tree = {
        "name": "weight", "links": {"bed": {"fixed": True}, "load": {"mass": 3.0, "inertia": 0.1, "cg": [0, 0]}},
        "joints": {"O": {"kind": "turning", "links": ["load", "bed"], "at": [0, 0]}},
        "supports": [{"kind": "spring", "link": "load", "at": [0.1, 0], "anchor": [0.1, 1], "stiffness": 10}],
        "initial": {"pose": "equilibrium"},
        "modes": [{"frequency": 50, "damping": 0.01, "mass": 2.0,
                   "shape": [{"at": [0, 0], "displacement": [0, 0.7]}]}],
    }  # fmt: skip
    history = run(parse_machine(tree), duration=0.01)
    assert history.modes is not None
    expected = -0.7 * 3.0 * 9.81 / (2.0 * (2 * math.pi * 50) ** 2)
    np.testing.assert_allclose(history.modes.displacement[:, 0], expected, rtol=1e-5)


def test_worn_machines_start_with_the_frame_of_the_healthy_one() -> None:
    machine = bent()
    settled = run(machine, {"B": 2e-4}, revolutions=2, settled=True)
    late = run(machine, {"B": 2e-4}, revolutions=2)
    assert settled.transient < late.transient
    energies = [np.mean(each.at_sensors(machine)[each.t >= each.transient] ** 2) for each in (settled, late)]
    assert energies[0] == pytest.approx(energies[1], rel=0.02)
    found = simulate_ensemble(machine, Case(Fault({"B": 2e-4})), Ensemble(starts=2), Settings(revolutions=8))
    assert found.status == "ok", found.message


def test_what_a_catalogue_keeps_is_what_sensors_take_for_a_rigid_frame() -> None:
    machine = bent()
    history = run(machine, duration=0.2)
    sensors = machine.sensors
    transform = sensor_transform([s.at for s in sensors], [s.direction for s in sensors], (0, 0))
    seen, kept = history.at_sensors(machine), history.as_rigid(machine)
    compared = seen @ np.linalg.pinv(transform).T
    # The transform holds for small rotations: 1e-3 rad and its square here.
    assert np.abs(compared - kept).max() < 5e-3 * np.abs(compared).max()
    assert np.abs(history.band_limited_acceleration - kept).max() > 5e-2 * np.abs(compared).max()
    three = parse_machine(machine.model_dump() | {"sensors": [s.model_dump() for s in sensors[:3]]})
    each = history.as_rigid(three) @ transform[:3].T
    assert np.abs(each - seen[:, :3]).max() < 5e-3 * np.abs(seen).max()


def test_a_second_guide_is_left_to_the_first() -> None:
    tree = bent().model_dump()
    tree["joints"]["G2"] = {**tree["joints"]["G1"], "at": [0.2, -0.1]}
    machine = parse_machine(tree)
    model = build_model(machine)
    assert [repeat.closure.name for repeat in model.repeats.left_out] == ["G2.normal"]
    one, two = (run(each, duration=0.1, rtol=1e-9) for each in (bent(), machine))
    np.testing.assert_allclose(one.at_sensors(bent()), two.at_sensors(bent()), atol=1e-4)
    shape = tree["modes"][0]["shape"]
    turned = [{**point, "rotation": 1.0 if point["at"] == (0.2, -0.1) else point["rotation"]} for point in shape]
    tree["modes"] = [{**tree["modes"][0], "shape": turned}]
    with pytest.raises(AssemblyError, match=r"joints\.G2: modes turn the frame otherwise here"):
        build_model(parse_machine(tree))


def test_the_account_adds_up() -> None:
    sizes = account(bent(150.0, 400.0), Fault({"B": 1e-4}))
    assert sizes.added == ("mode(0)", "mode(1)")
    kept = len(sizes.coordinates) + len(sizes.closures)
    assert sizes.full_unknowns + 2 == kept + sum(out.unknowns for out in sizes.left_out)


def test_numbers_of_modes_are_parameters() -> None:
    machine = bent()
    case = Case(parameters={"modes.0.frequency": 240.0, "modes.0.damping": 0.05, "modes.0.mass": 7.0})
    history = simulate(machine, case, Settings(duration=0.05, rtol=1e-10))
    filed = bent(240.0, damping=0.05, mass=7.0)
    np.testing.assert_allclose(
        history.at_sensors(machine), run(filed, duration=0.05, rtol=1e-10).at_sensors(filed), atol=1e-6
    )


def test_a_machine_without_modes_is_what_it_was() -> None:
    machine = shipped_machine("slider-crank")
    assert "modes" not in machine.model_dump()
    assert bent().content_key != machine.content_key == parse_machine(machine.model_dump() | {"modes": []}).content_key
    assert parse_machine(bent().model_dump()) == bent()


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"frequency": "3 mm"}, '"mm" is a length, must be a frequency, for example "1.5 Hz"'),
        ({"frequency": 0}, "modes.0.frequency: 0: must be greater than 0"),
        ({"damping": -0.1}, "modes.0.damping: -0.1: must not be less than 0"),
        ({"damping": "200 %"}, "modes.0.damping: 200 %: must not be greater than 1"),
        ({"mass": 0}, "modes.0.mass: 0: must be greater than 0"),
        ({"masss": 1}, 'modes.0.masss: 1: unknown key; did you mean "mass"?'),
        ({"shape": []}, "modes.0.shape: needs the point [0, 0.05]: there is joints.O of frame"),
        ({"shape": [{"at": [0, 0], "displacement": [0, 1], "rotation": "1 m"}]},
         'must be a rotation by displacement, for example "2 rad/m"'),
        ({"shape": [{"at": [0, 0], "displacement": [0, 1]}] * 2},
         "modes.0.shape.1.at: [0, 0]: must be the only point of the shape there"),
    ],
)  # fmt: skip
def test_modes_that_are_refused(change: dict[str, Any], line: str) -> None:
    machine = shipped_machine("slider-crank")
    with pytest.raises(MachineError) as caught:
        parse_machine(machine.model_dump() | {"modes": [bending_mode(machine) | change]}, "m.yaml")
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_example_of_the_page_is_a_mode() -> None:
    page = (Path(__file__).parents[2] / "docs" / "reference" / "machine-file.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```yaml\n(modes:\n.*?)```", page, re.DOTALL)
    machine = shipped_machine("slider-crank")
    tree = machine.model_dump() | {"supports": (), "sensors": ()} | read_tree(example, "page")
    (mode,) = parse_machine(tree).modes
    assert (mode.frequency, mode.damping, mode.mass) == (182.0, 0.015, 4.0)
    assert mode.rotation_at((0.2, 0.05)) == 12.8


def test_at_most_five() -> None:
    with pytest.raises(MachineError, match=r"modes: 6: must be at most 5"):
        bent(*range(100, 160, 10))


def test_what_is_neglected_is_small() -> None:
    """A head on a spring in the frame, as a link of its own, and as the mode that frame and head have together.

    What the mode leaves out is what the head's travel changes in the inertia; measured are 2.7e-5 and 7.1e-5.
    """
    machine = shipped_machine("slider-crank")
    bed, head, far, stiffness = 14.0, 6.0, 0.3, 6e6
    tree = machine.model_dump()
    tree["links"]["frame"] = {"mass": bed, "inertia": 0.4, "cg": [0, 0]}
    apart = {**tree, "links": {**tree["links"], "head": {"mass": head, "inertia": 0.1, "cg": [0, far]}}}
    guide = {"kind": "sliding", "links": ["head", "frame"], "at": [0, far], "direction": [0, 1], "viscous": 400.0}
    spring = {"kind": "spring", "link": "head", "to_link": "frame", "at": [0, far], "anchor": [0, 0]}
    apart["joints"] = {**tree["joints"], "H": guide}
    apart["supports"] = [*tree["supports"], {**spring, "stiffness": stiffness}]
    whole, reduced = bed + head, bed * head / (bed + head)
    frame = {"mass": whole, "inertia": 0.5 + reduced * far**2, "cg": [0, head / whole * far]}
    w = math.sqrt(stiffness / reduced)
    shape = [
        {"at": at, "displacement": [0, -head / whole]} for at in dict.fromkeys(at for _, at in machine.frame_points)
    ]
    mode = {"frequency": w / 2 / math.pi, "damping": 400.0 / (2 * reduced * w), "mass": reduced, "shape": shape}
    together = tree | {"links": {**tree["links"], "frame": frame}, "modes": [mode]}
    for worn, bound in (({}, 1e-4), ({"B": 2e-4}, 3e-4)):
        signals = [
            run(each, worn, duration=0.25, **TIGHT).at_sensors(each)[400:]
            for each in map(parse_machine, (apart, together))
        ]
        assert np.std(signals[0] - signals[1]) < bound * np.std(signals[0]), worn
