"""Which line of a machine file a message is about."""

from __future__ import annotations

import re
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from jointplay.solver.machines.yamlfile import LARGEST_TEXT, is_deep

_SYNTAX = re.compile(r"line (\d+)")


def line_of(text: str, path: str) -> int | None:
    """Find where a file says something.

    Parameters
    ----------
    text : str
        YAML or JSON, whole or broken.
    path : str
        Dotted path of a value, ``joints.A.at``, or ``line 3``, as :class:`jointplay.solver.errors.MachineError` has.

    Returns
    -------
    int or None
        Line from 1 on: that of the key; of the nearest mapping around it where the key is missing. None where the text
        cannot be read so far.
    """
    said = _SYNTAX.fullmatch(path)
    if said is not None:
        return min(int(said[1]), max(1, len(text.splitlines())))
    if not path or len(text) > LARGEST_TEXT or is_deep(text):
        return None
    try:
        node: Any = YAML(typ="safe", pure=True).compose(text)
    except (YAMLError, ValueError, RecursionError):
        return None
    doubled = None if "." in path else _find_doubled(node, path)
    if doubled is not None:
        return doubled
    line = 1 if node is not None else None
    for step in path.split("."):
        found = _step(node, step)
        if found is None:
            break
        node, line = found
    return line


def _find_doubled(node: Any, key: str) -> int | None:
    """Return the line in which a key stands for the second time in its mapping, which readers of JSON do not say."""
    kind = getattr(node, "id", "")
    if kind == "mapping":
        lines = [name.start_mark.line + 1 for name, _ in node.value if name.value == key]
        if len(lines) > 1:
            return int(lines[1])
    inside = [value for _, value in node.value] if kind == "mapping" else node.value if kind == "sequence" else []
    return next((line for each in inside if (line := _find_doubled(each, key)) is not None), None)


def _step(node: Any, step: str) -> tuple[Any, int] | None:
    """Return the node that a step of a path leads to, and its line."""
    kind = getattr(node, "id", "")
    if kind == "mapping":
        return next(((value, key.start_mark.line + 1) for key, value in node.value if str(key.value) == step), None)
    if kind == "sequence" and step.isdecimal() and int(step) < len(node.value):
        return node.value[int(step)], node.value[int(step)].start_mark.line + 1
    return None
