"""Machine files, read without the product: YAML or JSON, numbers with or without a unit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML

from second_simulator.machine import (
    TABLE,
    Array,
    Body,
    Contact,
    Drive,
    Guide,
    Load,
    Machine,
    Mount,
    Pin,
    Point,
    Sensor,
    constant,
)

SHIPPED = Path(__file__).parents[2] / "solver" / "machines" / "shipped"

UNITS = {
    "kg": 1.0,
    "g": 1e-3,
    "m": 1.0,
    "mm": 1e-3,
    "um": 1e-6,
    "s": 1.0,
    "ms": 1e-3,
    "N": 1.0,
    "kN": 1e3,
    "Nm": 1.0,
    "rad": 1.0,
    "deg": math.pi / 180,
    "rpm": 2 * math.pi / 60,
    "Hz": 2 * math.pi,
}


def number(said: object) -> float:
    """A number of a file: ``0.3``, ``"300 g"``, ``"100 kg mm2"``, ``"10 kN/mm"``."""
    if not isinstance(said, str):
        return float(said)  # type: ignore[arg-type]
    value, _, unit = said.strip().partition(" ")
    above, *below = unit.split("/")
    scale = 1.0
    for part, power in [(above, 1), *((each, -1) for each in below)]:
        for word in part.split():
            name = word.rstrip("23")
            scale *= UNITS[name] ** (power * int(word[len(name) :] or 1))
    return float(value) * scale


def point(said: Any) -> Point:
    """Two numbers of a file."""
    return number(said[0]), number(said[1])


def read(source: str | Path) -> Machine:
    """A machine file, or a shipped machine by its name."""
    path = Path(source)
    path = path if path.suffix else SHIPPED / f"{source}.yaml"
    tree: dict[str, Any] = YAML(typ="safe", pure=True).load(path.read_text())
    frame = tree.get("frame") or next(iter(tree["links"]))
    turning = {name: each for name, each in tree["joints"].items() if each["kind"] == "turning"}
    sliding = {name: each for name, each in tree["joints"].items() if each["kind"] == "sliding"}
    general = tree.get("defaults", {}).get("contact", {})
    return Machine(
        name=tree["name"],
        frame=frame,
        bodies={name: _body(each) for name, each in tree["links"].items()},
        pins={name: _pin(each) for name, each in turning.items()},
        guides={name: _guide(each) for name, each in sliding.items()},
        contacts={name: _contact({**general, **each.get("contact", {})}) for name, each in turning.items()},
        mounts=tuple(_mount(each) for each in tree.get("supports", [])),
        loads=tuple(_load(each) for each in tree.get("loads", [])),
        sensors=tuple(
            Sensor(each["name"], point(each["at"]), point(each["direction"])) for each in tree.get("sensors", [])
        ),
        drive=_drive(tree),
        gravity=number(tree.get("gravity", 9.81)),
    )


def _body(said: Mapping[str, Any]) -> Body:
    if said.get("fixed"):
        return Body(math.inf, math.inf, point(said.get("cg", (0, 0))))
    return Body(number(said["mass"]), number(said["inertia"]), point(said["cg"]))


def _pin(said: Mapping[str, Any]) -> Pin:
    if "film" in said:
        raise ValueError("joints are dry here")
    first, second = said["links"]
    pin = said.get("pin", first)
    return Pin(pin, second if pin == first else first, point(said["at"]), number(said.get("pin_radius", 0.0)))


def _guide(said: Mapping[str, Any]) -> Guide:
    x, y = point(said["direction"])
    length = math.hypot(x, y)
    slider, rail = said["links"]
    guide = Guide(slider, rail, point(said["at"]), (x / length, y / length))
    rubs: dict[str, Any] = {
        key: number(said[key]) for key in ("friction", "viscous", "friction_velocity") if key in said
    }
    return replace(guide, **rubs)


def _contact(said: Mapping[str, Any]) -> Contact:
    if said.get("law", "linear") != "linear":
        raise ValueError("contacts of a file are linear here; others are drawn")
    names = ("stiffness", "damping", "friction", "friction_velocity")
    numbers: dict[str, Any] = {name: number(said[name]) for name in names if name in said}
    return Contact(**numbers)


def _mount(said: Mapping[str, Any]) -> Mount:
    if said["kind"] != "mount":
        raise ValueError(f"no {said['kind']} here: supports are mounts")
    to = said.get("to_link", "")
    return Mount(said["link"], point(said["at"]), point(said["stiffness"]), point(said["damping"]), to)


def _load(said: Mapping[str, Any]) -> Load:
    place = point(said["at"])
    if "over_angle" in said:
        rows = np.array([[number(each) for each in row] for row in said["over_angle"]])
        angles = 2 * math.pi * np.arange(TABLE) / TABLE
        columns = [np.interp(angles, rows[:, 0], rows[:, column], period=2 * math.pi) for column in (1, 2, 3)]
        table: Array = np.stack(columns, axis=1)
    elif "over_time" in said:
        raise ValueError("no loads over time here")
    else:
        table = constant(point(said.get("force", (0, 0))), number(said.get("torque", 0)))
    return Load(said["link"], place, table)


def _drive(tree: Mapping[str, Any]) -> Drive | None:
    said = tree.get("drive")
    if said is None:
        return None
    if said["kind"] != "rotation" or said.get("ripple"):
        raise ValueError("drives of a file turn evenly here; wander and ripple are drawn")
    driven, base = tree["joints"][said["joint"]]["links"]
    return Drive(said["joint"], driven, base, number(said["speed"]))
