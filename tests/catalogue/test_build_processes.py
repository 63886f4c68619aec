"""Building with real processes, which are killed and interrupted at any moment."""

from __future__ import annotations

import multiprocessing.process
import os
import random
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import fake_simulator
import pytest
from building import KEYS, assert_complete, quick_build
from fake_simulator import MACHINE, PLAN

from jointplay.catalogue import processes
from jointplay.catalogue.building import scheduling
from jointplay.catalogue.building.build import BuildReport
from jointplay.catalogue.plans.cases import entries_of


def start(directory: Path, **environment: str) -> subprocess.Popen[str]:
    paths = [str(Path(__file__).parent), *sys.path]
    return subprocess.Popen(
        [sys.executable, str(Path(fake_simulator.__file__)), str(directory)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "FAKE_SECONDS": "0.05", **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def children(pid: int) -> list[int]:
    """Worker processes of a builder."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text():
                found.append(int(child))
    return found


def ended(pid: int, seconds: float = 300.0) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rsplit(")")[-1].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False


def begin_to_send(told: str) -> None:
    """Of a worker: send the head of a long result and a byte of it, say so, and go no further."""
    frame = sys._getframe()
    while "result_queue" not in frame.f_locals:
        assert frame.f_back is not None
        frame = frame.f_back
    os.write(frame.f_locals["result_queue"]._writer.fileno(), struct.pack("!i", 1000) + b"x")
    Path(told).touch()
    time.sleep(3600.0)


def test_a_worker_killed_while_it_sends_is_not_waited_for(tmp_path: Path) -> None:
    worker = processes.OneProcess()
    sent = worker.submit(begin_to_send, str(tmp_path / "told"))
    while not (tmp_path / "told").exists():
        assert not sent.done()
        time.sleep(0.01)
    end = threading.Thread(target=worker.close, kwargs={"at_once": True}, daemon=True)
    end.start()
    end.join(120.0)
    assert not end.is_alive()


def test_a_process_that_is_dead_before_its_pool_looks_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = processes.OneProcess()
    tasks = [worker.submit(time.sleep, 3600.0) for _ in range(3)]  # the last is behind those that the process has got
    assert tasks[-1].cancel()
    process, kill = worker.pid, multiprocessing.process.BaseProcess.kill

    def kill_and_doze(victim: multiprocessing.process.BaseProcess) -> None:
        kill(victim)
        time.sleep(1.0)

    monkeypatch.setattr(multiprocessing.process.BaseProcess, "kill", kill_and_doze)
    worker.close(at_once=True)
    assert not Path(f"/proc/{process}").exists()


@pytest.mark.long
def test_builder_and_workers_killed_at_random_moments(tmp_path: Path) -> None:
    """Kill -9 two builders and a worker of a third; the fourth finds everything done, and nothing was twice."""
    directory, log = tmp_path / "catalogue", tmp_path / "log"
    moments = random.Random(20)
    done = 0
    for _ in range(2):
        with start(directory, FAKE_LOG=str(log)) as builder:
            assert builder.stdout is not None
            assert int(builder.stdout.readline().split()[0]) >= done  # nothing that was there is gone
            for _ in range(moments.randint(1, 3)):
                line = builder.stdout.readline()
            time.sleep(moments.uniform(0.0, 0.06))
            workers = children(builder.pid)
            builder.kill()
            assert all(ended(worker) for worker in workers)
        done = int(line.split()[0])
        assert done < len(KEYS)

    with start(directory, FAKE_LOG=str(log)) as builder:
        assert builder.stdout is not None
        for _ in range(3):
            builder.stdout.readline()
        victim = moments.choice(children(builder.pid))
        os.kill(victim, signal.SIGKILL)
        output = builder.stdout.read().splitlines()
    assert builder.returncode == 0
    assert output[-1].split()[-1] in ("0", "1")  # deaths with a chunk in hand: this one may have been between two
    assert output[-1].split()[3] == "0"  # but no entry
    assert_complete(directory)
    # Chunks in hand at each of the three deaths may have been computed twice; more must not.
    assert len(log.read_text().split()) <= len(KEYS) + 3 * 2 * 4
    with start(directory) as builder:
        assert builder.communicate()[0].splitlines()[-1].startswith("added 0 ")


@pytest.mark.long
def test_case_that_kills_its_worker_is_found_and_the_others_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scheduling, "ATTEMPTS", 1)
    victim = next(entry.key for entry in entries_of(PLAN, MACHINE) if entry.draw == 3)
    monkeypatch.setenv("FAKE_DEADLY", victim)
    report = quick_build(tmp_path, workers=1)
    assert report.lost == (victim,)
    assert report.workers_lost == 3  # the chunk of four, its half, the case itself
    assert report.lost_reason == "its worker died, in 1 attempt"
    assert report.added == len(KEYS) - 1


@pytest.mark.long
@pytest.mark.parametrize("moment", [0.0, 3.0])  # s: while workers start, and when they compute
@pytest.mark.usefixtures("ctrl_c")
def test_interrupt_of_the_builder_ends_workers_at_once(tmp_path: Path, moment: float) -> None:
    with start(tmp_path / "catalogue", FAKE_SECONDS="3000") as builder:
        assert builder.stdout is not None
        builder.stdout.readline()
        while len(workers := children(builder.pid)) < 2:
            time.sleep(0.01)
        time.sleep(moment)
        for process in (*workers, builder.pid):  # as a terminal does it: to all of them
            os.kill(process, signal.SIGINT)
        began = time.monotonic()
        errors = builder.communicate()[1]
    assert builder.returncode == -signal.SIGINT
    assert errors.count("Traceback") == 1  # the builder's own, which a command line turns into a status
    assert time.monotonic() - began < 300
    assert all(ended(worker) for worker in workers)
    quick_build(tmp_path / "catalogue")
    assert_complete(tmp_path / "catalogue")


@pytest.mark.usefixtures("ctrl_c")
def test_interrupt_while_workers_start_waits_until_they_have_their_orders() -> None:
    finish = threading.Event()
    other = threading.Thread(target=finish.wait)  # does not block the signal, as threads of libraries
    other.start()
    reached: list[bool] = []

    def interrupted() -> None:
        with processes._interrupts_held():
            assert other.ident is not None
            signal.pthread_kill(other.ident, signal.SIGINT)
            time.sleep(0.1)
            reached.append(True)

    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert reached
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        finish.set()
        other.join()


def test_build_runs_in_a_thread(tmp_path: Path) -> None:
    reports: list[BuildReport] = []
    thread = threading.Thread(target=lambda: reports.append(quick_build(tmp_path, workers=1, chunk_size=64)))
    thread.start()
    thread.join()
    assert reports[0].added == len(KEYS)
