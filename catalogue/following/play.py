"""The play of every joint over time: a clearance that never falls by itself, and the rate at which it grows.

Beliefs are numbers on a grid: of each joint one for every rate and clearance. Joints wear each by itself; what a
recording says of several at once is kept as far as it concerns each one (assumed density filtering).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.signal import lfilter
from scipy.sparse import csr_array
from scipy.special import ndtr

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.plans.cases import BEYOND_FIT
from jointplay.catalogue.plans.plan_parts import ClearanceRange
from jointplay.solver.arrays import BoolArray, FloatArray
from jointplay.solver.machines.machine import Machine

LEAST, MOST, STEP = 1e-6, 6e-3, 0.04
"""Clearances of the grid, m, and its step in their logarithm."""

SLOWEST, FASTEST, FACTOR = 1e-15, 1e-7, 2.5
"""Rates of growth, m/s, from 30 nm a year to 0.4 mm an hour, and the factor between two; and none."""

USUAL, SCATTER = 3.2e-12, 2.0
"""Median rate of a joint that wears, m/s (100 um a year), and the standard deviation of its logarithm."""

RESTING, ANY = 0.5, 0.05
"""Share of joints that do not wear for now; and of rates of which nothing is known, as on a test rig."""

YEAR = 365.25 * 86400.0

MONTH = YEAR / 12.0
"""The longest step of time, s."""

CHANGES = 1.0 / YEAR
"""How often a joint begins to wear at another rate, 1/s."""

JUMPS, JUMP = 1.0 / YEAR, 0.5
"""How often a joint suddenly has more play, 1/s, and how much larger ln(clearance) then is in the mean: surfaces break
out, bushes come loose."""

REPAIRS = 0.2 / YEAR
"""How often a joint is made as new without a word, 1/s."""

NEVER = 100.0 * YEAR
"""Time, s, beyond which nothing is foretold."""

ANY_PLAY = 0.4
"""Share of joints of which nothing is known that may have any play, rather than that of their fit: with usual fits a
quarter of all are worn."""


def _rates() -> FloatArray:
    count = round(math.log(FASTEST / SLOWEST) / math.log(FACTOR)) + 1
    return np.concatenate([[0.0], SLOWEST * FACTOR ** np.arange(count)])


def _likely_rates(rates: FloatArray) -> FloatArray:
    usual = np.exp(-0.5 * (np.log(rates[1:] / USUAL) / SCATTER) ** 2)
    moving = (1.0 - ANY) * usual / usual.sum() + ANY / len(usual)
    return np.concatenate([[RESTING], (1.0 - RESTING) * moving])


AXIS: FloatArray = np.arange(math.log(LEAST), math.log(MOST), STEP)
"""ln(clearance), (X,)."""

RATES: FloatArray = _rates()
"""m/s, (S,)."""

LIKELY_RATES: FloatArray = _likely_rates(RATES)
"""Probability of each beforehand, (S,)."""


_NEXT = math.exp(-STEP / JUMP)
"""Part of the jumps that go on from a clearance to the next."""

_MOMENTS: FloatArray = np.concatenate(
    [[0.0], np.geomspace(3600.0, MONTH, 20)[:-1], MONTH * np.arange(1, 10), np.geomspace(10 * MONTH, NEVER, 52)]
)
"""Times, s, at which it is looked at what joints have become: a month apart at the most, from ten on a tenth."""

_MOMENTS_APART: list[float] = np.diff(_MOMENTS).tolist()


@dataclass(frozen=True)
class JointBounds:
    """What a joint's clearance means, m.

    Parameters
    ----------
    fit : (float, float)
        Play as new.
    worn_from : float
        Least clearance that counts as wear.
    limit : float
        From which on it is worn out.
    """

    fit: tuple[float, float]
    worn_from: float
    limit: float

    @property
    def worn(self) -> BoolArray:
        """Which clearances of the grid (X,) are wear."""
        return np.asarray(math.log(self.worn_from) <= AXIS)

    def as_new(self) -> FloatArray:
        """Probability (S, X) of a joint as new: any play of its fit, at rates not yet known."""
        low, high = np.log(self.fit)
        play = ((AXIS > low - 0.5 * STEP) & (AXIS < high + 0.5 * STEP)).astype(np.float64)
        return np.asarray(LIKELY_RATES[:, None] * (play / play.sum()))

    def at_first(self) -> FloatArray:
        """Probability (S, X) of a joint of which nothing is known."""
        anywhere = LIKELY_RATES[:, None] / len(AXIS)
        return np.asarray((1.0 - ANY_PLAY) * self.as_new() + ANY_PLAY * anywhere)


def bounds_of(machine: Machine, joints: Iterable[str]) -> dict[str, JointBounds]:
    """Return what clearances of joints of a machine mean, as its file says and plans have it that say nothing else.

    Raises
    ------
    DiagnosisError
        A joint is not the machine's, or its fit is beyond what is followed.
    """
    found = {}
    for name in joints:
        if name not in machine.joints:
            raise DiagnosisError(f"joint {name}: must be one of those of the machine, {', '.join(machine.joints)}")
        joint = machine.joints[name]
        low, high = joint.play_as_new
        worn_from = max(ClearanceRange().low, BEYOND_FIT * high)
        if not (low >= LEAST and worn_from < MOST / 2):
            rule = f"must be from {1e6 * LEAST:g} um to {1e3 * MOST / 2 / BEYOND_FIT:g} mm to be followed"
            raise DiagnosisError(f"joint {name}: fit {1e6 * low:g} to {1e6 * high:g} um: {rule}")
        found[name] = JointBounds((low, high), worn_from, joint.worn_out_from)
    return found


def let_pass(belief: FloatArray, seconds: float, mended: FloatArray | None = None) -> FloatArray:
    """Return what is believed of joints (..., S, X) some time later.

    Each grows at its rate; some begin to grow at another one, some jump, and some are made as new. What would grow
    beyond the grid stays at its end. In steps of a month at most, so that what changes goes on from when it did, and
    two times one after the other are as the whole.

    Parameters
    ----------
    belief : ndarray, shape (..., S, X)
    seconds : float
    mended : ndarray, shape (..., S, X), optional
        Joints as new, of which there are more with time. Nobody mends any unless given.
    """
    if seconds <= 0.0:
        return belief
    steps = math.ceil(seconds / MONTH)
    each = seconds / steps
    move, share = _movement(each), -math.expm1(-REPAIRS * each)
    for _ in range(steps):
        belief = _step(belief, each, move)
        if mended is not None:
            belief = (1.0 - share) * belief + share * mended
    return belief


def _step(belief: FloatArray, seconds: float, move: csr_array) -> FloatArray:
    """Let so many seconds pass for joints (..., S, X) at once: rates change, joints jump, then they wear.

    The latter by what :func:`_movement` says of this time.
    """
    change = -math.expm1(-CHANGES * seconds)
    mixed = (1.0 - change) * belief + change * LIKELY_RATES[:, None] * belief.sum(axis=-2, keepdims=True)
    # In so many parts that there are few jumps in one; after it a joint may wear at any rate.
    parts = max(1, math.ceil(2.0 * JUMPS * seconds))
    jumping = -math.expm1(-JUMPS * seconds / parts)
    for _ in range(parts):
        before = jumping * mixed.sum(axis=-2, keepdims=True)
        after = lfilter([1.0 - _NEXT], [1.0, -_NEXT], before, axis=-1)
        after[..., -1] += before.sum(axis=-1) - after.sum(axis=-1)
        mixed = (1.0 - jumping) * mixed + LIKELY_RATES[:, None] * after
    return np.ascontiguousarray(mixed.reshape(-1, move.shape[0]) @ move).reshape(mixed.shape)


def _movement(seconds: float) -> csr_array:
    """Where joints of every rate and clearance are after so many seconds, at the same rate, shape (S X, S X)."""
    size, places = len(AXIS), np.arange(len(AXIS))
    reached = np.log(np.exp(AXIS) + RATES[:, None] * seconds)
    place = np.clip((reached - AXIS[0]) / STEP, places, size - 1.0)  # never back by a rounding
    cell = np.minimum(place.astype(np.int64), size - 2)
    part = place - cell
    # The two next to where it is then.
    there = cell + size * np.arange(len(RATES))[:, None]
    share, column = np.stack([1.0 - part, part], axis=-1), np.stack([there, there + 1], axis=-1)
    rows = np.arange(0, share.size + 1, 2, dtype=np.int32)
    return csr_array((share.ravel(), column.ravel().astype(np.int32), rows), shape=(there.size, there.size))


@cache
def _movements_ahead() -> tuple[csr_array, ...]:
    """Those between the moments at which is looked ahead, 0.13 MB each."""
    return tuple(map(_movement, _MOMENTS_APART))


def quantiles(marginal: FloatArray, shares: FloatArray, blur: float = 0.0) -> FloatArray:
    """Return the clearances (m,), in m, below which lie shares (m,) of a probability (X,) on the grid.

    Parameters
    ----------
    blur : float
        Standard deviation of ln(clearance) of what every recording has wrong alike, which more of them do not cure.
    """
    if blur > 0.0:
        reach = np.arange(-math.ceil(3.0 * blur / STEP), math.ceil(3.0 * blur / STEP) + 1) * STEP
        kernel = np.exp(-0.5 * (reach / blur) ** 2)
        marginal = np.convolve(marginal, kernel / kernel.sum(), mode="same")
    below = np.concatenate([[0.0], np.cumsum(marginal)])
    edges = np.concatenate([AXIS - 0.5 * STEP, [AXIS[-1] + 0.5 * STEP]])
    found: FloatArray = np.exp(np.interp(shares * below[-1], below, edges))
    return found


def reach(belief: FloatArray, limits: FloatArray, alike: float, shares: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the probabilities (J,) that joints (J, S, X) have reached their limits (J,), m, and when they will have.

    The latter with probabilities (m,): times (J, m), s, infinite beyond a century. Joints go on as they do, and some
    begin to grow at another rate; nobody mends them.

    Parameters
    ----------
    alike : float
        Standard deviation of ln(clearance) of what every recording has wrong alike.
    """
    over = ndtr((AXIS - np.log(limits)[:, None]) / alike)
    reached = [np.sum(belief.sum(axis=-2) * over, axis=-1)]
    for seconds, move in zip(_MOMENTS_APART, _movements_ahead(), strict=True):
        belief = _step(belief, seconds, move)
        reached.append(np.sum(belief.sum(axis=-2) * over, axis=-1))
    course = np.maximum.accumulate(np.array(reached))  # never back by a rounding
    times = [np.interp(shares, each, _MOMENTS, right=math.inf) for each in course.T]
    return np.minimum(course[0], 1.0), np.array(times)
