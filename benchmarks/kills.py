"""Kill -9 whoever takes part in a build, at random moments; the finished catalogue must be as if nobody had.

``python -m benchmarks.kills --kills 10 --rounds 3`` runs builds of a small catalogue of made-up spectra, on local
processes and on a Dask cluster, with one builder and with two; each time ten of them are killed, one after the other.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from jointplay.catalogue.storage.directory import CatalogueDirectory
from jointplay.catalogue.storage.store import Catalogue
from jointplay.catalogue.storage.verify import verify

PROGRAM = Path(__file__).parents[1] / "tests" / "catalogue" / "fake_simulator.py"
LEASE = "2"

Process = subprocess.Popen[str]


class Site:
    """Builders of one catalogue, and the cluster they may use; all processes of it end with the block.

    Parameters
    ----------
    directory : Path
        For the catalogue.
    dask : bool
        Compute on a Dask cluster of two workers, in place of two processes a builder.
    index : str, optional
        URL of the database for the index.
    seconds : float
        Time of a chunk of four cases [s].
    """

    def __init__(self, directory: Path, *, dask: bool, index: str | None = None, seconds: float = 0.1) -> None:
        self.catalogue = directory / "catalogue"
        self._dask = dask
        self._port = free_port()
        paths = [str(PROGRAM.parent), *sys.path]
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(paths),
            "FAKE_SECONDS": str(seconds),
            "FAKE_LEASE": LEASE,
            **({"FAKE_SCHEDULER": self.address} if dask else {}),
            **({"FAKE_INDEX": index} if index else {}),
        }
        self.scheduler: Process | None = None
        self.workers: list[Process] = []
        self.builders: list[Process] = []

    def __enter__(self) -> Site:
        if self._dask:
            self.start_cluster()
        return self

    def __exit__(self, *ending: object) -> None:
        for process in (*self.builders, *self.workers, *filter(None, [self.scheduler])):
            process.kill()
            process.communicate()

    @property
    def address(self) -> str:
        """Of the scheduler."""
        return f"tcp://127.0.0.1:{self._port}"

    def start_cluster(self) -> None:
        """A scheduler, always at the same address, and two workers."""
        options = ["--host", "127.0.0.1", "--port", str(self._port), "--dashboard-address", ":0"]
        self.scheduler = self._start("-m", "distributed.cli.dask_scheduler", *options)
        self.start_worker()
        self.start_worker()

    def start_worker(self) -> None:
        """One more Dask worker; it ends with its scheduler."""
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60"]
        self.workers.append(self._start("-m", "distributed.cli.dask_worker", self.address, *options))

    def start_builder(self) -> Process:
        """One more builder."""
        builder = self._start(str(PROGRAM), str(self.catalogue), piped=True)
        self.builders.append(builder)
        return builder

    def victims(self) -> list[str]:
        """Kinds of processes there are."""
        return ["builder", "worker", "scheduler"] if self._dask else ["builder", "worker"]

    def kill(self, kind: str, choice: random.Random) -> None:
        """Kill one of a kind, and start what whoever runs the site would start again."""
        if kind == "builder":
            builder = self.builders.pop(choice.randrange(len(self.builders)))
            end(builder)
            self.start_builder()
        elif not self._dask:
            found = self._local_workers()
            if found:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(choice.choice(found), signal.SIGKILL)
        elif kind == "worker":
            end(self.workers.pop(choice.randrange(len(self.workers))))
            self.start_worker()
        elif self.scheduler is not None:
            for process in (self.scheduler, *self.workers):
                end(process)
            self.workers.clear()
            self.start_cluster()

    def wait_for_more(self, seconds: float = 60.0) -> None:
        """Wait until one more shard is there, or all builders have ended."""
        done, deadline = self._shards(), time.monotonic() + seconds
        while self._shards() == done and time.monotonic() < deadline:
            if all(builder.poll() is not None for builder in self.builders):
                return
            time.sleep(0.02)

    def _local_workers(self, seconds: float = 60.0) -> list[int]:
        """Worker processes of all builders, as soon as there are any; none if all builders have ended."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and any(builder.poll() is None for builder in self.builders):
            found = [child for builder in self.builders for child in children(builder.pid)]
            if found:
                return found
            time.sleep(0.05)
        return []

    def _shards(self) -> int:
        return len(CatalogueDirectory(self.catalogue).shard_names())

    def finish(self, seconds: float = 120.0) -> list[str]:
        """Wait for the end of all builders; returns their last lines, and says what went wrong with one that failed."""
        last = []
        for builder in self.builders:
            output, errors = builder.communicate(timeout=seconds)
            if builder.returncode != 0:
                raise RuntimeError(f"builder ended with {builder.returncode}: {errors[-2000:]}")
            last.append(output.splitlines()[-1])
        self.builders.clear()
        return last

    def _start(self, *command: str, piped: bool = False) -> Process:
        output = subprocess.PIPE if piped else subprocess.DEVNULL
        return subprocess.Popen(
            [sys.executable, *command], env=self._environment, stdout=output, stderr=output, text=True
        )


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def children(pid: int) -> list[int]:
    """Worker processes of a builder (Linux)."""
    found = []
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text().split():
                if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text():
                    found.append(int(child))
    return found


def end(process: Process) -> None:
    """Kill -9, and wait for the end."""
    process.kill()
    process.communicate()


def disturbed(site: Site, kills: Sequence[str | None], builders: int, seed: int, pause: float = 2.0) -> list[str]:
    """Build while processes are killed.

    Parameters
    ----------
    site : Site
    kills : sequence of str or None
        Whom to kill, one after the other; None for anybody.
    builders : int
        How many work at the same time.
    seed : int
        Of victims and moments.
    pause : float
        Longest wait before a kill [s]; every other one also waits until something more is done, so that kills do not
        all meet processes that are just starting.

    Returns
    -------
    list of str
        Who was killed.
    """
    choice, killed = random.Random(seed), []
    for _ in range(builders):
        site.start_builder()
    for number, wanted in enumerate(kills):
        if number % 2 == 0:
            site.wait_for_more()
        time.sleep(choice.uniform(0.0, pause))
        kind = wanted or choice.choice(site.victims())
        site.kill(kind, choice)
        killed.append(kind)
    site.finish()
    return killed


def content(directory: Path) -> str:
    """Id of a catalogue that has been found in order."""
    report = verify(directory)
    if not report.is_sound:
        raise RuntimeError(f"{directory}: {report.findings}")
    return Catalogue.open(directory).id


def cases(where: Sequence[str], indexes: Sequence[str | None]) -> Iterator[tuple[bool, int, str | None]]:
    """Where to compute (on Dask or not), how many builders, and where the index is."""
    for dask in [place == "dask" for place in where]:
        for builders in (1, 2):
            for index in indexes:
                yield dask, builders, index


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=1.0, help="time of a chunk of four cases")
    parser.add_argument("--where", action="append", choices=("local", "dask"), help="both by default")
    parser.add_argument("--index", action="append", help="URL of PostgreSQL, beside SQLite")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, Site(Path(folder), dask=False) as site:
        site.start_builder()
        site.finish()
        wanted = content(site.catalogue)
    print(f"undisturbed: {wanted[:16]}")
    different = 0
    for turn in range(options.rounds):
        for dask, builders, index in cases(options.where or ["local", "dask"], [None, *(options.index or [])]):
            with (
                tempfile.TemporaryDirectory() as folder,
                Site(Path(folder), dask=dask, index=index, seconds=options.seconds) as site,
            ):
                began = time.monotonic()
                killed = disturbed(site, [None] * options.kills, builders, options.seed + turn)
                found = content(site.catalogue)
            different += found != wanted
            where = f"{'dask' if dask else 'local'}, {builders} builders, {'PostgreSQL' if index else 'SQLite'}"
            counts = ", ".join(f"{killed.count(kind)} {kind}" for kind in sorted(set(killed)))
            print(f"{where}: {found[:16]} after {counts} in {time.monotonic() - began:.0f} s", flush=True)
    if different:
        sys.exit(f"{different} catalogues differ from the undisturbed one")


if __name__ == "__main__":
    main()
