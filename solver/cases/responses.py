"""The frequency response of a machine's frame: what was measured, or what the modes in its file make of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.cases.preparation import standing_model
from jointplay.solver.cases.rates import without_dry_friction
from jointplay.solver.cases.steps import Suspension, suspension_modes, suspension_of
from jointplay.solver.equations.drive import drive_rates
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.modes import shapes_at
from jointplay.solver.spectra.sensor import sensor_transform

#: Frequencies by modes: so many, evenly by ratio, from half of the drive's or the lowest resonance, whichever is lower,
#: to three times the highest.
LINES, BELOW, ABOVE = 800, 0.5, 3.0
#: More of them beside a resonance, in its damping ratios; the nearest are within 2 % of its peak.
BESIDE = np.array([-8.0, -4.0, -2.0, -1.0, -0.5, -0.2, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0])
#: What a resonance is taken to be damped by there at least: an undamped one has no height.
LEAST_DAMPING = 1e-3


@dataclass(frozen=True, eq=False)
class FrameResponse:
    """What sensors answer to forces at a point of the frame.

    Attributes
    ----------
    point : str
        Where a unit of fx, fy and moment acts, in words.
    frequency : (f,) array
        Hz, > 0.
    accelerances : (f, s, 3) complex array
        Of the sensors, in the order of the file, m/s2/N and m/s2/(N m).
    """

    point: str
    frequency: FloatArray
    accelerances: ComplexArray


def find_response(machine: Machine) -> FrameResponse:
    """Find what a frame answers, as measured or by its modes, where the file has one of these."""
    if machine.response is None:
        return _by_modes(machine)
    frequency = np.array(machine.response.frequency)
    names = tuple(sensor.name for sensor in machine.sensors)
    known = frequency > 0
    found = machine.response.accelerances(names, frequency)[known]
    return FrameResponse(f"the centre of gravity of {machine.frame}", frequency[known], found)


def _by_modes(machine: Machine) -> FrameResponse:
    """By modes of a frame on its supports, links in place and at rest: at the joint that the modes move most."""
    points = list(machine.frame_points)
    joints = [each for each in points if each[0].startswith("joints.")] or points
    compliance = 1.0 / np.array([mode.mass for mode in machine.modes])
    moved = np.sum(shapes_at(machine.modes, [at for _, at in joints]) ** 2, axis=2) @ compliance
    name, at = joints[int(np.argmax(moved))]
    model = standing_model(without_dry_friction(machine), (), ())
    suspension = suspension_of(model, model.vector({}))
    free = [i for i, motion in enumerate(("x", "y", "theta")) if motion in suspension.motions]
    turning = np.array([float(i == 2) for i in free] + [mode.rotation_at(at) for mode in machine.modes])

    def along(points: list[tuple[float, float]], directions: list[tuple[float, float]]) -> FloatArray:
        """What the frame's motions move points by (p, k), along directions."""
        rigid = sensor_transform(points, directions, machine.links[machine.frame].cg)
        return np.hstack([rigid[:, free], np.einsum("pmk,pk->pm", shapes_at(machine.modes, points), directions)])

    forces = np.vstack([along([at, at], [(1.0, 0.0), (0.0, 1.0)]), turning])
    sensors = along([sensor.at for sensor in machine.sensors], [sensor.direction for sensor in machine.sensors])
    frequency = _lines(machine, suspension)
    name = name.replace("joints.", "joint ")
    return FrameResponse(name, frequency, sensors @ np.linalg.solve(suspension.apparent_mass(frequency), forces.T))


def _lines(machine: Machine, suspension: Suspension) -> FloatArray:
    """Frequencies [Hz] at which a response by modes is drawn."""
    resonances = [(abs(s) / (2 * math.pi), -s.real / abs(s)) for s in suspension_modes(suspension)]
    resonances += [(mode.frequency, mode.damping) for mode in machine.modes]
    drive = abs(drive_rates(machine, {})[0]) / (2 * math.pi)
    low = BELOW * min([each for each, _ in resonances] + [drive or math.inf])
    evenly = np.geomspace(low, ABOVE * max(each for each, _ in resonances), LINES)
    close = [each * (1.0 + max(damping, LEAST_DAMPING) * BESIDE) for each, damping in resonances]
    lines = np.unique(np.concatenate([evenly, *close]))
    return lines[lines >= low]
