"""Small plans for a quick-return, and what tests ask of their cases."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from typing import Any

from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.entry import Entry
from jointplay.catalogue.plans.parameters import MachineNumbers
from jointplay.catalogue.plans.plan import Plan, parse_plan
from jointplay.solver.machines.machine import Machine, shipped_machine

QUICK_RETURN = shipped_machine("quick-return")
MOUNTS = {
    path: number
    for path, number in MachineNumbers(QUICK_RETURN).by_path.items()
    if re.search(r"supports\.\d\.(stiff|damp)", path)
}


TREE: dict[str, Any] = {
    "laws": {"own": 1},
    "fits": {"silent": 0},
    "draws": {"healthy": 3, "single": 6, "pair": 4, "larger": 5},
}


def keys(plan: Plan, machine: Machine = QUICK_RETURN) -> list[str]:
    return [entry.key for entry in entries_of(plan, machine)]


def plan_of(**changes: Any) -> Plan:
    return parse_plan({**TREE, **changes})


def draws(**counts: int) -> dict[str, int]:
    return {**TREE["draws"], **counts}


def sizes_of(entry: Entry) -> dict[str, float]:
    return dict(zip(entry.joints, entry.clearances, strict=True))


def counted(entries: Iterable[Entry]) -> dict[str, int]:
    return dict(Counter(entry.hypothesis.label for entry in entries))
