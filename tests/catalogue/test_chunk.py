"""Chunks with the real simulation: what is stored is what the solver gives."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointplay.catalogue.building.build import build
from jointplay.catalogue.building.chunk import Chunk, cut_chunks, mean_difference_db, simulate_chunk
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.cases.case import Case, Settings
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.machine import parse_machine, shipped_machine
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.band_power import band_matrix

MACHINE = shipped_machine("slider-crank")
PLAN = parse_plan(
    {
        "clearance": {"low": "0.1 mm", "high": "0.4 mm"},
        "draws": {"healthy": 2, "single": 4},
        "fits": {"silent": 0},
        "laws": {"own": 1},
        "guard": 3,
        "seconds": 0,
        "revolutions": 4,
        "bands": {"f_max": "1 kHz"},
        "sample_rate": "4 kHz",
    }
)


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    directory = tmp_path_factory.mktemp("catalogue")
    report = build(MACHINE, PLAN, directory, workers=1)
    assert report.failed == {}
    assert report.lost == ()
    return Catalogue.open(directory)


def test_all_hypotheses_have_spectra(catalogue: Catalogue) -> None:
    assert catalogue.hypotheses == ("healthy", "A", "B", "O")
    assert len(catalogue.entries) == 2 + 3 * 4
    table = catalogue.entries
    assert {0, 1} <= set(table.period) <= {0, 1, 2}
    # Windows of three revolutions, one apart, in four; one of what repeats.
    assert (table.segments == np.where(table.period, 1, 2)).all()
    auto = np.einsum("nbii->nbi", catalogue.power()).real
    assert (auto >= 0).all()
    worn = auto[catalogue.entries.hypothesis == "A", -1, 1]
    healthy = auto[catalogue.entries.hypothesis == "healthy", -1, 1]
    # Impacts, and nothing else, sound at 1 kHz; those of fits more softly. Measured: 400 times; 5 to 990 by others.
    assert np.median(worn) > 10 * np.median(healthy) > 0


def test_stored_spectra_are_those_of_the_solver(catalogue: Catalogue) -> None:
    wanted = [entry for entry in entries_of(PLAN, MACHINE) if entry.worn == ("A",)]
    settings = Settings(
        sample_rate=4000.0,
        accuracy="draft",
        revolutions=4.01,
        settled=True,
        repeating=True,
        motion=False,
        transient=False,
    )
    # In the order in which a catalogue writes its machine: equations in another order round otherwise, which machines
    # with contacts in all joints amplify.
    machine = parse_machine(MACHINE.canonical_json())
    histories = simulate_batch(machine, [Case(entry.fault, entry.parameters) for entry in wanted], settings)
    for case, history in zip(wanted, histories, strict=True):
        entry = catalogue.entry(case.key)
        assert entry.drive_speed == history.drive_speed == case.parameters["drive.speed"]
        assert entry.transient == history.transient
        assert entry.period == history.period
        bands = band_matrix(
            history.band_limited_acceleration,
            history.sample_rate,
            history.drive_speed,
            catalogue.scheme,
            cuts=catalogue.matrix.cuts,
            angle=history.drive_speed * history.t[0],
            period=history.period,
        )
        assert entry.power is not None
        assert entry.spread_db is not None
        assert np.allclose(entry.power, bands.power, rtol=1e-6, atol=0)
        assert np.allclose(entry.spread_db, bands.spread_db, rtol=1e-6)
        ((_, outcome),) = catalogue.cases(np.array(catalogue.matrix.find(case.key)))
        assert outcome.cyclic is not None
        assert np.allclose(outcome.cyclic, bands.cyclic, rtol=1e-5, atol=1e-7 * np.abs(bands.cyclic).max())


def test_a_period_has_the_spectrum_of_a_long_record(catalogue: Catalogue) -> None:
    repeating = [entry for entry in entries_of(PLAN, MACHINE) if catalogue.entry(entry.key).period]
    settings = Settings(sample_rate=4000.0, accuracy="draft", revolutions=12.01, settled=True, transient=False)
    cuts, differences = np.array(catalogue.matrix.cuts[:-1]), []
    for case, long in zip(
        repeating,
        simulate_batch(MACHINE, [Case(entry.fault, entry.parameters) for entry in repeating], settings),
        strict=True,
    ):
        bands = band_matrix(long.band_limited_acceleration, 4000.0, long.drive_speed, catalogue.scheme)
        power = catalogue.entry(case.key).power
        assert power is not None
        stored, found = (np.einsum("bii->bi", np.add.reduceat(p, cuts)).real for p in (power, bands.power))
        differences.append(np.abs(10 * np.log10(stored / found)))
    # Four thousand cases of the shipped machines: 0.01 dB in the median, 0.14 at the 90th percentile.
    assert len(differences) >= 4
    assert np.median(differences) < 0.05
    assert np.quantile(differences, 0.9) < 0.5


def test_spectra_do_not_depend_on_which_order_of_the_machine_file_was_met_first(catalogue: Catalogue) -> None:
    """The catalogue was built in another process, which has seen no other order than its own."""
    wanted = next(entry for entry in entries_of(PLAN, MACHINE) if entry.worn == ("O",))
    simulate_batch(MACHINE, [Case(wanted.fault, wanted.parameters)], Settings(sample_rate=4000.0, revolutions=3.0))
    (outcome,) = simulate_chunk(Chunk(MACHINE.canonical_json(), PLAN.recipe(MACHINE), (wanted,)))
    assert np.array_equal(outcome.power, catalogue.entry(wanted.key).power)  # type: ignore[arg-type]


def test_machine_that_cannot_be_assembled_is_refused_before_anything_is_stored(tmp_path: Path) -> None:
    tree = MACHINE.model_dump()
    for joint in ("O", "A"):  # a crank longer than the rod
        tree["joints"][joint]["at"] = [0.0, 0.0] if joint == "O" else [0.9 * MACHINE.joints["B"].at[0], 0.5]
    with pytest.raises(AssemblyError, match=r"joints\.G1: cannot be assembled at a drive angle of"):
        build(parse_machine(tree), PLAN, tmp_path / "catalogue", workers=0)
    assert not (tmp_path / "catalogue").exists()


def test_chunks_are_of_one_hypothesis_and_take_turns() -> None:
    entries = entries_of(PLAN, MACHINE)
    chunks = cut_chunks(MACHINE, PLAN.recipe(MACHINE), entries, 3)
    labels = [{entry.hypothesis.label for entry in chunk.entries} for chunk in chunks]
    assert labels == [{"healthy"}, {"A"}, {"B"}, {"O"}, {"A"}, {"B"}, {"O"}]
    assert {chunk.joints for chunk in chunks} == {("A", "B", "O")}
    assert [[entry.draw for entry in chunk.entries] for chunk in chunks[1:5:3]] == [[0, 1, 2], [3]]
    assert sorted(entry.key for chunk in chunks for entry in chunk.entries) == sorted(entry.key for entry in entries)
    assert [chunk.id for chunk in cut_chunks(MACHINE, PLAN.recipe(MACHINE), entries, 3)] == [
        chunk.id for chunk in chunks
    ]
    first, second = chunks[1].halves()
    assert first.entries + second.entries == chunks[1].entries
    assert len({chunks[1].id, first.id, second.id}) == 3


def test_chunks_do_not_depend_on_what_is_missing() -> None:
    """Blocks of draws are absolute, so that two builders, or a larger plan, cut the same chunks."""
    recipe, entries = PLAN.recipe(MACHINE), entries_of(PLAN, MACHINE)
    missing = [entry for entry in entries if not (entry.worn == ("A",) and entry.draw < 2)]
    ids = {chunk.id for chunk in cut_chunks(MACHINE, recipe, entries, 2)}
    assert {chunk.id for chunk in cut_chunks(MACHINE, recipe, missing, 2)} < ids


def test_chunks_have_one_law_one_stratum_and_one_speed() -> None:
    tree = {**PLAN.content, "laws": {"own": 1, "hertz": 1}, "wide": {"draws": 1}, "speeds": [1, 1.1]}
    tree |= {"draws": {"healthy": 8, "single": 8}}
    plan = parse_plan(tree)
    entries = entries_of(plan, MACHINE)
    chunks = cut_chunks(MACHINE, plan.recipe(MACHINE), entries, 64)
    kinds = [{(e.hypothesis, e.stratum, e.variant, e.speed, e.joints) for e in chunk.entries} for chunk in chunks]
    assert all(len(kind) == 1 for kind in kinds)
    assert len(set.union(*kinds)) == len(kinds)
    assert sum(len(chunk.entries) for chunk in chunks) == len(entries)
    chunk = next(c for c in chunks if c.entries[0].variant.law == "hertz" and c.entries[0].stratum == "wide")
    assert all(outcome.status == "ok" for outcome in simulate_chunk(chunk))


def test_guarded_cases_are_compared_with_finer_steps(catalogue: Catalogue) -> None:
    """The guard is the difference from the same case at accuracy standard, and only some cases have it."""
    table = catalogue.entries
    assert (np.isfinite(table.guard_db) == (table.draw % 3 == 0)).all()
    wanted = next(entry for entry in entries_of(PLAN, MACHINE) if entry.worn == ("A",) and entry.guarded)
    finer = Chunk(MACHINE.canonical_json(), replace(PLAN.recipe(MACHINE), accuracy="standard"), (wanted,))
    (outcome,) = simulate_chunk(finer)
    stored = catalogue.entry(wanted.key)
    assert outcome.guard_db is None
    assert outcome.power is not None
    assert stored.power is not None
    assert stored.guard_db == pytest.approx(mean_difference_db(stored.power, outcome.power), rel=1e-6)
    assert 0 < stored.guard_db < 6  # chaotic cases differ by their own scatter, which is some 2 dB


def test_mean_difference_of_levels() -> None:
    power = np.einsum("b,ij->bij", [1.0, 1e-3, 1e-12], np.eye(3)).astype(np.complex64)
    assert mean_difference_db(power, power) == 0
    assert mean_difference_db(power, 10 * power) == pytest.approx(10, rel=1e-6)
    other = power.copy()
    other[2] *= 100  # rounding: 120 dB below the largest band
    assert mean_difference_db(power, other) == 0
    other[1, 0, 0] *= 100
    assert mean_difference_db(power, other) == pytest.approx(20 / 6, rel=1e-6)  # one of six levels that count
    assert mean_difference_db(0 * power, 0 * power) == 0


def test_outcomes_are_in_the_order_of_the_entries() -> None:
    recipe = PLAN.recipe(MACHINE)
    entries = [entry for entry in entries_of(PLAN, MACHINE) if entry.worn == ("A",)]
    entries = [entries[i] for i in (2, 0, 3, 1)]
    outcomes = simulate_chunk(Chunk(MACHINE.canonical_json(), recipe, tuple(entries)))
    assert [outcome.drive_speed for outcome in outcomes] == [entry.parameters["drive.speed"] for entry in entries]
