"""What the joints of a machine carry at each angle of its drive, laid over the revolution that was recorded."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import scipy.fft

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.sensors import map_sensors
from jointplay.catalogue.signals.shown_motion import ShownLine, ShownSignal
from jointplay.catalogue.signals.shown_views import by_angle, show_signal
from jointplay.catalogue.signals.signal_question import SignalQuestion
from jointplay.solver.arrays import FloatArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import RotationDrive
from jointplay.solver.simulation.simulate import simulate

SAMPLE_RATE = 20_000.0
SAMPLES_A_PLACE = 2.0


def show_contact(
    recording: Recording,
    question: SignalQuestion,
    machine: Machine,
    mapping: Mapping[str, str] | None,
    clearances: Mapping[str, float],
) -> ShownSignal:
    """Simulate a machine as it was matched, and show the force in each joint by the angle of the recording.

    Parameters
    ----------
    recording : Recording
    question : SignalQuestion
        With a speed.
    machine : Machine
    mapping : mapping of column to sensor, optional
    clearances : mapping of joint to float
        Radial, m; joints that are not in it are ideal.

    Returns
    -------
    ShownSignal
        The lines are mean forces [N] on pins, and normal forces on guides.

    Raises
    ------
    MeasurementError
        The machine is not driven at a constant speed, or it cannot be simulated.
    """
    drive = machine.drive
    if not isinstance(drive, RotationDrive) or not isinstance(drive.speed, int | float):
        rule = "forces by angle are simulated of machines that turn at a constant speed"
        raise MeasurementError(recording.name, rule=rule, field="view")
    seen = replace(question, view="revolution", of="sensors", unit="m/s2", channel="")
    measured = show_signal(recording, seen)
    parts, speed = len(measured.at), abs(question.speed or 0.0)
    rate = max(SAMPLE_RATE, SAMPLES_A_PLACE * parts * speed / (2.0 * math.pi))
    settings = Settings(sample_rate=rate, accuracy="draft", links=True, settled=True, transient=False)
    case = Case(Fault(dict(clearances)), {"drive.speed": math.copysign(speed, drive.speed)})
    history = simulate(machine, case, settings)
    if history.status is not Status.OK or history.links is None:
        raise MeasurementError(recording.name, rule=f"its machine cannot be simulated: {history.message}", field="view")
    angle = speed * history.t
    sensing = map_sensors(recording, machine, mapping)
    names = [sensor.name for sensor in machine.sensors]
    felt, _ = by_angle(history.at_sensors(machine)[:, [names.index(each) for each in sensing.sensors]], angle, parts)
    means = {line.name: line.values for line in measured.lines if line.kind == "mean"}
    recorded = np.array([means[recording.channel_names[column]] for column in sensing.columns])
    shift, alike = lay_over(recorded, felt)
    lines = []
    for joint, force in forces_of(history.links.reactions).items():
        mean, _ = by_angle(force[:, None], angle, parts)
        lines.append(ShownLine(joint, "mean", "N", np.roll(mean[0], shift)))
    notes = (
        "simulated: " + (", ".join(f"{joint} {1e6 * size:.3g} um" for joint, size in clearances.items()) or "no play"),
        f"laid over the recording by its sensors, whose means agree to {100 * alike:.0f} %",
    )
    return replace(measured, lines=tuple(lines), notes=notes)


def lay_over(recorded: FloatArray, felt: FloatArray) -> tuple[int, float]:
    """By how many places a revolution is to be turned to lie over another, and their correlation then.

    Parameters
    ----------
    recorded, felt : (s, k) arrays
        What the same sensors saw by angle.
    """
    whole = recorded - recorded.mean(axis=1, keepdims=True)
    other = felt - felt.mean(axis=1, keepdims=True)
    product = (scipy.fft.rfft(whole, axis=1) * scipy.fft.rfft(other, axis=1).conj()).sum(axis=0)
    alike = scipy.fft.irfft(product, whole.shape[1])
    scale = float(np.sqrt(np.sum(whole**2) * np.sum(other**2)))
    best = int(np.argmax(alike))
    return best, float(alike[best]) / scale if scale > 0 else 0.0


def forces_of(reactions: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Magnitude of the force [N] in each joint, (n,)."""
    found = {}
    for name, values in reactions.items():
        if name.startswith("force_"):
            found[name.removeprefix("force_").removesuffix("_on_pin")] = np.hypot(values[:, 0], values[:, 1])
        elif name.startswith("normal_"):
            found[name.removeprefix("normal_")] = np.abs(values)
    return dict(sorted(found.items()))
