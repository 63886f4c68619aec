"""The slider-crank's file, to be changed in one place."""

from __future__ import annotations

import copy
from typing import Any

from jointplay.solver.machines.machine import shipped_machine_text
from jointplay.solver.machines.yamlfile import read_tree

SLIDER_CRANK = read_tree(shipped_machine_text("slider-crank"), "slider-crank.yaml")
MISSING = object()
SPRING = {"kind": "spring", "link": "frame", "at": [0, 0], "anchor": [0, -0.1], "stiffness": 1}


def changed(path: str, value: object) -> dict[str, Any]:
    """Return the slider-crank's file with one value put in place, or taken out."""
    tree = copy.deepcopy(SLIDER_CRANK)
    at: Any = tree
    *steps, last = path.split(".")
    for step in steps:
        at = at[int(step)] if isinstance(at, list) else at.setdefault(step, {})
    if value is MISSING:
        del at[last]
    else:
        at[int(last) if isinstance(at, list) else last] = value
    return tree
