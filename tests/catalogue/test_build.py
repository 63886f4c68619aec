"""Building: nothing twice, nothing lost, whoever is killed when."""

from __future__ import annotations

import os
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from building import FAILING, KEYS, assert_complete, quick_build, with_draws
from fake_simulator import MACHINE, PLAN, compute

from jointplay.catalogue.building.build import BuildReport, Progress, build
from jointplay.catalogue.building.executors import InProcess
from jointplay.catalogue.errors import (
    CatalogueBusyError,
    CatalogueFileError,
)
from jointplay.catalogue.plans.cases import entries_of
from jointplay.catalogue.plans.plan import parse_plan
from jointplay.catalogue.storage.directory import STALE, CatalogueDirectory
from jointplay.catalogue.storage.index import Index
from jointplay.catalogue.storage.leases import BuilderLock, ChunkStatus, Leases
from jointplay.catalogue.storage.location import adopt
from jointplay.catalogue.storage.store import Catalogue
from jointplay.catalogue.storage.verify import verify
from jointplay.solver.machines.machine import parse_machine


def test_everything_is_computed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "log"))
    directory = tmp_path / "catalogue"
    assert FAILING
    told: list[Progress] = []
    report = quick_build(directory, progress=told.append)
    assert (report.added, report.present, report.adopted) == (len(KEYS), 0, 0)
    assert report.failed == {"diverged": len(FAILING)}
    assert [told[0].done, told[-1].done, told[-1].total] == [0, len(KEYS), len(KEYS)]
    assert told[-1].failed == len(FAILING)
    assert told[-1].rate > 0
    assert told[-1].eta == 0
    assert [p.done for p in told] == sorted(p.done for p in told)

    before = sorted(path.name for path in (directory / "shards").iterdir())
    again = quick_build(directory)
    assert (again.added, again.present) == (0, len(KEYS))
    assert again.failed == {"diverged": len(FAILING)}
    assert sorted(path.name for path in (directory / "shards").iterdir()) == before
    assert sorted((tmp_path / "log").read_text().split()) == sorted(KEYS)
    assert_complete(directory)


def test_clearances_of_the_file_are_left_aside(tmp_path: Path) -> None:
    report = quick_build(tmp_path)
    tree = MACHINE.model_dump()
    tree["joints"]["A"]["clearance"] = "0.2 mm"
    filed = parse_machine(tree)
    assert filed.content_key != MACHINE.content_key
    again = build(filed, PLAN, tmp_path, workers=0, compute=compute, chunk_size=4)
    assert (again.added, again.present) == (0, report.added)
    assert Catalogue.open(tmp_path).machine == MACHINE


def test_chunks_have_one_set_of_joints_and_their_state_is_kept(tmp_path: Path) -> None:
    quick_build(tmp_path)
    with Index(tmp_path / "index.sqlite") as index:
        chunks = index.chunks()
        assert all(chunk.status is ChunkStatus.DONE and chunk.attempts == 1 for chunk in chunks)
        assert [chunk.hypothesis for chunk in chunks[:4]] == ["healthy", "A", "B", "O"]
        assert sum(chunk.entries for chunk in chunks) == len(KEYS)
        assert index.counts()["healthy", "ok"] + index.counts().get(("healthy", "diverged"), 0) == 6


def test_two_builds_give_the_same_bytes(tmp_path: Path) -> None:
    quick_build(tmp_path / "a")
    quick_build(tmp_path / "b")
    assert Catalogue.open(tmp_path / "a").id == Catalogue.open(tmp_path / "b").id


@pytest.mark.parametrize(
    "larger",
    [
        {"draws": {"healthy": 6, "single": 18}},
        {"draws": {"healthy": 6, "single": 12, "larger": 3}, "sets": [["A", "B", "O"]]},
        {
            "hypotheses": ["healthy", "singles", "pairs", "triples"],
            "draws": {"healthy": 6, "single": 12, "pair": 4, "larger": 3},
        },
        {"wide": {"draws": 0.5}},
        {"speeds": [1, 1.25]},
    ],
)
def test_a_larger_plan_adds_what_is_missing(
    tmp_path: Path, larger: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_LOG", str(tmp_path / "log"))
    directory = tmp_path / "catalogue"
    quick_build(directory)
    before = {path.name: path.read_bytes() for path in (directory / "shards").iterdir()}
    plan = parse_plan({**PLAN.content, **larger, "name": "large"})
    report = quick_build(directory, plan)
    total = len(entries_of(plan, MACHINE))
    assert (report.added, report.present) == (total - len(KEYS), len(KEYS))
    assert len((tmp_path / "log").read_text().split()) == total
    assert all((directory / "shards" / name).read_bytes() == content for name, content in before.items())
    assert Catalogue.open(directory).plan == plan.resolve(MACHINE)
    assert_complete(directory, plan)
    smaller = quick_build(directory)
    assert (smaller.added, smaller.present) == (0, len(KEYS))
    assert Catalogue.open(directory).plan == plan.resolve(MACHINE)


def test_interrupt_leaves_what_is_done(tmp_path: Path) -> None:
    def stop(progress: Progress) -> None:
        if progress.done >= 12:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        quick_build(tmp_path, progress=stop)
    done = len(Catalogue.open(tmp_path).entries) + len(Catalogue.open(tmp_path).failed)
    assert 12 <= done < len(KEYS)
    report = quick_build(tmp_path)
    assert (report.present, report.added) == (done, len(KEYS) - done)
    assert_complete(tmp_path)


def test_death_between_shard_and_index_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The shard is there, the index does not know it: it is adopted, not computed again."""
    real = Index.add_shard

    def dying(index: Index, *args: Any, **options: Any) -> int:
        if len(index.shards()) == 3:
            raise KeyboardInterrupt
        return real(index, *args, **options)

    monkeypatch.setattr(Index, "add_shard", dying)
    with pytest.raises(KeyboardInterrupt):
        quick_build(tmp_path)
    monkeypatch.undo()
    layout = CatalogueDirectory(tmp_path)
    assert len(layout.shard_names()) == 4
    (layout.shards / ".tmp-123-abc").write_bytes(b"half a shard")
    report = quick_build(tmp_path)
    assert report.adopted == 4
    assert report.added + report.present == len(KEYS)
    assert not list(layout.shards.glob(".tmp*"))
    assert_complete(tmp_path)


def test_what_interrupted_writing_left_goes_and_what_is_being_written_stays(tmp_path: Path) -> None:
    quick_build(tmp_path)
    layout = CatalogueDirectory(tmp_path)
    for folder in (layout.models, layout.networks, layout.machines):
        folder.mkdir()
        for name, age in ((".tmp-1-old", 2.0 * STALE), (".tmp-1-new", 0.0), ("kept.npz", 2.0 * STALE)):
            (folder / name).write_bytes(b"part of a model")
            written = time.time() - age
            os.utime(folder / name, (written, written))
    quick_build(tmp_path)
    for folder in (layout.models, layout.networks, layout.machines):
        assert {path.name for path in folder.iterdir()} == {".tmp-1-new", "kept.npz"}


@pytest.mark.parametrize("content", [None, b"", b"this is no database" * 100])
def test_build_goes_on_without_its_index(tmp_path: Path, content: bytes | None) -> None:
    quick_build(tmp_path)
    (tmp_path / "index.sqlite").unlink()
    if content is not None:
        (tmp_path / "index.sqlite").write_bytes(content)
    report = quick_build(tmp_path)
    assert (report.added, report.present, report.adopted) == (0, len(KEYS), len(KEYS))
    assert_complete(tmp_path)


def test_shards_that_are_gone_are_computed_again(tmp_path: Path) -> None:
    quick_build(tmp_path)
    layout = CatalogueDirectory(tmp_path)
    layout.shard(layout.shard_names()[0]).unlink()
    report = quick_build(tmp_path)
    assert 0 < report.added <= 4
    assert_complete(tmp_path)


def test_second_builder_does_what_is_left_and_verify_is_refused(tmp_path: Path) -> None:
    """Begun in the middle of the first, the second builder has all other chunks done before the first goes on."""
    reports: list[BuildReport] = []

    def second(progress: Progress) -> None:
        if progress.done and not reports:
            with pytest.raises(CatalogueBusyError) as caught:
                verify(tmp_path)
            assert (
                str(caught.value) == f"{tmp_path}: another build or verify is running here; wait for its end or stop it"
            )
            reports.append(quick_build(tmp_path))

    first = quick_build(tmp_path, progress=second)
    assert (first.added, first.others) == (4, len(KEYS) - 4)
    assert (reports[0].added, reports[0].others, reports[0].present) == (len(KEYS) - 4, 0, 4)
    assert first.failed == reports[0].failed == {"diverged": len(FAILING)}
    assert_complete(tmp_path)


def test_builders_that_cut_the_plan_differently_store_each_case_once(tmp_path: Path) -> None:
    """Chunks of the second hold parts of chunks of the first, which finds its results there, wholly or in part."""
    reports: list[BuildReport] = []

    def second(progress: Progress) -> None:
        if progress.done and not reports:
            reports.append(quick_build(tmp_path, parse_plan({**PLAN.content, "hypotheses": ["singles"]}), chunk_size=3))

    first = quick_build(tmp_path, progress=second)
    assert reports[0].added > 0
    assert first.added + first.others == len(KEYS)
    assert reports[0].added + first.added == len(KEYS)
    assert first.others == reports[0].added
    assert_complete(tmp_path)


def test_build_waits_for_the_end_of_a_verify(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    quick_build(tmp_path, with_draws(1))
    monkeypatch.setattr("jointplay.catalogue.storage.leases.WAIT", 0.1)
    with CatalogueDirectory(tmp_path).hold_alone(), pytest.raises(CatalogueBusyError):
        quick_build(tmp_path)
    monkeypatch.undo()
    with ThreadPoolExecutor(1) as pool:
        with CatalogueDirectory(tmp_path).hold_alone():
            later = pool.submit(quick_build, tmp_path)
            with pytest.raises(TimeoutError):
                later.result(timeout=0.3)
        assert later.result().added > 0
    assert_complete(tmp_path)


def test_builder_takes_over_what_another_one_had_too_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A chunk on somebody's lease is left alone until the lease has run out."""
    monkeypatch.setattr(Leases, "extend", lambda self, owner, seconds: None)  # no sign of life
    stopped: list[float] = []

    class Sleeper(InProcess):
        """Comes to a halt with its first chunk in hand, as a computer that is suspended."""

        def submit(self, task: Any, argument: Any) -> Future[Any]:
            if not stopped:
                stopped.append(time.monotonic())
                reports.append(quick_build(tmp_path, lease=60.0))
            return super().submit(task, argument)

    reports: list[BuildReport] = []
    late = quick_build(tmp_path, executor=Sleeper(), lease=1.5)
    assert reports[0].added == len(KEYS)
    assert time.monotonic() - stopped[0] >= 0.5
    assert (late.added, late.others) == (0, len(KEYS))  # what it brings late is there already, once
    assert_complete(tmp_path)


def test_readers_read_while_a_build_goes_on(tmp_path: Path) -> None:
    sizes: list[int] = []

    def read(progress: Progress) -> None:
        catalogue = Catalogue.open(tmp_path)
        assert len(catalogue.entries) == len(catalogue.power())
        sizes.append(len(catalogue.entries) + len(catalogue.failed))
        assert sizes[-1] == progress.done

    quick_build(tmp_path, progress=read)
    assert sizes == sorted(sizes)


def test_what_was_changed_while_the_lock_became_a_shared_one_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process can be alone between the two kinds of lock: here it finds a shard damaged, and repairs."""
    quick_build(tmp_path)
    layout = CatalogueDirectory(tmp_path)
    share = BuilderLock.share

    def share_after_a_repair(lock: BuilderLock) -> None:
        layout.move_to_quarantine(layout.shard(layout.shard_names()[0]))
        layout.index.unlink()
        with Index(layout.index) as index:
            for name in layout.shard_names():
                adopt(layout, index, name)
        share(lock)

    monkeypatch.setattr(BuilderLock, "share", share_after_a_repair)
    assert quick_build(tmp_path).added > 0
    monkeypatch.undo()
    assert_complete(tmp_path)


def test_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    quick_build(tmp_path, with_draws(1))
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CatalogueFileError, match=r"manifest\.json: cannot be written \(No space left on device\)$"):
        quick_build(tmp_path)
    monkeypatch.undo()
    assert not list(tmp_path.rglob(".tmp*"))
    quick_build(tmp_path)
    assert_complete(tmp_path)


def test_caller_may_bring_an_executor(tmp_path: Path) -> None:
    class Counting(InProcess):
        submitted = closed = 0

        def submit(self, task: Any, argument: Any) -> Future[Any]:
            self.submitted += 1
            return super().submit(task, argument)

        def close(self, *, at_once: bool = False) -> None:
            self.closed += 1

    executor = Counting()
    quick_build(tmp_path, executor=executor)
    assert executor.submitted > 4
    assert executor.closed == 0
    assert_complete(tmp_path)
