"""Drive speeds as requests and forms say them."""

from __future__ import annotations

from jointplay.app.errors import BadFieldError
from jointplay.solver.errors import UnitError
from jointplay.solver.machines.units import speed_to_si


def speed_of(given: str | None) -> float | None:
    """Return a drive speed in rad/s from what a request says; a web form's empty text is "not given"."""
    if given is None or given == "":
        return None
    try:
        value = speed_to_si(given)
    except UnitError as error:
        raise BadFieldError(f"speed: {given}: {error}", field="speed") from None
    if value <= 0:
        raise BadFieldError(f"speed: {given}: must be greater than 0", field="speed")
    return value
