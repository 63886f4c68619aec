"""What else than wear can be the matter with a machine."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from second_simulator.individual import Individual, log_uniform
from second_simulator.machine import Body, Machine, Mount
from second_simulator.process import loaded
from second_simulator.turning import Ripple

Fault = Callable[[Individual, np.random.Generator], None]


def soften(machine: Machine, place: int, factor: float) -> Machine:
    """The machine with another stiffness of one mount; its damping goes with the root."""
    mounts, old = list(machine.mounts), machine.mounts[place]
    root = math.sqrt(factor)
    (kx, ky), (cx, cy) = old.stiffness, old.damping
    mounts[place] = replace(old, stiffness=(factor * kx, factor * ky), damping=(root * cx, root * cy))
    return replace(machine, mounts=tuple(mounts))


def one_mount(individual: Individual, draw: np.random.Generator) -> None:
    """One mount has gone soft."""
    place, factor = int(draw.integers(len(individual.machine.mounts))), float(draw.uniform(0.2, 0.6))
    individual.machine = soften(individual.machine, place, factor)
    individual.blame("mount", str(place), factor, "x stiffness")


def all_mounts(individual: Individual, draw: np.random.Generator) -> None:
    """All mounts half or twice as stiff."""
    factor = float(draw.choice([0.5, 2.0]))
    for place in range(len(individual.machine.mounts)):
        individual.machine = soften(individual.machine, place, factor)
    individual.blame("mounts", "", factor, "x stiffness")


def unbalance(individual: Individual, draw: np.random.Generator) -> None:
    """A further mass at the end of the driven body, up to 15 % of the moving mass."""
    machine = individual.machine
    drive = machine.drive
    assert drive is not None
    centre = np.array(machine.pins[drive.joint].at)
    ends = [np.array(pin.at) - centre for pin in machine.pins.values() if drive.driven in (pin.pin, pin.socket)]
    radius = max(float(np.hypot(*each)) for each in ends)
    mass, angle = machine.moving_mass * draw.uniform(0.06, 0.15), draw.uniform(0, 2 * math.pi)
    at = centre + radius * np.array([math.cos(angle), math.sin(angle)])
    individual.machine = machine.with_body(drive.driven, **with_mass(machine.bodies[drive.driven], mass, at))
    individual.blame("unbalance", drive.driven, mass * radius, "kg m")


def with_mass(body: Body, mass: float, at: np.ndarray) -> dict[str, object]:
    """Numbers of a body with a point mass added."""
    total, own = body.mass + mass, np.array(body.at)
    centre = (body.mass * own + mass * at) / total
    inertia = body.inertia + body.mass * float(((own - centre) ** 2).sum()) + mass * float(((at - centre) ** 2).sum())
    return {"mass": total, "inertia": inertia, "at": (float(centre[0]), float(centre[1]))}


def frame_mass(individual: Individual, draw: np.random.Generator) -> None:
    """The frame's mass is 40 % more or less than filed, and its inertia with it."""
    machine, factor = individual.machine, float(draw.choice([0.6, 1.4]))
    frame = machine.bodies[machine.frame]
    individual.machine = machine.with_body(machine.frame, mass=factor * frame.mass, inertia=factor * frame.inertia)
    individual.blame("mass", machine.frame, factor, "x mass")


def load_constant(individual: Individual, draw: np.random.Generator) -> None:
    """A force of 60 to 150 N on the output."""
    force = float(draw.uniform(60, 150) * draw.choice([-1, 1]))
    individual.machine = loaded(individual.machine, constant=force)
    individual.blame("load-constant", "", force, "N")


def load_cyclic(individual: Individual, draw: np.random.Generator) -> None:
    """A force of 100 to 150 N against the output on one stroke."""
    force, sense = float(draw.uniform(100, 150)), int(draw.choice([-1, 1]))
    individual.machine = loaded(individual.machine, stroke=force, sense=sense)
    individual.blame("load-cyclic", "", force, "N")


def frame_mode(individual: Individual, draw: np.random.Generator) -> None:
    """Part of the frame sits on springs on the rest, with a mode at 80 to 250 Hz."""
    machine, frequency = individual.machine, log_uniform(draw, 80.0, 250.0)
    share, ratio = draw.uniform(0.15, 0.3), draw.uniform(0.01, 0.03)
    frame = machine.bodies[machine.frame]
    panel = Body(share * frame.mass, share * frame.inertia, frame.at)
    rest = replace(frame, mass=(1 - share) * frame.mass, inertia=(1 - share) * frame.inertia)
    reduced, omega = share * (1 - share) * frame.mass, 2 * math.pi * frequency
    # Twice the stiffness along x, and springs so far apart that turning is 1.6 times as fast.
    half = 1.6 * math.sqrt(frame.inertia / frame.mass)
    stiffness = (reduced * omega**2, 0.5 * reduced * omega**2)
    damping = (2 * ratio * reduced * omega, ratio * reduced * omega)
    springs = [
        Mount("panel", (frame.at[0] + side * half, frame.at[1]), stiffness, damping, machine.frame) for side in (-1, 1)
    ]
    bodies = {**machine.bodies, machine.frame: rest, "panel": panel}
    individual.machine = replace(machine, bodies=bodies, mounts=(*machine.mounts, *springs))
    individual.blame("mode", machine.frame, frequency, "Hz")


def drive_ripple(individual: Individual, draw: np.random.Generator) -> None:
    """The drive turns unevenly: by 1 to 3 % of its speed, once to eight times a revolution."""
    order = int(draw.choice([1, 2, 3, 4, 6, 8]))
    amplitude = float(draw.uniform(0.01, 0.03)) / order
    individual.ripple.append(Ripple(order, amplitude, float(draw.uniform(0, 2 * math.pi))))
    individual.blame("ripple", f"order {order}", amplitude, "rad")


FAULTS: tuple[Fault, ...] = (
    one_mount,
    all_mounts,
    unbalance,
    frame_mass,
    load_constant,
    load_cyclic,
    frame_mode,
    drive_ripple,
)
