"""From pydantic's findings to one line about a machine file: file, dotted path, value, rule."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fields import MISSING, nearest

_RULES = {
    "missing": "is missing",
    "dict_type": "must be a mapping of keys to values",
    "mapping_type": "must be a mapping of keys to values",
    "model_type": "must be a mapping of keys to values",
    "model_attributes_type": "must be a mapping of keys to values",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "bool_type": "must be true or false",
    "int_type": "must be a whole number",
}


def first_error(error: ValidationError, tree: Mapping[str, object], source: str) -> MachineError:
    """Translate the first finding.

    Parameters
    ----------
    error : pydantic.ValidationError
        What validation found, in the order of the fields.
    tree : mapping
        The content that was validated; it tells keys of the file from pydantic's own marks in a location.
    source : str
        Name of the file.

    Returns
    -------
    MachineError
        One line that names the place as a user would write it.
    """
    details = error.errors(include_url=False)[0]
    path = _path(details["loc"], tree)
    context: dict[str, Any] = details.get("ctx", {})
    value: object = MISSING if details["type"] == "missing" else details["input"]
    if details["type"] == "rule":
        at = context["at"]
        path += tuple(str(step) for step in at)
        value = context["value"] if at or context["value"] is not MISSING else value
    elif details["type"].startswith("union_tag"):
        path += ("kind",)
        value = context.get("tag", MISSING)
    return MachineError(source, ".".join(path), show_value(value), _rule(details, context))


def _path(location: Sequence[int | str], tree: object) -> tuple[str, ...]:
    path: list[str] = []
    at: object = tree
    for step in location:
        if step == "[key]" or (isinstance(at, Mapping) and step not in at and at.get("kind") == step):
            continue  # pydantic's mark for a mapping's key; the kind that chose among joints or drives
        path.append(str(step))
        if isinstance(at, Mapping):
            at = at.get(step)
        elif isinstance(at, (list, tuple)) and isinstance(step, int) and step < len(at):
            at = at[step]
        else:
            at = None
    return tuple(path)


def _rule(details: ErrorDetails, context: Mapping[str, Any]) -> str:
    kind = details["type"]
    if kind == "rule":
        return str(context["rule"])
    if kind == "too_long":
        return f"must have {context['max_length']} entries"
    if kind == "literal_error":
        return f"must be {context['expected']}".replace("'", "")
    if kind == "union_tag_not_found":
        return "is missing"
    if kind == "union_tag_invalid":
        known = [name.strip().strip("'") for name in context["expected_tags"].split(",")]
        return f"is not a known kind{nearest(str(context['tag']), known)}"
    return _RULES.get(kind) or " ".join(details["msg"].split())


def show_value(value: object) -> str | None:
    """Return a value as a user would write it, or None if there is none to show."""
    if value is MISSING or value is None:
        return None
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and math.isfinite(value):
        short = f"{value:g}"
        return short if float(short) == value else repr(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {show_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(str(show_value(item)) for item in value) + "]"
    return " ".join(str(value).split())
