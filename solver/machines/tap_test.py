"""A frequency response of the frame from a universal file of a measuring system.

Of its data sets 58, those of function type 4 say what one node answers along one direction to a force at another.
Blows hit the frame where it can be reached; of a frame that is rigid there, three of them or more say what a sensor
answers to unit forces and a unit moment at the centre of gravity: ``docs/reference/machine-file.md``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jointplay.solver.arrays import ComplexArray, FloatArray
from jointplay.solver.errors import MachineError
from jointplay.solver.machines import units
from jointplay.solver.machines.fields import QuantityField, RuleError, VectorField
from jointplay.solver.machines.parts import Sensor
from jointplay.solver.machines.universal import (
    ACCELERATION,
    DISPLACEMENT,
    EXCITATION,
    FREQUENCY,
    VELOCITY,
    Function,
    Refusal,
    find_sets,
    read_functions,
    read_units,
)
from jointplay.solver.machines.yamlfile import Tree

#: What an ordinate of data set 58 measures: its dimension, and the times (i w) that make it an acceleration.
_MOTIONS = {DISPLACEMENT: (units.LENGTH, 2), VELOCITY: (units.SPEED, 1), ACCELERATION: (units.ACCELERATION, 0)}
_ORDERS = dict(_MOTIONS.values())
_RESPONSE_FUNCTION = 4
#: Directions of data set 58 in the plane of the machine, without their sign.
_X, _Y, _TURN = 1, 2, 6
_NAMES = {_X: "X", _Y: "Y", _TURN: "Z turning"}
_POINT = VectorField((QuantityField(units.LENGTH),) * 2)
#: As points of a shape are found: a micrometre.
_SAME_PLACE = 1e-6

Degree = tuple[int, int]
"""A node and a direction without its sign."""
Answers = dict[Degree, dict[Degree, ComplexArray]]
"""Accelerances (f,), m/s2/N or m/s2/(N m), by what answers and by what is hit."""


def is_universal(path: Path) -> bool:
    """Whether a file begins as a universal file does."""
    try:
        with path.open("rb") as file:
            return file.read(200).split(b"\n", 1)[0].strip() == b"-1"
    except OSError:
        return False


def read_tap_test(
    path: Path, nodes: object, sensors: Sequence[Sensor], centre: tuple[float, float], source: str
) -> Tree:
    """Read what sensors answer to unit forces at the frame's centre of gravity, by least squares of all blows.

    Parameters
    ----------
    path : Path
        Of the universal file.
    nodes : object
        As the machine file has it: node numbers, with where they are in the drawing.
    sensors : sequence of Sensor
    centre : (float, float)
        The frame's centre of gravity, m.
    source : str
        Name of the machine file, for messages.

    Returns
    -------
    dict
        The tree of a :class:`jointplay.solver.machines.response.FrequencyResponse`, accelerances in SI.

    Raises
    ------
    MachineError
        The first thing that is wrong.
    """

    def wrong(line: int, value: object, rule: str) -> MachineError:
        where = f", line {line}" if line else ""
        return MachineError(source, f"response.file, {path.name}{where}", value, rule)

    places = _read_nodes(nodes, source)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise wrong(0, None, f"cannot be read: {error.strerror or error}") from None
    frequency, answers = _read_answers(data, set(places), wrong)
    used = {node for answered, blows in answers.items() for node in (answered[0], *(blow[0] for blow in blows))}
    for node in places:
        if node not in used:
            rule = f"{path.name} has no frequency response of it with another node that is listed"
            raise MachineError(source, f"response.nodes.{node}", None, rule)
    found = {}
    for sensor in sensors:
        columns = _solve(sensor, answers, places, centre, wrong)
        pairs = np.stack([columns.real, columns.imag], axis=-1).tolist()
        found[sensor.name] = dict(zip(("fx", "fy", "moment"), pairs, strict=True))
    return {"quantity": "accelerance", "frequency": frequency, "sensors": found}


def _read_nodes(given: object, source: str) -> dict[int, tuple[float, ...]]:
    if not isinstance(given, Mapping) or not given:
        rule = "a universal file needs where its nodes are in the drawing: {1: [0.1, 0.2], 2: ...}"
        raise MachineError(source, "response.nodes", None, rule)
    places = {}
    for node, at in given.items():
        path = f"response.nodes.{node}"
        if not re.fullmatch("[0-9]{1,10}", str(node)):
            raise MachineError(source, path, None, "must be the number of a node")
        if int(node) in places:
            raise MachineError(source, path, None, "is there twice")
        try:
            places[int(node)] = _POINT.validate(at)
        except RuleError as error:
            raise MachineError(source, path, at, error.message()) from None
    return places


def _read_answers(data: bytes, nodes: set[int], wrong: Refusal) -> tuple[list[float], Answers]:
    """Frequencies, Hz, and what is answered to blows; of nodes that are listed, in the plane, signs taken out."""
    answers: Answers = {}
    frequency = np.zeros(0)
    lengths: tuple[float, float] | None = None
    sets = find_sets(data, wrong)
    for each in sets:
        if each.kind == "164":
            lengths = read_units(each, wrong)
        for function in read_functions([each], wrong):
            (node, way), (other, back) = function.response, function.reference
            answered, hit = (node, abs(way)), (other, abs(back))
            planar = answered[1] in (_X, _Y) and hit[1] in (_X, _Y, _TURN)
            if function.kind != _RESPONSE_FUNCTION or not planar or not {node, other} <= nodes:
                continue
            x = function.x * _hertz(function, wrong)
            if not len(frequency):
                frequency = x
            if len(x) != len(frequency) or not np.allclose(x, frequency, rtol=1e-5, atol=0.0):
                raise wrong(function.line, None, "data set 58: must be at the frequencies of those before it")
            if hit in answers.setdefault(answered, {}):
                rule = f"data set 58: {_say(answered)} to {_say(hit)} is there twice"
                raise wrong(function.line, None, rule)
            sign = math.copysign(1.0, way * back)
            answers[answered][hit] = sign * _accelerances(function, lengths, x, wrong)
    if not answers:
        raise wrong(0, None, "holds no data set 58 of function type 4 between nodes that are listed, along X or Y")
    return frequency.tolist(), answers


def _say(degree: Degree) -> str:
    return f"{degree[0]} {_NAMES[degree[1]]}"


def _hertz(function: Function, wrong: Refusal) -> float:
    """Hz to a unit of the abscissa."""
    unit = function.abscissa.unit
    found = units.factor_of(unit, (units.FREQUENCY,)) if unit else (units.FREQUENCY, 1.0)
    if found is None or function.abscissa.kind not in (0, FREQUENCY):
        raise wrong(function.line, unit or function.abscissa.kind, "data set 58: abscissa must be a frequency")
    return found[1]


def _accelerances(
    function: Function, lengths: tuple[float, float] | None, frequency: FloatArray, wrong: Refusal
) -> ComplexArray:
    """Values (f,) as accelerances in SI: units are those of the labels, as the layout says, else of data set 164."""

    def refuse(value: object, rule: str) -> Exception:
        return wrong(function.line, value, f"data set 58: {rule}")

    if function.values.dtype.kind != "c":
        raise refuse(None, "a frequency response must be of complex numbers")
    if not np.isfinite(function.values).all():
        raise refuse(None, "its numbers must be finite")
    motion, force = function.ordinate.unit, function.denominator.unit
    known = _MOTIONS.get(function.ordinate.kind)
    dimensions = (known[0],) if known else () if function.ordinate.kind else tuple(_ORDERS)
    found = units.factor_of(motion, dimensions) if motion else None
    if motion and found is None and "/" in motion:  # one label for both, m/s^2/N
        numerator, _, denominator = motion.rpartition("/")
        found, force = units.factor_of(numerator, dimensions), force or denominator.strip("() ")
    turning = abs(function.reference[1]) == _TURN
    per = units.factor_of(force, (units.TORQUE if turning else units.FORCE,)) if force else None
    if lengths and not motion and known:
        found = known[0], lengths[0]
    if lengths and not force:
        per = units.FORCE, lengths[1] * (lengths[0] if turning else 1.0)
    if found is None:
        rule = "ordinate must be a displacement, velocity or acceleration, with its unit or a data set 164 before it"
        raise refuse(motion or function.ordinate.kind, rule)
    if per is None or function.denominator.kind not in ((0, EXCITATION) if force else (EXCITATION,)):
        what = "moment" if turning else "force"
        rule = f"denominator must be an excitation {what}, with its unit or a data set 164 before it"
        raise refuse(force or function.denominator.kind, rule)
    return np.asarray(function.values * (found[1] / per[1]) * (2j * np.pi * frequency) ** _ORDERS[found[0]])


def _solve(
    sensor: Sensor,
    answers: Answers,
    places: Mapping[int, tuple[float, ...]],
    centre: tuple[float, float],
    wrong: Refusal,
) -> ComplexArray:
    """What a sensor answers to unit fx, fy and moment at the centre of gravity, (3, f)."""
    here = [node for node, at in places.items() if math.dist(at, sensor.at) < _SAME_PLACE]
    if not here:
        raise wrong(0, None, f"response.nodes needs one at {list(sensor.at)}: there is sensor {sensor.name}")
    parts = [(share, way) for share, way in zip(sensor.direction, (_X, _Y), strict=True) if abs(share) > 1e-9]
    found: dict[Degree, ComplexArray] = {}
    for node in here:
        hits = [answers.get((node, way), {}) for _, way in parts]
        for hit in hits[0]:
            if all(hit in each for each in hits):
                found[hit] = np.sum([share * each[hit] for (share, _), each in zip(parts, hits, strict=True)], axis=0)
    rows = []
    for node, way in found:
        x, y = (a - b for a, b in zip(places[node], centre, strict=True))
        rows.append({_X: (1.0, 0.0, -y), _Y: (0.0, 1.0, x), _TURN: (0.0, 0.0, 1.0)}[way])
    blows = np.array(rows).reshape(-1, 3)
    arm = float(np.abs(blows[:, 2]).max(initial=0.0)) or 1.0
    if np.linalg.matrix_rank(blows / (1.0, 1.0, arm), _SAME_PLACE) < 3:
        shown = ", ".join(map(_say, found)) or "none"
        rule = "must be along three lines that neither meet in one point nor are all parallel"
        raise wrong(0, shown, f"blows that {sensor.name} answers to {rule}")
    return np.asarray(np.linalg.lstsq(blows, np.array(list(found.values())), rcond=None)[0])
