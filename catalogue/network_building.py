"""The networks of a catalogue, trained side by side when it has been built."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait
from pathlib import Path

from catalogue.executors import InProcess, LocalProcesses
from catalogue.learning import Learning
from catalogue.network_shelf import NetworkShelf
from catalogue.store import Catalogue

__all__ = ["train_networks"]


def train_networks(
    folder: Path, *, workers: int = 1, progress: Callable[[int, int], None] | None = None
) -> tuple[str, ...]:
    """Train the networks that a catalogue should have, and has not; forget those of its former states.

    What is interrupted is trained by the next call; diagnoses do without it until then, and say so.

    Parameters
    ----------
    folder : Path
        Of the catalogue.
    workers : int
        Processes side by side, >= 1; each network takes one.
    progress : callable, optional
        Called with the number of networks trained and their total.

    Returns
    -------
    tuple of str
        Modes of those trained, in the order of asking.
    """
    catalogue = Catalogue.open(folder)
    wanted = list(NetworkShelf.of(catalogue).missing())
    if wanted:
        _train_all(folder, wanted, workers, progress or (lambda done, total: None))
    for file in catalogue.layout.networks.glob("*.npz"):
        # Of the state that is there now, which another builder may have made meanwhile.
        if not file.name.startswith((catalogue.id[:12], Catalogue.open(folder).id[:12])):
            file.unlink(missing_ok=True)
    return tuple(learning.mode for learning, _ in wanted)


def _train_all(
    folder: Path, wanted: list[tuple[Learning, float]], workers: int, tell: Callable[[int, int], None]
) -> None:
    count = min(workers, len(wanted))
    executor = LocalProcesses(count) if count > 1 else InProcess()
    tell(0, len(wanted))
    try:
        waiting = {executor.submit(_train, (str(folder), learning, speed)) for learning, speed in wanted}
        while waiting:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()
            tell(len(wanted) - len(waiting), len(wanted))
    except BaseException:
        executor.close(at_once=True)
        raise
    executor.close()


def _train(asked: tuple[str, Learning, float]) -> None:
    folder, learning, speed = asked
    NetworkShelf.of(Catalogue.open(folder)).train(learning, speed)
