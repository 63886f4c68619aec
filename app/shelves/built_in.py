"""Recordings that ship with the program, with what they were made with."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any, get_args

from jointplay.app.schemas.virtual import BuiltIn
from jointplay.solver.machines.machine import Machine, shipped_machine


@cache
def read_truths() -> Mapping[str, Mapping[str, Any]]:
    """Return what each recording was made with, by its name."""
    found: dict[str, Mapping[str, Any]] = json.loads((_folder() / "truth.json").read_text(encoding="utf-8"))
    return {name: found[name] for name in get_args(BuiltIn)}


def content_of(name: str) -> bytes:
    """Return the bytes of a recording as they are stored."""
    return bytes((_folder() / file_name(name)).read_bytes())


def file_name(name: str) -> str:
    """Return what the file of a recording is called."""
    return f"{name}.csv.gz"


def recordings_of(machine: Machine) -> list[str]:
    """Return the names of the recordings of a machine."""
    return [name for name, truth in read_truths().items() if _content_key(truth["machine"]) == machine.content_key]


@cache
def _content_key(name: str) -> str:
    return shipped_machine(name).without_clearances().content_key


def _folder() -> Any:
    return resources.files("jointplay.app.demo") / "recordings"
