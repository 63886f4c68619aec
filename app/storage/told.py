"""What the sender of a file says of it: the same for the command line, the HTTP interface and the page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from jointplay.app.errors import BadFieldError

if TYPE_CHECKING:
    from jointplay.catalogue.measurements.import_profile import ImportProfile

#: Where in a profile a field of a form goes.
PLACES: dict[str, tuple[str, ...]] = {
    "full_scale": ("full_scale",),
    "sensitivity": ("sensitivity",),
    "tacho": ("tacho", "column"),
    "pulses_per_revolution": ("tacho", "pulses_per_revolution"),
    "scaling": ("spectrum", "scaling"),
    "detector": ("spectrum", "detector"),
    "decibel": ("spectrum", "decibel"),
    "reference": ("spectrum", "reference"),
    "window": ("spectrum", "window"),
}
TOLD = frozenset({"sample_rate", "units", "profile", *PLACES})
"""Fields of a form that say something of its file."""

ALL_OTHERS = "*"
MOST_UNITS = 256
LONGEST = 200


@dataclass(frozen=True)
class Told:
    """What somebody says of a file that does not say it itself.

    Parameters
    ----------
    sample_rate_hz : float, optional
    units : Mapping
        Column to unit; ``*`` for all columns that have none.
    profile : Mapping
        Members of a :class:`jointplay.catalogue.measurements.import_profile.ImportProfile` that are set.
    """

    sample_rate_hz: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    profile: Mapping[str, Any] = field(default_factory=dict)

    @property
    def beside_rate(self) -> dict[str, Any]:
        """What is told besides the sample rate, as JSON values; empty where nothing is."""
        told = {"units": dict(self.units), "profile": dict(self.profile)}
        return {name: value for name, value in told.items() if value}

    @property
    def shown(self) -> dict[str, Any]:
        """All that is told, as JSON values."""
        rate = {} if self.sample_rate_hz is None else {"sample_rate_hz": self.sample_rate_hz}
        return {**rate, **self.beside_rate}

    @property
    def import_profile(self) -> ImportProfile:
        """The profile that a file is read by."""
        from jointplay.catalogue.measurements.import_profile import ImportProfile

        return ImportProfile.model_validate(self.profile)


def told_of(fields: Mapping[str, str]) -> Told:
    """Return what the fields of a form say of its file.

    Parameters
    ----------
    fields : Mapping
        Texts by name; those that are none of :data:`TOLD` are not looked at.

    Raises
    ------
    BadFieldError
        Naming the field, its value and the rule it breaks.
    """
    said = {name: fields[name] for name in PLACES if name in fields}
    return Told(
        rate_of(fields.get("sample_rate")),
        pairs_of("units", fields["units"]) if "units" in fields else {},
        profile_of(fields.get("profile"), said),
    )


def rate_of(given: str | None) -> float | None:
    """Return a sample rate in Hz from a text: "10 kHz", or a number in Hz.

    Raises
    ------
    BadFieldError
    """
    from jointplay.solver.errors import UnitError
    from jointplay.solver.machines.units import FREQUENCY, to_si

    if not given:
        return None
    try:
        value = to_si(given, FREQUENCY)
    except UnitError as error:
        raise BadFieldError(f"sample_rate: {given[:80]}: {str(error)[:200]}", field="sample_rate") from None
    if not 0 < value < math.inf:
        raise BadFieldError(f"sample_rate: {given[:80]}: must be greater than 0, and finite", field="sample_rate")
    return value


def pairs_of(name: str, text: str) -> dict[str, str]:
    """Return texts by column, from a JSON object, or from one text that all columns have in common.

    Raises
    ------
    BadFieldError
    """
    from jointplay.catalogue.measurements.readers.raw import NO_TEXT

    if NO_TEXT.search(text):
        raise BadFieldError(f"{name}: holds a character that is no text", field=name)
    if not text.lstrip().startswith("{"):
        if len(text) > LONGEST:
            raise BadFieldError(f"{name}: {text[:80]}: must be a text of 1 to {LONGEST} characters", field=name)
        return {ALL_OTHERS: text.strip()}
    try:
        held = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadFieldError(f"{name}: is not JSON: {error}", field=name) from None
    for column, value in held.items():
        if NO_TEXT.search(f"{column}{value}"):
            raise BadFieldError(f"{name}: holds a character that is no text", field=name)
        if not isinstance(value, str) or not value.strip() or len(column) > LONGEST or len(value) > LONGEST:
            shown = json.dumps(value)[:80]
            raise BadFieldError(
                f"{name}: {column[:80]}: {shown}: must be a text of 1 to {LONGEST} characters", field=name
            )
    if len(held) > MOST_UNITS:
        raise BadFieldError(f"{name}: {len(held)} columns: at most {MOST_UNITS} can be named", field=name)
    return dict(held)


def profile_of(text: str | None, said: Mapping[str, str]) -> dict[str, Any]:
    """Return the members of a profile that are set; single fields win over the profile's text.

    Parameters
    ----------
    text : str, optional
        YAML or JSON.
    said : Mapping
        Values by the names of :data:`PLACES`.

    Raises
    ------
    BadFieldError
    """
    from pydantic import ValidationError

    from jointplay.catalogue.errors import MeasurementError
    from jointplay.catalogue.measurements.import_profile import ImportProfile, full_scale_of, parse_profile

    try:
        profile = parse_profile(text, "profile") if text is not None else ImportProfile()
    except MeasurementError as error:
        raise BadFieldError(str(error), field="profile") from None
    members = profile.model_dump(mode="json", exclude_defaults=True)
    for name, value in said.items():
        *parents, last = PLACES[name]
        inside = members
        for parent in parents:
            inside = inside.setdefault(parent, {})
        inside[last] = pairs_of(name, value) if name == "sensitivity" else value
    if "full_scale" in said:
        members.pop("full_scale_m_s2", None)
        try:
            full_scale_of(said["full_scale"], "")
        except MeasurementError as error:
            raise BadFieldError(str(error), field="full_scale") from None
    if "pulses_per_revolution" in said and "column" not in members["tacho"]:
        rule = "says something of a tacho only: name its column by tacho"
        raise BadFieldError(f"pulses_per_revolution: {rule}", field="pulses_per_revolution")
    try:
        checked = ImportProfile.model_validate(members)
    except ValidationError as error:
        first = error.errors()[0]
        name = next((each for each, place in PLACES.items() if first["loc"][: len(place)] == place), "profile")
        raise BadFieldError(f"{name}: {str(first['input'])[:80]}: {first['msg'].lower()}", field=name) from None
    plain: dict[str, Any] = checked.model_dump(mode="json", exclude_defaults=True)
    return plain
