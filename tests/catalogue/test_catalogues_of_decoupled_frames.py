"""Machines whose frame does not act back, or answers by a measured response, from a small catalogue to answers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jointplay.catalogue.building.build import build
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.signals.suspension import accelerance
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import Machine, parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate

PLAN = {
    "hypotheses": ["healthy"], "sets": [["A"]], "laws": {"own": 1}, "guard": 0, "seconds": 1.0,
    "draws": {"healthy": 48, "single": 48},
}  # fmt: skip
WORN = {"O": 9e-6, "A": 3e-4, "B": 8e-6}


def machine_of(kind: str) -> Machine:
    """The slider-crank, its frame decoupled, or by the response of its own mounts at three sensors."""
    filed = shipped_machine("slider-crank")
    tree: dict[str, Any] = filed.model_dump()
    if kind == "decoupled":
        return parse_machine(tree | {"decoupled": True})
    at = {"one": ([0.3, 0.0], [0, 1]), "two": ([-0.1, 0.0], [0, 1]), "three": ([0.0, 0.1], [1, 0])}
    frequency = np.linspace(5.0, 4000.0, 800)
    body = np.zeros((len(frequency), 3, 3), complex)
    body[:] = accelerance(filed, {}, frequency)
    cg = np.array(filed.links[filed.frame].cg)
    sensors = {}
    for name, (place, way) in at.items():
        x, y = np.array(place) - cg
        row = np.array([*way, way[1] * x - way[0] * y])
        answer = np.einsum("k,fkj->fj", row, body)
        sensors[name] = {
            force: np.column_stack([answer[:, k].real, answer[:, k].imag]).tolist()
            for k, force in enumerate(("fx", "fy", "moment"))
        }
    tree["sensors"] = [{"name": name, "at": place, "direction": way} for name, (place, way) in at.items()]
    return parse_machine(tree | {"response": {"frequency": frequency.tolist(), "sensors": sensors}})


@pytest.fixture(scope="module", params=["decoupled", "response"])
def catalogue(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    folder: Path = tmp_path_factory.mktemp(request.param) / "catalogue"
    build(machine_of(request.param), parse_plan(PLAN), folder, workers=0)
    return Catalogue.open(folder)


@pytest.mark.long
@pytest.mark.parametrize("effort", ["fast", "standard", "thorough"])
def test_a_worn_machine_is_found(catalogue: Catalogue, effort: Any) -> None:
    machine = catalogue.machine
    settings = Settings(duration=2.0, sample_rate=catalogue.recipe.sample_rate)
    history = simulate(machine, Case(Fault(WORN)), settings)
    names = [sensor.name for sensor in machine.sensors]
    recording = Recording.from_arrays(history.at_sensors(machine), history.sample_rate, names)
    found = diagnose(recording, catalogue, effort=effort, cases=96)
    assert found.verdict == "worn"
    assert found.hypotheses[0].joints["A"].clearance_um == pytest.approx(300, rel=0.35)
    assert found.causes == ()
