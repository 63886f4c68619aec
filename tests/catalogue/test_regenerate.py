"""Cases simulated again: the same program gives the same bits, and another answer is noticed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from building import quick_build
from fake_simulator import compute

from jointplay import solver
from jointplay.catalogue.building.chunk import Chunk, simulate_chunk
from jointplay.catalogue.building.regenerate import TOLERANCE_DB, regenerate
from jointplay.catalogue.errors import CatalogueMismatchError
from jointplay.catalogue.storage.shard import CaseOutcome
from jointplay.catalogue.storage.store import Catalogue


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    path = tmp_path_factory.mktemp("catalogue")
    quick_build(path)
    return Catalogue.open(path)


def test_real_cases_come_out_the_same(small_catalogue: Catalogue) -> None:
    shown: list[tuple[int, int]] = []
    report = regenerate(small_catalogue, 6, seed=3, progress=lambda done, total: shown.append((done, total)))
    assert report.identical == len(report.cases) == 6
    assert (report.mean_db, report.changed, report.agrees, report.same_program) == (0.0, (), True, True)
    assert shown[-1] == (6, 6)
    assert [case.key for case in report.cases] == [
        case.key for case in regenerate(small_catalogue, 6, seed=3, compute=nothing).cases
    ]
    assert len({case.key for case in report.cases}) == 6


def nothing(chunk: Chunk) -> tuple[CaseOutcome, ...]:
    return tuple(CaseOutcome("diverged", "", 1.0, 0.0, 0, 0.0) for _ in chunk.entries)


def test_machines_that_round_otherwise_agree(small_catalogue: Catalogue) -> None:
    """Clearances changed by 1e-12: measured 0.05 to 0.2 dB on average over twenty cases, by seed."""

    def perturbed(chunk: Chunk) -> tuple[CaseOutcome, ...]:
        entries = (replace(e, clearances=tuple(c * (1 + 1e-12) for c in e.clearances)) for e in chunk.entries)
        return simulate_chunk(replace(chunk, entries=tuple(entries)))

    report = regenerate(small_catalogue, 20, compute=perturbed)
    assert report.identical < 20
    assert 0.0 < report.mean_db < TOLERANCE_DB
    assert report.agrees


def test_all_cases_with_those_that_failed(made_up: Catalogue) -> None:
    report = regenerate(made_up, 10_000, compute=compute)
    assert len(report.cases) == len(made_up.entries) + len(made_up.failed) == report.identical
    assert {case.now for case in report.cases} == {"ok", "diverged"}


def test_workers_are_processes(made_up: Catalogue) -> None:
    assert regenerate(made_up, 12, workers=2, compute=compute).identical == 12


def louder(chunk: Chunk) -> tuple[CaseOutcome, ...]:
    return tuple(
        replace(outcome, power=None if outcome.power is None else outcome.power * 2.0) for outcome in compute(chunk)
    )


def test_differences_are_measured_and_refused(made_up: Catalogue) -> None:
    report = regenerate(made_up, 1000, compute=louder)
    good = [case for case in report.cases if case.stored == "ok"]
    assert np.allclose([case.difference_db for case in good], 10.0 * np.log10(2.0), atol=1e-4)
    assert not report.agrees
    assert report.identical == len(report.cases) - len(good)
    assert report.worst is not None and report.worst.difference_db == max(case.difference_db for case in good)


def test_changed_statuses_are_named(made_up: Catalogue) -> None:
    report = regenerate(made_up, 1000, compute=nothing)
    assert len(report.changed) == len(made_up.entries)
    assert not report.agrees
    assert (report.changed[0].stored, report.changed[0].now) == ("ok", "diverged")


def test_other_numbers_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick_build(tmp_path)
    catalogue = Catalogue.open(tmp_path)
    monkeypatch.setattr("jointplay.catalogue.storage.manifest.__version__", "9.9.9")
    assert regenerate(catalogue, 5, compute=compute).identical == 5
    monkeypatch.setattr(solver, "NUMBERS_VERSION", 99)
    rule = r"holds numbers of version \d+, this program computes version 99: nothing to compare$"
    with pytest.raises(CatalogueMismatchError, match=rule):
        regenerate(catalogue, 5, compute=compute)
