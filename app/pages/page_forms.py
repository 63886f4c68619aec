"""What the page's forms say, and where a refusal is shown: beside the field at fault."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fastapi import Request

from jointplay.app.errors import BadFieldError, BadRequestError
from jointplay.app.fields import TOLD
from jointplay.app.http.uploads import PLAIN_BYTES, plain_fields
from jointplay.app.http.validation import validate
from jointplay.app.problems import Problem
from jointplay.app.schemas.resources import DiagnosisRequest
from jointplay.app.speeds import speed_of
from jointplay.app.storage.rows import DiagnosisRow
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.signals.sensors import match_by_name
from jointplay.solver.errors import UnitError
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.units import Dimension, to_si

SAID = tuple(sorted(TOLD))
NUMBERS = ("sample_rate", "full_scale", "pulses_per_revolution", "reference")
"""Fields of a file that are one number, some with a unit."""
UPLOAD = ("catalogue", "file", "asset", "beside", *SAID)
CONFIRM = ("measurement", "measurements", "beside", "catalogue", "asset", "speed", "effort", "mode", "prior", "mapping")
NOT_USED = "-"
TEXT_BYTES = 1_000_000
"""Largest form with a whole text in it."""
COMMA = re.compile(r"([+-]?\d*),(\d+)(\D.*)?")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}(\D.*)?")
LOCAL = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d)?")


async def plain_form(request: Request, text: str = "") -> dict[str, str]:
    """Return the fields of a form without files; empty ones are left out.

    Parameters
    ----------
    request : Request
    text : str
        Name of a field that is a whole text: it stays as it was typed, with the lines of this system.

    Raises
    ------
    UnsupportedMediaError
        For a body of another type.
    BadRequestError
        For a body with too many fields, or one given twice.
    """
    given: dict[str, str] = {}
    for name, value in await plain_fields(request, TEXT_BYTES if text else PLAIN_BYTES):
        if name in given:
            raise BadRequestError(f"{name[:80]}: is given twice")
        given[name] = value.replace("\r\n", "\n") if name == text else value.strip()
    return {name: value for name, value in given.items() if value.strip()}


def read_form(
    given: Mapping[str, str], columns: Sequence[str], machine: Machine, first: Beside | None = None
) -> DiagnosisRequest:
    """Return what a confirmed form asks for.

    Parameters
    ----------
    given : Mapping
        Its fields; ``sensor-0`` ... say which sensor each column is.
    columns : sequence of str
        Of the recording.
    machine : Machine
        Of the catalogue.
    first : Beside, optional
        What the recording is diagnosed together with.

    Raises
    ------
    BadFieldError
        For a speed that is none, a sensor that two columns are said to be, or no sensor at all, weights that are none;
        for another machine or asset than the first recordings', or a column that is another sensor there.
    RequestValidationError
        For a field that breaks a rule of the HTTP interface.
    """
    members: dict[str, Any] = {
        name: given[name] for name in ("measurement", "catalogue", "asset", "effort", "mode") if name in given
    }
    speed = with_point(given.get("speed", ""), "speed")
    if speed and speed != given.get("estimated"):
        # The page asks for revolutions per minute; whoever writes a unit is believed.
        members["speed"] = f"{speed} rpm" if plain_number(speed) else speed
        speed_of(members["speed"])
    if given.get("prior"):
        members["prior"] = {"joints": weights_of(given["prior"], machine)}
    mapping = chosen_sensors(given, columns, machine)
    if first is not None:
        members = first.join(members, machine)
        mapping = first.join_sensors(mapping, columns, machine)
    return validate(DiagnosisRequest, {**members, "mapping": mapping})


@dataclass(frozen=True)
class Beside:
    """Recordings that have an answer, with which a further one is diagnosed together.

    Parameters
    ----------
    row : DiagnosisRow
        Their answer.
    columns : mapping of str to sequence of str
        Of each of them, by its id.
    """

    row: DiagnosisRow
    columns: Mapping[str, Sequence[str]]

    def join(self, members: Mapping[str, Any], machine: Machine) -> dict[str, Any]:
        """Return what is asked about one more recording as a question about all.

        Raises
        ------
        BadFieldError
            When that is of another machine or asset.
        """
        own, asset = self.row.answer.machine, self.row.request.get("asset")
        if machine.name != own:
            said = f"catalogue: {members['catalogue']}: is of {machine.name}; what stands beside it is a {own}"
            raise BadFieldError(said, field="catalogue")
        if asset is not None and members.get("asset") != asset:
            said = f"asset: {members.get('asset', 'none')}: what stands beside it is of asset {asset}"
            raise BadFieldError(said, field="asset")
        asked = self.row.request
        before = asked.get("speeds") or [asked.get("speed") or None] * len(self.row.measurements)
        several = {"measurements": [*self.row.measurements, members["measurement"]]}
        if any(speeds := [*before, members.get("speed")]):
            several["speeds"] = speeds
        return {name: value for name, value in members.items() if name not in ("measurement", "speed")} | several

    def join_sensors(self, mapping: Mapping[str, str], columns: Sequence[str], machine: Machine) -> dict[str, str]:
        """Return which sensor each column of all recordings is.

        Raises
        ------
        BadFieldError
            When a column of both is one sensor here, and another one there.
        """
        before = self.row.request.get("mapping", {})
        for measurement, own in self.columns.items():
            for column in set(columns) & set(own):
                here, there = (
                    {**match_by_name(names, machine), **said}.get(column) or NOT_USED
                    for names, said in ((columns, mapping), (own, before))
                )
                if here != there:
                    said = f"column {column[:80]}: is {here} here and {there} in {measurement}"
                    raise BadFieldError(f"{said}: must be one sensor in all recordings of an answer", field="mapping")
        return {**before, **mapping}


def chosen_sensors(given: Mapping[str, str], columns: Sequence[str], machine: Machine) -> dict[str, str]:
    """Return the mapping that the selects of a form stand for; empty where it is what the names say anyway."""
    by_name = match_by_name(columns, machine)
    chosen = {
        column: given.get(f"sensor-{index}", by_name.get(column, NOT_USED)) for index, column in enumerate(columns)
    }
    used = [sensor for sensor in chosen.values() if sensor != NOT_USED]
    for sensor in used:
        if used.count(sensor) > 1:
            raise BadFieldError(f"sensor {sensor[:80]}: two columns are said to be it", field="mapping")
    if not used:
        raise BadFieldError("say of one column at least which sensor it is", field="mapping")
    if chosen == {column: by_name.get(column, NOT_USED) for column in columns}:
        return {}
    return {
        column: "" if sensor == NOT_USED else sensor
        for column, sensor in chosen.items()
        if sensor != NOT_USED or column in by_name
    }


def weights_of(text: str, machine: Machine) -> dict[str, float]:
    """Return how likely joints are to wear, as "A=3, B=0.5" says it.

    Raises
    ------
    BadFieldError
        For what is no joint of the machine, no weight, or said twice.
    """
    found: dict[str, float] = {}
    for part in filter(None, (each.strip() for each in text.split(","))):
        joint, _, weight = (each.strip() for each in part.partition("="))
        if joint in found or not plain_number(weight):
            rule = "is said twice" if joint in found else "must be joint=number, such as A=3"
            raise BadFieldError(f"prior: {part[:80]}: {rule}", field="prior")
        found[joint] = float(weight)
    try:
        Prior(joints=found).check(machine.wearing_joints)
    except DiagnosisError as error:
        raise BadFieldError(str(error)[:240], field="prior") from None
    return found


def plain_number(text: str) -> bool:
    """Return whether a text is a number without a unit."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def with_point(text: str, field: str, what: str = "") -> str:
    """Return a number that was typed, or one with a unit, with a point for a decimal comma.

    Raises
    ------
    BadFieldError
        For "1,500", which is another number to every second reader.
    """
    if THOUSANDS.fullmatch(text):
        plain, point = text.replace(",", ""), text.replace(",", ".")
        raise BadFieldError(f"{what or field}: {text[:80]}: write {plain[:80]} or {point[:80]}", field=field)
    return COMMA.sub(r"\1.\2\3", text) if COMMA.fullmatch(text) else text


def number_of(text: str, field: str, what: str = "") -> float:
    """Return a number that was typed, a whole one as such.

    Parameters
    ----------
    text : str
    field : str
        Of the form, that is marked.
    what : str
        What a refusal names, where that is not the field.

    Raises
    ------
    BadFieldError
    """
    written = with_point(text, field, what)
    if not plain_number(written):
        raise BadFieldError(f"{what or field}: {text[:80]}: must be a number", field=field)
    value = float(written)
    return int(value) if value.is_integer() else value


def quantity_of(text: str, what: str, field: str, dimension: Dimension, unit: str) -> float:
    """Return a number that was typed as SI; without a unit it is in that of its field.

    Raises
    ------
    BadFieldError
    """
    written = with_point(text, field, what)
    try:
        return to_si(f"{written} {unit}" if plain_number(written) else written, dimension)
    except UnitError as error:
        raise BadFieldError(f"{what}: {text[:80]}: {error}", field=field) from None


def moment_of(text: str) -> str:
    """Return a moment that was typed; one without a zone comes from a browser without scripts, whose label says UTC."""
    if not LOCAL.fullmatch(text):
        return text
    return f"{text}Z" if text.count(":") == 2 else f"{text}:00Z"


def messages_of(problem: Problem, fields: Sequence[str]) -> dict[str, str]:
    """Return the messages of a problem by field of a form; what is wrong with a recording is about the recording.

    There are none of what no field of the form is about.
    """
    parts = [entry["field"].partition(".")[0] for entry in problem.errors]
    named = [part for part in parts if part in fields]
    about_file = problem.type.rpartition(":")[2] in ("measurement", "too-large", "diagnosis")
    recording = [name for name in ("file", "measurement", "measurements") if name in fields][:1]
    return dict.fromkeys(named or (recording if about_file else []), problem.detail)
