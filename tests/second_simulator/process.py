"""What a process does to a machine: forces on its output, constant or on one of the two strokes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from second_simulator.ideal import Ideal
from second_simulator.machine import TABLE, Array, Load, Machine, Point

#: Part of a turn over which a stroke's force comes and goes.
EDGE = 10 / 360


@dataclass(frozen=True, eq=False)
class Output:
    """Point of the output body, its direction of motion (TABLE, 2) over a turn, and its speed (TABLE,) along it."""

    body: str
    at: Point
    direction: Array
    speed: Array


def output(machine: Machine) -> Output:
    """The body that slides on the frame, along its guide; else the one that swings on it, across its arm."""
    ideal = Ideal(machine)
    places, rates = ideal.revolution(TABLE)
    index = {name: place for place, name in enumerate(machine.bodies)}
    for guide in machine.guides.values():
        if guide.rail == machine.frame:
            along = np.tile(guide.direction, (TABLE, 1))
            body = guide.slider
            return Output(body, guide.at, along, np.einsum("tc,tc->t", along, rates[:, index[body], :2]))
    drive = machine.drive
    assert drive is not None
    hinge = next(
        pin
        for pin in machine.pins.values()
        if machine.frame in (pin.pin, pin.socket) and drive.driven not in (pin.pin, pin.socket)
    )
    body = hinge.pin if hinge.socket == machine.frame else hinge.socket
    end = next(pin.at for pin in machine.pins.values() if body in (pin.pin, pin.socket) and pin is not hinge)
    arm = np.array(end) - np.array(hinge.at)
    angle = places[:, index[body], 2] + math.atan2(arm[1], arm[0])
    across = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    return Output(body, end, across, rates[:, index[body], 2] * float(np.hypot(*arm)))


def loaded(machine: Machine, constant: float = 0.0, stroke: float = 0.0, sense: int = 1) -> Machine:
    """The machine with forces [N] on its output.

    ``constant`` always acts the same way along its path; ``stroke`` resists it on the forward stroke, or (sense -1) on
    the other, whichever way the drive turns.
    """
    found = output(machine)
    assert machine.drive is not None
    working = (found.speed * sense * math.copysign(1.0, machine.drive.speed) > 0).astype(float)
    window = np.hanning(round(EDGE * TABLE) + 2)[1:-1]
    soft = np.convolve(np.concatenate([working] * 3), window / window.sum(), mode="same")[TABLE : 2 * TABLE]
    force = constant - sense * stroke * soft
    table = np.column_stack([force[:, None] * found.direction, np.zeros(TABLE)])
    return replace(machine, loads=(*machine.loads, Load(found.body, found.at, table)))
