"""What a build will take, said before: cases counted, what is there left aside, time and size in proportion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from building import KEYS, quick_build, with_draws
from fake_simulator import MACHINE, PLAN, compute

from jointplay.catalogue.building import forecast as forecasting
from jointplay.catalogue.building.chunk import Chunk, cut_chunks
from jointplay.catalogue.building.forecast import Forecast, forecast
from jointplay.catalogue.errors import CatalogueMismatchError
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import preset
from jointplay.catalogue.storage.shard import CaseOutcome
from jointplay.solver.machines.machine import shipped_machine


class Clock:
    """Time that cases take: a hundred seconds each, seven for the model of a chunk, fifty for what models share."""

    def __init__(self) -> None:
        self.now, self.first = 0.0, 50.0

    def read(self) -> float:
        return self.now

    def compute(self, chunk: Chunk) -> tuple[CaseOutcome, ...]:
        self.now += self.first + 7.0 + 100.0 * len(chunk.entries)
        self.first = 0.0
        return tuple(replace(each, seconds=100.0) for each in compute(chunk))


def foreseen(folder: Path | None = None, workers: int = 2, plan: object = PLAN) -> Forecast:
    return forecast(MACHINE, plan, workers, folder, compute=compute)  # type: ignore[arg-type]


def test_all_cases_are_counted_and_nothing_is_written(tmp_path: Path) -> None:
    found = foreseen(tmp_path / "none")
    assert (found.cases, found.present, found.workers) == (len(KEYS), 0, 2)
    assert found.tried > 0
    assert found.seconds > 0.0
    assert not list(tmp_path.iterdir())


def test_what_is_there_is_not_computed_again(tmp_path: Path) -> None:
    quick_build(tmp_path / "c")
    found = foreseen(tmp_path / "c")
    assert (found.cases, found.present, found.tried, found.seconds, found.size_bytes) == (
        *(len(KEYS), len(KEYS), 0, 0.0, 0),
    )
    more = with_draws(12)
    left = len(entries_of(more, MACHINE)) - len(KEYS)
    assert foreseen(tmp_path / "c", plan=more).present == len(KEYS)
    assert left > 0
    with pytest.raises(CatalogueMismatchError):
        forecast(shipped_machine("four-bar"), preset("quick"), 2, tmp_path / "c", compute=compute)


def test_the_size_is_that_of_the_files(tmp_path: Path) -> None:
    plan = with_draws(64)
    quick_build(tmp_path / "c", plan, chunk_size=512)
    files = [*tmp_path.glob("c/shards/*.h5"), *tmp_path.glob("c/matrix/*/power.npy")]
    assert foreseen(plan=plan).size_bytes == pytest.approx(sum(file.stat().st_size for file in files), rel=0.2)


@pytest.mark.parametrize(("workers", "busy"), [(1, 1.0), (4, 1.0), (2, 3.0)])
def test_time_is_that_of_cases_and_models_shared_by_workers(
    workers: int, busy: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    read = SimpleNamespace(process_time=clock.read, perf_counter=lambda: busy * clock.now)
    monkeypatch.setattr(forecasting, "time", read)
    found = forecast(MACHINE, PLAN, workers, compute=clock.compute, enough=1e9)
    chunks = cut_chunks(MACHINE, PLAN.recipe(MACHINE), entries_of(PLAN, MACHINE), 512)
    models = len({(chunk.entries[0].variant, chunk.joints) for chunk in chunks})
    assert found.seconds == pytest.approx(
        busy * ((100.0 * len(KEYS) + 7.0 * models) / workers + 50.0 + forecasting.STARTING_S), rel=1e-6
    )


def test_no_more_is_tried_than_tells_enough() -> None:
    tried: list[int] = []

    def counted(chunk: Chunk) -> tuple[CaseOutcome, ...]:
        tried.append(len(chunk.entries))
        return compute(chunk)

    forecast(MACHINE, PLAN, 1, compute=counted, enough=0.0)
    assert len(tried) == 2
    forecast(MACHINE, PLAN, 1, compute=counted, enough=1e9)
    assert len(tried) == 2 + len(forecasting.PLACES)
    assert max(tried) <= forecasting.CASES
