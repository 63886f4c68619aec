"""Builds on a Dask cluster, and builds whose processes are killed: the same catalogue, whoever dies when."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import Any

import databases
import distributed
import pytest
from building import FAILING, KEYS, assert_complete, quick_build
from fake_simulator import compute

from benchmarks.kills import Site, content, disturbed, free_port
from jointplay.catalogue.building import cluster
from jointplay.catalogue.building.chunk import Chunk
from jointplay.catalogue.building.cluster import DaskCluster
from jointplay.catalogue.building.scheduling import HOPELESS
from jointplay.catalogue.errors import BuildError
from jointplay.solver.errors import MachineError


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """A cluster in this process."""
    options: dict[str, Any] = {"processes": False, "dashboard_address": ":0", "protocol": "tcp"}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, **options) as local:
        yield local.scheduler_address


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("undisturbed")
    quick_build(folder)
    return content(folder)


def test_same_catalogue_as_without_a_cluster(tmp_path: Path, scheduler: str, undisturbed: str) -> None:
    workers = DaskCluster(scheduler, wait=300)
    assert workers.capacity == 4
    report = quick_build(tmp_path, executor=workers)
    workers.close()
    assert report.added == len(KEYS)
    assert report.failed == {"diverged": len(FAILING)}
    assert content(tmp_path) == undisturbed


def test_case_that_cannot_be_computed_and_refusals_come_back(
    tmp_path: Path, scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    workers = DaskCluster(scheduler, wait=300)
    with pytest.raises(MachineError) as caught:
        quick_build(tmp_path, executor=workers, compute=refuse)
    assert (caught.value.path, caught.value.value) == ("drive.speed", 1e9)
    with pytest.raises(BuildError, match=f"nothing could be computed in {HOPELESS} attempts, the last: OSError: disk"):
        quick_build(tmp_path, executor=workers, compute=fail)
    monkeypatch.setenv("FAKE_RAISES", KEYS[7])
    report = quick_build(tmp_path, executor=workers)
    assert report.lost == (KEYS[7],)
    monkeypatch.undo()
    assert quick_build(tmp_path, executor=workers).added == 1
    workers.close()
    assert_complete(tmp_path)


def refuse(chunk: Chunk) -> Any:
    raise MachineError("machine", "drive.speed", 1e9, "must be less")


def fail(chunk: Chunk) -> Any:
    raise OSError("disk full")


def unreadable() -> None:
    raise ArithmeticError("cannot be unpacked here")


class Unreadable:
    """Can be packed at a worker; unpacking it at the builder fails."""

    def __reduce__(self) -> Any:
        return unreadable, ()


def spoil(chunk: Chunk) -> Any:
    return Unreadable()


def test_result_that_never_arrives_whole_ends_the_build(tmp_path: Path, scheduler: str) -> None:
    """It is no fault of the connection: begun again without a limit, the build would never end."""
    workers = DaskCluster(scheduler, wait=300)
    rule = r"nothing could be computed in (\d+) attempts, the last: ArithmeticError: cannot be unpacked"
    with pytest.raises(BuildError, match=rule) as raised:
        quick_build(tmp_path, executor=workers, compute=spoil)
    workers.close()
    attempts = re.match(rule, str(raised.value))
    # Parts that share cases fail, too: how many do before it ends depends on the order of the answers.
    assert attempts and int(attempts[1]) >= HOPELESS


@pytest.mark.parametrize(
    ("raised", "blameless"),
    [
        (OSError("closed"), True),
        (TimeoutError(), True),
        (CancelledError(), True),
        (asyncio.CancelledError(), True),
        (ArithmeticError("x"), False),
    ],
)
def test_only_the_connection_is_blameless(scheduler: str, raised: BaseException, blameless: bool) -> None:
    class Remote:
        status = "finished"

        def result(self, timeout: float) -> Any:
            raise raised

    workers = DaskCluster(scheduler, wait=300)
    local: Future[Any] = Future()
    workers._hand_over(Remote(), local)
    error = local.exception()
    workers.close()
    assert error is not None
    assert workers.is_blameless(error) is blameless


def test_workers_of_other_versions_are_refused() -> None:
    versions = {**cluster._versions(), "numpy": "1.0"}
    with pytest.raises(BuildError, match=r"^a worker of the cluster has numpy .*, this builder 1\.0$"):
        cluster._at_worker(compute, None, versions)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("address", "rule"),
    [
        ("tcp://127.0.0.1:{port}", "no scheduler answers within 1 s"),
        ("nonsense://x", "is no address of a scheduler"),
        ("foo", "is no address of a scheduler, tcp://host:8786 (missing port number"),
        ("tcp://host:x", "is no address of a scheduler"),
        ("tcp://host:70000", "a port of 1 to 65535"),
        ("tcp://:8786", "it needs a host"),
    ],
)
def test_no_scheduler_is_one_line(address: str, rule: str) -> None:
    with pytest.raises(BuildError) as caught:
        DaskCluster(address.format(port=free_port()), first_wait=1)
    assert rule in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_worker_is_one_line() -> None:
    told: list[str] = []
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0", protocol="tcp") as local,
        pytest.raises(BuildError, match=r"the cluster has no worker within 1 s$"),
    ):
        DaskCluster(local.scheduler_address, wait=1, tell=told.append)
    assert told == [
        f"waiting for the scheduler {local.scheduler_address}, up to 10 s",
        f"waiting for a worker of the scheduler {local.scheduler_address}, up to 1 s",
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    ("dask", "kind", "builders", "kills"),
    [
        (True, "sqlite", 1, ["worker", "scheduler", "builder"]),
        *[(False, kind, 2, ["worker", "builder"]) for kind in databases.KINDS if kind != "sqlite"],
    ],
)
def test_catalogue_is_the_same_whoever_is_killed(
    tmp_path: Path, undisturbed: str, dask: bool, kind: str, builders: int, kills: list[str]
) -> None:
    with databases.database(kind, tmp_path) as url, Site(tmp_path, dask=dask, index=url) as site:
        assert disturbed(site, kills, builders, seed=4) == kills
        assert content(site.catalogue) == undisturbed
