"""Causes other than play: which family of them explains the low orders of a recording, and with what size.

What a change makes of the low orders of the catalogue's machines in order,
or of those that are worn as the recording's seems to be, is put beside the recording: levels of orders 1 to 20, with
what they scatter by, gains of sensors included.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from jointplay.catalogue.diagnosing.baseline_levels import LevelStatistics, OrderLevels, class_statistics, share_beyond
from jointplay.catalogue.diagnosing.cause_families import ALL_MOUNTS, WARMTH, Family, IdealFrame, Misfit, families_of
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import on_mounts
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.machines.parts import ForceDrive

#: What evidence is divided by, as a logarithm: the forces on a rigid frame are no simulation of a machine with play,
#: and levels that err together are not as many as they look.
TEMPERATURE = 2.0
#: A cause is named where it is so much likelier (ln) than no change: of sixty machines in order, with the tolerances of
#: machines, none had more than -3; of changes that low orders can show at all, none less than 34. A catalogue whose
#: frames are all exactly that of the file takes such tolerances for changes, with up to 44.
LEAST_GAIN, LEAST_GAIN_EXACT = 10.0, 50.0
#: where it has this probability,
LEAST_PROBABILITY = 0.05
#: and where it leaves no more than this part of what the machine as filed leaves unexplained, less the expected square
#: of every level, or fits as well as this.
MOST_LEFT = 0.35
EXPLAINED = 0.01
#: What has changed since a recording of the same machine shows much more clearly: then that gain is to be so large.
LEAST_GAIN_SINCE = 50.0
#: Families that are searched beyond their starts: the best so many,
SEARCHED = 5
#: where one of the starts is no more than so much less likely (ln) than no change: half of the time of a recording of a
#: machine as filed, and the answers to eighteen of machines that had changed were the same without it.
HOPELESS = 5.0
#: Nor where that holds even of this part of what the start leaves, beside no change of machines that explain more: a
#: search leaves 0.3 of its start or more (47 recordings of slider-cranks, whatever was the matter with them).
SEARCH_LEAVES = 0.1
#: Evidence (ln) that is the same, as near as searches end: on a guide, a force on one stroke cannot be told from the
#: opposite one on the other, and the first of the two is told.
SAME = 0.01
#: Entries of a worn hypothesis that stand for the recording's machine: those nearest in clearance.
NEAREST = 80
#: Fewest levels that a change is told from others by.
LEAST_LEVELS = 12


@dataclass(frozen=True)
class NamedCause:
    """A cause other than play.

    Parameters
    ----------
    name : str
        "mount 1", "unbalance", "load" ...
    size : float
    unit : str
        What the size is in: "x stiffness", "kg m", "N" ...
    probability : float
        Among the families that were tried, nothing at all among them.
    suspension : mapping of str to float
        Numbers of frame and supports as they then are, by path; empty where forces are the cause.
    since : bool
        Whether the machine has not had it when it was in order, as recordings of that say.
    """

    name: str
    size: float
    unit: str
    probability: float
    suspension: Mapping[str, float] = field(default_factory=dict)
    since: bool = False

    @property
    def extent(self) -> float:
        """How far it is from nothing, and which way: the size, or the logarithm of a factor."""
        return math.log(self.size) if self.unit.startswith("x ") else self.size

    @property
    def is_warmth(self) -> bool:
        """Whether it is no more than mounts that are all a little warmer or colder than they were."""
        return self.since and self.name == ALL_MOUNTS and WARMTH[0] <= self.size <= WARMTH[1]


def name_causes(
    prepared: PreparedMeasurement,
    catalogue: Catalogue,
    worn: Sequence[tuple[str, IntArray]] = (),
    *,
    small: bool,
) -> tuple[NamedCause, ...]:
    """Say which change other than play explains the low orders of a recording.

    Parameters
    ----------
    prepared : PreparedMeasurement
    catalogue : Catalogue
    worn : sequence of (label, rows)
        Worn machines that the recording's may be, besides those in order: hypothesis and nearest entries.
    small : bool
        Whether anything is named where what explains best is a small change.

    Returns
    -------
    tuple of NamedCause
        Most probable first; empty where nothing but play is needed, or no family explains them.

    Raises
    ------
    DiagnosisError
        The ideal machine does not come round at this speed.
    """
    scored = _score_all(prepared, catalogue, worn)
    best = max(scored, key=lambda each: each.evidence, default=None)
    return () if best is not None and best.is_small and not small else _rank(scored)


def explain_as_well(prepared: PreparedMeasurement, catalogue: Catalogue) -> tuple[NamedCause, ...]:
    """Return every change that explains a recording of a machine in order well enough to be named.

    One of them explains it best, but any may be what the machine has. Raises as :func:`name_causes`.
    """
    return tuple(
        NamedCause(each.family.name, each.family.size(each.numbers), each.family.unit, 1.0)
        for each in _score_all(prepared, catalogue)
        if each.family and each.named and each.is_meant
    )


def _score_all(
    prepared: PreparedMeasurement, catalogue: Catalogue, worn: Sequence[tuple[str, IntArray]] = ()
) -> list[_Scored]:
    """Score every family, and no change at all, beside machines in order and worn ones."""
    machine = catalogue.machine
    model = _ideal(catalogue, prepared.drive_speed)
    if model is None:
        return []
    levels = OrderLevels.of(prepared)
    families = tuple(families_of(model))
    drawn = catalogue.plan.spread(machine, "trusted")
    has_tolerances = any(path.startswith(("frame.", "supports.", f"links.{machine.frame}.")) for path in drawn)
    least = LEAST_GAIN if has_tolerances else LEAST_GAIN_EXACT
    scored: list[_Scored] = []
    # Worn machines first: what they explain by themselves need not be searched for among changes of those in order.
    for label, rows in (*worn, ("healthy", None)):
        known = class_statistics(catalogue, levels, label, rows)
        if known is not None:
            beside = min((-2.0 * TEMPERATURE * each.evidence for each in scored if not each.family), default=math.inf)
            scored = [*_score(known, model, families, least, beside=beside), *scored]
    return scored


def name_changes(expected: LevelStatistics, catalogue: Catalogue) -> tuple[NamedCause, ...]:
    """Say which change other than play explains how a recording differs from the machine's own past.

    Parameters
    ----------
    expected : LevelStatistics
        How its levels were to lie.
    catalogue : Catalogue

    Returns
    -------
    tuple of NamedCause
        As for :func:`name_causes`, and raises as that.
    """
    model = _ideal(catalogue, expected.levels.prepared.drive_speed)
    if model is None:
        return ()
    scored = list(_score(expected, model, tuple(families_of(model)), LEAST_GAIN_SINCE, since=True))
    return tuple(replace(cause, since=True) for cause in _rank(scored))


def _ideal(catalogue: Catalogue, speed: float) -> IdealFrame | None:
    """The ideal machine at a speed; None where it is not one that causes can be worked out for."""
    machine = catalogue.machine
    if not on_mounts(machine) or isinstance(machine.drive, ForceDrive):
        return None
    return IdealFrame.of(machine, math.copysign(speed, catalogue.recipe.nominal_drive_speed))


@dataclass(frozen=True, eq=False)
class _Scored:
    """The best member of a family, and whether it may be named; no family where nothing was changed."""

    family: Family | None
    evidence: float
    numbers: FloatArray
    named: bool = False

    @property
    def is_small(self) -> bool:
        """Whether this is a change, and a small one."""
        return self.family is not None and bool(np.linalg.norm(self.numbers) < self.family.least)

    @property
    def is_meant(self) -> bool:
        """Whether this is a change that this machine may have: not much more of one than searches start from.

        No more than twice the largest force, and of masses and springs no factor below half the least or above 1.8
        times the largest. What only others by far explain is no recording of this machine: one of a shaper was
        explained by mounts four times as stiff.
        """
        if self.family is None:
            return False
        sizes = [abs(self.family.size(numbers)) for numbers in self.family.starts]
        size = self.family.size(self.numbers)
        if self.family.unit.startswith("x "):
            return min(sizes) / 2.0 < size < 1.8 * max(sizes)
        return abs(size) < 2.0 * max(sizes)


def _score(
    known: LevelStatistics,
    model: IdealFrame,
    families: Sequence[Family],
    least_gain: float,
    *,
    since: bool = False,
    beside: float = math.inf,
) -> Iterator[_Scored]:
    """Score every family, and no change at all, for some machines of the catalogue, or for one beside its past.

    Nothing is searched where machines that were scored before, with no change at all, are so much nearer (`beside`).
    Where scatter is so small, what is not known of any change would speak for every family: a change of nothing that
    the ideal machine knows counts as no change then.
    """
    misfit = Misfit.of(known, model)
    if len(misfit.away) < LEAST_LEVELS:
        return
    none, count = min(misfit.none, misfit.unknown if since else math.inf), len(misfit.away)
    penalty = 0.5 * math.log(count)
    yield _Scored(None, -0.5 * none / TEMPERATURE, np.zeros(0))
    starts = []
    every = misfit.of_members([(family, family.starts) for family in families], odd=False)
    for family, values in zip(families, every, strict=True):
        best = int(np.argmin(values))
        starts.append((float(values[best]), family, family.starts[best]))
    starts.sort(key=lambda start: round(start[0] / SAME))
    least, hopeless = starts[0][0], 2.0 * TEMPERATURE * HOPELESS
    if least > none + hopeless or SEARCH_LEAVES * least > beside + hopeless:
        return
    chosen = [family for _, family, _ in starts[:SEARCHED]]

    def off(numbers: Sequence[FloatArray]) -> list[FloatArray]:
        return misfit.of_members(list(zip(chosen, numbers, strict=True)))

    better = least_of(off, [numbers for _, _, numbers in starts[:SEARCHED]])
    in_order: FloatArray | None = None
    for rank, (found, family, numbers) in enumerate(starts):
        if rank < SEARCHED:
            numbers, found = better[rank]
        gain = 0.5 * (none - found) / TEMPERATURE - penalty * len(numbers)
        named = gain >= least_gain and found - count <= MOST_LEFT * (misfit.none - count)
        if gain >= least_gain and not named:
            in_order = misfit.in_order() if in_order is None else in_order
            named = share_beyond(found, in_order) >= EXPLAINED
        yield _Scored(family, gain - 0.5 * none / TEMPERATURE, numbers, named)


def _rank(scored: Sequence[_Scored]) -> tuple[NamedCause, ...]:
    """Causes that are named, by probability; of those of one name the best counts."""
    best: dict[str, _Scored] = {}
    for each in scored:
        name = each.family.name if each.family else ""
        if name not in best or each.evidence > best[name].evidence + SAME:
            best[name] = each
    evidences = np.array([each.evidence for each in best.values()])
    share = np.exp(evidences - logsumexp(evidences)) if len(evidences) else evidences
    found = []
    for (name, each), probability in zip(best.items(), share.tolist(), strict=True):
        family = each.family
        if family and each.named and each.is_meant and probability >= LEAST_PROBABILITY:
            size, suspension = family.size(each.numbers), family.suspension(each.numbers)
            found.append(NamedCause(name, size, family.unit, probability, suspension))
    return tuple(sorted(found, key=lambda cause: -cause.probability))


#: First step, as a part of the largest number of the start.
FIRST_STEP = 0.1
#: Points each way of the first look, which finds the deepest of several valleys: in steps, by count of numbers.
FIRST_LOOK = {1: np.arange(-8.0, 10.5, 0.5), 2: 2.0 * np.arange(-2.0, 3.0)}
#: A search ends where the step is this part of the first, or a parabola promises this much or less;
LEAST_STEP = 0.01
LEAST_PROMISE = 0.02
#: it moves by so many steps at once, at most,
FARTHEST = 3.0
#: and takes no more than so many.
MOST_STEPS = 20


@dataclass(eq=False)
class _CauseSearch:
    """Where a search is: middle (p,) and step of the values looked at next, and the best of those looked at."""

    middle: FloatArray
    step: float
    best: FloatArray
    least: float = np.inf
    done: bool = False

    def around(self) -> FloatArray:
        """The middle and its neighbours (3^p, p), a step off in each number."""
        return self.middle + self.step * _neighbours(len(self.middle))

    def go(self, values: FloatArray) -> None:
        """Go on to the least value of a parabola through the values (3^p,) around the middle."""
        offsets = _neighbours(len(self.middle))
        lowest = int(np.argmin(values))
        if values[lowest] >= self.least:
            # The parabola was wrong that far off: look closer.
            self.middle, self.step = self.best, 0.3 * self.step
            return
        self.best, self.least = self.middle + self.step * offsets[lowest], float(values[lowest])
        curved, slope, own = _parabola(offsets, values)
        sizes, ways = np.linalg.eigh(curved)
        if sizes[0] <= 1e-9 * max(1.0, float(abs(own))):
            self.middle = self.best
            return
        off = -ways @ ((ways.T @ slope) / sizes)
        far = float(np.abs(off).max())
        self.middle = self.middle + self.step * off * min(1.0, FARTHEST / max(far, 1e-300))
        if far < 1.0:
            self.done = abs(self.least - own - 0.5 * float(slope @ off)) < LEAST_PROMISE
            self.step *= max(far, 0.2)


def least_of(
    function: Callable[[Sequence[FloatArray]], Sequence[FloatArray]], starts: Sequence[FloatArray]
) -> list[tuple[FloatArray, float]]:
    """Find least values near some starts, by parabolas through neighbours.

    Parameters
    ----------
    function : callable
        From numbers (n, p) of every search, to values (n,) of every one.
    starts : sequence of (p,) array
        Of one or two numbers, not all zero.

    Returns
    -------
    list of ((p,) array, float)
        Numbers and value.
    """
    steps = [FIRST_STEP * float(np.abs(start).max()) for start in starts]
    looks = [
        start + step * _points(FIRST_LOOK[len(start)], len(start)) for start, step in zip(starts, steps, strict=True)
    ]
    lowest = [look[np.argmin(value)] for look, value in zip(looks, function(looks), strict=True)]
    searches = [_CauseSearch(middle, step, middle) for middle, step in zip(lowest, steps, strict=True)]
    for _ in range(MOST_STEPS):
        values = function([search.around()[: 0 if search.done else None] for search in searches])
        for search, value, first in zip(searches, values, steps, strict=True):
            if not search.done:
                search.go(value)
                search.done |= search.step < LEAST_STEP * first
        if all(search.done for search in searches):
            break
    return [(search.best, search.least) for search in searches]


def _points(places: FloatArray, count: int) -> FloatArray:
    """All points (n, p) that have every coordinate among some places."""
    return np.array(list(itertools.product(places, repeat=count)))


def _neighbours(count: int) -> FloatArray:
    """All points (3^p, p) whose coordinates are -1, 0 or 1."""
    return _points(np.arange(-1.0, 2.0), count)


def _parabola(offsets: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Curvature (p, p), slope (p,) and value at the middle, of least squares through values at offsets (n, p)."""
    count = offsets.shape[1]
    pairs = list(itertools.combinations_with_replacement(range(count), 2))
    terms = [np.ones(len(offsets)), *offsets.T, *(offsets[:, i] * offsets[:, j] for i, j in pairs)]
    found = np.linalg.lstsq(np.column_stack(terms), values, rcond=None)[0]
    curved = np.zeros((count, count))
    for (i, j), value in zip(pairs, found[1 + count :], strict=True):
        curved[i, j] += value
        curved[j, i] += value
    return curved, found[1 : 1 + count], float(found[0])
