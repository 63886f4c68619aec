"""Builds of the small catalogue of :mod:`fake_simulator`, and what must be true of them afterwards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fake_simulator
import numpy as np
from fake_simulator import MACHINE, PLAN, compute, diverges

from jointplay.catalogue.building.build import BuildReport, build
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import Plan, parse_plan
from jointplay.catalogue.storage.store import Catalogue
from jointplay.catalogue.storage.verify import verify

KEYS = [entry.key for entry in entries_of(PLAN, MACHINE)]
FAILING = {key for key in KEYS if diverges(key)}


def quick_build(directory: Path, plan: Plan = PLAN, **options: Any) -> BuildReport:
    options = {"workers": 0, "compute": compute, "chunk_size": 4, **options}
    return build(MACHINE, plan, directory, **options)


def assert_complete(directory: Path, plan: Plan = PLAN) -> None:
    """The catalogue holds exactly the plan, each entry once, and is sound."""
    catalogue = Catalogue.open(directory)
    keys = {entry.key for entry in entries_of(plan, MACHINE)}
    assert sorted([*catalogue.entries.key, *catalogue.failed.key]) == sorted(keys)
    assert set(catalogue.failed.key) == {key for key in keys if diverges(key)}
    for key, power in zip(catalogue.entries.key, catalogue.power(), strict=True):
        made = fake_simulator._outcome(str(key), catalogue.scheme).power
        assert made is not None
        assert np.allclose(power, made, rtol=1e-6)
    report = verify(directory)
    assert report.is_sound, report.findings
    assert report.entries == len(keys)


def with_draws(draws: int) -> Plan:
    return parse_plan({**PLAN.content, "draws": {"healthy": 6, "single": 3 * draws}})
