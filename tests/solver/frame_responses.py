"""Frequency responses of frames that are rigid on their supports, in closed form, and what is compared of runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from jointplay.solver.cases.history import History
from jointplay.solver.cases.preparation import standing_model
from jointplay.solver.cases.steps import suspension_of
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.sensor import sensor_transform

FORCES = ("fx", "fy", "moment")
LINES = np.arange(2.0, 2001.0, 2.0)


def transform_of(machine: Machine) -> Any:
    sensors, frame = machine.sensors, machine.links[machine.frame]
    return sensor_transform([sensor.at for sensor in sensors], [sensor.direction for sensor in sensors], frame.cg)


def accelerances(machine: Machine, frequency: Any) -> Any:
    """Of the machine's own mass on its supports, (f, sensors, 3)."""
    model = standing_model(machine.model_copy(update={"decoupled": True}), (), ())
    found = suspension_of(model, model.vector({}))
    s = 2j * np.pi * np.asarray(frequency)[:, None, None]
    return transform_of(machine) @ np.linalg.inv(found.mass - found.gradients[1] / s - found.gradients[0] / s**2)


def tree_of(machine: Machine, frequency: Any, answers: Any, quantity: str = "accelerance") -> dict[str, Any]:
    sensors = {
        sensor.name: {
            force: np.column_stack([answers[:, i, j].real, answers[:, i, j].imag]).tolist()
            for j, force in enumerate(FORCES)
        }
        for i, sensor in enumerate(machine.sensors)
    }
    return {"quantity": quantity, "frequency": list(map(float, frequency)), "sensors": sensors}


def harmonics(signal: Any, history: History, since: float = 0.0) -> Any:
    samples = round(2 * np.pi / history.drive_speed * history.sample_rate)
    steady = signal[history.t >= max(since, history.transient)]
    revolutions = len(steady) // samples
    return np.fft.rfft(steady[: revolutions * samples], axis=0)[revolutions::revolutions][: round(0.4 * samples)]
