"""The arrays of a simulation under the names that files give them, with units and all that says what they are."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from jointplay.solver.cases.history import MOTIONS, Case, History, Settings
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.spectrum import order_levels

Attribute = str | float | int | bool | tuple[str, ...]

HIGHEST_ORDER = 100


@dataclass(frozen=True, eq=False)
class SimulationFile:
    """What a file of a simulation holds.

    Parameters
    ----------
    arrays : Mapping
        Name to array; the names are those of the contract between program and scripts.
    units : Mapping
        Unit of an array; several, one a column, are separated by commas.
    attributes : Mapping
        Of the whole file.
    missing : str
        Why there are no spectra; empty when there are.
    """

    arrays: Mapping[str, npt.NDArray[np.generic]]
    units: Mapping[str, str]
    attributes: Mapping[str, Attribute]
    missing: str = ""


def record(machine: Machine, history: History, settings: Settings, version: str) -> SimulationFile:
    """Collect what there is to store about a simulation.

    Parameters
    ----------
    machine : Machine
    history : History
        Of status ok.
    settings : Settings
        Of the simulation.
    version : str
        Of the solver.
    """
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "t": history.t,
        "frame_displacement": history.displacement,
        "frame_velocity": history.velocity,
        "frame_acceleration": history.acceleration,
    }
    units = {
        "t": "s",
        "frame_displacement": "m,m,rad",
        "frame_velocity": "m/s,m/s,rad/s",
        "frame_acceleration": "m/s2,m/s2,rad/s2",
    }
    instantaneous = history.at_sensors(machine, history.acceleration)
    for column, sensor in enumerate(machine.sensors):
        arrays[f"sensor_{sensor.name}"] = instantaneous[:, column]
        units[f"sensor_{sensor.name}"] = "m/s2"
    add_links(machine, history, arrays, units)
    attributes = describe(machine, history, settings, version)
    try:
        spectra = spectra_of(machine, history)
    except SettingsError as error:
        return SimulationFile(arrays, units, {**attributes, "spectra": f"none: {error}"}, str(error))
    return SimulationFile(
        {**arrays, **spectra.arrays}, {**units, **spectra.units}, {**attributes, **spectra.attributes}
    )


def add_links(
    machine: Machine, history: History, arrays: dict[str, npt.NDArray[np.generic]], units: dict[str, str]
) -> None:
    """Add the motion of every link, (time, link, 3), and the reactions, where the simulation gave them."""
    motion = history.links
    if motion is None:
        return
    arrays["links"] = np.array(motion.links)
    arrays["link_displacement"] = motion.displacement
    arrays["link_velocity"] = motion.velocity
    arrays["link_acceleration"] = motion.acceleration
    units.update({f"link_{name}": units[f"frame_{name}"] for name in ("displacement", "velocity", "acceleration")})
    turning_drive = machine.drive is not None and machine.drive.joint in machine.turning_joints
    for name, reaction in motion.reactions.items():
        arrays[name] = reaction
        moment = name.startswith("couple_") or (name == "drive_effort" and turning_drive)
        units[name] = "N m" if moment else ",".join(["N"] * (1 if reaction.ndim == 1 else reaction.shape[1]))


def describe(machine: Machine, history: History, settings: Settings, version: str) -> dict[str, Attribute]:
    """Return the attributes that say what was simulated, how, and what came of it."""
    return {
        **identity(machine, history.case, version),
        **accuracy_of(settings),
        "status": str(history.status),
        "message": history.message,
        "step_s": history.step,
        "sample_rate_hz": history.sample_rate,
        "duration_s": float(history.t[-1]),
        "transient_s": history.transient,
        "drive_speed_rad_per_s": history.drive_speed,
    }


def identity(machine: Machine, case: Case, version: str) -> dict[str, Attribute]:
    """Return the attributes that say what was simulated."""
    return {
        "machine": machine.name,
        "machine_content_key": machine.content_key,
        "machine_json": machine.canonical_json(),
        "fault": case.fault.label,
        "parameters_json": json.dumps(dict(case.parameters), sort_keys=True),
        "solver_version": version,
        "frame": machine.frame,
        "frame_point": "centre of gravity, global axes, from the drawn pose",
        "frame_columns": MOTIONS,
    }


def accuracy_of(settings: Settings) -> dict[str, Attribute]:
    """Return the attributes that say how finely."""
    accuracy = settings.accuracy if settings.rtol is None else f"rtol {settings.rtol:g}"
    return {"accuracy": accuracy, "method": settings.integrator}


def spectra_of(machine: Machine, history: History) -> SimulationFile:
    """Return spectral densities of the alias-free acceleration after the transient, and levels by order.

    Raises
    ------
    SettingsError
        When the signal is too short for them.
    """
    point = f"centre of gravity of {machine.frame}, global axes"
    frame = history.spectrum(point=point)
    arrays: dict[str, npt.NDArray[np.generic]] = {"f": frame.frequency, "psd_frame": frame.values}
    units = {"f": "Hz", "psd_frame": ",".join(frame.value_units)}
    if machine.sensors:
        names = tuple(sensor.name for sensor in machine.sensors)
        signals = history.at_sensors(machine)
        sensors = history.spectrum(signals, names, "at each sensor along its direction")
        for column, name in enumerate(names):
            arrays[f"psd_sensor_{name}"] = sensors.values[:, column]
            units[f"psd_sensor_{name}"] = sensors.value_units[column]
    attributes: dict[str, Attribute] = {
        "psd_quantity": frame.quantity,
        "psd_scaling": "one-sided power spectral density",
        "psd_window": frame.window,
        "psd_resolution_hz": frame.resolution,
        "psd_averages": frame.averages,
        "psd_transient_dropped_s": frame.transient,
    }
    if history.drive_speed:
        base = abs(history.drive_speed) / (2 * math.pi)
        highest = min(HIGHEST_ORDER, int(frame.frequency[-1] / base - 0.5))
        orders = np.arange(1, highest + 1, dtype=np.float64)
        arrays["orders"] = orders
        arrays["order_level_frame"] = order_levels(frame, orders)
        units["orders"] = "multiples of the drive frequency"
        units["order_level_frame"] = ",".join(f"{unit} rms" for unit in frame.units)
        attributes["order_level"] = "rms in the band one order wide around each order"
    return SimulationFile(arrays, units, attributes)
