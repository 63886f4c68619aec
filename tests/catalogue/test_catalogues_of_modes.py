"""Frames with modes in plans, in a small catalogue of real simulations, and in its answers."""

from __future__ import annotations

from dataclasses import replace

import pytest
from bent_frames import bent

from jointplay.catalogue.building.build import build
from jointplay.catalogue.building.chunk import SLACK_REVOLUTIONS, Chunk, mean_difference_db, simulate_chunk
from jointplay.catalogue.diagnosing.diagnosis import diagnose
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.plans.plan_parts import default_uncertain, default_wide
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.machines.fault import Fault
from jointplay.solver.machines.machine import shipped_machine
from jointplay.solver.simulation.simulate import simulate
from jointplay.solver.spectra.band_power import band_matrix

PLAN = {
    "hypotheses": ["healthy"], "sets": [["B"]], "laws": {"own": 1}, "guard": 0, "seconds": 1.0,
    "draws": {"healthy": 48, "single": 48},
}  # fmt: skip


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    folder = tmp_path_factory.mktemp("modes") / "bent"
    build(bent(), parse_plan(PLAN), folder, workers=0)
    return Catalogue.open(folder)


def test_modes_are_uncertain() -> None:
    laws = {"own": 1.0}
    assert "modes.0.frequency" not in default_uncertain(shipped_machine("slider-crank"), laws)
    found, wide = default_uncertain(bent(damping=0.6), laws), default_wide(bent(damping=0.6))
    assert (found["modes.0.frequency"].lognormal, found["modes.0.damping"].lognormal) == (0.015, 0.2)
    assert wide["modes.0.damping"].factor_loguniform == (0.5, pytest.approx(1 / 0.6))
    assert "modes.0.damping" not in default_wide(bent(damping=0.0))


def test_an_entry_is_what_sensors_take_for_a_rigid_frame() -> None:
    """Its levels are those of its simulation at the sensors, not those of the frame's centre of gravity."""
    machine, plan = bent(), parse_plan(PLAN)
    entry = next(each for each in entries_of(plan, machine) if each.hypothesis.label == "B")
    assert "modes.0.frequency" in entry.parameters
    recipe = plan.recipe(machine)
    (outcome,) = simulate_chunk(Chunk(machine.canonical_json(), recipe, (entry,)))
    assert outcome.power is not None
    settings = Settings(
        sample_rate=recipe.sample_rate, revolutions=recipe.revolutions + SLACK_REVOLUTIONS, settled=True, motion=False
    )
    own = entry.variant.machine(machine)
    history = simulate(own, Case(entry.fault, entry.parameters), replace(settings, accuracy=recipe.accuracy))
    seen, centre = (
        band_matrix(signal[history.t >= history.transient], recipe.sample_rate, history.drive_speed, recipe.scheme)
        for signal in (history.as_rigid(own), history.band_limited_acceleration)
    )
    # Of one period, whereas the long run begins with what is left of its transient; measured 0.051.
    assert mean_difference_db(outcome.power, seen.power) < 0.1
    assert mean_difference_db(outcome.power, centre.power) > 1.0


def test_a_worn_machine_is_found(catalogue: Catalogue) -> None:
    machine = catalogue.machine
    fault = Fault({"O": 9e-6, "A": 12e-6, "B": 4e-4})
    history = simulate(machine, Case(fault), Settings(duration=2.0, sample_rate=10_000))
    names = [sensor.name for sensor in machine.sensors]
    found = diagnose(Recording.from_arrays(history.at_sensors(machine), 10_000, names), catalogue)
    assert found.verdict == "worn"
    assert found.candidate_set == ("B",)
    assert found.hypotheses[0].joints["B"].clearance_um == pytest.approx(400, rel=0.35)
