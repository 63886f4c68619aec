"""Virtual recordings: what the sensors of a machine with chosen wear would record, simulated by a worker."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from jointplay.app.errors import BadFieldError
from jointplay.app.jobs.summaries import summary_of
from jointplay.app.storage.told import Told
from jointplay.solver.machines.machine import Machine, parse_machine

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from jointplay.solver.cases.history import History

SAMPLE_RATE = 10_000.0
RPM = 30.0 / math.pi
LIMITS = 5.0
"""Times the limit of time of the service: the equations of a machine are compiled when it is simulated first."""

FARTHEST = 5.0
"""Times its own speed, or by so much slower, that a machine may turn: no catalogue reaches farther."""


@dataclass(frozen=True)
class VirtualTask:
    """What is to be simulated.

    Parameters
    ----------
    machine : str
        Canonical JSON.
    clearances_um : Mapping
        Radial clearance by joint [um]; a joint that is not named has the play of a new one.
    drive_speed_rpm : float or None
        The machine's own unless given.
    sensor_noise : float
        White noise of each sensor, rms [m/s2].
    revolutions : int
        Length.
    seed : int
        Of the noise.
    """

    machine: str
    clearances_um: Mapping[str, float]
    drive_speed_rpm: float | None
    sensor_noise: float
    revolutions: int
    seed: int


def make_recording(task: VirtualTask) -> tuple[bytes, str, dict[str, Any]]:
    """Simulate a recording.

    Returns
    -------
    bytes
        The recording as CSV.
    str
        What its file is called.
    dict
        What there is to say about it, as :func:`jointplay.app.jobs.summaries.summary_of` does, with ``virtual``: what
        it was made with.

    Raises
    ------
    BadFieldError
        A joint that cannot wear, a speed or clearances that the machine cannot have.
    """
    from jointplay.catalogue.measurements.measured_spectrum import read_recording
    from jointplay.catalogue.plans.driving import at_speed, nominal_drive_speed
    from jointplay.solver.cases.case import Case, Settings, Status
    from jointplay.solver.machines.fault import Fault
    from jointplay.solver.simulation.simulate import simulate

    machine = parse_machine(task.machine)
    if not machine.sensors:
        raise BadFieldError(f"catalogue: {machine.name}: has no sensors that could record", field="catalogue")
    clearances = all_clearances(machine, task.clearances_um)
    nominal = nominal_drive_speed(machine)
    speed = nominal if task.drive_speed_rpm is None else math.copysign(task.drive_speed_rpm / RPM, nominal)
    if task.drive_speed_rpm is not None and not at_speed(machine, speed):
        rule = "the load of its motor says how fast this machine turns; leave it out"
        raise BadFieldError(f"drive_speed_rpm: {task.drive_speed_rpm:g}: {rule}", field="drive_speed_rpm")
    if not 1.0 / FARTHEST <= abs(speed / nominal) * (1.0 + 1e-9) <= FARTHEST * (1.0 + 2e-9):
        low, high = (abs(nominal) * RPM * factor for factor in (1 / FARTHEST, FARTHEST))
        rule = f"must be {low:.4g} to {high:.4g}, a {FARTHEST:g}th to {FARTHEST:g} times the machine's own"
        raise BadFieldError(f"drive_speed_rpm: {task.drive_speed_rpm:g}: {rule}", field="drive_speed_rpm")
    case = Case(Fault({joint: size * 1e-6 for joint, size in clearances.items()}), at_speed(machine, speed))
    history = simulate(machine, case, Settings(sample_rate=SAMPLE_RATE, revolutions=task.revolutions + 0.1))
    if history.status is not Status.OK:
        raise refusal(clearances, f"{history.status}: {history.message}")
    if history.turning is not None and not history.turning.is_steady:
        raise refusal(clearances, "its drive does not come to a steady speed")
    turned = abs(history.drive_speed) * RPM
    worn = {joint: size for joint, size in sorted(task.clearances_um.items()) if size > 0}
    truth = {
        "clearances_um": clearances,
        "drive_speed_rpm": turned,
        "sensor_noise_m_s2": task.sensor_noise,
        "seed": task.seed,
    }
    said = ",".join(f"{joint}={size:g}um" for joint, size in worn.items()) or "as-new"
    name = f"virtual {said} {turned:.4g}rpm.csv"
    content = csv_of(machine, sensed(machine, history, task))
    return content, name, {**summary_of(read_recording(content, name=name), Told()), "virtual": truth}


def refusal(clearances: Mapping[str, float], why: str) -> BadFieldError:
    """Return the error for a machine that does not run with some clearances."""
    said = ", ".join(f"{joint}={size:g}" for joint, size in clearances.items())
    return BadFieldError(f"clearances_um: {said}: cannot be simulated: {why}", field="clearances_um")


def all_clearances(machine: Machine, asked: Mapping[str, float]) -> dict[str, float]:
    """Return the radial clearance of every joint that can wear [um]: as asked, or the middle of its play as new."""
    for joint in asked:
        if joint not in machine.wearing_joints:
            known = ", ".join(machine.wearing_joints)
            raise BadFieldError(
                f"clearances_um.{joint[:80]}: is no joint that can wear; those are {known}", field="clearances_um"
            )
    return {
        joint: asked.get(joint, round(1e6 * math.sqrt(math.prod(machine.joints[joint].play_as_new)), 3))
        for joint in machine.wearing_joints
    }


def sensed(machine: Machine, history: History, task: VirtualTask) -> npt.NDArray[np.float64]:
    """Return what the sensors record (n, s) [m/s2], the transient over, with their noise."""
    import numpy as np

    first = int(np.searchsorted(history.t, history.transient))
    samples = round(task.revolutions * 2 * math.pi / abs(history.drive_speed) * SAMPLE_RATE)
    signal = history.at_sensors(machine, slice(first, first + samples))
    noise = np.random.default_rng(task.seed).normal(size=signal.shape)
    return np.asarray(signal + task.sensor_noise * noise)


def csv_of(machine: Machine, signal: npt.NDArray[np.float64]) -> bytes:
    """Return samples as a table."""
    import numpy as np

    names = ["time [s]", *(f"{sensor.name} [m/s2]" for sensor in machine.sensors)]
    times = np.arange(len(signal)) / SAMPLE_RATE
    text = io.StringIO()
    np.savetxt(text, np.column_stack([times, signal]), "%.7g", ",", header=",".join(names), comments="")
    return text.getvalue().encode()
