"""The arrays of a simulation under the names that files give them, with units and all that says what they are."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.cases.history import MOTIONS, History
from jointplay.solver.cases.turning import Turning
from jointplay.solver.errors import SettingsError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.by_angle import cascade
from jointplay.solver.spectra.spectrum import Quantity, Scaling, order_levels

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


@dataclass(frozen=True)
class AskedSpectra:
    """Spectra to give besides the density of the acceleration, which every file has.

    Parameters
    ----------
    quantities : tuple of str
        "displacement", "velocity", "acceleration".
    scaling : str
        "psd", "power", "rms" or "peak".
    """

    quantities: tuple[Quantity, ...] = ()
    scaling: Scaling = "psd"

    def name(self, quantity: Quantity, of: str) -> str:
        """Return the name of one in a file: ``psd_frame`` of the acceleration, else ``peak_displacement_frame``."""
        common = (quantity, self.scaling) == ("acceleration", "psd")
        return f"psd_{of}" if common else f"{self.scaling}_{quantity}_{of}"


ALWAYS = AskedSpectra(("acceleration",))


def record(
    machine: Machine, history: History, settings: Settings, version: str, asked: AskedSpectra | None = None
) -> SimulationFile:
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
    asked : AskedSpectra, optional
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
    instantaneous = history.at_sensors(machine, instantaneous=True)
    for column, sensor in enumerate(machine.sensors):
        arrays[f"sensor_{sensor.name}"] = instantaneous[:, column]
        units[f"sensor_{sensor.name}"] = "m/s2"
    add_links(machine, history, arrays, units)
    attributes = describe(machine, history, settings, version)
    if history.turning is not None:
        arrays["drive_angle"], units["drive_angle"] = history.turning.angle, "rad"
    try:
        spectra = spectra_of(machine, history, asked)
    except SettingsError as error:
        return SimulationFile(arrays, units, {**attributes, "spectra": f"none: {error}"}, str(error))
    return SimulationFile(
        {**arrays, **spectra.arrays},
        {**units, **spectra.units},
        {**attributes, **spectra.attributes},
        spectra.missing,
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
    turning_drive = machine.driven_joint in machine.turning_joints
    for name, reaction in motion.reactions.items():
        arrays[name] = reaction
        moment = name.startswith("couple_") or (name == "drive_effort" and turning_drive)
        units[name] = "N m" if moment else ",".join(["N"] * (1 if reaction.ndim == 1 else reaction.shape[1]))


def describe(machine: Machine, history: History, settings: Settings, version: str) -> dict[str, Attribute]:
    """Return the attributes that say what was simulated, how, and what came of it."""
    return {
        **identity(machine, history.case, version),
        **accuracy_of(settings),
        **turning_of(history),
        "status": str(history.status),
        "message": history.message,
        "step_s": history.step,
        "sample_rate_hz": history.sample_rate,
        "duration_s": float(history.t[-1] - history.t[0]),
        "transient_s": history.transient,
        "drive_speed_rad_per_s": history.drive_speed,
        **({"open_reactions": ", ".join(history.links.open)} if history.links and history.links.open else {}),
    }


def turning_of(history: History) -> dict[str, Attribute]:
    """Return what is to be said of how a driver turned that no motion is prescribed to."""
    found = history.turning
    if found is None:
        return {}
    return {
        "limit_cycle": found.is_steady,
        "drive_mean_speed_rad_per_s": found.speed,
        "drive_speed_scatter": found.scatter,
        "drive_revolutions": found.revolutions,
        "frame_period_revolutions": found.period,
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


def spectra_of(machine: Machine, history: History, asked: AskedSpectra | None) -> SimulationFile:
    """Return spectral densities of the alias-free acceleration after the transient, what is asked for besides, and
    levels by order.

    Of a machine that its drive brings to no steady speed, levels by order over its speed.

    Raises
    ------
    SettingsError
        When the signal is too short for them.
    """
    if history.turning is not None and not history.turning.is_steady:
        return cascade_of(history, history.turning)
    point = f"centre of gravity of {machine.frame}, global axes"
    frame = history.spectrum(point=point)
    arrays: dict[str, npt.NDArray[np.generic]] = {"f": frame.frequency}
    units = {"f": "Hz"}
    names, signals = tuple(sensor.name for sensor in machine.sensors), history.at_sensors(machine)
    for wanted in dict.fromkeys((ALWAYS, asked or ALWAYS)):
        for quantity in wanted.quantities:
            spectrum = partial(history.spectrum, quantity=quantity, scaling=wanted.scaling)
            name, found = wanted.name(quantity, "frame"), spectrum(point=point)
            arrays[name], units[name] = found.values, ",".join(found.value_units)
            if not names:
                continue
            sensors = spectrum(signals, names, "at each sensor along its direction")
            for column, sensor in enumerate(names):
                name = wanted.name(quantity, f"sensor_{sensor}")
                arrays[name], units[name] = sensors.values[:, column], sensors.value_units[column]
    attributes: dict[str, Attribute] = {
        "psd_quantity": frame.quantity,
        "psd_scaling": "one-sided power spectral density",
        "psd_window": frame.window,
        "psd_resolution_hz": frame.resolution,
        "psd_averages": frame.averages,
        "psd_transient_dropped_s": frame.transient,
    }
    if asked is not None:
        attributes["noise_bandwidth_hz"] = frame.noise_bandwidth
    if history.drive_speed:
        base = abs(history.drive_speed) / (2 * math.pi)
        highest = min(HIGHEST_ORDER, int(frame.frequency[-1] / base - 0.5))
        orders = np.arange(1, highest + 1, dtype=np.float64)
        arrays["orders"] = orders
        arrays["order_level_frame"] = order_levels(history.order_spectrum(point=point), orders)
        units["orders"] = "multiples of the drive frequency"
        units["order_level_frame"] = ",".join(f"{unit} rms" for unit in frame.units)
        attributes["order_level"] = "rms in the band one order wide around each order"
    return SimulationFile(arrays, units, attributes)


def cascade_of(history: History, turning: Turning) -> SimulationFile:
    """Return levels by order over the speed of a machine that is not steady.

    Raises
    ------
    SettingsError
        Its driver hardly turns.
    """
    why = f"not steady: {turning.reason}"
    try:
        found = cascade(history.t, history.band_limited_acceleration, turning.angle, history.sample_rate)
    except SettingsError as error:
        raise SettingsError(f"{why}; {error}") from None
    arrays = {
        "cascade_t": found.t,
        "cascade_speed": found.speed,
        "orders": found.orders,
        "cascade_level_frame": found.level,
    }
    units = {
        "cascade_t": "s",
        "cascade_speed": "rad/s",
        "orders": "multiples of the drive frequency",
        "cascade_level_frame": "m/s2 rms,m/s2 rms,rad/s2 rms",
    }
    attributes: dict[str, Attribute] = {"cascade_level": "rms in the one-order band around each order, by angle"}
    return SimulationFile(arrays, units, attributes, f"{why}; orders over speed are in their place")
