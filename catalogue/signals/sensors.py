"""Which column of a recording is which sensor of the machine, and what of the frame's motion the sensors see."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.catalogue.errors import MeasurementError
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.sensor import rigid_body, sensor_transform
from jointplay.solver.spectra.spectrum import DERIVATIVES

MOTIONS = ("x", "y", "theta")


@dataclass(frozen=True, eq=False)
class SensorMap:
    """Columns of a recording and the frame's motion.

    Parameters
    ----------
    columns : tuple of int, (s,)
        Columns of the recording that are used.
    sensors : tuple of str, (s,)
        The machine's sensors they are.
    transform : (s, 3) array
        ``signal = transform @ [ax, ay, alpha]``, accelerations.
    compared : tuple of str, (c,)
        What is compared with a catalogue: the frame's free motions where the sensors see them all, else the sensors.
    channels : (c, s) array
        ``compared = channels @ signal``: least squares, or the identity.
    derivatives : tuple of int, (s,)
        How many times each column is to be differentiated to be an acceleration.
    warnings : tuple of str
    phases : bool
        Whether phases between the columns are known.
    """

    columns: tuple[int, ...]
    sensors: tuple[str, ...]
    transform: FloatArray
    compared: tuple[str, ...]
    channels: FloatArray
    derivatives: tuple[int, ...]
    warnings: tuple[str, ...]
    phases: bool = True

    @property
    def rigid_body(self) -> bool:
        """Whether motions of the frame are compared, not sensors."""
        return self.compared != self.sensors

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the compared channels, (c,)."""
        rotation = MOTIONS[2]
        return tuple("rad/s2" if self.rigid_body and name == rotation else "m/s2" for name in self.compared)


def map_sensors(
    measurement: Recording | MeasuredSpectrum, machine: Machine, mapping: Mapping[str, str] | None = None
) -> SensorMap:
    """Match columns of a recording to sensors of a machine.

    Parameters
    ----------
    measurement : Recording or MeasuredSpectrum
    machine : Machine
    mapping : mapping of column to sensor, optional
        Columns not in it are matched by name; capitals, blanks, hyphens and underscores do not count. A column mapped
        to an empty text is left out, whatever its name.

    Returns
    -------
    SensorMap

    Raises
    ------
    MeasurementError
        When nothing matches or the mapping names what is not there; the message lists columns and sensors.
    """
    wanted = dict(mapping or {})
    names = measurement.channel_names
    sensors = {sensor.name: sensor for sensor in machine.sensors}
    lists = f"columns: {', '.join(names)}; sensors of {machine.name}: {', '.join(sensors) or 'none'}"
    if not free_motions(machine):
        raise MeasurementError(
            measurement.name, rule=f"the frame of {machine.name} cannot move: sensors on it see nothing"
        )
    for column, sensor in wanted.items():
        if column not in names:
            raise MeasurementError(
                measurement.name, None, column, rule=f"is mapped but not in the recording; {lists}", field="mapping"
            )
        if sensor and sensor not in sensors:
            raise MeasurementError(measurement.name, None, column, sensor, f"is not a sensor; {lists}", field="mapping")
    found: dict[str, int] = {}
    plain = {_plain(name): name for name in sensors}
    for index, name in enumerate(names):
        if wanted.get(name) == "":
            continue
        matched = wanted.get(name) or (
            plain.get(_plain(name)) if plain.get(_plain(name)) not in wanted.values() else None
        )
        if matched is None:
            continue
        if matched in found:
            rule = f"is the second column for sensor {matched}; {lists}"
            raise MeasurementError(measurement.name, None, name, rule=rule, field="mapping")
        found[matched] = index
    # In the machine's order, whatever that of the columns: recordings by the same sensors are compared.
    found = {name: found[name] for name in sensors if name in found}
    if not found:
        raise MeasurementError(measurement.name, rule=f"no column is a sensor; {lists}; map them", field="mapping")
    unused = [name for index, name in enumerate(names) if index not in found.values() and wanted.get(name) != ""]
    warnings = [f"columns not used, as they are no sensor of {machine.name}: {', '.join(unused)}"] if unused else []
    transform, compared, channels = choose_channels(machine, tuple(found))
    if compared == tuple(found):
        warnings.append("the sensors do not see all motions of the frame: they are compared one by one")
    columns = tuple(found.values())
    quantities = [measurement.channels[column].quantity for column in columns]
    derivatives = tuple(DERIVATIVES["acceleration"] - DERIVATIVES[quantity] for quantity in quantities)
    return SensorMap(columns, tuple(found), transform, compared, channels, derivatives, tuple(warnings))


def match_by_name(names: Sequence[str], machine: Machine) -> dict[str, str]:
    """Return the sensor of each column whose name says it, as :func:`map_sensors` finds it without a mapping."""
    plain = {_plain(sensor.name): sensor.name for sensor in machine.sensors}
    return {name: plain[_plain(name)] for name in names if _plain(name) in plain}


def choose_channels(machine: Machine, names: Sequence[str]) -> tuple[FloatArray, tuple[str, ...], FloatArray]:
    """Return what some sensors see, and what is compared: fields of :class:`SensorMap`.

    Parameters
    ----------
    machine : Machine
        Its frame can move.
    names : sequence of str, (s,)
        Of its sensors.

    Returns
    -------
    transform : (s, 3) array
    compared : tuple of str, (c,)
    channels : (c, s) array
    """
    by_name = {sensor.name: sensor for sensor in machine.sensors}
    chosen, free = [by_name[name] for name in names], free_motions(machine)
    transform = sensor_transform([s.at for s in chosen], [s.direction for s in chosen], machine.links[machine.frame].cg)
    body = rigid_body(transform[:, free])
    if body.inverse is None:
        return transform, tuple(names), np.eye(len(names))
    return transform, tuple(MOTIONS[index] for index in free), body.inverse


def without_columns(sensing: SensorMap, machine: Machine, left_out: Collection[int]) -> SensorMap | None:
    """Do without columns that cannot be trusted.

    Parameters
    ----------
    sensing : SensorMap
    machine : Machine
    left_out : collection of int
        Columns of the recording.

    Returns
    -------
    SensorMap or None
        None where the other sensors would see less of the frame's motion than all of them do.
    """
    kept = [index for index, column in enumerate(sensing.columns) if column not in left_out]
    if not kept or np.linalg.matrix_rank(sensing.transform[kept]) < np.linalg.matrix_rank(sensing.transform):
        return None
    transform = sensing.transform[kept]
    names = tuple(sensing.sensors[index] for index in kept)
    compared, channels = names, np.eye(len(kept))
    if sensing.rigid_body:
        inverse = rigid_body(transform[:, free_motions(machine)]).inverse
        if inverse is None:
            return None
        compared, channels = sensing.compared, inverse
    columns = tuple(sensing.columns[index] for index in kept)
    derivatives = tuple(sensing.derivatives[index] for index in kept)
    return SensorMap(columns, names, transform, compared, channels, derivatives, sensing.warnings)


def sensors_one_by_one(sensing: SensorMap) -> SensorMap:
    """Compare the sensors themselves: without phases between them the frame's motion does not follow."""
    return dataclasses.replace(sensing, compared=sensing.sensors, channels=np.eye(len(sensing.sensors)), phases=False)


def free_motions(machine: Machine) -> list[int]:
    """Which of x, y, theta the frame can do."""
    frame = machine.links[machine.frame]
    return [] if frame.fixed else [index for index, motion in enumerate(MOTIONS) if motion not in frame.locked]


def _plain(name: str) -> str:
    return re.sub(r"[\s_\-.]+", "", name).casefold()
