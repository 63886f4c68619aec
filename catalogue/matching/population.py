"""The sampling of an analysis by synthesis: cases drawn where the best ones lie, and weights for that they were.

The sample was not drawn where its weights lie: how far they can be believed, and tempered until so.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from scipy.stats import genpareto

from jointplay.catalogue.plans.driving import DRIVE_SPEED
from jointplay.catalogue.plans.entry import Entry
from jointplay.solver.arrays import BoolArray, FloatArray

CaseKind = tuple[object, ...]

INFLATION = 1.2
"""Factor on the spread of the best cases: they are few, and the best one may lie beyond them."""

LEAST_SPREAD = 0.05
"""Least spread of new cases, as a part of that of the catalogue's draws."""


@dataclass(frozen=True, eq=False)
class _Space:
    """Coordinates of cases that differ in numbers only: logarithms of what is always positive, else the numbers.

    `share` of a hypothesis' cases are of this kind.
    """

    names: tuple[str, ...]
    logarithmic: BoolArray
    low: FloatArray
    high: FloatArray
    spread: FloatArray
    share: float

    @classmethod
    def of(cls, entries: Sequence[Entry], share: float) -> _Space:
        names = tuple(name for name in sorted(entries[0].parameters) if name != DRIVE_SPEED)
        values = _values(entries, names)
        logarithmic: BoolArray = np.asarray((values > 0.0).all(axis=0), dtype=np.bool_)
        points = np.where(logarithmic, np.log(np.where(logarithmic, values, 1.0)), values)
        return cls(names, logarithmic, points.min(axis=0), points.max(axis=0), points.std(axis=0), share)

    def points(self, entries: Sequence[Entry]) -> FloatArray:
        values = _values(entries, self.names)
        found: FloatArray = np.where(self.logarithmic, np.log(np.where(self.logarithmic, values, 1.0)), values)
        return found

    def case(self, point: FloatArray, joints: int) -> tuple[tuple[float, ...], dict[str, float]]:
        values = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, point, 0.0)), point).tolist()
        return tuple(values[:joints]), dict(zip(self.names, values[joints:], strict=True))


def _values(entries: Sequence[Entry], names: Sequence[str]) -> FloatArray:
    return np.array([[*entry.clearances, *(entry.parameters[name] for name in names)] for entry in entries])


@dataclass(frozen=True)
class Population:
    """Cases of one hypothesis, and where new ones are drawn.

    Parameters
    ----------
    spaces : mapping
        Coordinates by kind of case: contact law, joints with clearance, and what is drawn.
    start : tuple of Entry
        Cases of the first generation.
    """

    spaces: Mapping[CaseKind, _Space]
    start: tuple[Entry, ...]

    @classmethod
    def of(cls, entries: Sequence[Entry], start: Sequence[Entry]) -> Population:
        """Make it of a catalogue's entries of a hypothesis, beginning with some of them."""
        kinds: dict[CaseKind, list[Entry]] = defaultdict(list)
        for entry in entries:
            kinds[_kind(entry)].append(entry)
        spaces = {kind: _Space.of(each, len(each) / len(entries)) for kind, each in kinds.items()}
        return cls(spaces, tuple(start))

    def draw(
        self, elite: Sequence[Entry], size: int, generator: np.random.Generator
    ) -> Iterator[tuple[Entry, tuple[float, ...], dict[str, float], float]]:
        """Yield new cases: a case of their kind, clearances (m), numbers by path, and an importance.

        The importance is the logarithm of how much denser the catalogue's own draws lie there than the new ones, as if
        they were spread evenly; 0 for the first generation, which is of the catalogue's own.

        Parameters
        ----------
        elite : sequence of Entry
            The best cases so far; none for the first generation.
        size : int
            How many.
        generator : Generator

        Notes
        -----
        Each kind of case gets as many as it has among the best. They are normal around the mean of the best, with
        their covariance (Rubinstein and Kroese, The Cross-Entropy Method, 2004), inflated, and a least spread in every
        direction; what falls outside of the catalogue's draws is put on their edge.
        """
        if not elite:
            for entry in self.start[:size]:
                yield entry, entry.clearances, dict(entry.parameters), 0.0
            return
        kinds: dict[CaseKind, list[Entry]] = defaultdict(list)
        for entry in elite:
            kinds[_kind(entry)].append(entry)
        shares = np.cumsum([len(each) for each in kinds.values()]) * size / len(elite)
        counts = np.diff(np.rint(np.r_[0.0, shares]).astype(np.int64)).tolist()
        for (kind, parents), count in zip(kinds.items(), counts, strict=True):
            space = self.spaces[kind]
            points = space.points(parents)
            middle, varies = points.mean(axis=0), space.spread > 0.0
            away = (points - middle)[:, varies] / np.sqrt(max(1, len(parents) - 1))
            covariance = INFLATION**2 * away.T @ away + np.diag((LEAST_SPREAD * space.spread[varies]) ** 2)
            factor = np.linalg.cholesky(covariance)
            # Of the density of the new draws and the even one of the catalogue's, a share of which is of this kind.
            size_of = float(np.sum(np.log(np.diag(factor))) - np.sum(np.log((space.high - space.low)[varies])))
            constant = size_of + 0.5 * int(varies.sum()) * math.log(2.0 * math.pi)
            constant += math.log(space.share * len(elite) / len(parents))
            for normal in generator.normal(size=(count, int(varies.sum()))):
                point = middle.copy()
                point[varies] += factor @ normal
                clearances, parameters = space.case(np.clip(point, space.low, space.high), len(parents[0].joints))
                yield parents[0], clearances, parameters, constant + 0.5 * float(normal @ normal)


def _kind(entry: Entry) -> CaseKind:
    return entry.variant, entry.stratum, entry.joints, tuple(sorted(entry.parameters))


LEAST_EFFECTIVE = 8.0
"""Least effective size of a sample, or half of it where it is smaller."""

TEMPERATURES = tuple(np.geomspace(1.0, 200.0, 24).tolist())


@dataclass(frozen=True, eq=False)
class Weighed:
    """A sample and its weights.

    Parameters
    ----------
    weights : ndarray, shape (n,)
        They add up to 1.
    log_mean : float
        Logarithm of the mean of the weights before that.
    effective : float
        Effective size of the sample.
    """

    weights: FloatArray
    log_mean: float
    effective: float

    @property
    def k(self) -> float:
        """Pareto shape of the largest weights: above 0.7 they are not to be believed.

        It is told, and not tempered away: of a dozen weights it is known to 0.3 at best (A. Vehtari et al., J. Mach.
        Learn. Res. 25 (2024) 72).
        """
        return pareto_k(self.weights)

    @property
    def error(self) -> float:
        """Standard error of `log_mean`, to first order."""
        return float(np.sqrt(max(0.0, 1.0 / self.effective - 1.0 / len(self.weights))))


def effective_size(weights: FloatArray) -> float:
    """Return the effective size of weights (n,), (sum w)^2 / sum w^2."""
    return float(weights.sum() ** 2 / np.square(weights).sum())


def pareto_k(weights: FloatArray) -> float:
    """Return the shape of the generalised Pareto law of the largest weights (n,); -1 where they are all the same."""
    count = max(5, min(len(weights) // 5, int(3 * np.sqrt(len(weights)))))
    if len(weights) <= count:
        return 0.0
    top = np.sort(weights)[-count - 1 :] / weights.max()
    excess = top[1:] - top[0]
    if excess[-1] < 1e-12:
        return -1.0
    return float(genpareto.fit(excess, floc=0.0)[0])


def weigh(samples: list[FloatArray]) -> tuple[list[Weighed], float]:
    """Weigh samples by tempered weights: the least temperature that all of them bear.

    Parameters
    ----------
    samples : list of ndarray, each (n,)
        Logarithms of weights: likelihood times importance.

    Returns
    -------
    weighed : list of Weighed
    temperature : float
        What logarithms were divided by, >= 1.

    Notes
    -----
    Transformed weights of a population Monte Carlo: E. Koblents, J. Miguez, Stat. Comput. 25 (2015) 407. A sample of
    some dozens in as many dimensions has next to all of its weight in one case; tempered it is as sure as it may be.
    """
    found: list[Weighed] = []
    temperature = TEMPERATURES[-1]
    for temperature in TEMPERATURES:
        found = [_weigh(each / temperature) for each in samples]
        least = [min(LEAST_EFFECTIVE, 0.5 * len(each)) for each in samples]
        if all(w.effective >= enough for w, enough in zip(found, least, strict=True)):
            break
    return found, temperature


def _weigh(log_weights: FloatArray) -> Weighed:
    total = float(logsumexp(log_weights))
    weights = np.exp(log_weights - total)
    return Weighed(weights, total - float(np.log(len(weights))), effective_size(weights))
