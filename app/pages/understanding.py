"""What worker processes do for the page besides diagnosing: say what is understood, move a drawing, show an entry."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from jointplay.app.jobs.samples import read
from jointplay.app.jobs.tasks import open_catalogue
from jointplay.app.problems import say
from jointplay.app.storage.told import Told
from jointplay.solver.machines.fault import Fault

RPM = 30.0 / math.pi


def understand(
    path: str, name: str, told: Told, catalogue: str, stamp: str, mapping: Mapping[str, str]
) -> dict[str, Any]:
    """Return how a recording would be compared with a catalogue: sensors by column, drive speed, warnings.

    Parameters
    ----------
    path, name, told, catalogue, stamp
        As for :func:`jointplay.app.jobs.tasks.diagnose`.
    mapping : Mapping
        Sensors of columns as they are remembered.

    Returns
    -------
    dict
        ``speed_rpm`` and ``uncertainty_rpm``, None where the speed was not found, of the first piece where it changes;
        ``tacho``: whether pulses say it; ``warnings``; ``field`` and ``message``: what has to be put right first, empty
        where nothing has.
    """
    from jointplay.catalogue.errors import MeasurementError
    from jointplay.catalogue.measurements.measurement import Recording
    from jointplay.catalogue.signals.features import prepare
    from jointplay.catalogue.signals.sensors import map_sensors
    from jointplay.catalogue.signals.speedpieces import cut_by_speed

    measurement = read(path, name, told)
    found = open_catalogue(catalogue, stamp)
    answer: dict[str, Any] = {"speed_rpm": None, "uncertainty_rpm": None, "warnings": [], "field": "", "message": ""}
    answer["tacho"] = isinstance(measurement, Recording) and measurement.turns is not None
    field = "mapping"
    try:
        map_sensors(measurement, found.machine, mapping)
        field = "speed"
        cut = cut_by_speed(measurement, found.machine, found.drive_speeds, mapping)
        prepared = prepare(
            cut.pieces[0],
            found.machine,
            mapping,
            scheme=found.scheme,
            nominal=found.recipe.nominal_drive_speed,
            near=found.drive_speeds,
        )
    except MeasurementError as error:
        return {**answer, "warnings": list(measurement.warnings), "field": field, "message": say(error)}
    estimate = prepared.speed
    compared = [f"compared by itself: {piece.name}" for piece in cut.pieces] if len(cut.pieces) > 1 else []
    return {
        **answer,
        "speed_rpm": estimate.speed * RPM,
        "uncertainty_rpm": estimate.uncertainty * RPM,
        "warnings": list(dict.fromkeys([*prepared.warnings, *compared, *cut.left_out])),
    }


@lru_cache(maxsize=16)
def motion(machine: str, fault: tuple[tuple[str, float], ...] = ()) -> Mapping[str, Any]:
    """Return how the drawing of a machine goes through one period of its drive, and worn pins in their sockets.

    Parameters
    ----------
    machine : str
        Canonical JSON of the machine.
    fault : tuple of (str, float)
        Radial clearances (m) by joint. With some, the settled machine is simulated.

    Returns
    -------
    dict
        Members of :class:`jointplay.app.schemas.machines.Motion`.
    """
    from jointplay.solver.machines.drawing_motion import moving_drawing
    from jointplay.solver.machines.machine import parse_machine
    from jointplay.solver.simulation.pins import pin_orbits

    parsed = parse_machine(json.loads(machine))
    moving, worn = moving_drawing(parsed), Fault(dict(fault))
    pins = [
        {"joint": name, "clearance_um": worn[name] * 1e6, "at": (orbit / worn[name]).round(3).tolist()}
        for name, orbit in (pin_orbits(parsed, worn) if worn else {}).items()
    ]
    return {
        "view_box": moving.view_box,
        "transforms": {name: list(steps) for name, steps in moving.transforms.items()},
        "pins": pins,
    }
