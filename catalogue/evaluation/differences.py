"""In what a real machine may differ from its model: errors of the model, and causes no hypothesis stands for."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from jointplay.catalogue.diagnosing.frame_forces import Revolution
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.evaluation.truth import Response, Truth, draw_contacts
from jointplay.catalogue.plans.driving import nominal_drive_speed
from jointplay.catalogue.plans.entry import seed_from
from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.plans.variants import Variant, output_load
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.machine import Machine, has_known_effort, parse_machine

Difference = Callable[[Truth, np.random.Generator], Truth]
"""Draws what differs, and returns the machine with it."""

HERTZ_LENGTH = 40e-6
"""Penetration at which a Hertzian contact is as stiff as the linear one it stands for, m."""

LAWS: Mapping[str, Mapping[str, float]] = {"hertz": {"hysteresis": 1.7}, "lankarani-nikravesh": {"restitution": 0.7}}
"""Other contact laws, with the middle of what is drawn."""

TABLE_POINTS = 36
"""Points of a load over the drive angle."""

LOAD_ORDERS = 8
"""Orders of a load that comes and goes with the strokes of a machine."""

RIPPLE_ORDERS = (1, 2, 3, 4, 6, 12)
"""Orders of which one is the ripple of a drive."""

WEIGHT = 9.81
"""Acceleration of gravity [m/s2] that weights are meant with, also where a machine lies flat."""


def with_differences(truth: Truth, names: tuple[str, ...], seed: int, number: int) -> Truth:
    """Return a truth with some of :data:`DIFFERENCES`, each drawn from a seed of its own."""
    for name in names:
        draws = np.random.default_rng(seed_from("difference", name, seed, truth.hypothesis.label, number))
        truth = DIFFERENCES[name](truth, draws)
    return truth


def _law(truth: Truth, draws: np.random.Generator) -> Truth:
    """A Hertzian contact with hysteresis in every joint, of one of two kinds."""
    law = str(draws.choice(sorted(LAWS)))
    machine = _with_law(truth.machine, law)
    kept = {path: value for path, value in truth.parameters.items() if not _of_normal_force(path)}
    return replace(truth, machine=machine, parameters=kept | draw_contacts(machine, truth.joints, 0.6, draws))


def _of_normal_force(path: str) -> bool:
    return path.rpartition(".contact.")[2] in ("stiffness", "damping", "hysteresis", "restitution")


@lru_cache(maxsize=16)
def _with_law(machine: Machine, law: str) -> Machine:
    tree = json.loads(machine.canonical_json())
    for joint in machine.wearing_joints:
        own = machine.joints[joint].contact
        scale = 1.0 / math.sqrt(HERTZ_LENGTH) if own.law == "linear" else 1.0
        contact = {
            **own.own_friction,
            "viscous": own.viscous,
            "law": law,
            "stiffness": own.stiffness * scale,
            **LAWS[law],
        }
        tree["joints"][joint]["contact"] = contact
    return _machine(tree, machine)


def _resonance(truth: Truth, draws: np.random.Generator) -> Truth:
    """All sensors on one spring at 300 Hz."""
    gains = (1.0,) * len(truth.machine.sensors)
    return replace(truth, response=Response(300.0, float(draws.uniform(0.01, 0.05)), gains))


def _mode(truth: Truth, draws: np.random.Generator) -> Truth:
    """A mode of the frame between 150 and 600 Hz, which every sensor sees in its own way."""
    frequency = math.exp(draws.uniform(math.log(150.0), math.log(600.0)))
    gains = tuple(draws.uniform(-0.6, 1.0, len(truth.machine.sensors)).tolist())
    return replace(truth, response=Response(frequency, float(draws.uniform(0.01, 0.05)), gains))


def _frame(truth: Truth, draws: np.random.Generator) -> Truth:
    """Mass and inertia of the frame up to 20 % off, stiffness of all supports in x and in y up to 30 %."""
    machine = truth.machine
    body = machine.links[machine.frame]
    changed: dict[str, float] = {}
    for name in ("mass", "inertia"):
        factor = float(draws.uniform(0.8, 1.2))
        if getattr(body, name):
            changed[f"links.{machine.frame}.{name}"] = getattr(body, name) * factor
    factors = draws.uniform(0.7, 1.3, 2).tolist()
    changed |= _supports(machine, range(len(machine.supports)), (factors[0], factors[1]))
    return replace(truth, parameters={**truth.parameters, **changed})


def _supports(
    machine: Machine, supports: range, factors: tuple[float, float], name: str = "stiffness"
) -> dict[str, float]:
    """Changed stiffness or damping of some supports: in x and y, or along a spring with the first factor."""
    changed: dict[str, float] = {}
    for index in supports:
        own = getattr(machine.supports[index], name, None)
        if isinstance(own, tuple):
            changed |= {
                f"supports.{index}.{name}.{axis}": value * factors[axis] for axis, value in enumerate(own) if value
            }
        elif own:
            changed[f"supports.{index}.{name}"] = own * factors[0]
    return changed


def _half_mount(truth: Truth, draws: np.random.Generator) -> Truth:
    """One support at half its stiffness."""
    return _with_soft_mount(truth, 0.5, int(draws.integers(len(truth.machine.supports))))


def _loose_mount(truth: Truth, draws: np.random.Generator) -> Truth:
    """One support at a tenth of its stiffness, and a third of its damping."""
    return _with_soft_mount(truth, 0.1, int(draws.integers(len(truth.machine.supports))), damping=True)


def _with_soft_mount(truth: Truth, factor: float, index: int, *, damping: bool = False) -> Truth:
    changed = _supports(truth.machine, range(index, index + 1), (factor, factor))
    if damping:
        changed |= _supports(truth.machine, range(index, index + 1), (math.sqrt(factor),) * 2, "damping")
    return replace(truth, parameters={**truth.parameters, **changed}, causes=(*truth.causes, f"mount {index}"))


def _soft_mounts(truth: Truth, draws: np.random.Generator) -> Truth:
    """All supports at 40 to 75 % of their stiffness; softer rubber damps less."""
    factor = float(draws.uniform(0.4, 0.75))
    every = range(len(truth.machine.supports))
    changed = _supports(truth.machine, every, (factor, factor))
    changed |= _supports(truth.machine, every, (math.sqrt(factor),) * 2, "damping")
    return replace(truth, parameters={**truth.parameters, **changed}, causes=(*truth.causes, "all mounts"))


def _frame_mass(truth: Truth, draws: np.random.Generator) -> Truth:
    """A frame that is 20 to 40 % lighter or heavier, and as much easier or harder to turn."""
    factor = 1.0 + float(draws.choice([-1.0, 1.0])) * float(draws.uniform(0.2, 0.4))
    machine = truth.machine
    body = machine.links[machine.frame]
    own = {name: getattr(body, name) for name in ("mass", "inertia")}
    changed = {f"links.{machine.frame}.{name}": factor * value for name, value in own.items() if value}
    causes = (*truth.causes, f"mass of {machine.frame}")
    return replace(truth, parameters={**truth.parameters, **changed}, causes=causes)


def _gain(truth: Truth, draws: np.random.Generator) -> Truth:
    """Every sensor up to 15 % off."""
    return replace(truth, gains=tuple((1.0 + draws.uniform(-0.15, 0.15, len(truth.machine.sensors))).tolist()))


def _load(truth: Truth, draws: np.random.Generator) -> Truth:
    """A constant force of 20 to 100 N on the output link."""
    force = float(draws.uniform(20.0, 100.0)) * float(draws.choice([-1.0, 1.0]))
    link, at, (along, _) = _output(truth.machine)
    machine = _with_load(truth.machine, link, at, "force", (0.0, 0.0))
    place = len(machine.loads) - 1
    changed = {f"loads.{place}.force.{axis}": force * part for axis, part in enumerate(along)}
    return replace(truth, machine=machine, parameters={**truth.parameters, **changed}, causes=(*truth.causes, "load"))


def _cyclic_load(truth: Truth, draws: np.random.Generator) -> Truth:
    """A force against one of the two strokes of the output link, of one to three weights of the moving links.

    Its first orders are what they are of a force that comes and goes at once, weighed so that its edges are soft
    (C. Lanczos, Discourse on Fourier series, 1966, chapter 4). Their amplitudes are numbers of a case, so that one
    compiled model serves all recordings.
    """
    base = truth.machine
    place = output_load(base)
    if place is None:
        return truth
    moving = sum(link.mass or 0.0 for name, link in base.links.items() if name != base.frame)
    force = float(draws.uniform(1.0, 3.0)) * moving * WEIGHT * (place.arm or 1.0)
    stroke = float(draws.choice([-1.0, 1.0]))
    mean, waves = _stroke(base, stroke)
    machine = Variant(load=place.link, load_orders=tuple(range(1, LOAD_ORDERS + 1))).machine(base)
    numbers = MachineNumbers(machine)
    parts = {"load": mean, **waves}
    changed = {
        target.path: -stroke * force * part * target.share
        for path, part in parts.items()
        for target in numbers.targets(path)
    }
    causes = (*truth.causes, "load on one stroke")
    return replace(truth, machine=machine, parameters={**truth.parameters, **changed}, causes=causes)


@lru_cache(maxsize=16)
def _stroke(machine: Machine, stroke: float) -> tuple[float, dict[str, float]]:
    """Mean and waves, by the path of a plan, of what is 1 on the strokes forward (1) or back (-1), else 0."""
    place = output_load(machine)
    assert place is not None
    speed = nominal_drive_speed(machine)
    velocity = Revolution.of(machine, speed).velocity(place.link, place.direction)
    course = (stroke * velocity > 0.0).astype(np.float64)
    angle = math.copysign(2.0 * math.pi, speed) * np.arange(len(course)) / len(course)
    waves = {}
    for order in range(1, LOAD_ORDERS + 1):
        soft = 2.0 * float(np.sinc(order / (LOAD_ORDERS + 1)))
        waves[f"load.{order}.sin"] = soft * float(np.mean(course * np.sin(order * angle)))
        waves[f"load.{order}.cos"] = soft * float(np.mean(course * np.cos(order * angle)))
    return float(course.mean()), waves


def _motor_ripple(truth: Truth, draws: np.random.Generator) -> Truth:
    """Ripple of a motor with three phases: up to 1 % of the speed at order 6, up to 0.5 % at order 12."""
    if has_known_effort(truth.machine):  # ripples as its own curve and inertia have it
        return truth
    shares = {6: float(draws.uniform(0.0, 0.01)), 12: float(draws.uniform(0.0, 0.005))}
    return _with_ripple(truth, tuple(shares), shares, draws)


def _ripple(truth: Truth, draws: np.random.Generator) -> Truth:
    """Ripple of the drive at one order, of 0.5 to 1.5 % of its speed."""
    if has_known_effort(truth.machine):
        raise DiagnosisError(f"machine {truth.machine.name}: the motion of its drive is not prescribed, nor is ripple")
    order = int(draws.choice(RIPPLE_ORDERS))
    return _with_ripple(truth, RIPPLE_ORDERS, {order: float(draws.uniform(0.005, 0.015))}, draws)


def _with_ripple(
    truth: Truth, orders: tuple[int, ...], shares: Mapping[int, float], draws: np.random.Generator
) -> Truth:
    """A machine with terms of some orders, and speeds that ripple by some shares of the mean at some of them."""
    machine = Variant(ripple=orders).machine(truth.machine)
    numbers = MachineNumbers(machine)
    changed: dict[str, float] = {}
    for order, share in shares.items():
        phase = float(draws.uniform(0.0, 2.0 * math.pi))
        for path, part in (("sin", math.cos(phase)), ("cos", math.sin(phase))):
            changed |= {target.path: share / order * part for target in numbers.targets(f"ripple.{order}.{path}")}
    causes = (*truth.causes, *(f"ripple of the drive, order {order}" for order in shares))
    return replace(truth, machine=machine, parameters={**truth.parameters, **changed}, causes=causes)


def _bent_rail(truth: Truth, draws: np.random.Generator) -> Truth:
    """A force across the way of the output link, once a revolution, of a third of the moving weight."""
    machine = truth.machine
    moving = sum(link.mass or 0.0 for name, link in machine.links.items() if name != machine.frame)
    force = moving * (machine.gravity or 9.81) / 3.0
    # A table is a part of the compiled model, so two phases serve all recordings.
    phase = float(draws.choice([0.0, 0.5 * math.pi]))
    link, at, (_, across) = _output(machine)
    angles = [2.0 * math.pi * i / TABLE_POINTS for i in range(TABLE_POINTS)]
    rows = [(a, *(force * math.sin(a + phase) * part for part in across), 0.0) for a in angles]
    return replace(truth, machine=_with_load(machine, link, at, "over_angle", tuple(rows)))


def _unbalance(truth: Truth, draws: np.random.Generator) -> Truth:
    """A weight at the far end of the driven link, 10, 20 or 30 % of its own."""
    machine = _with_unbalance(truth.machine, float(draws.choice([0.1, 0.2, 0.3])))
    return replace(truth, machine=machine, causes=(*truth.causes, "unbalance"))


@lru_cache(maxsize=16)
def _with_unbalance(machine: Machine, share: float) -> Machine:
    joint = machine.joints[str(getattr(machine.drive, "joint", ""))]
    name = next(each for each in joint.links if each != machine.frame)
    body = machine.links[name]
    others = [each.at for each in machine.joints.values() if isinstance(each, TurningJoint) and name in each.links]
    far = max(others, key=lambda point: math.dist(point, joint.at))
    tree = json.loads(machine.canonical_json())
    cg = [(own + share * end) / (1.0 + share) for own, end in zip(body.cg, far, strict=True)]
    tree["links"][name] |= {"mass": (body.mass or 0.0) * (1.0 + share), "cg": cg}
    return _machine(tree, machine)


Components = tuple[float, float]


def _output(machine: Machine) -> tuple[str, Components, tuple[Components, Components]]:
    """The link that does the work, the point it is loaded at, and the directions along and across its way.

    That is the link that slides on the frame; else the one that turns on the frame and is not driven, at the joint
    furthest from the frame's.
    """
    frame, driven = machine.frame, str(getattr(machine.drive, "joint", ""))
    for joint in machine.joints.values():
        if isinstance(joint, SlidingJoint) and frame in joint.links:
            link = next(name for name in joint.links if name != frame)
            x, y = joint.direction
            return link, joint.at, ((x, y), (-y, x))
    for name, joint in machine.joints.items():
        if isinstance(joint, TurningJoint) and frame in joint.links and name != driven:
            link = next(each for each in joint.links if each != frame)
            others = [other.at for other in machine.joints.values() if link in other.links]
            far = max(others, key=lambda point: math.dist(point, joint.at))
            length = math.dist(far, joint.at)
            x, y = ((far[0] - joint.at[0]) / length, (far[1] - joint.at[1]) / length) if length else (1.0, 0.0)
            return link, far, ((-y, x), (x, y))
    moving = next(name for name in machine.links if name != frame)
    return moving, machine.links[moving].cg, ((1.0, 0.0), (0.0, 1.0))


@lru_cache(maxsize=64)
def _with_load(machine: Machine, link: str, at: Components, name: str, value: tuple[Any, ...]) -> Machine:
    tree = json.loads(machine.canonical_json())
    tree["loads"] = [*tree["loads"], {"link": link, "at": list(at), name: value}]
    return _machine(tree, machine)


def _machine(tree: dict[str, Any], machine: Machine) -> Machine:
    return parse_machine(tree, f"machine {machine.name} of an evaluation")


DIFFERENCES: Mapping[str, Difference] = {
    "law": _law,
    "resonance": _resonance,
    "mode": _mode,
    "frame": _frame,
    "gain": _gain,
    "load": _load,
    "half-mount": _half_mount,
    "loose-mount": _loose_mount,
    "soft-mounts": _soft_mounts,
    "frame-mass": _frame_mass,
    "ripple": _ripple,
    "cyclic-load": _cyclic_load,
    "motor-ripple": _motor_ripple,
    "bent-rail": _bent_rail,
    "unbalance": _unbalance,
}
"""Differences by name."""
