"""What the sender of a file says of it: the same for the command line, the HTTP interface and the page."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any, Self

from jointplay.app.errors import BadFieldError
from jointplay.app.fields import ALL_OTHERS, FILE_FIELDS

if TYPE_CHECKING:
    from jointplay.catalogue.measurements.import_profile import ImportProfile


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
        Members of a :class:`jointplay.catalogue.measurements.import_profile.ImportProfile` that are set, but for the
        moment.
    measured_at : datetime, optional
        When it was measured.
    remembered_of : str
        The asset of whose last file with the same columns the rest was said; empty where it is said of this one.
    """

    sample_rate_hz: float | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    profile: Mapping[str, Any] = field(default_factory=dict)
    measured_at: datetime | None = None
    remembered_of: str = ""

    @classmethod
    def of(
        cls, profile: ImportProfile, sample_rate_hz: float | None = None, units: Mapping[str, str] | None = None
    ) -> Self:
        """Return what a profile says, beside rate and units."""
        members = profile.model_dump(mode="json", exclude_defaults=True, exclude={"measured_at"})
        return cls(sample_rate_hz, units or {}, members, profile.measured_at)

    @property
    def shown(self) -> dict[str, Any]:
        """What is told of how to read the file, as JSON values; when it was measured stands by itself."""
        told = {"sample_rate_hz": self.sample_rate_hz, "units": dict(self.units), "profile": dict(self.profile)}
        return {name: value for name, value in told.items() if value}

    @property
    def import_profile(self) -> ImportProfile:
        """The profile that a file is read by."""
        from jointplay.catalogue.measurements.import_profile import ImportProfile

        return ImportProfile.model_validate({**self.profile, "measured_at": self.measured_at})


def read_told(fields: Mapping[str, str]) -> Told:
    """Return what the fields of a form say of its file.

    Parameters
    ----------
    fields : Mapping
        Texts by name; those that are none of :data:`jointplay.app.fields.TOLD` are not looked at.

    Raises
    ------
    BadFieldError
        Naming the field, its value and the rule it breaks.
    """
    from jointplay.catalogue.errors import MeasurementError
    from jointplay.catalogue.measurements.import_profile import ImportProfile, parse_profile

    said: dict[str, Any] = {
        each.name: pairs_of(each.name, fields[each.name]) if each.by_column else fields[each.name]
        for each in FILE_FIELDS
        if each.name in fields
    }
    try:
        profile = parse_profile(fields["profile"], "profile") if "profile" in fields else ImportProfile()
    except MeasurementError as error:
        raise BadFieldError(str(error), field="profile") from None
    return Told.of(with_said(profile, said), rate_of(fields.get("sample_rate")), said.get("units"))


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
    """Return texts by column: from a JSON object, from "t=s, *=g", or from one text that all columns have in common.

    Raises
    ------
    BadFieldError
    """
    from jointplay.catalogue.measurements.readers.raw import NO_TEXT

    if NO_TEXT.search(text):
        raise BadFieldError(f"{name}: holds a character that is no text", field=name)
    if not text.lstrip().startswith("{"):
        held = plain_pairs(name, text)
    else:
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


def plain_pairs(name: str, text: str) -> dict[str, str]:
    """Return texts by column as people write them: "t=s, *=g", or "g" for all columns.

    Raises
    ------
    BadFieldError
        A part without an equals sign beside others, or a column twice.
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) == 1 and "=" not in text:
        return {ALL_OTHERS: text.strip()}
    held: dict[str, str] = {}
    for part in parts:
        column, _, said = (each.strip() for each in part.rpartition("="))
        if not column or column in held:
            rule = "is given twice" if column else 'must be COLUMN=TEXT, as in "t=s, *=g"'
            raise BadFieldError(f"{name}: {part[:80]}: {rule}", field=name)
        held[column] = said
    return held


def with_said(profile: ImportProfile, said: Mapping[str, Any]) -> ImportProfile:
    """Return a profile with what single fields say, which win over it.

    Parameters
    ----------
    profile : ImportProfile
    said : Mapping
        Values by the names of :data:`jointplay.app.fields.FILE_FIELDS`.

    Raises
    ------
    BadFieldError
    """
    from pydantic import ValidationError

    from jointplay.catalogue.errors import MeasurementError
    from jointplay.catalogue.measurements.import_profile import ImportProfile, full_scale_of, rule_of

    places = {each.name: tuple(each.place.split(".")) for each in FILE_FIELDS if each.place}
    members = profile.model_dump(mode="json", exclude_defaults=True)
    for name in places.keys() & said.keys():
        *parents, last = places[name]
        inside = members
        for parent in parents:
            inside = inside.setdefault(parent, {})
        inside[last] = said[name]
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
        return ImportProfile.model_validate(members)
    except ValidationError as error:
        first = error.errors()[0]
        name = next((each for each, place in places.items() if first["loc"][: len(place)] == place), "profile")
        raise BadFieldError(f"{name}: {str(first['input'])[:80]}: {rule_of(first)}", field=name) from None
