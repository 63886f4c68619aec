"""Step control that every driver of error-controlled steps follows: when a step is accepted, and what comes next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solver.contact_laws import SLOWEST_APPROACH

#: Outcome of a case; `RUNNING` before it has one.
OK, DIVERGING, STALLED, JAMMED, RUNNING = 0, 1, 2, 3, -1

#: A step aims at this part of the tolerance, and is the last one times a number between these two.
SAFETY, SHRINK, GROW = 0.9, 0.2, 4.0
#: A run begins with this part of its first step: what settles in the beginning would pass between the stages of a long
#: one without any sign in the error estimate.
CAUTION = 0.01
#: A step shorter than this part of the time of the case stalls.
SHORTEST = 1e-14
#: Part of the first step below which an error estimate is taken for noise, and how often in one case.
FLOOR = 1e-4
MOST_FORCED = 10_000
#: Largest scaled error of a step that is accepted as noise, or this many times the tolerance where that is more.
BEARABLE, BEARABLE_PART = 1e-5, 10.0
#: Refusals say noise where a step cut to this part has a larger error than before: an integrator's own falls with the
#: fifth power of the step, and that of a kink with the step, but rounding grows close to where closures lose rank.
NOISY_CUT = 0.1
#: Accepted steps between corrections of the closures.
PROJECT_EVERY = 32
#: A shortened step aims past the switch by this part of the precision, so that it ends on its other side.
PAST = 0.3


def crossing(p0: float, r0: float, p1: float, r1: float) -> float:
    """First part of a step at which the cubic through values and slopes (per step) at its ends becomes positive.

    Returns a number above 1 where it stays negative.
    """
    a = 2 * p0 - 2 * p1 + r0 + r1
    b = -3 * p0 + 3 * p1 - 2 * r0 - r1
    low, high = 0.0, 2.0
    for i in range(1, 9):
        x = i / 8
        if p0 + x * (r0 + x * (b + x * a)) > 0.0:
            low, high = (i - 1) / 8, x
            break
    if high > 1.0:
        return high
    for _ in range(30):
        middle = 0.5 * (low + high)
        if p0 + middle * (r0 + middle * (b + middle * a)) > 0.0:
            high = middle
        else:
            low = middle
    return high


def remember(w: NDArray[np.float64], memory: int, penetration: int, approach: int) -> None:
    """What one contact remembers (:mod:`solver.contact_laws`), brought up to date with an accepted state.

    Nothing where the surfaces are apart; the velocity of approach where they have just met.

    Parameters
    ----------
    w : array
        Work array.
    memory, penetration, approach : int
        Places of these numbers of one contact in one lane.
    """
    if w[penetration] <= 0.0:
        w[memory] = 0.0
    elif w[memory] == 0.0:
        w[memory] = max(abs(w[approach]), SLOWEST_APPROACH)
