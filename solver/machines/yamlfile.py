"""Text of a machine file (YAML 1.2 or JSON) to a plain tree of mappings, lists and scalars."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from datetime import date
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from jointplay.solver.errors import MachineError
from jointplay.solver.machines.fields import nearest

type_names = {dict: "a mapping", list: "a list", str: "text", bool: "true or false", type(None): "nothing"}

Tree = dict[str, object]
"""A mapping read from a file: keys are strings, values are mappings, lists or scalars."""

LARGEST_TEXT = 2_000_000
"""Characters; a machine of a thousand links stays far below."""

MOST_NODES = 200_000
"""Values in the tree with aliases followed: stops a small file that unfolds into a huge one."""

DEEPEST = 20
"""Levels of nesting; a machine file has six."""

MOST_BRACKETS = 64
"""Brackets that may be open at a time; some may stand in texts, where they nest nothing."""


def read_text(name: str, noun: str, shipped: Sequence[str]) -> str:
    """Return what a file holds that somebody named in place of something shipped.

    Parameters
    ----------
    name : str
        Its path.
    noun : str
        What it should describe, for the message.
    shipped : sequence of str
        Names that would have done, too.

    Raises
    ------
    MachineError
        When there is none, when it cannot be read, is longer than :func:`read_tree` takes, or no text.
    """
    path = Path(name)
    if not path.exists():
        raise MachineError(name, "", None, f"is neither a file nor a shipped {noun}{nearest(name, shipped)}")
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(LARGEST_TEXT + 1)
    except OSError as error:
        raise MachineError(name, "", None, f"cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise MachineError(name, "", None, "is not a text file in UTF-8") from None
    if len(text) > LARGEST_TEXT:
        raise MachineError(name, "", None, f"must not be longer than {LARGEST_TEXT} characters")
    return text


def read_tree(text: str, source: str) -> Tree:
    """Read YAML 1.2 or JSON.

    Parameters
    ----------
    text : str
        The file's content. JSON is recognised by its opening brace.
    source : str
        Name of the file, for messages.

    Returns
    -------
    Tree
        Keys that are whole numbers have become strings (links may be called 1, 2, 3).

    Raises
    ------
    MachineError
        With the line, for broken syntax and duplicate keys; for anything but a mapping; for non-string keys.
    """
    if len(text) > LARGEST_TEXT:
        raise MachineError(source, "", f"{len(text)} characters", f"must not be longer than {LARGEST_TEXT}")
    try:
        tree = _read_json(text, source) if text.lstrip().startswith("{") else _read_yaml(text, source)
    except RecursionError:
        raise MachineError(source, "", None, f"must not be nested deeper than {DEEPEST} levels") from None
    if not isinstance(tree, dict):
        raise MachineError(source, "", type_names.get(type(tree), tree), "must be a mapping of keys to values")
    budget = iter(range(MOST_NODES))
    return _plain_mapping(tree, source, (), budget)


def _read_json(text: str, source: str) -> object:
    try:
        return json.loads(text, object_pairs_hook=lambda pairs: _unique(pairs, source))
    except json.JSONDecodeError as error:
        if source.endswith(".json"):
            raise MachineError(source, f"line {error.lineno}", None, f"is not JSON: {error.msg}") from None
        return _read_yaml(text, source)  # YAML, too, may start with a brace


def _unique(pairs: list[tuple[str, object]], source: str) -> dict[str, object]:
    mapping: dict[str, object] = {}
    for key, value in pairs:
        if key in mapping:
            raise MachineError(source, key, None, "is given twice; every key may stand once")
        mapping[key] = value
    return mapping


def is_deep(text: str) -> bool:
    """Whether brackets are nested so deeply that the reader, which is slow with that, need not be asked."""
    depth = 0
    for bracket in re.findall(r"[][{}]", text):
        depth = depth + 1 if bracket in "[{" else max(0, depth - 1)
        if depth > MOST_BRACKETS:
            return True
    return False


def _read_yaml(text: str, source: str) -> object:
    if is_deep(text):
        raise RecursionError
    yaml = YAML(typ="safe", pure=True)  # the pure reader follows YAML 1.2: 1.0e7 is a number and y is a string
    try:
        return yaml.load(text)
    except DuplicateKeyError as error:
        key = (error.problem or "").split('"')[1:2]
        raise MachineError(source, _line(error), "".join(key), "is given twice; every key may stand once") from None
    except MarkedYAMLError as error:
        problem = " ".join((error.problem or error.context or "broken syntax").split())
        raise MachineError(source, _line(error), None, f"is not YAML: {problem}") from None
    except (YAMLError, ValueError) as error:  # control characters; dates that are none
        raise MachineError(source, "", None, f"is not YAML: {' '.join(str(error).split())}") from None


def _line(error: MarkedYAMLError) -> str:
    return f"line {error.problem_mark.line + 1}" if error.problem_mark else ""


def _plain_mapping(tree: dict[object, object], source: str, path: tuple[str, ...], budget: Iterator[int]) -> Tree:
    plain: Tree = {}
    for key, value in tree.items():
        if isinstance(key, bool) or not isinstance(key, (str, int)):
            raise MachineError(source, ".".join(path), key, "a key must be text")
        if str(key) in plain:
            raise MachineError(source, ".".join((*path, str(key))), None, "is given twice; every key may stand once")
        plain[str(key)] = _plain(value, source, (*path, str(key)), budget)
    return plain


def _plain(value: object, source: str, path: tuple[str, ...], budget: Iterator[int]) -> object:
    if next(budget, None) is None:
        raise MachineError(source, "", None, f"must not hold more than {MOST_NODES} values")
    if len(path) > DEEPEST:
        raise MachineError(source, ".".join(path[:3]), None, f"must not be nested deeper than {DEEPEST} levels")
    if isinstance(value, dict):
        return _plain_mapping(value, source, path, budget)
    if isinstance(value, list):
        return [_plain(item, source, (*path, str(index)), budget) for index, item in enumerate(value)]
    if value is None or isinstance(value, (str, int, float, bool)):
        return value
    if isinstance(value, date):  # a moment, too: text by the rules of YAML 1.2
        return value.isoformat()
    raise MachineError(source, ".".join(path), value, "must be text, a number, a list or a mapping")
