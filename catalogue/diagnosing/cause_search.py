"""Several searches for a least value side by side, so that every step of all of them is one call."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import FloatArray

#: First step, as a part of the largest number of the start.
FIRST_STEP = 0.1
#: Points each way of the first look, which finds the deepest of several valleys: in steps, by count of numbers.
FIRST_LOOK = {1: np.arange(-8.0, 10.5, 0.5), 2: 2.0 * np.arange(-2.0, 3.0)}
#: A search ends where the step is this part of the first, or a parabola promises this much or less;
LEAST_STEP = 0.01
LEAST_GAIN = 0.02
#: it moves by so many steps at once, at most,
FARTHEST = 3.0
#: and takes no more than so many.
MOST_STEPS = 20


@dataclass(eq=False)
class _Search:
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
            self.done = abs(self.least - own - 0.5 * float(slope @ off)) < LEAST_GAIN
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
    searches = [_Search(middle, step, middle) for middle, step in zip(lowest, steps, strict=True)]
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
