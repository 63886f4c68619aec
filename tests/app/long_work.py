"""What the background does in tests of it; its process imports this module, and little else."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from jointplay.app.errors import RecordingMissingError
from jointplay.catalogue.errors import CatalogueFileError, DiagnosisError

Progress = Callable[[int, int], None]


def total_of(folder: Path) -> int:
    """Another number for each answer."""
    return 9216 + len(folder.name)


def work(folder: Path, progress: Progress) -> str:
    """Note that it began, tell how far it is, and wait to be let go."""
    with (folder / "begun").open("a") as file:
        print(os.getpid(), os.nice(0), file=file)
    progress(768, total_of(folder))
    while not (folder / "go").exists():
        time.sleep(0.01)
    return str(folder)


def refuse(folder: Path, progress: Progress) -> None:
    raise DiagnosisError("worn.csv: no column is a sensor")


def fail(folder: Path, progress: Progress) -> None:
    raise CatalogueFileError("entries.h5", "cannot be read")


def lack(folder: Path, progress: Progress) -> None:
    raise RecordingMissingError("recording worn.csv: its file is missing")
