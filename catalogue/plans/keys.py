"""Addresses by content: what goes into a simulated case, written in one canonical way and hashed.

Two cases have the same key exactly if machine, fault, parameters, settings and the version of numbers are the same, on
every computer and in every process; so a key finds a stored entry, tells a repeated case, and serves as an HTTP entity
tag.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping

import numpy as np

from jointplay.catalogue.errors import KeyContentError


def _plain(value: object, where: str) -> object:
    """`value` with NumPy scalars, tuples and mappings turned into what JSON knows; everything else is refused."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        if not math.isfinite(value):
            raise KeyContentError(where, value, "must be a finite number")
        return value + 0.0  # -0.0 and 0.0 are one number and must have one key
    if isinstance(value, Mapping):
        plain: dict[str, object] = {}
        for name, item in value.items():
            if not isinstance(name, str):
                raise KeyContentError(where, name, "must be a string to be a key of a mapping")
            plain[name] = _plain(item, f"{where}.{name}" if where else name)
        return plain
    if isinstance(value, (list, tuple)):
        return [_plain(item, f"{where}.{index}") for index, item in enumerate(value)]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist(), where)
    raise KeyContentError(where, value, "has no canonical JSON form")


def canonical_json(value: object) -> str:
    """One spelling of a value: mapping keys sorted, no blanks, floats by ``repr`` (shortest form that reads back).

    Parameters
    ----------
    value : object
        Mappings with string keys, sequences, strings, finite numbers, booleans, ``None``, NumPy scalars and arrays.

    Returns
    -------
    str
        ASCII JSON. An integer and a float of equal value are spelt differently; whoever makes a key decides the type.

    Raises
    ------
    KeyContentError
        A number that is not finite, or something that is not data.
    """
    return json.dumps(_plain(value, ""), sort_keys=True, separators=(",", ":"), allow_nan=False)


def content_digest(value: object) -> str:
    """SHA-256 of the canonical JSON of `value`, 64 hexadecimal digits."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()


def entry_key(
    machine_key: str,
    clearances: Mapping[str, float],
    parameters: Mapping[str, float],
    settings: Mapping[str, object],
    numbers_version: int,
    variant: Mapping[str, object] | None = None,
) -> str:
    """Key of one simulated case.

    Parameters
    ----------
    machine_key : str
        Content key of the machine.
    clearances : mapping of str to float
        Fault: radial clearance in m by joint.
    parameters : mapping of str to float
        Numbers of the machine that differ from its file, by dotted path, SI.
    settings : mapping
        Settings of the simulation and of the estimate made from it: accuracy, sample rate, revolutions, bands.
    numbers_version : int
        :data:`jointplay.solver.NUMBERS_VERSION`: of what the same case gives.
    variant : mapping, optional
        How the machine differs in kind from its file; nothing by default.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    content: dict[str, object] = {
        "machine": machine_key,
        "fault": {joint: float(clearance) for joint, clearance in clearances.items()},
        "parameters": {path: float(number) for path, number in parameters.items()},
        "settings": settings,
        "numbers": numbers_version,
    }
    if variant:
        content["variant"] = variant
    return content_digest(content)


def seed_from(*parts: object) -> int:
    """A 64-bit seed that is a pure function of `parts`, the same in every process and on every computer."""
    return int(content_digest(list(parts))[:16], 16)
