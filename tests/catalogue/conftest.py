"""One small catalogue of real simulations for all tests that need one."""

from __future__ import annotations

from pathlib import Path

import pytest

from catalogue.building.build import build
from catalogue.plans.plan import parse_plan
from catalogue.storage.store import Catalogue
from solver.machines.machine import shipped_machine

PLAN = {
    "name": "tests",
    "clearance": {"low": "40 um", "high": "0.8 mm"},
    "draws": {"healthy": 36, "single": 72},
    "seconds": 1.0,
}


@pytest.fixture(scope="session")
def small_catalogue(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    """Single faults of the slider-crank, a few draws each."""
    folder: Path = tmp_path_factory.mktemp("catalogue") / "slider-crank"
    build(shipped_machine("slider-crank"), parse_plan(PLAN), folder, workers=0)
    return Catalogue.open(folder)
