"""Error-controlled integration of one case, for compilers of Python: what ``adaptive.py`` does to a lane.

The functions are bound to a kernel in scalar Python (:mod:`jointplay.solver.compiler.scalar`) by whatever compiles
both: Numba for a CUDA device, or nothing at all. What is kept between two trial steps is in two arrays, so that a run
can be left after any trial step and taken up again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.integrators.control import (
    CAUTION,
    DIVERGING,
    JAMMED,
    OK,
    PROJECT_EVERY,
    RUNNING,
    SHORTEST,
    STALLED,
    accepted,
    after_switch,
    arrival,
    next_step,
    refused,
    remember,
    shortened,
    switch_part,
)
from jointplay.solver.integrators.dopri import DENSE_ROWS, StepRows
from jointplay.solver.integrators.gill import DIVERGED, LOST, PATIENCE
from jointplay.solver.integrators.kernel import KernelCode
from jointplay.solver.integrators.kernel_functions import Compile, Function, kernel_functions

#: Places in the state of a case. Given: time of the first sample, bound of the scaled error of a step, time in which
#: the machine moves by its own size, first and longest step, samples wanted, trial steps after which it counts as
#: stalled, penetration within which the instant of a switch must be met.
BEGIN, TOLERANCE, PACE, FIRST, LONGEST, SAMPLES, MOST, PRECISION = range(8)
#: Kept: how it ended, time, trial step, that step before a switch shortened it, the same at the end of the last
#: contact, 16th root of the last error, samples, trial and accepted steps, accepted steps since closures were restored,
#: forced steps, corrections of closures not believed one after the other, samples when closures last held, step at
#: which refusals for error began (0 for none), that error, 1 where the next trial is that step again; then switch,
#: penetration and approach of every contact.
OUTCOME, NOW, STEP, NATURAL, PRESSED, ROOT, SAMPLE, TRIALS, ACCEPTED, SINCE, FORCED = range(8, 19)
UNBELIEVED, HELD_AT, UNCUT, UNCUT_ERROR, OVER, BEFORE = range(19, 25)


Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def state_length(contacts: int) -> int:
    """Numbers in the state of a case."""
    return BEFORE + 3 * contacts


def case_functions(
    code: KernelCode, rows: StepRows, remembering: tuple[int, ...], compiled: Compile
) -> tuple[Function, Function]:
    """What integrates one case: ``begin`` and ``advance``.

    Parameters
    ----------
    code : KernelCode
        In the scalar dialect.
    rows : StepRows
        Of its work array.
    remembering : tuple of int
        Contacts whose law remembers.
    compiled : callable
        The compiler.

    Returns
    -------
    begin : callable
        ``begin(w, s)``: from a work array `w` with parameters, coordinates and velocities, and a state `s` of zeros but
        for what is given, to a state ready for a first trial step.
    advance : callable
        ``advance(w, s, count, interval, oversampling, places, coordinates, velocities,
        accelerations, memories)``: at most `count` trial steps, until ``s[OUTCOME]`` is no longer ``RUNNING``. `places`
        are the recorded coordinates; the others are as in
        :meth:`jointplay.solver.integrators.device.DeviceKernel.integrate`, of one case.
    """
    functions = kernel_functions(code, compiled)
    prepare, held, dopri, project = (functions[name] for name in ("prepare", "held", "dopri", "project"))
    constrained, jam, rubs = code.constrained, code.jam, code.jam >= 0
    layout = rows.layout
    n, contacts, channels = layout.size, rows.contacts, len(rows.recorded)
    time_at, step_at, z_at, a_at, kept = layout.time, layout.step, layout.z, layout.a, layout.scratch
    touching, switch, penetration, approach = rows.touching, rows.switch, rows.penetration, rows.approach
    error_at, growth_at, root_at, size_at = rows.error, rows.growth, rows.root, rows.size
    pace_at, strictness_at = rows.pace, rows.strictness
    slopes, last, dense = rows.slopes, rows.last_slopes, rows.dense
    memory, memories_count = layout.memory, len(remembering)
    contact_of = remembering or (0,)  # a tuple of nothing has no type for a compiler
    allowed, arrive, following, after_refusal = (compiled(rule) for rule in (accepted, arrival, next_step, refused))
    remember_contact, shorten, switched_at = (compiled(rule) for rule in (remember, shortened, switch_part))
    switched_to = compiled(after_switch)

    @compiled
    def remember_contacts(w: Array) -> None:
        for m in range(memories_count):
            remember_contact(w, memory + m, penetration + contact_of[m], approach + contact_of[m])

    @compiled
    def go_on(w: Array, s: Array, source: int) -> None:
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
        go_on(w, s, a_at)

    @compiled
    def begin(w: Array, s: Array) -> None:
        s[OUTCOME], s[NOW], s[STEP] = RUNNING, s[BEGIN], CAUTION * s[FIRST]
        s[PRESSED], s[ROOT] = np.inf, 1.0
        w[pace_at], w[strictness_at] = s[PACE], 1.0 / s[TOLERANCE]
        prepare(w)
        w[time_at] = s[NOW]
        held(w)
        # Whether a contact pushes at the start follows from the switch, which does not depend on the assumption.
        for j in range(contacts):
            w[touching + j] = 1.0 if w[switch + j] > 0.0 else 0.0
        remember_contacts(w)  # a contact at the start begins there
        settle(w, s)

    @compiled
    def first_switch(w: Array, s: Array, step: float, shortest: float) -> tuple[int, float]:
        """The contact that switches first within an acceptable step (-1: none), and the shorter step to it, or 0."""
        event, first, shorter = -1, 1.0, 0.0
        for j in range(contacts):
            pushing = w[touching + j] > 0.5
            where = switched_at(
                pushing, s[BEFORE + j], w[switch + j], s[BEFORE + contacts + j], w[penetration + j],
                s[BEFORE + 2 * contacts + j], w[approach + j], step,
            )  # fmt: skip
            if where <= 1.0:
                wanted = shorten(step, where, pushing, w[switch + j], w[approach + j], s[PRECISION], shortest)
                if wanted > 0.0 and (shorter == 0.0 or wanted < shorter):
                    event, shorter = j, wanted
                elif shorter == 0.0 and (event < 0 or where < first):
                    event, first = j, where
        return event, shorter

    @compiled
    def switch_over(w: Array, event: int) -> bool:
        """Let the contact of the event push or cease to, with those that switched then; whether it pushes."""
        for j in range(contacts):
            pushes = w[touching + j] > 0.5
            if j == event or pushes != (w[switch + j] > 0.0):
                w[touching + j] = 0.0 if pushes else 1.0
        return bool(w[touching + event] > 0.5)

    @compiled
    def record(
        w: Array, s: Array, step: float, now: float, interval: float, oversampling: int, places: Indices,
        coordinates: Array, velocities: Array, accelerations: Array, memories: Array,
    ) -> None:  # fmt: skip
        """Samples within an accepted step that ends at `now`, by its dense output."""
        sample = int(s[SAMPLE])
        while sample < s[SAMPLES] and s[BEGIN] + sample * interval <= now:
            x = (s[BEGIN] + sample * interval - s[NOW]) / step
            y = 1.0 - x
            reduced = sample // oversampling
            moving = coordinates.shape[1] > 0 and sample % oversampling == 0
            for r in range(channels):
                base = dense + DENSE_ROWS * (channels + r)
                c2, c3, c4, c5 = w[base], w[base + 1], w[base + 2], w[base + 3]
                start = w[kept + n + places[r]]
                velocities[r, sample] = start + x * (c2 + y * (c3 + x * (c4 + y * c5)))
                if moving:
                    inner = c4 + y * c5
                    middle = c3 + x * inner
                    slope = c2 + y * middle - x * middle + x * y * (inner - x * c5)
                    accelerations[r, reduced] = slope / step
                    base = dense + DENSE_ROWS * r
                    c2, c3, c4, c5 = w[base], w[base + 1], w[base + 2], w[base + 3]
                    start = w[kept + places[r]]
                    coordinates[r, reduced] = start + x * (c2 + y * (c3 + x * (c4 + y * c5)))
            if moving:
                for m in range(memories_count):
                    memories[m, reduced] = w[memory + m]
            sample += 1
        s[SAMPLE] = sample

    @compiled
    def any_contact(w: Array) -> bool:
        """Whether any contact pushes over the step."""
        pushing = 0.0
        for j in range(contacts):
            pushing += w[touching + j]
        return pushing > 0.5

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
    def accept(w: Array, s: Array, step: float, now: float, end: float, event: int) -> None:
        """Go on from the end of a step whose samples are recorded."""
        s[NOW] = now
        if s[SAMPLE] >= s[SAMPLES]:
            s[OUTCOME] = OK
            return
        remember_contacts(w)
        natural, longest = 0.0, s[LONGEST]
        if event >= 0:
            natural, pushes = s[NATURAL], switch_over(w, event)
            s[PRESSED], longest = switched_to(natural, step, s[PRESSED], longest, pushes)
            settle(w, s)
        else:
            go_on(w, s, last)
        # Refusals in a contact say nothing of the closures.
        if s[UNCUT] > 0.0 and (step >= s[UNCUT] or any_contact(w)):
            s[UNCUT] = 0.0
        s[NATURAL] = 0.0
        growth = w[growth_at] * s[ROOT]
        s[ROOT] = w[root_at] if event < 0 else 1.0
        s[STEP] = following(step, s[FIRST], growth, natural, longest, now, end)
        s[SINCE] += 1.0

    @compiled
    def reject(w: Array, s: Array, interval: float, reason: int) -> None:
        """Go back to the start of a step; where no step is left to try, the case ends for this reason."""
        for i in range(2 * n):
            w[z_at + i] = w[kept + i]
        if s[STEP] < SHORTEST * (abs(s[NOW]) + interval) or s[TRIALS] > s[MOST]:
            s[OUTCOME] = reason

    @compiled
    def advance(
        w: Array, s: Array, count: int, interval: float, oversampling: int,
        places: Indices, coordinates: Array, velocities: Array, accelerations: Array, memories: Array,
    ) -> None:  # fmt: skip
        end = s[BEGIN] + (s[SAMPLES] - 1.0) * interval
        for _ in range(count):
            if s[OUTCOME] != RUNNING:
                return
            step = s[STEP]
            now = arrive(s[NOW], step, end, interval)
            w[time_at], w[step_at] = s[NOW], step
            if rubs:
                w[jam] = 0.0
            dopri(w)
            s[TRIALS] += 1.0
            e = w[error_at]
            jammed = rubs and w[jam] > 0.5
            good, noise = allowed(e, jammed, step, s[FIRST], s[TOLERANCE], s[OVER] > 0.5, int(s[FORCED]))
            if noise:
                s[FORCED] += 1.0
            s[OVER] = 0.0
            event = -1
            if good:
                event, shorter = first_switch(w, s, step, SHORTEST * (abs(s[NOW]) + interval))
                if shorter > 0.0:
                    good = False
                    s[NATURAL], s[STEP] = max(s[NATURAL], step), shorter
            else:
                smooth = constrained and not any_contact(w)
                shorter, uncut, uncut_error, over, due = after_refusal(
                    step, e, jammed, w[growth_at], s[TOLERANCE], int(s[FORCED]), smooth, s[UNCUT], s[UNCUT_ERROR]
                )
                s[STEP], s[UNCUT], s[UNCUT_ERROR] = shorter, uncut, uncut_error
                if over:
                    s[OVER] = 1.0
                    s[FORCED] += 1.0
                s[NATURAL] = s[STEP]
                if due:
                    s[SINCE] = PROJECT_EVERY
            if good:
                s[ACCEPTED] += 1.0
                size = w[size_at]
                if not (size < DIVERGED) or s[UNBELIEVED] >= PATIENCE or s[TRIALS] > s[MOST]:
                    s[OUTCOME], s[NOW] = STALLED if s[TRIALS] > s[MOST] else DIVERGING, now
                    return
                record(
                    w, s, step, now, interval, oversampling, places, coordinates, velocities, accelerations, memories
                )  # fmt: skip
                accept(w, s, step, now, end, event)
            else:
                reject(w, s, interval, JAMMED if jammed else STALLED)
            if constrained and s[OUTCOME] == RUNNING and s[SINCE] >= PROJECT_EVERY:
                restore(w, s)

    return begin, advance
