"""A catalogue of several speeds compares a recording with machines at its own speed alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from recordings import RECORDINGS

from jointplay.catalogue.building.build import build
from jointplay.catalogue.diagnosing.baseline_levels import OrderLevels, class_statistics
from jointplay.catalogue.diagnosing.frame_modes import find_mode
from jointplay.catalogue.measurements.measurement import read_measurement
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.machines.machine import shipped_machine

PLAN = {"name": "tests", "hypotheses": ["healthy"], "draws": {"healthy": 96}, "sample_rate": "12 kHz"}


@pytest.fixture(scope="module")
def one_and_three(tmp_path_factory: pytest.TempPathFactory) -> tuple[Catalogue, Catalogue]:
    """Catalogues of one speed, and of that and two others: the machines are the same."""
    folder, machine = tmp_path_factory.mktemp("speeds"), shipped_machine("slider-crank")
    for name, speeds in (("one", [1]), ("three", [0.8, 1, 1.2])):
        build(machine, parse_plan({**PLAN, "speeds": speeds}), folder / name, workers=0)
    return Catalogue.open(folder / "one"), Catalogue.open(folder / "three")


def prepared_for(catalogue: Catalogue) -> PreparedMeasurement:
    scale = (catalogue.scheme, catalogue.recipe.nominal_drive_speed, catalogue.drive_speeds)
    return prepare(read_measurement(RECORDINGS / "slider-crank-02.csv.gz"), catalogue.machine, {}, None, *scale)


def test_levels_of_machines_in_order_are_those_at_the_speed(one_and_three: tuple[Catalogue, Catalogue]) -> None:
    one, three = (
        class_statistics(catalogue, OrderLevels.of(prepared_for(catalogue)), "healthy") for catalogue in one_and_three
    )
    assert one is not None and three is not None
    # Windows of noise differ a little with the sample rate of the bands' upper end; of all speeds there were 288.
    assert three.deviations.shape == one.deviations.shape == (96, len(one.mean))
    assert np.abs(three.mean - one.mean).max() < 0.1
    assert np.abs(three.deviations - one.deviations).max() < 0.5


def test_modes_of_the_frame_are_looked_for_among_machines_at_the_speed(
    one_and_three: tuple[Catalogue, Catalogue], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, three = one_and_three
    asked: list[Any] = []
    rows = type(three.matrix).rows

    def noting(self: object, *given: Any, **named: Any) -> Any:
        asked.append(named.get("speed"))
        return rows(self, *given, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(type(three.matrix), "rows", noting)
    prepared = prepared_for(three)
    find_mode(prepared, three)
    assert asked == [prepared.drive_speed]
