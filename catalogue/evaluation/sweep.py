"""Speed against accuracy: draws and solver accuracy of a catalogue against quality and cost of diagnoses."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from jointplay import solver
from jointplay.catalogue.building.build import build
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.evaluation.metrics import FiguresOfMerit
from jointplay.catalogue.evaluation.protocols import EvaluationProtocol, protocols_of
from jointplay.catalogue.evaluation.recordings import Recordings
from jointplay.catalogue.evaluation.study import Setup, evaluate
from jointplay.catalogue.plans.entry import content_digest
from jointplay.catalogue.plans.plan import Plan
from jointplay.catalogue.storage.leases import ChunkStatus
from jointplay.catalogue.storage.location import IndexLocation
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.cases.steps import Accuracy


@dataclass(frozen=True)
class SweepPoint:
    """One catalogue and one setup.

    Parameters
    ----------
    accuracy : str
        Of the catalogue's simulations.
    draws : int
        Entries of a hypothesis, at most.
    entries : int
        Of the catalogue.
    build_seconds : float
        Processor time that simulating them took when they were built.
    setup : Setup
    figures : FiguresOfMerit
    """

    accuracy: str
    draws: int
    entries: int
    build_seconds: float
    setup: Setup
    figures: FiguresOfMerit


@dataclass(frozen=True)
class Sweep:
    """The trade between speed and accuracy of one machine.

    Parameters
    ----------
    machine : str
    protocol : EvaluationProtocol
    seed, count : int
    points : tuple of Point
    """

    machine: str
    protocol: EvaluationProtocol
    seed: int
    count: int
    points: tuple[SweepPoint, ...]

    def content(self) -> dict[str, object]:
        """Return everything as plain data, for JSON."""
        return dataclasses.asdict(self)


def trade_off(
    catalogue: Catalogue,
    draws: Sequence[int],
    accuracies: Sequence[str],
    protocol: str | EvaluationProtocol = "hard",
    count: int = 120,
    seed: int = 1,
    *,
    setups: Sequence[Setup] = (Setup(),),
    recordings: Recordings | None = None,
    folder: Path | None = None,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Diagnose the same recordings from catalogues of several sizes and accuracies.

    Parameters
    ----------
    catalogue : Catalogue
        Gives machine and plan; serves for its own accuracy.
    draws : sequence of int
        Entries of a hypothesis; more than the catalogue has count as all of them, once.
    accuracies : sequence of str
        Of the solver; the same plan is built for those that the catalogue does not have.
    protocol, count, seed, setups, recordings
        As for :func:`jointplay.catalogue.evaluation.study.evaluate`.
    folder : Path, optional
        Where catalogues of other accuracies are kept; made anew each time without it.
    workers : int
        Processes that build them.
    progress : callable, optional
        Called with the number of recordings done and their total.

    Raises
    ------
    DiagnosisError
        As for :func:`jointplay.catalogue.evaluation.study.evaluate`, a group of protocols, or a number of draws below
        3.
    """
    conditions, *others = protocols_of([protocol])
    if others:
        raise DiagnosisError(f"protocol: {protocol}: stands for {1 + len(others)} protocols, must be one")
    if not draws or min(draws) < 3:
        raise DiagnosisError(f"draws: {min(draws, default=0)}: must be at least 3")
    largest = max(int(np.sum(catalogue.entries.hypothesis == label)) for label in catalogue.hypotheses)
    sizes = sorted({min(each, largest) for each in draws})
    total, done = len(sizes) * len(accuracies) * count, 0
    points: list[SweepPoint] = []
    with tempfile.TemporaryDirectory(prefix="jointplay-sweep-") as scratch:
        for accuracy in accuracies:
            known = _build(catalogue, cast(Accuracy, accuracy), folder or Path(scratch), workers)
            each = _seconds_a_case(known)
            counts = {label: int(np.sum(known.entries.hypothesis == label)) for label in known.hypotheses}
            for most in sizes:

                def told(now: int, _: int, before: int = done) -> None:
                    if progress is not None:
                        progress(min(total, before + now), total)

                study = evaluate(
                    known,
                    [conditions],
                    count,
                    seed,
                    setups=setups,
                    recordings=recordings,
                    most=most,
                    progress=told,
                )
                done += count
                taken = {label: min(most, counts[label]) for label in counts}
                seconds = sum(each[label] * count for label, count in taken.items())
                points += [
                    SweepPoint(accuracy, most, sum(taken.values()), seconds, row.setup, row.figures)
                    for row in study.rows
                ]
    return Sweep(catalogue.machine.name, conditions, seed, count, tuple(points))


def _build(catalogue: Catalogue, accuracy: Accuracy, folder: Path, workers: int) -> Catalogue:
    """The catalogue itself, or one of the same plan with another accuracy."""
    if catalogue.recipe.accuracy == accuracy:
        return catalogue
    plan: Plan = catalogue.plan.model_copy(update={"accuracy": accuracy})
    digest = content_digest([catalogue.machine.content_key, plan.hash, solver.NUMBERS_VERSION])[:16]
    place = folder / f"{catalogue.machine.name}-{accuracy}-{digest}"
    build(catalogue.machine, plan, place, workers=workers)
    return Catalogue.open(place)


def _seconds_a_case(catalogue: Catalogue) -> dict[str, float]:
    """Processor time of a case by hypothesis, as the index has it from building the catalogue."""
    with IndexLocation.of(catalogue.layout).open() as index:
        rows = [row for row in index.chunks() if row.status is ChunkStatus.DONE]
    found = {}
    for label in catalogue.hypotheses:
        own = [row for row in rows if row.hypothesis == label]
        if not own:
            rule = "its index does not know what building it took: build it into another folder, or leave out --sweep"
            raise DiagnosisError(f"{catalogue.path}: {rule}")
        found[label] = sum(row.seconds for row in own) / sum(row.entries for row in own)
    return found
