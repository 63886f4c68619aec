"""A chunk: cases of one hypothesis with the same joints, simulated together by one worker with one compiled model.

Some of them are simulated again with finer steps: how far their spectra are apart guards the catalogue.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import zip_longest

import numpy as np

from jointplay.catalogue.plans.entry import Entry, Recipe, content_digest
from jointplay.catalogue.storage.shard import OK, CaseOutcome
from jointplay.solver.arrays import AnyComplexArray
from jointplay.solver.cases.case import Case, Settings, Status
from jointplay.solver.cases.history import History
from jointplay.solver.cases.steps import Accuracy
from jointplay.solver.machines.machine import Machine, parse_machine
from jointplay.solver.simulation.simulate import simulate_batch
from jointplay.solver.spectra.band_power import band_matrix
from jointplay.solver.spectra.bands import FEATURE_ORDERS

LEAST_POWER = 1e-9
"""Bands below this part of the largest band of the same motion are rounding and do not count."""


def mean_difference_db(power: AnyComplexArray, finer: AnyComplexArray) -> float:
    """Mean magnitude of the difference of two spectra's levels.

    Parameters
    ----------
    power, finer : ndarray of complex, shape (B, 3, 3)
        Cross-power in bands.

    Returns
    -------
    float
        dB, over all bands and motions that count in either; 0 without any.
    """
    a, b = (np.einsum("bii->bi", each).real.astype(np.float64) for each in (power, finer))
    floor = LEAST_POWER * np.maximum(a.max(axis=0, initial=0.0), b.max(axis=0, initial=0.0))
    counts = np.maximum(a, b) > floor
    levels = [10.0 * np.log10(np.maximum(each, np.maximum(floor, np.finfo(float).tiny))) for each in (a, b)]
    return float(np.abs(levels[0] - levels[1])[counts].mean()) if counts.any() else 0.0


NO_LIMIT_CYCLE = "no_limit_cycle"
"""Status of a case whose motor brings it to no steady mean speed."""


@dataclass(frozen=True)
class Chunk:
    """Cases to be computed together, and all that a worker must know for it.

    Parameters
    ----------
    machine : str
        Canonical JSON.
    recipe : Recipe
    entries : tuple of Entry
        At least one; all of the same hypothesis, stratum, variant and speed, with the same joints and parameter names.
    """

    machine: str
    recipe: Recipe
    entries: tuple[Entry, ...]

    @cached_property
    def id(self) -> str:
        """Follows from the entries alone, so that a build that continues knows its chunks again."""
        return content_digest([entry.key for entry in self.entries])[:16]

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints with clearance in all its cases."""
        return self.entries[0].joints

    def halves(self) -> tuple[Chunk, Chunk]:
        """Two chunks of its cases, to find the one that kills workers; only where there are two cases at least."""
        middle = len(self.entries) // 2
        first, second = self.entries[:middle], self.entries[middle:]
        return Chunk(self.machine, self.recipe, first), Chunk(self.machine, self.recipe, second)


FINER: Accuracy = "standard"
"""Accuracy at which guarded cases are computed again."""

SLACK_REVOLUTIONS = 0.01
"""Simulated beyond the recipe's, so that rounding to samples and to fast transforms costs no window of the estimate."""

Compute = Callable[[Chunk], tuple[CaseOutcome, ...]]
"""What a worker does with a chunk: one outcome a case, in the order of the cases. A module's function, picklable."""


def cut_chunks(machine: Machine, recipe: Recipe, entries: Iterable[Entry], size: int) -> list[Chunk]:
    """Cut cases into chunks.

    Parameters
    ----------
    machine : Machine
    recipe : Recipe
    entries : iterable of Entry
        Of one plan, any of its cases.
    size : int
        Most cases of a chunk. A chunk holds draws of one block of so many, ``0 <= draw < size`` for the first, so that
        it does not depend on which other cases are missing.

    Returns
    -------
    list of Chunk
        The first chunks of all hypotheses, then the second ones, and so on: what an interrupted build leaves knows them
        all.
    """
    groups: dict[tuple[object, ...], list[Entry]] = defaultdict(list)
    for entry in entries:
        kind = (entry.hypothesis, entry.stratum, entry.variant, entry.speed, entry.joints)
        groups[*kind, tuple(sorted(entry.parameters)), entry.draw // size].append(entry)
    content = machine.canonical_json()
    alike: dict[object, list[Chunk]] = defaultdict(list)
    for (hypothesis, *_), group in groups.items():
        alike[hypothesis].append(Chunk(content, recipe, tuple(group)))
    return [chunk for turn in zip_longest(*alike.values()) for chunk in turn if chunk is not None]


@lru_cache(maxsize=2)
def _machine(content: str) -> Machine:
    return parse_machine(content, "machine of the catalogue")


def simulate_chunk(chunk: Chunk) -> tuple[CaseOutcome, ...]:
    """Simulate the cases of a chunk and estimate their spectra in bands.

    Raises
    ------
    SolverError
        A parameter or a setting that the solver refuses. What goes wrong numerically is the status of an outcome.
    """
    guarded = [i for i, entry in enumerate(chunk.entries) if entry.guarded and chunk.recipe.accuracy != FINER]
    found = _simulate(chunk, guarded)
    outcomes = found[: len(chunk.entries)]
    for i, finer in zip(guarded, found[len(chunk.entries) :], strict=True):
        power, seconds = outcomes[i].power, outcomes[i].seconds + finer.seconds
        if power is not None and finer.power is not None:
            outcomes[i] = replace(outcomes[i], guard_db=mean_difference_db(power, finer.power), seconds=seconds)
    return tuple(outcomes)


def _simulate(chunk: Chunk, guarded: Sequence[int]) -> list[CaseOutcome]:
    """All cases, then the guarded ones more finely: one queue, for a few cases would leave most lanes empty."""
    recipe, entries = chunk.recipe, [*chunk.entries, *(chunk.entries[i] for i in guarded)]
    accuracies = [recipe.accuracy] * len(chunk.entries) + [FINER] * len(guarded)
    machine = entries[0].variant.machine(_machine(chunk.machine))
    revolutions = recipe.revolutions + SLACK_REVOLUTIONS
    settings = Settings(
        sample_rate=recipe.sample_rate,
        revolutions=revolutions,
        motion=False,
        transient=False,
        settled=True,
        repeating=True,
    )
    cases = [Case(entry.fault, entry.parameters) for entry in entries]
    histories = simulate_batch(machine, cases, settings, accuracies=accuracies)
    cuts = recipe.scheme.third_octave_groups(FEATURE_ORDERS)
    return [_outcome(machine, history, recipe, cuts) for history in histories]


def _outcome(machine: Machine, history: History, recipe: Recipe, cuts: Sequence[int]) -> CaseOutcome:
    message = " ".join(history.message.split())

    def failed(status: str, message: str) -> CaseOutcome:
        return CaseOutcome(status, message, history.drive_speed, history.transient, 0, history.seconds)

    if history.status is not Status.OK:
        return failed(history.status.value, message)
    if history.turning is not None and not history.turning.is_steady:
        return failed(NO_LIMIT_CYCLE, message)
    signal = history.as_rigid(machine)
    if not np.isfinite(signal).all():
        return failed("not_finite", "the acceleration holds a number that is not finite")
    rate, angle = history.sample_rate, abs(history.drive_speed) * float(history.t[0])
    if history.turning is not None:
        signal, rate, angle = history.by_revolutions(signal)
    bands = band_matrix(
        signal,
        rate,
        history.drive_speed,
        recipe.scheme,
        cuts=cuts,
        angle=angle,
        period=history.period,
    )
    power = bands.power.astype(np.complex64)
    if not (np.isfinite(power).all() and np.isfinite(bands.spread_db).all()):
        return failed("not_finite", "a band power is beyond the range of single precision")
    return CaseOutcome(
        OK,
        message,
        history.drive_speed,
        history.transient,
        bands.segments,
        history.seconds,
        power,
        bands.spread_db.astype(np.float32),
        bands.cyclic.astype(np.complex64),
        period=history.period,
    )
