"""Recordings of a machine in order, as far as others are compared with them: by the same sensors, and sound."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from jointplay.catalogue.diagnosing.question import MOST_TOGETHER
from jointplay.catalogue.diagnosing.verdict import speed_warnings
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.sensors import map_sensors, match_by_name
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import Machine


@dataclass(frozen=True)
class InOrder:
    """A recording of a machine in order of which something is known that does not hold for what is compared with it.

    Parameters
    ----------
    recording : Recording
    mapping : mapping of str to str, optional
        Sensor of each column that is not named like its sensor; that of what is compared with it where it is None.
    speed : float, optional
        Drive speed, rad/s; estimated where it is None.
    """

    recording: Recording
    mapping: Mapping[str, str] | None = None
    speed: float | None = None


def sensors_by_column(
    recording: Recording | MeasuredSpectrum, machine: Machine, mapping: Mapping[str, str]
) -> dict[str, str]:
    """Return the sensor of each column that is one; raises as :func:`map_sensors`."""
    found = map_sensors(recording, machine, mapping)
    return {recording.channel_names[column]: name for column, name in zip(found.columns, found.sensors, strict=True)}


def recordings_in_order(given: Recording | InOrder | Sequence[Recording | InOrder] | None) -> dict[str, InOrder]:
    """Return recordings of a machine in order by checksum, none of them twice; empty where there are none.

    Raises
    ------
    DiagnosisError
        There are too many.
    """
    each = [] if given is None else [given] if isinstance(given, Recording | InOrder) else list(given)
    if len(each) > MOST_TOGETHER:
        raise DiagnosisError(f"baseline: {len(each)}: must be at most {MOST_TOGETHER} recordings")
    found = [InOrder(one) if isinstance(one, Recording) else one for one in each]
    return {one.recording.sha256: one for one in found}


def prepare_past(
    in_order: Mapping[str, InOrder],
    mapping_of: Callable[[Recording], Mapping[str, str]],
    diagnosed: Sequence[Mapping[str, str]],
    used: Collection[str],
    catalogue: Catalogue,
) -> tuple[dict[str, PreparedMeasurement], list[str]]:
    """Return those recordings of a machine in order that others are compared with, and what is to be said of all.

    Sensors that are not used are left out of these; and those recordings that lack one that is, unless all do, or whose
    sensors contradict each other.

    Parameters
    ----------
    in_order : mapping of str to InOrder
        By checksum.
    mapping_of : callable
        Gives the sensors of columns where nothing is said of a recording's own.
    diagnosed : sequence of mapping
        Sensor of each column of the others.
    used : collection of str
        Sensors by which these are compared; all that there are where it is empty, as of spectra.
    catalogue : Catalogue
        Of the machine.

    Raises
    ------
    MeasurementError
        One cannot be compared.
    """
    machine = catalogue.machine
    scale = (catalogue.scheme, catalogue.recipe.nominal_drive_speed, catalogue.drive_speeds)
    used = set(used)
    said: list[tuple[str, str]] = []
    sound: dict[str, PreparedMeasurement] = {}
    for key, each in in_order.items():
        name = each.recording.name
        mapping = each.mapping or mapping_of(each.recording)
        if each.mapping is not None and not each.mapping:  # its columns are called like sensors, those that are some
            by_name = match_by_name(each.recording.channel_names, machine)
            mapping = {column: sensor for column, sensor in mapping.items() if column not in by_name}
        own = sensors_by_column(each.recording, machine, mapping)
        others = [column for column, sensor in own.items() if any(d.get(column, sensor) != sensor for d in diagnosed)]
        if others:
            rule = "is another sensor there than in what is compared with it, as was said of it"
            said.append((name, f"column {', '.join(others)}: {rule}"))
        unused = {column: "" for column, sensor in own.items() if used and sensor not in used}
        unused = {} if len(unused) == len(own) else unused
        found = prepare(each.recording, machine, {**mapping, **unused}, each.speed, *scale)
        flawed = {flaw.text for flaw in found.flaws}
        said += [(name, f"{line}: left out" if line in flawed else line) for line in found.warnings]
        said += [(name, line) for line in speed_warnings(found, catalogue)]
        if not flawed:
            sound[key] = found
    views = [set(each.sensing.sensors) for each in sound.values()]
    view = used if used in views else next(iter(views), used)
    used = used or view
    for heard, own_view in zip(sound.values(), views, strict=True):
        if own_view != view:
            said.append((heard.name, f"has other sensors than {', '.join(sorted(view))}: left out"))
        elif view != used:
            said.append((heard.name, f"has other sensors than {', '.join(sorted(used))}: not compared with as such"))
    return {key: each for (key, each), own in zip(sound.items(), views, strict=True) if own == view}, _once(said)


def _once(said: Iterable[tuple[str, str]]) -> list[str]:
    """Lines with the names of all recordings that they are about."""
    names: dict[str, list[str]] = {}
    for name, line in said:
        names.setdefault(line, []).append(name)
    return [f"baseline {', '.join(dict.fromkeys(about))}: {line}" for line, about in names.items()]
