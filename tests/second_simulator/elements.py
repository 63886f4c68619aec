"""A machine as arrays: what the compiled march over time reads."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from second_simulator.machine import TABLE, Array, Machine, Point

Indices = npt.NDArray[np.int64]

#: Natural frequency [rad/s] and damping ratio of a guide across its line: above what is recorded, and quickly gone.
GUIDE_FREQUENCY, GUIDE_DAMPING = 2 * math.pi * 12_000, 0.3
#: Least speed [m/s] at which a contact counts as begun: slower ones would be damped without bound.
SLOWEST_APPROACH = 0.02


class Elements(NamedTuple):
    """Everything that acts; points are from the centre of gravity, in the body's own axes (those of the drawing)."""

    gravity: float
    inverse_mass: Array
    inverse_inertia: Array
    frame: int
    pin_bodies: Indices  # (P, 2): pin, socket
    pin_points: Array  # (P, 4): of the pin, of the socket
    pin_numbers: Array  # (P, 8): radius, clearance, is hertz, stiffness, damping, hysteresis, friction, its velocity
    guide_bodies: Indices  # (G, 2): slider, rail
    guide_points: Array  # (G, 6): of the slider, of the rail, direction
    guide_numbers: Array  # (G, 7): stiffness, damping, of the couple both, friction, its velocity, viscous
    mount_bodies: Indices  # (M, 2): body, other body or -1
    mount_points: Array  # (M, 4): of the body, of the other or in the drawing
    mount_numbers: Array  # (M, 4): stiffness, damping
    load_bodies: Indices  # (L,)
    load_points: Array  # (L, 2)
    load_tables: Array  # (L, TABLE, 3)
    driven: int  # -1: nothing is driven
    base: int


def elements(machine: Machine, clearances: Mapping[str, float]) -> Elements:
    """Arrays of a machine with a radial clearance [m] in every turning joint."""
    index = {name: place for place, name in enumerate(machine.bodies)}
    bodies = list(machine.bodies.values())

    def local(body: str, at: Point) -> Point:
        centre = machine.bodies[body].at
        return at[0] - centre[0], at[1] - centre[1]

    pins, guides, mounts = machine.pins, machine.guides.values(), machine.mounts
    numbers = []
    for name, pin in pins.items():
        law = machine.contacts[name]
        hysteresis = 0.75 * (1 - law.restitution**2)
        hertz = float(law.law == "hertz")
        rubs = (law.friction, law.friction_velocity)
        numbers.append((pin.radius, clearances[name], hertz, law.stiffness, law.damping, hysteresis, *rubs))
    stiff = []
    for guide in guides:
        slider = machine.bodies[guide.slider]
        square, rate = GUIDE_FREQUENCY**2, 2 * GUIDE_DAMPING * GUIDE_FREQUENCY
        along = (slider.mass * square, slider.mass * rate, slider.inertia * square, slider.inertia * rate)
        stiff.append((*along, guide.friction, guide.friction_velocity, guide.viscous))
    drive = machine.drive
    return Elements(
        gravity=machine.gravity,
        inverse_mass=np.array([1 / body.mass for body in bodies]),
        inverse_inertia=np.array([1 / body.inertia for body in bodies]),
        frame=index[machine.frame],
        pin_bodies=_indices([(index[pin.pin], index[pin.socket]) for pin in pins.values()], 2),
        pin_points=_table([(*local(pin.pin, pin.at), *local(pin.socket, pin.at)) for pin in pins.values()], 4),
        pin_numbers=_table(numbers, 8),
        guide_bodies=_indices([(index[guide.slider], index[guide.rail]) for guide in guides], 2),
        guide_points=_table(
            [(*local(guide.slider, guide.at), *local(guide.rail, guide.at), *guide.direction) for guide in guides], 6
        ),
        guide_numbers=_table(stiff, 7),
        mount_bodies=_indices([(index[each.body], index[each.to] if each.to else -1) for each in mounts], 2),
        mount_points=_table(
            [(*local(each.body, each.at), *(local(each.to, each.at) if each.to else each.at)) for each in mounts], 4
        ),
        mount_numbers=_table([(*each.stiffness, *each.damping) for each in mounts], 4),
        load_bodies=np.array([index[load.body] for load in machine.loads], dtype=np.int64),
        load_points=_table([local(load.body, load.at) for load in machine.loads], 2),
        load_tables=np.array([load.table for load in machine.loads]).reshape(-1, TABLE, 3),
        driven=index[drive.driven] if drive else -1,
        base=index[drive.base] if drive else -1,
    )


def _table(rows: Sequence[tuple[float, ...]], width: int) -> Array:
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def _indices(rows: Sequence[tuple[int, ...]], width: int) -> Indices:
    return np.array(rows, dtype=np.int64).reshape(-1, width)
