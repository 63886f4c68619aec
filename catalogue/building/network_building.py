"""The networks of a catalogue, trained side by side when it has been built."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path

from jointplay.catalogue.building.executors import InProcess, LocalProcesses
from jointplay.catalogue.errors import BuildError
from jointplay.catalogue.matching.learning import Learning
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.storage.store import Catalogue


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
        Modes of those trained, in the order of asking; "strata" for the one that tells strata apart.

    Raises
    ------
    BuildError
        A process that trains one died.
    CatalogueFileError
        The catalogue cannot be read, or a network cannot be written.
    """
    catalogue = Catalogue.open(folder)
    wanted = list(NetworkShelf.of(catalogue).missing())
    if wanted:
        _train_all(folder, wanted, workers, progress or (lambda done, total: None))
    for file in catalogue.layout.networks.glob("*.npz"):
        # Of the state that is there now, which another builder may have made meanwhile.
        if not file.name.startswith((catalogue.id[:12], Catalogue.open(folder).id[:12])):
            file.unlink(missing_ok=True)
    return tuple(learning.mode if learning.subject == "hypotheses" else learning.subject for learning, _ in wanted)


def _train_all(
    folder: Path, wanted: list[tuple[Learning, float]], workers: int, tell: Callable[[int, int], None]
) -> None:
    count = min(workers, len(wanted))
    executor = LocalProcesses(count) if count > 1 else InProcess()
    left, total = deque(wanted), len(wanted)
    waiting: set[Future[None]] = set()
    tell(0, total)
    try:
        while left or waiting:
            while left and len(waiting) < count:
                waiting.add(executor.submit(_train, (str(folder), *left.popleft())))
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in done:
                error = future.exception()
                if error is not None and executor.is_loss(error):
                    rule = "a process that trains a network died; building again trains what is missing"
                    raise BuildError(f"{folder}: {rule}") from error
                future.result()
            tell(total - len(left) - len(waiting), total)
    except BaseException:
        executor.close(at_once=True)
        raise
    executor.close()


def _train(asked: tuple[str, Learning, float]) -> None:
    folder, learning, speed = asked
    NetworkShelf.of(Catalogue.open(folder)).train(learning, speed, lasting=True)
