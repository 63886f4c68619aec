"""Cases that cannot be computed: all others are, and they are told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from building import KEYS, assert_complete, quick_build, with_draws
from fake_simulator import MACHINE, PLAN, compute

from jointplay.catalogue.building import scheduling
from jointplay.catalogue.building.chunk import Chunk, cut_chunks
from jointplay.catalogue.building.executors import InProcess
from jointplay.catalogue.errors import (
    BuildError,
)
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.storage.index import Index
from jointplay.catalogue.storage.leases import ChunkStatus
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.errors import MachineError


def test_case_that_cannot_be_computed_is_found_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick_build(tmp_path, with_draws(1))
    victim = next(entry.key for entry in entries_of(PLAN, MACHINE) if entry.joints and entry.draw == 7)
    monkeypatch.setenv("FAKE_RAISES", victim)
    report = quick_build(tmp_path)
    assert report.lost == (victim,)
    assert report.lost_reason == f"ArithmeticError: case {victim[:8]} is too hard"
    assert report.added + report.present == len(KEYS) - 1
    with Index(tmp_path / "index.sqlite") as index:
        lost = [chunk for chunk in index.chunks() if chunk.status is ChunkStatus.LOST]
        assert [(chunk.entries, chunk.message) for chunk in lost] == [(4, f"{victim[:12]}: {report.lost_reason}")]
    monkeypatch.undo()
    assert quick_build(tmp_path).added == 1
    assert_complete(tmp_path)


def test_one_bad_case_of_a_large_first_chunk_does_not_end_the_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Halves that can be computed count as a success, though their chunk is stored only when all of it is done."""
    first = cut_chunks(MACHINE, PLAN.recipe(MACHINE), entries_of(PLAN, MACHINE), 64)[0]
    victim = first.entries[-1].key
    monkeypatch.setattr(scheduling, "HOPELESS", 3)  # the chunk, its half and a half of that fail
    monkeypatch.setenv("FAKE_RAISES", victim)
    report = quick_build(tmp_path, chunk_size=64)
    assert report.lost == (victim,)
    assert report.added == len(KEYS) - 1


class Mortal(InProcess):
    """Workers that die of some cases, without the time that starting them takes."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity

    def is_loss(self, error: BaseException) -> bool:
        return isinstance(error, ChildProcessError)


@pytest.mark.parametrize(
    ("victims", "workers"),
    [
        ([("healthy", 0), ("healthy", 5)], 1),  # in both halves of one chunk
        ([("healthy", 0), ("healthy", 1)], 1),
        ([("healthy", draw) for draw in range(6)], 2),  # a whole chunk
        ([("healthy", 0), ("A", 11), ("B", 3), ("O", 7)], 4),  # in every chunk
    ],
)
def test_all_but_the_cases_that_kill_workers_are_computed(
    tmp_path: Path, victims: list[tuple[str, int]], workers: int
) -> None:
    planned = entries_of(PLAN, MACHINE)
    deadly = {entry.key for entry in planned if (entry.hypothesis.label, entry.draw) in victims}
    assert len(deadly) == len(victims)

    def die(chunk: Chunk) -> Any:
        if not deadly.isdisjoint(entry.key for entry in chunk.entries):
            raise ChildProcessError
        return compute(chunk)

    report = quick_build(tmp_path, executor=Mortal(workers), compute=die, chunk_size=64)
    assert set(report.lost) == deadly
    assert report.lost_reason == "its worker died, in 3 attempts"
    catalogue = Catalogue.open(tmp_path)
    assert {*catalogue.entries.key, *catalogue.failed.key} == {entry.key for entry in planned} - deadly
    with Index(tmp_path / "index.sqlite") as index:
        said = "; ".join(chunk.message for chunk in index.chunks())
    assert all(f"{key[:12]}: its worker died" in said for key in deadly)
    assert quick_build(tmp_path, chunk_size=64).added == len(deadly)
    assert_complete(tmp_path)


def test_trouble_with_every_case_ends_the_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(chunk: object) -> Any:
        raise ZeroDivisionError("float division by zero")

    with pytest.raises(BuildError, match="nothing could be computed in 10 attempts, the last: ZeroDivisionError") as e:
        quick_build(tmp_path, compute=broken)
    assert "\n" not in str(e.value)


def test_refusal_by_the_solver_is_passed_on(tmp_path: Path) -> None:
    def refuse(chunk: object) -> Any:
        raise MachineError("machine", "drive.speed", 1e9, "must be less")

    with pytest.raises(MachineError, match=r"machine: drive\.speed: "):
        quick_build(tmp_path, compute=refuse)


def refuse_in_worker(chunk: object) -> Any:
    raise MachineError("machine", "drive.speed", 1e9, "must be less")


def test_refusal_by_the_solver_comes_out_of_a_worker_as_it_was(tmp_path: Path) -> None:
    with pytest.raises(MachineError) as caught:
        quick_build(tmp_path, workers=1, compute=refuse_in_worker)
    assert (caught.value.path, caught.value.value) == ("drive.speed", 1e9)
