"""The machine as its past tells it: simulated once, and found again by the recordings that come."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from loaded import LOADS, asked, prepared_of

from jointplay.catalogue.diagnosing import as_found, as_known, found_cases, kept_cases
from jointplay.catalogue.diagnosing.as_found import networks_of
from jointplay.catalogue.diagnosing.as_known import refine_known
from jointplay.catalogue.diagnosing.drawn_mounts import find_loose, loosen, warm
from jointplay.catalogue.diagnosing.found_cases import changed, draw_cases, simulate_cases
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.diagnosing.kept_cases import simulate_once
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.stroke_loads import FoundLoad, find_load
from jointplay.catalogue.diagnosing.told import ToldNumbers
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import Observed
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.plans.entry import HEALTHY, Entry
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import Machine

MASS = "links.frame.mass"
TOLD = ToldNumbers((MASS,), np.array([math.log(7.5)]), np.array([[1e-8]]), np.array([True]))


@pytest.fixture
def own_catalogue(small_catalogue: Catalogue, tmp_path: Path) -> Catalogue:
    """One whose folder no other test has written to."""
    shutil.copytree(small_catalogue.layout.root, tmp_path / "own", ignore=shutil.ignore_patterns("machines"))
    return Catalogue.open(tmp_path / "own")


@pytest.fixture(autouse=True)
def few_cases(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many as a network needs to be trained at all."""
    monkeypatch.setattr(as_known, "LEAST_CASES", 192)


@pytest.fixture(scope="module")
def loaded(small_catalogue: Catalogue) -> PreparedMeasurement:
    return prepared_of(small_catalogue, "B", LOADS)


def that_tells(load: FoundLoad | None, numbers: ToldNumbers | None) -> KnownMachine:
    return cast(KnownMachine, SimpleNamespace(tell=lambda *_: (load, numbers)))


def counted(monkeypatch: pytest.MonkeyPatch) -> list[Entry]:
    """What is simulated from now on."""
    simulated: list[Entry] = []

    def simulate(catalogue: Catalogue, machine: Machine, cases: Sequence[Entry], *told: Any) -> FoundSpectra:
        simulated.extend(cases)
        return simulate_cases(catalogue, machine, cases, *told)

    monkeypatch.setattr(kept_cases, "simulate_cases", simulate)
    return simulated


def doubted(catalogue: Catalogue, prepared: PreparedMeasurement) -> tuple[Observed, MatchResult]:
    observed, result = asked(catalogue, prepared)
    return observed, replace(result, trusted_p_value=1e-4)


def probabilities(result: MatchResult) -> dict[str, Any]:
    return {match.label: (match.probability, match.clearances) for match in result.hypotheses}


@pytest.mark.long
def test_a_machine_is_simulated_once(
    own_catalogue: Catalogue, loaded: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the load and the numbers that are told, about the speed of the catalogue; what comes next finds it again.

    The same answer, whoever simulated; and one that was broken off goes on where it was.
    """
    simulated = counted(monkeypatch)
    monkeypatch.setattr(as_found, "weight_as_filed", lambda p_value: 1.0)
    observed, vague = doubted(own_catalogue, loaded)
    nominal = own_catalogue.recipe.nominal_drive_speed
    found = find_load(own_catalogue, [(loaded, HEALTHY, 1.0)], nominal)
    assert found is not None
    load = replace(found, mean=np.array([-50.0, 20.0]))
    first = refine_known(observed, own_catalogue, vague, ["A", "B"], that_tells(load, TOLD), is_otherwise=True, cases=1)
    assert first is not None
    assert first.simulations == len(simulated) == 4 * as_known.LEAST_CASES
    assert first.told  # though it explains nothing: what is told is not what was recorded
    assert "loads of -50 and 20 N" in first.reason
    assert {round(entry.parameters[MASS], 1) for entry in simulated} == {7.5}
    speeds = np.array([entry.parameters["drive.speed"] for entry in simulated]) / nominal
    assert 0.97 <= speeds.min() < 0.98 and 1.02 < speeds.max() <= 1.03
    assert sum(match.probability for match in first.result.hypotheses) == pytest.approx(1.0)

    simulated.clear()
    networks = set(own_catalogue.layout.machines.glob("*.npz")) - set(own_catalogue.layout.machines.glob("cases-*"))
    assert len(networks) == 1
    monkeypatch.setattr(NetworkShelf, "train", lambda *_, **__: pytest.fail("trained again"))
    again = refine_known(observed, Catalogue.open(own_catalogue.layout.root), vague, ["A", "B"],
                         that_tells(load, TOLD), is_otherwise=True, cases=1)  # fmt: skip
    assert again is not None and not simulated
    assert (again.reason, again.simulations) == (first.reason, first.simulations)
    assert probabilities(again.result) == probabilities(first.result)

    kept = sorted(own_catalogue.layout.machines.glob("cases-*.npz"))
    assert len(kept) == 4
    kept[0].unlink()
    kept[1].write_bytes(b"half a file")
    told: list[tuple[int, int]] = []
    third = refine_known(observed, own_catalogue, vague, ["A", "B"], that_tells(load, TOLD), is_otherwise=True, cases=1,
                         progress=lambda *done: told.append(done))  # fmt: skip
    assert third is not None and len(simulated) == 2 * as_known.LEAST_CASES
    assert told == sorted(told) and {total for _, total in told} == {4 * as_known.LEAST_CASES}
    assert len({(done - 1) // as_known.LEAST_CASES for done, _ in told}) == 2  # nothing of what was kept
    assert probabilities(third.result) == probabilities(first.result)


def test_where_nothing_can_change_nothing_is_asked(own_catalogue: Catalogue, loaded: PreparedMeasurement) -> None:
    """And where a past tells nothing, that is said: the machine is simulated as the recording has it then."""
    observed, vague = doubted(own_catalogue, loaded)
    asleep = cast(KnownMachine, SimpleNamespace(tell=lambda *_: pytest.fail("asked")))
    left = refine_known(observed, own_catalogue, vague, ["A", "B"], asleep, mode="robust", is_otherwise=True, cases=1)
    assert left is not None and left.result is vague and not left.simulations
    assert (
        refine_known(observed, own_catalogue, vague, ["A", "B"], that_tells(None, None), is_otherwise=True, cases=1)
        is None
    )
    assert observed.speed is not None
    faster = replace(observed, speed=1.1 * observed.speed)
    assert refine_known(faster, own_catalogue, vague, ["A", "B"], asleep, is_otherwise=True, cases=1) is None
    assert not own_catalogue.layout.machines.exists()


def test_many_cases_teach_a_network_by_more_recordings(
    small_catalogue: Catalogue, loaded: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Five of each; few cases by as many as before."""
    trained = []
    monkeypatch.setattr(NetworkShelf, "applies", lambda *_: True)
    monkeypatch.setattr(NetworkShelf, "train", lambda shelf, *_: trained.append(shelf._training.rows))
    observed, _ = asked(small_catalogue, loaded)
    entries = draw_cases(small_catalogue, small_catalogue.recipe.nominal_drive_speed, [("A",)], None, 1)[1]
    for count in (2304, 8640):
        networks_of(FoundSpectra(small_catalogue.matrix, tuple(entries * count), np.empty((0, 1, 33))), observed)
    assert trained == [20_000, 43_200]


def test_sets_are_drawn_each_by_itself(small_catalogue: Catalogue) -> None:
    """Whatever others are asked for: what is kept of one serves every recording."""
    speed = small_catalogue.recipe.nominal_drive_speed
    keys = []
    for sets in ([(), ("A",), ("A", "B")], [("A",), ("O",)], [("A",)]):
        machine, drawn = draw_cases(small_catalogue, speed, sets, None, 50, doubted=True, told=TOLD, to_come=True)
        keys.append([entry.key for entry in drawn if entry.worn == ("A",)])
    changed_to = changed(drawn[0], machine, small_catalogue.recipe, drawn[0].clearances, drawn[0].parameters)
    assert changed_to.key == drawn[0].key  # as the catalogue's own are simulated
    assert keys[0] == keys[1] == keys[2] and len(set(keys[0])) == 50


def test_cases_come_in_their_order_whoever_simulates(
    small_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In chunks on several processors, to the last bit."""
    speed = small_catalogue.recipe.nominal_drive_speed
    machine, drawn = draw_cases(small_catalogue, speed, [("A",), ("B",)], None, 20, doubted=True)
    alone = simulate_cases(small_catalogue, machine, drawn[::-1])
    monkeypatch.setattr(found_cases, "CHUNK", 8)
    monkeypatch.setattr(found_cases, "count_processors", lambda: 3)
    shared = simulate_cases(small_catalogue, machine, drawn[::-1])
    assert [entry.key for entry in shared.entries] == [entry.key for entry in drawn[::-1]]
    assert alone.entries == shared.entries
    np.testing.assert_array_equal(alone.spectra, shared.spectra)


def test_days_to_come_have_warm_mounts_and_loose_ones(small_catalogue: Catalogue) -> None:
    """All by one factor on one day; a third of the machines have one of them looser, whatever is worn."""
    speed = small_catalogue.recipe.nominal_drive_speed
    (machine, days), (_, usual) = (
        draw_cases(small_catalogue, speed, [("A",), ("B",)], None, 300, doubted=True, told=TOLD, to_come=to_come)
        for to_come in (True, False)
    )

    def factors(what: str) -> FloatArray:
        paths = sorted(path for path in usual[0].parameters if path.startswith("supports.") and what in path)
        ratios = [
            [day.parameters[path] / own.parameters[path] for path in paths]
            for day, own in zip(days, usual, strict=True)
        ]
        return np.array(ratios).reshape(len(ratios), -1, 2)

    stiff, damping = factors("stiffness"), factors("damping")
    assert stiff.shape == damping.shape == (600, 2, 2)
    np.testing.assert_allclose(stiff[..., 0], stiff[..., 1])
    warm = stiff[..., 0].max(axis=1)
    own = stiff[..., 0] / warm[:, None]
    is_loose = own < 1.0 - 1e-9
    assert (is_loose.sum(axis=1) <= 1).all()
    assert 0.28 < is_loose.any(axis=1).mean() < 0.39
    assert (is_loose.sum(axis=0) > 60).all()
    assert 0.3 <= own[is_loose].min() < 0.4 and own[is_loose].max() > 0.9
    assert 0.9 <= warm.min() < 0.92 and 1.08 < warm.max() <= 1.1
    damped = damping[..., 0] / np.sqrt(warm)[:, None]
    np.testing.assert_allclose(damped[~is_loose], 1.0)
    assert (own[is_loose] <= damped[is_loose]).all() and (damped[is_loose] <= 1.0).all()
    powers = np.log(damped[is_loose]) / np.log(own[is_loose])
    assert powers.min() < 0.1 and powers.max() > 0.9
    for entry, each in zip(days, own, strict=True):
        place, said = find_loose(machine, entry.hypothesis.label, entry.draw)
        assert each[place] == pytest.approx(said) if place >= 0 else each.min() == pytest.approx(1.0)
    assert not np.array_equal(own[:300], own[300:])  # what is of the day is another in every set
    inertias = [[entry.parameters["links.frame.inertia"] for entry in each] for each in (days, usual)]
    assert inertias[0] == inertias[1]


def test_mounts_of_which_the_plan_draws_nothing_are_warm_and_loose_as_well(small_catalogue: Catalogue) -> None:
    """And a machine without any has neither."""
    machine = small_catalogue.machine
    assert set(warm(machine, {}, "A", 1)) == {
        f"supports.{place}.{name}.{axis}" for place in (0, 1) for name in ("stiffness", "damping") for axis in (0, 1)
    }
    number = next(each for each in range(20) if find_loose(machine, "A", each)[0] == 1)
    assert {path.rpartition(".")[0] for path in loosen(machine, {}, "A", number)} == {
        "supports.1.stiffness",
        "supports.1.damping",
    }
    bare = machine.model_copy(update={"supports": ()})
    assert not warm(bare, {}, "A", number) and not loosen(bare, {}, "A", number)


@pytest.mark.long
@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_a_mount_that_has_come_loose_is_told_beside_wear(own_catalogue: Catalogue, factor: float) -> None:
    """By simulations of the machine with and without; one that is as it was is not named."""
    mounts = {
        f"supports.{place}.stiffness.{axis}": each
        for place, mount in enumerate(own_catalogue.machine.supports)
        for axis, each in enumerate(mount.stiffness)
    }
    count = len(mounts)
    told = ToldNumbers(tuple(mounts), np.log([*mounts.values()]), 0.03**2 * np.eye(count), np.full(count, True))
    loose = {path: factor * each for path, each in mounts.items() if path.startswith("supports.1.")}
    observed, vague = doubted(own_catalogue, prepared_of(own_catalogue, "B", own={**mounts, **loose}))
    found = refine_known(observed, own_catalogue, vague, ["A", "B"], that_tells(None, told), is_otherwise=True, cases=1)
    assert found is not None and found.told
    if factor == 1.0:
        assert found.cause is None
    else:
        assert found.cause is not None and found.cause.since
        assert (found.cause.name, found.cause.unit) == ("mount 1", "x stiffness")
        assert found.cause.size == pytest.approx(factor, abs=0.15)
        assert found.result.best.label == "B"


def test_a_folder_that_cannot_be_written_only_costs_time(
    own_catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor does one with too many files: those that have not been used for long go."""
    simulated = counted(monkeypatch)
    speed = own_catalogue.recipe.nominal_drive_speed
    machine, drawn = draw_cases(own_catalogue, speed, [("A",)], None, 8)
    own_catalogue.layout.machines.write_text("a file in its place")
    first, second = (simulate_once(own_catalogue, machine, drawn) for _ in range(2))
    np.testing.assert_array_equal(first.spectra, second.spectra)
    assert first.id == second.id and len(simulated) == 16
    own_catalogue.layout.machines.unlink()
    monkeypatch.setattr(kept_cases, "KEPT", 2)
    for count in (8, 7, 8, 6):
        simulate_once(own_catalogue, machine, drawn[:count])
    simulated.clear()
    simulate_once(own_catalogue, machine, drawn)
    assert not simulated  # used again after the second
    simulate_once(own_catalogue, machine, drawn[:7])
    assert len(simulated) == 7


@pytest.mark.long
def test_what_is_told_counts_for_most(
    own_catalogue: Catalogue, loaded: PreparedMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    observed, vague = doubted(own_catalogue, loaded)
    even = replace(vague, hypotheses=tuple(replace(match, probability=0.25) for match in vague.hypotheses))
    says = {"B": 0.4, "A": 0.2, "O": 0.2, HEALTHY: 0.2}
    said = tuple(replace(match, probability=says[match.label]) for match in vague.hypotheses)
    monkeypatch.setattr(as_known, "answer_by", lambda *_, **__: replace(vague, hypotheses=said, trusted_p_value=1.0))
    monkeypatch.setattr(as_found, "weight_as_filed", lambda p_value: 1.0)
    monkeypatch.setattr(as_found, "_cases_near", lambda *_: 1e9)
    found = refine_known(observed, own_catalogue, even, ["A", "B"], that_tells(None, TOLD), is_otherwise=True, cases=1)
    assert found is not None
    assert found.told
    odds = math.log(found.result.probability("B") / found.result.probability("A"))
    assert odds == pytest.approx(as_found.KNOWN_SHARE * math.log(2.0), rel=1e-6)
    monkeypatch.setattr(as_found, "weight_as_filed", lambda p_value: 0.1)
    doubtful = refine_known(
        observed, own_catalogue, even, ["A", "B"], that_tells(None, TOLD), is_otherwise=True, cases=1
    )
    assert doubtful is not None and not doubtful.told
    assert "does not explain" in doubtful.reason
