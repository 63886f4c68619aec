"""Drive speeds as requests and forms say them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jointplay.app.errors import BadFieldError
from jointplay.solver.errors import UnitError
from jointplay.solver.machines.units import speed_to_si


def speed_of(given: str | None, field: str = "speed") -> float | None:
    """Return a drive speed in rad/s from what a request says; a web form's empty text is "not given"."""
    if given is None or given == "":
        return None
    try:
        value = speed_to_si(given)
    except UnitError as error:
        raise BadFieldError(f"{field}: {given}: {error}", field=field) from None
    if value <= 0:
        raise BadFieldError(f"{field}: {given}: must be greater than 0", field=field)
    return value


def speeds_of(request: Mapping[str, Any]) -> tuple[float | None, ...]:
    """Return the drive speed in rad/s of each recording that a request names, None where it is not given."""
    if several := request.get("speeds"):
        return tuple(speed_of(each, "speeds") for each in several)
    return (speed_of(request.get("speed")),) * len(request.get("measurements") or [""])
