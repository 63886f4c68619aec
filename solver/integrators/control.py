"""Step control: when an error-controlled step is accepted, and what comes next."""

from __future__ import annotations

import math

from jointplay.solver.arrays import FloatArray
from jointplay.solver.compiler.native import inlined
from jointplay.solver.equations.contact import SLOWEST_APPROACH

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
#: Part of a step within which a switch is located.
LOCATED = 1e-9
#: A shortened step aims past the switch by this part of the precision, so that it ends on its other side.
PAST = 0.3


@inlined
def arrival(t: float, step: float, end: float, interval: float) -> float:
    """Time at the end of a step from `t`: to the last digit `end`, or the last sample would need another step.

    `interval`, the time between samples, gives a size where all times are about zero; all in s.
    """
    now = t + step
    return end if abs(now - end) <= SHORTEST * (abs(end) + interval) else now


@inlined
def accepts(
    e: float, jammed: bool, step: float, first: float, tolerance: float, over: bool, forced: int
) -> tuple[bool, bool]:
    """Whether the error allows a step, and whether only because it is taken for noise.

    Where closures lose their rank for an instant the estimate is rounding noise that no step removes.

    Parameters
    ----------
    e : float
        Largest scaled error of the step, in parts of the tolerance; may be no number.
    jammed : bool
        Whether a joint jammed within the step.
    step, first : float
        The step, and the first one of the case, s.
    tolerance : float
    over : bool
        Whether the step is one again that shorter ones only made worse (:func:`refuse_step`).
    forced : int
        Steps of the case that were taken for noise before.
    """
    if e <= 1.0 and not jammed:  # false for a number that is none
        return True, False
    bearable = max(BEARABLE_PART, BEARABLE / tolerance)
    patient = e < math.inf and not jammed and forced < MOST_FORCED
    noise = patient and e <= bearable and (step <= FLOOR * first or over)
    return noise, noise


@inlined
def switch_part(
    pushing: bool, s0: float, s1: float, p0: float, p1: float, r0: float, r1: float, step: float
) -> float:  # fmt: skip
    """Part of a step at which a contact begins or ceases to push; 2 where it does not.

    Where a pin that was inside left and came in anew within the step, a part at which it is outside, or near that.

    Parameters
    ----------
    pushing : bool
        Whether it pushes over the step.
    s0, s1, p0, p1, r0, r1 : float
        Switch function and penetration, m, and the penetration's rate, m/s, at both ends of the step.
    step : float
        s.
    """
    # The cubic through penetrations and rates at both ends.
    d0, d1 = step * r0, step * r1
    a = 2 * p0 - 2 * p1 + d0 + d1
    b = -3 * p0 + 3 * p1 - 2 * d0 - d1
    lag0 = rise = 0.0
    low, high, sign = 0.0, 1.0, 1.0
    if pushing:
        if s1 >= 0.0:
            # Out on one side and in on the other: both ends, gone on with straight, are outside in between.
            return p0 / -d0 if d0 < 0.0 < d1 and p0 / -d0 + p1 / d1 < 1.0 else 2.0
        if s0 <= 0.0:
            return 0.0
        # Damping lets go before the penetration ends: p + lag p'. The lag of a linear contact is constant, that of
        # hysteresis goes with the penetration; outside there is none of it, and s is p.
        lag1 = (s1 - p1) / d1 if d1 != 0.0 else 0.0
        lag0 = (s0 - p0) / d0 if d0 < 0.0 else lag1
        if s1 == p1:
            rise = lag0 / p0
        elif p1 != p0:
            rise = (lag1 - lag0) / (p1 - p0)
        sign = -1.0
        if p0 + lag0 * d0 <= 0.0:
            return s0 / (s0 - s1)
    elif p0 >= 0.0:
        # Still inside after its force had gone. Pressed in again, unless it left and came in anew, on the other side
        # say: then the step is to end outside first, where what it remembers is forgotten.
        if s1 <= 0.0:
            return 2.0
        for i in range(1, 8):
            x = i / 8
            if p0 + x * (d0 + x * (b + x * a)) < 0.0:
                return x
        part = s0 / (s0 - s1) if s0 < 0.0 else 0.0
        # A small clearance crossed at speed shows in no cubic, and the straight line hardly shortens the step.
        return min(part, 0.5) if r0 < 0.0 < r1 else part
    else:
        # Also where both ends are open but the pair came near and went: it may have touched in between.
        if not (s1 > 0.0 or r0 > 0.0 > r1):
            return 2.0
        high = 2.0
        for i in range(1, 9):
            x = i / 8
            if p0 + x * (d0 + x * (b + x * a)) > 0.0:
                low, high = (i - 1) / 8, x
                break
        if high > 1.0:
            return high
    # Newton's method, kept between the ends: halving takes six times as long.
    x = 0.5 * (low + high)
    for _ in range(30):
        slope = d0 + x * (2 * b + 3 * a * x)
        p = p0 + x * (d0 + x * (b + x * a))
        lag = lag0 + rise * (p - p0)
        value = sign * (p + lag * slope)
        if value > 0.0:
            high = x
        else:
            low = x
        steep = sign * (slope * (1.0 + rise * slope) + lag * (2 * b + 6 * a * x))
        before, x = x, x - value / steep
        if not (low < x < high):  # also where that is no number
            x = 0.5 * (low + high)
        if abs(x - before) <= LOCATED:
            break
    return x


@inlined
def is_met(pushing: bool, s1: float, precision: float) -> bool:
    """Whether a step ends so little past a switch that it may stand; parameters as of :func:`shorten`."""
    return (s1 > 0.0) != pushing and abs(s1) <= precision


@inlined
def shorten(
    step: float, part: float, pushing: bool, s1: float, approach: float, precision: float, shortest: float
) -> float:
    """Step that ends a little past a switch; 0 where this one does, or comes as near as it can.

    Parameters
    ----------
    step, part : float
        The step, s, and the part of it at which the switch is expected.
    pushing : bool
        Whether the contact pushes over the step.
    s1, approach : float
        Switch function, m, and rate of penetration, m/s, at the end of the step.
    precision : float
        Penetration within which the switch must be met, m.
    shortest : float
        Step below which a case stalls, s.
    """
    if is_met(pushing, s1, precision) or step <= 1e3 * shortest or abs(part - 1.0) <= 1e-9:
        return 0.0
    speed = abs(approach) + 1e-12
    # Never nearly the same step again: a slow approach must not make it creep.
    past = min(PAST * precision / speed, 0.5 * (1.0 - part) * step)
    return max(part * step + past, 0.001 * step)


@inlined
def after_switch(
    natural: float, step: float, pressed: float, longest: float, pushes: bool
) -> tuple[float, float]:  # fmt: skip
    """What a switch leaves: the step to keep for the next contact, and the longest one that may follow, s.

    Parameters
    ----------
    natural, step : float
        Step that error control asked for before the switch, and the one that ended at it, s.
    pressed : float
        What was kept: the step at the end of the contact before, s.
    longest : float
        Longest step of the case, s.
    pushes : bool
        Whether the contact pushes from now on.
    """
    # The step of a free flight is far too long for a contact, and refused time and again.
    return (pressed, min(longest, pressed)) if pushes else (max(natural, step), longest)


@inlined
def refuse_step(
    step: float, e: float, jammed: bool, growth: float, tolerance: float, forced: int, smooth: bool, uncut: float,
    uncut_error: float,
) -> tuple[float, float, float, bool, bool]:  # fmt: skip
    """What follows a step that its error forbids.

    Parameters
    ----------
    step, e, jammed, tolerance, forced
        As in :func:`accepts`.
    growth : float
        Next step in parts of this one, as the error wants it.
    smooth : bool
        Whether there are closures that can lose their rank, and no contact pushes.
    uncut, uncut_error : float
        Kept from refusal to refusal: step at which they began, s (0 for none), and its error.

    Returns
    -------
    (float, float, float, bool, bool)
        Next step, s; the two numbers kept; whether it steps over noise; whether the closures are to be restored: near
        a loss of rank it is their drift that spoils the accelerations.
    """
    shorter = step * max(SHRINK, growth) if e < math.inf and not jammed else 0.1 * step
    if uncut == 0.0 or e * uncut * uncut < uncut_error * step * step:
        return shorter, step, e, False, smooth
    bearable = max(BEARABLE_PART, BEARABLE / tolerance)
    patient = e < math.inf and not jammed and forced < MOST_FORCED
    if smooth and patient and step <= NOISY_CUT * uncut and uncut_error < min(e, bearable):
        return uncut, 0.0, uncut_error, True, True  # step over what shorter steps make worse
    return shorter, uncut, uncut_error, False, True


@inlined
def before_row(t: float, h: float, row: float, shortest: float) -> tuple[float, float]:
    """Time and step of a trial that must not step over a row of a table, where accelerations jump.

    It ends just before the row, where all its stages still see what goes before; the next begins at the row.

    Parameters
    ----------
    t, h : float
        Time and step, s.
    row : float
        The next row after `t`, s.
    shortest : float
        What counts as no time, s.
    """
    if row - t <= 2.0 * shortest:
        return row, h
    left = row - shortest - t
    return t, left if 1.01 * h > left else h


@inlined
def next_step(
    step: float, first: float, growth: float, natural: float, longest: float, now: float, end: float
) -> float:  # fmt: skip
    """Step after an accepted one.

    Parameters
    ----------
    step, first
        As in :func:`accepts`.
    growth : float
        Next step in parts of this one, as the errors of this step and of the one before want it; not asked after a
        step short enough for its error to be noise.
    natural : float
        Step that error control asked for before a contact shortened it, s; 0 where none did.
    longest : float
        s.
    now, end : float
        Time reached, and time of the last sample, where a step must end; s.
    """
    grown = step * (GROW if step <= FLOOR * first else min(GROW, growth))
    wanted = min(max(grown, natural), longest)
    return end - now if now + 1.01 * wanted > end else wanted


@inlined
def remember(w: FloatArray, memory: int, penetration: int, approach: int, lane: int) -> None:
    """What one contact remembers (:mod:`jointplay.solver.equations.contact`), brought up to date with an accepted
    state.

    Nothing where the surfaces are apart; the velocity of approach where they have just met.

    Parameters
    ----------
    w : array
        Work array.
    memory, penetration, approach, lane : int
        Rows of these numbers of one contact, and the lane.
    """
    if w[penetration, lane] <= 0.0:
        w[memory, lane] = 0.0
    elif w[memory, lane] == 0.0:
        w[memory, lane] = max(abs(w[approach, lane]), SLOWEST_APPROACH)
