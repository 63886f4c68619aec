"""How a machine turns that no motion is prescribed to: whole revolutions of its driver, and whether they are steady.

A section of the motion is where the driver has turned by another whole revolution. The machine is in its limit cycle
when the speeds from section to section have come to rest: not because they hardly change, which those of a heavy
flywheel never do, but because what they will change yet, by the ratio of successive changes, is small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import FloatArray

#: The mean speed may change by this part of itself yet: at order 100 that is a tenth of an order.
STEADY = 1e-3
#: Where revolutions scatter, means are compared within this many standard errors, and known to this part at least.
_ERRORS, _KNOWN = 2.0, 5e-3
#: A mean speed that changed by less than this part from third to third has come to rest, whatever the ratio; one that
#: changed by more than this has not, whatever it promises.
_NOTHING, _MOVING = 1e-5, 1e-2
#: Where revolutions are to repeat, their mean speed may be off by this part: recordings know theirs no better. It is
#: the last thing to come to rest, and what it moves in the spectrum with it.
_KEPT = 1e-4
#: Least revolutions to judge by: three windows of three.
LEAST_REVOLUTIONS = 9
#: The frame comes back if it does within this part of its range: what its suspension's transient leaves is half of it.
COMES_BACK = 0.02
#: Most revolutions that one cycle may take.
_LONGEST_CYCLE = 4


@dataclass(frozen=True, eq=False)
class Turning:
    """How the driver turned in a history.

    Attributes
    ----------
    angle : (n,) array
        Of the driver at the samples since it was drawn, rad; of a sliding drive, and of a driver that rocks as it
        turns, that of its cycles, even within each of them.
    speed : float
        Mean over whole revolutions after the transient, rad/s; 0 without two of them.
    scatter : float
        Standard deviation of the mean speeds of revolutions, part of `speed`.
    revolutions : int
        That these are of.
    period : int
        Revolutions after which the frame comes back to where it was, moving as it did; 0 where it does not within
        four, or where there are too few to say.
    apart : float
        How far it then is from there, part of its range; after one revolution where it does not come back, infinite
        where there is nothing to say it by.
    reason : str
        Why this is no limit cycle; empty where it is.
    """

    angle: FloatArray
    speed: float
    scatter: float
    revolutions: int
    period: int
    apart: float
    reason: str

    @property
    def is_steady(self) -> bool:
        """Whether the machine is in its limit cycle."""
        return not self.reason

    def say(self, begun: float) -> str:
        """One line for the user; `begun` is the time at which the limit cycle was reached, s."""
        if self.reason:
            return f"no limit cycle: {self.reason}"
        rpm = f"{self.speed * 30 / math.pi:.6g} rpm"
        told = f"limit cycle from {begun:.3g} s on: {rpm}, revolutions scatter by {100 * self.scatter:.2g} %"
        if self.apart == math.inf:
            return told
        if self.period:
            every = "every revolution" if self.period == 1 else f"every {self.period} revolutions"
            return f"{told}, the frame comes back {every} within {100 * self.apart:.2g} % of its range"
        return f"{told}, the frame does not come back within {_LONGEST_CYCLE} revolutions: chaotic, or not yet"


def cycles(t: FloatArray, position: FloatArray, rotates: bool) -> tuple[FloatArray, FloatArray]:
    """Sections of a motion, and the driver's angle at every sample.

    Parameters
    ----------
    t : (n,) array
        s.
    position : (n,) array
        Of the driver: rad, or m of one that slides.
    rotates : bool

    Returns
    -------
    sections : (k,) array
        When the driver had turned by another whole revolution, or slid through the middle of its travel again, in the
        same direction; s, growing.
    angle : (n,) array
        rad; negative where it turns clockwise.
    """
    if not rotates:
        middle = 0.5 * (position.min() + position.max())
        first = np.flatnonzero((position[:-1] < middle) & (position[1:] >= middle))
        part = (middle - position[first]) / (position[first + 1] - position[first])
        sections = t[first] + part * (t[first + 1] - t[first])
        return sections, _even(t, sections)
    way = 1.0 if position[-1] >= position[0] else -1.0
    farthest = np.maximum.accumulate(way * position)
    turns = farthest / (2 * math.pi)
    whole = np.arange(math.floor(turns[0]) + 1, math.floor(turns[-1]) + 1)
    after = np.searchsorted(turns, whole)
    part = (whole - turns[after - 1]) / (turns[after] - turns[after - 1])
    sections = t[after - 1] + part * (t[after] - t[after - 1])
    if np.array_equal(farthest, way * position):
        return sections, position
    return sections, way * _even(t, sections)


def _even(t: FloatArray, sections: FloatArray) -> FloatArray:
    """Angle that grows evenly from section to section, and beyond the outer ones as next to them."""
    if len(sections) < 2:
        return np.zeros_like(t)
    turns = np.interp(t, sections, np.arange(len(sections), dtype=np.float64))
    for outside, at, rate in (
        (t < sections[0], sections[0], 1 / (sections[1] - sections[0])),
        (t > sections[-1], sections[-1], 1 / (sections[-1] - sections[-2])),
    ):
        turns[outside] += (t[outside] - at) * rate
    return np.asarray(2 * math.pi * turns)


def even_angle(t: FloatArray, angle: FloatArray) -> FloatArray:
    """The angle (n,) of a driver, even within each of its revolutions: as a mark that passes once in each tells it.

    Recordings know no more of how a machine turns within a revolution, so it is what compares with them.

    Parameters
    ----------
    t : (n,) array
        s.
    angle : (n,) array
        rad, two whole turns at least.
    """
    sections, _ = cycles(t, angle, rotates=True)
    turned = _even(t, sections)
    first = 2 * math.pi * round(float(np.interp(sections[0], t, angle)) / (2 * math.pi))
    return np.asarray(first + (turned if angle[-1] >= angle[0] else -turned))


def why_unsteady(sections: FloatArray) -> str:
    """Why revolutions are no limit cycle; empty where they are.

    Parameters
    ----------
    sections : (k,) array
        Ends of revolutions, s.

    Notes
    -----
    Of three successive thirds the mean speeds differ by d1 and d2. What decays by the ratio d2 / d1 from third to third
    will change by d2 r / (1 - r) yet (Aitken's process). Where revolutions scatter, both differences may be noise: then
    they say nothing but that the means are known no better; so do small ones of opposite signs.
    """
    speeds = 2 * math.pi / np.diff(sections)
    if len(speeds) < LEAST_REVOLUTIONS:
        return f"{len(speeds)} whole revolutions, too few to judge by: {LEAST_REVOLUTIONS} are the least"
    count = len(speeds) // 3
    thirds = speeds[-3 * count :].reshape(3, count)
    means = thirds.mean(axis=1)
    (first, second), last = np.diff(means), means[2]
    at = np.arange(count) - 0.5 * (count - 1)
    slopes = thirds @ at / max(float(at @ at), 1.0)
    rest = thirds - thirds.mean(axis=1, keepdims=True) - slopes[:, None] * at
    # Mean and slope of each third are taken out of its revolutions: two of them less to tell the scatter by.
    error = _ERRORS * float(np.sqrt(np.sum(rest**2) / (3 * (count - 2)))) / math.sqrt(count)
    yet = _yet(first, second, last)
    comes_to_rest = yet <= STEADY * last and abs(second) <= _MOVING * last
    if comes_to_rest or max(abs(first), abs(second)) <= error <= _KNOWN * last:
        return ""
    now = f"the mean speed is {last * 30 / math.pi:.4g} rpm"
    if yet == math.inf:
        return f"{now} and changes by {100 * abs(second) / last:.2g} % in {count} revolutions, no less than before"
    return f"{now} and will change by {100 * yet / last:.2g} % or more yet"


def _yet(first: float, second: float, last: float) -> float:
    """What a mean speed will change yet, by two successive changes of it up to the last; infinite where they tell not.

    It is 0 where they are next to nothing.
    """
    change = max(abs(first), abs(second))
    swings = first * second < 0 and change <= STEADY * last  # what runs up or down does not come back
    if swings or change <= _NOTHING * last:
        return 0.0
    ratio = abs(second) / abs(first) if first else math.inf
    return abs(second) * ratio / (1 - ratio) if ratio < 1 else math.inf


def keeps_speed(sections: FloatArray, period: int) -> bool:
    """Whether the mean speed of the last two periods is the one that stays.

    Parameters
    ----------
    sections : (k,) array
        Ends of revolutions, in any unit of time.
    period : int
        Revolutions of a period; `k` is greater than this by three at least, and than twice this.
    """
    before, then, now = (float(speed) for speed in period / (sections[period:] - sections[:-period])[-3:])
    mean = 2 * period / float(sections[-1] - sections[-1 - 2 * period])
    yet = _yet(then - before, now - then, now) + abs(now - mean)
    return yet <= _KEPT * now and abs(now - then) <= _MOVING * now


def turning_of(
    t: FloatArray, position: FloatArray, rotates: bool, frame: FloatArray, transient: float, reason: str | None = None
) -> Turning:
    """How a recorded machine turned.

    Parameters
    ----------
    t : (n,) array
        s.
    position : (n,) array
        As for :func:`cycles`.
    rotates : bool
    frame : (n, m) array
        What must come back, each quantity with its range: displacements and velocities of the frame.
    transient : float
        Samples before are not judged, s.
    reason : str, optional
        Why it is no limit cycle, or "", where that is known; else it is judged by these revolutions.
    """
    if len(t) < 2:
        return Turning(np.zeros(len(t)), 0.0, 0.0, 0, 0, math.inf, reason or "no samples")
    sections, angle = cycles(t, position, rotates)
    sections = sections[sections >= transient]
    if reason is None:
        reason = why_unsteady(sections)
    if len(sections) < 3:
        reason = reason or f"{max(0, len(sections) - 1)} whole revolutions after the transient"
        return Turning(angle, 0.0, 0.0, max(0, len(sections) - 1), 0, math.inf, reason)
    count = len(sections) - 1
    way = 1.0 if angle[-1] >= angle[0] else -1.0
    speed = way * 2 * math.pi * count / (sections[-1] - sections[0])
    speeds = 2 * math.pi / np.diff(sections)
    period, apart = _period(t, frame[:, np.ptp(frame, axis=0) > 0], sections)
    return Turning(angle, speed, float(np.std(speeds, ddof=1) / abs(speed)), count, period, apart, reason)


def _period(t: FloatArray, frame: FloatArray, sections: FloatArray) -> tuple[int, float]:
    """After how many revolutions a motion comes back (0 if it does not), and how near; infinite where none is known."""
    steady = frame[t >= sections[0]]
    if not steady.size or len(sections) < 3:
        return 0, math.inf
    ranges = np.ptp(steady, axis=0)
    states = np.array([np.interp(sections, t, column) for column in frame.T]).T / np.where(ranges > 0, ranges, 1.0)
    found = [
        float(np.sqrt(np.mean((states[after:] - states[:-after]) ** 2, axis=0)).max())
        for after in range(1, min(_LONGEST_CYCLE, len(states) - 2) + 1)
    ]
    period = next((after for after, apart in enumerate(found, start=1) if apart <= COMES_BACK), 0)
    return period, found[period - 1] if period else found[0]
