"""Error-controlled integration of one case, for compilers of Python: what :mod:`solver.adaptive` does to a lane.

The functions are bound to a kernel in scalar Python (:mod:`solver.scalar`) by whatever compiles both: Numba for a CUDA
device, or nothing at all. What is kept between two trial steps is in two arrays, so that a run can be left after any
trial step and taken up again.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from solver.control import (
    DIVERGING,
    FLOOR,
    GROW,
    JAMMED,
    MOST_FORCED,
    OK,
    PAST,
    PROJECT_EVERY,
    RUNNING,
    SAFETY,
    SHORTEST,
    SHRINK,
    STALLED,
    crossing,
)
from solver.dopri import DENSE_ROWS, StepRows
from solver.gill import DIVERGED, LOST, PATIENCE
from solver.kernel import KernelCode
from solver.scalar import Compile, Function, kernel_functions

#: Places in the state of a case: how it ended, time, trial step, that step before a switch shortened it, samples, trial
#: and accepted steps, accepted steps since closures were restored, forced steps, corrections of closures not believed
#: one after the other, samples when closures last held; then switch, penetration and approach of every contact.
OUTCOME, NOW, STEP, NATURAL, SAMPLE, TRIALS, ACCEPTED, SINCE, FORCED, UNBELIEVED, HELD_AT, BEFORE = range(12)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def state_length(contacts: int) -> int:
    """Numbers in the state of a case."""
    return BEFORE + 3 * contacts


def case_functions(code: KernelCode, rows: StepRows, compiled: Compile) -> tuple[Function, Function]:
    """What integrates one case: ``begin`` and ``advance``.

    Parameters
    ----------
    code : KernelCode
        In the scalar dialect.
    rows : StepRows
        Of its work array.
    compiled : callable
        The compiler.

    Returns
    -------
    begin : callable
        ``begin(w, s, first)``: from a work array `w` with parameters, coordinates and velocities to a state `s` ready
        for a first trial step, s.
    advance : callable
        ``advance(w, s, count, first, longest, end, most, interval, tolerance, precision, oversampling, recorded,
        coordinates, velocities, accelerations)``: at most `count` trial steps, until ``s[OUTCOME]`` is no longer
        ``RUNNING``. The other arguments are those of :func:`solver.adaptive.integrate`, of one case.
    """
    functions = kernel_functions(code, compiled)
    prepare, held, dopri, project = (functions[name] for name in ("prepare", "held", "dopri", "project"))
    constrained, jam, rubs = code.constrained, code.jam, code.jam >= 0
    layout = rows.layout
    n, contacts, channels = layout.size, rows.contacts, len(rows.recorded)
    time_at, step_at, z_at, v_at, a_at, kept = layout.time, layout.step, layout.z, layout.v, layout.a, layout.scratch
    touching, switch, penetration, approach = rows.touching, rows.switch, rows.penetration, rows.approach
    error_at, slopes, last, dense = rows.error, rows.slopes, rows.last_slopes, rows.dense
    first_crossing = compiled(crossing)

    @compiled
    def remember(w: Array, s: Array, source: int) -> None:
        """Make the end of a step the start of the next; its accelerations stand at `source`."""
        for i in range(n):
            w[slopes + i] = w[source + i]
        for j in range(contacts):
            s[BEFORE + j] = w[switch + j]
            s[BEFORE + contacts + j] = w[penetration + j]
            s[BEFORE + 2 * contacts + j] = w[approach + j]

    @compiled
    def settle(w: Array, s: Array) -> None:
        """Evaluate the start of the next step anew, after a switch or a correction."""
        w[time_at] = s[NOW]
        held(w)
        remember(w, s, a_at)

    @compiled
    def begin(w: Array, s: Array, first: float) -> None:
        for k in range(BEFORE):
            s[k] = 0.0
        s[OUTCOME], s[STEP] = RUNNING, first
        for j in range(contacts):
            w[touching + j] = 0.0
        prepare(w)
        w[time_at] = 0.0
        held(w)
        # Whether a contact pushes at the start follows from the switch, which does not depend on the assumption.
        for j in range(contacts):
            w[touching + j] = 1.0 if w[switch + j] > 0.0 else 0.0
        settle(w, s)

    @compiled
    def switched(w: Array, s: Array, step: float) -> tuple[int, float]:
        """The contact that switches first within an acceptable step (-1: none), and at which part of it."""
        event, part = -1, 1.0
        for j in range(contacts):
            s0, s1 = s[BEFORE + j], w[switch + j]
            p0, p1 = s[BEFORE + contacts + j], w[penetration + j]
            r0, r1 = s[BEFORE + 2 * contacts + j], w[approach + j]
            where = 2.0
            if w[touching + j] > 0.5:
                if s1 < 0.0:
                    where = s0 / (s0 - s1) if s0 > 0.0 else 0.5
            elif s1 > 0.0 or r0 > 0.0 > r1:
                # Also where both ends are open but the pair came near and went: it may have touched in between.
                if p0 < 0.0:
                    where = first_crossing(p0, step * r0, p1, step * r1)
                elif s1 > 0.0:  # still inside after its force had gone: pressed in again
                    where = s0 / (s0 - s1) if s0 < 0.0 else 0.5
            if where <= 1.0 and (event < 0 or where < part):
                event, part = j, where
        return event, part

    @compiled
    def shortened(w: Array, s: Array, event: int, part: float, step: float, interval: float, precision: float) -> float:
        """Step that ends a little past the switch; 0 where this one does."""
        s1 = w[switch + event]
        flipped = (s1 > 0.0) != (w[touching + event] > 0.5)
        if flipped and abs(s1) <= precision:
            return 0.0
        if step <= 1e3 * SHORTEST * (s[NOW] + interval) or abs(part - 1.0) <= 1e-9:
            return 0.0
        speed = abs(w[approach + event]) + 1e-12
        shorter: float = min(0.999 * step, part * step + PAST * precision / speed)
        return max(0.001 * step, shorter)

    @compiled
    def landed(now: float, end: int, interval: float) -> float:
        """Time of the last sample where it is that but for rounding, or that sample would need another step."""
        last = (end - 1) * interval
        return last if abs(now - last) <= SHORTEST * (last + interval) else now

    @compiled
    def record(
        w: Array,
        s: Array,
        step: float,
        end: int,
        interval: float,
        oversampling: int,
        recorded: Indices,
        coordinates: Array,
        velocities: Array,
        accelerations: Array,
    ) -> None:
        """Samples within an accepted step, by its dense output."""
        sample, now = int(s[SAMPLE]), landed(s[NOW] + step, end, interval)
        while sample < end and sample * interval <= now:
            x = (sample * interval - s[NOW]) / step
            y = 1.0 - x
            for r in range(channels):
                base = dense + DENSE_ROWS * (channels + r)
                c2, c3, c4, c5 = w[base], w[base + 1], w[base + 2], w[base + 3]
                start = w[kept + n + recorded[r]]
                velocities[r, sample] = start + x * (c2 + y * (c3 + x * (c4 + y * c5)))
                if sample % oversampling == 0:
                    inner = c4 + y * c5
                    middle = c3 + x * inner
                    slope = c2 + y * middle - x * middle + x * y * (inner - x * c5)
                    accelerations[r, sample // oversampling] = slope / step
                    base = dense + DENSE_ROWS * r
                    c2, c3, c4, c5 = w[base], w[base + 1], w[base + 2], w[base + 3]
                    start = w[kept + recorded[r]]
                    coordinates[r, sample // oversampling] = start + x * (c2 + y * (c3 + x * (c4 + y * c5)))
            sample += 1
        s[SAMPLE] = sample

    @compiled
    def restore(w: Array, s: Array) -> None:
        """Correct the closures, unless the correction cannot be believed."""
        for i in range(2 * n):
            w[kept + i] = w[z_at + i]
        w[time_at] = s[NOW]
        project(w)
        moved = 0.0
        for i in range(n):
            moved += abs(w[z_at + i] - w[kept + i])
        s[SINCE] = 0.0
        if moved < LOST:
            s[UNBELIEVED], s[HELD_AT] = 0.0, s[SAMPLE]
        else:  # also a correction that is no number
            s[UNBELIEVED] += 1.0
            for i in range(2 * n):
                w[z_at + i] = w[kept + i]
        settle(w, s)

    @compiled
    def accept(
        w: Array, s: Array, step: float, e: float, event: int, first: float, longest: float, end: int, interval: float
    ) -> None:
        """Go on from the end of a step whose samples are recorded."""
        s[NOW] = landed(s[NOW] + step, end, interval)
        if s[SAMPLE] >= end:
            s[OUTCOME] = OK
            return
        grown = step * min(GROW, SAFETY / max(e, 1e-10) ** 0.2)
        if step <= FLOOR * first:
            grown = GROW * step
        if event >= 0:
            w[touching + event] = 1.0 - w[touching + event]
            settle(w, s)
            grown = max(grown, s[NATURAL])
        else:
            remember(w, s, last)
        s[NATURAL] = 0.0
        s[STEP] = min(grown, longest)
        if s[NOW] + 1.01 * s[STEP] > (end - 1) * interval:
            s[STEP] = (end - 1) * interval - s[NOW]  # end where the last sample is
        s[SINCE] += 1.0

    @compiled
    def reject(w: Array, s: Array, most: int, interval: float, reason: int) -> None:
        """Go back to the start of a step; where no step is left to try, the case ends for this reason."""
        for i in range(2 * n):
            w[z_at + i] = w[kept + i]
        if s[STEP] < SHORTEST * (s[NOW] + interval) or s[TRIALS] > most:
            s[OUTCOME] = reason

    @compiled
    def advance(
        w: Array,
        s: Array,
        count: int,
        first: float,
        longest: float,
        end: int,
        most: int,
        interval: float,
        tolerance: float,
        precision: float,
        oversampling: int,
        recorded: Indices,
        coordinates: Array,
        velocities: Array,
        accelerations: Array,
    ) -> None:
        for _ in range(count):
            if s[OUTCOME] != RUNNING:
                return
            step = s[STEP]
            w[time_at], w[step_at] = s[NOW], step
            if rubs:
                w[jam] = 0.0
            dopri(w)
            s[TRIALS] += 1.0
            e = w[error_at] / tolerance
            jammed = rubs and w[jam] > 0.5
            accepted = e <= 1.0 and not jammed  # false for a number that is none
            noise = not accepted and not jammed and e < math.inf and step <= FLOOR * first
            if noise and s[FORCED] < MOST_FORCED:
                # Where closures lose their rank for an instant the estimate is rounding noise that no step removes.
                accepted, e = True, 1.0
                s[FORCED] += 1.0
            event = -1
            if accepted:
                event, part = switched(w, s, step)
                if event >= 0:
                    shorter = shortened(w, s, event, part, step, interval, precision)
                    if shorter > 0.0:
                        accepted = False
                        s[NATURAL], s[STEP] = max(s[NATURAL], step), shorter
            else:
                s[STEP] = step * max(SHRINK, SAFETY / e**0.2) if e < math.inf and not jammed else 0.1 * step
                s[NATURAL] = s[STEP]
                # Near a loss of rank it is the drift of the closures that spoils the accelerations.
                s[SINCE] = PROJECT_EVERY
            if accepted:
                s[ACCEPTED] += 1.0
                size = 0.0
                for i in range(n):
                    size += abs(w[z_at + i]) + abs(w[v_at + i])
                if not (size < DIVERGED) or s[UNBELIEVED] >= PATIENCE:
                    s[OUTCOME] = DIVERGING
                    return
                record(w, s, step, end, interval, oversampling, recorded, coordinates, velocities, accelerations)
                accept(w, s, step, e, event, first, longest, end, interval)
            else:
                reject(w, s, most, interval, JAMMED if jammed else STALLED)
            if constrained and s[OUTCOME] == RUNNING and s[SINCE] >= PROJECT_EVERY:
                restore(w, s)

    return begin, advance
