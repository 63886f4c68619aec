"""What may happen in the process of a build, without building: for processes that tests start and kill."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path

from jointplay.app.jobs.build_process import BuildProgress, Order
from jointplay.app.jobs.workers import prepare
from jointplay.app.logs import LogSettings


def note(order: Order) -> None:
    with open(order.folder.with_suffix(".log"), "a") as log:
        log.write(f"{os.getpid()}\n")


def noted(folder: Path, catalogue: str) -> list[int]:
    """Processes that worked on a catalogue, in their order."""
    log = folder / f"{catalogue}.log"
    return [int(line) for line in log.read_text().split()] if log.exists() else []


def quick(order: Order, sender: Connection) -> None:
    note(order)
    sender.send(BuildProgress("progress", {"cases_done": 3, "cases_total": 12}))
    sender.send(BuildProgress("done", {"catalogue_id": "c" * 64, "cases_done": 12, "message": ""}))


def endless(order: Order, sender: Connection) -> None:
    prepare(LogSettings())
    note(order)
    sender.send(BuildProgress("progress", {"cases_done": 3, "cases_total": 12}))
    time.sleep(600)


def deadly(order: Order, sender: Connection) -> None:
    note(order)
    os.kill(os.getpid(), signal.SIGKILL)


def refused(order: Order, sender: Connection) -> None:
    sender.send(BuildProgress("failed", {"message": "plan: breaks a rule"}))
