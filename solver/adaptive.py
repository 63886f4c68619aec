"""Error-controlled integration in lanes: every lane its own time, step and case.

A trial step is computed for all lanes at once; each lane then accepts it, refuses it, or shortens it to end where a
contact begins or ends to push. A lane whose case has ended takes the next one from the queue.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solver.compiled import compiled
from solver.control import (
    BEARABLE,
    BEARABLE_PART,
    CAUTION,
    DIVERGING,
    FLOOR,
    GROW,
    JAMMED,
    MOST_FORCED,
    NOISY_CUT,
    OK,
    PAST,
    PROJECT_EVERY,
    SHORTEST,
    SHRINK,
    STALLED,
    crossing,
    remember,
)
from solver.dense import record, samples_until
from solver.gill import DIVERGED, LOST, PATIENCE, call
from solver.ir import LANES
from solver.lanes import BUSY, ENDED, FREE, NEXT, STALE, Lanes, Queue, Records, Rows

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Structured = NDArray[Any]

_crossing = compiled(crossing)
_remember = compiled(remember)


@partial(compiled, forceinline=True)
def _remember_impacts(w: Array, rows: Rows, remembering: Integers, lane: int) -> None:
    """Bring what the contacts of a lane remember up to date with an accepted state."""
    for m in range(remembering.size):
        penetration, approach = rows.penetration + remembering[m], rows.approach + remembering[m]
        _remember(w, (rows.memory + m) * LANES + lane, penetration * LANES + lane, approach * LANES + lane)


@compiled
def _load(
    w: Array, n: int, contacts: int, rows: Rows, cases: Structured, starts: Array, parameters: Array,
    lanes: Structured, remembering: Integers, free: Integers, cursor: Integers,
) -> int:  # fmt: skip
    """Give idle lanes the next cases of the queue, as long as there is room for their records; how many got one."""
    loaded = 0
    for lane in range(LANES):
        c = cursor[NEXT]
        if lanes[lane].case >= 0 or c >= cases.size or cursor[FREE] == 0:
            continue
        cursor[FREE] -= 1
        mine, case = lanes[lane], cases[c]
        mine.case, mine.slot, mine.fresh = c, free[cursor[FREE]], 1
        mine.begin = mine.t = case.begin
        mine.h, mine.natural = CAUTION * case.first_step, 0.0
        mine.uncut, mine.over = 0.0, 0
        mine.sample = mine.trials = mine.since = mine.forced = mine.lost = mine.held_at = 0
        for i in range(2 * n):
            w[(2 + i) * LANES + lane] = starts[c, i]
        w[rows.pace * LANES + lane], w[rows.strictness * LANES + lane] = case.pace, 1.0 / case.tolerance
        for i in range(parameters.shape[1]):
            w[(rows.parameters + i) * LANES + lane] = parameters[c, i]
        for j in range(contacts):
            w[(rows.touching + j) * LANES + lane] = 0.0
        for m in range(remembering.size):
            w[(rows.memory + m) * LANES + lane] = starts[c, 2 * n + m]
        cursor[NEXT] += 1
        cursor[BUSY] += 1
        loaded += 1
    return loaded


@partial(compiled, forceinline=True)
def _end(
    w: Array, n: int, lane: int, outcome: int, reached: int, cases: Structured, starts: Array, lanes: Structured,
    ended: Integers, cursor: Integers, memory: int,
) -> None:  # fmt: skip
    """Put the lane's case away: how it ended, and where it stands."""
    mine = lanes[lane]
    case = cases[mine.case]
    case.outcome, case.reached, case.begin = outcome, reached, mine.t
    for i in range(2 * n):
        starts[mine.case, i] = w[(2 + i) * LANES + lane]
    for i in range(2 * n, starts.shape[1]):
        starts[mine.case, i] = w[(memory + i - 2 * n) * LANES + lane]
    ended[cursor[ENDED], 0], ended[cursor[ENDED], 1] = mine.case, mine.slot
    cursor[ENDED] += 1
    cursor[BUSY] -= 1
    mine.case = -1


@partial(compiled, forceinline=True)
def _remember_contacts(w: Array, contacts: int, rows: Rows, lane: int, old: Array) -> None:
    """Penetration, its rate and the switch function now are those at the start of the next step."""
    for j in range(contacts):
        old[0, j, lane] = w[(rows.penetration + j) * LANES + lane]
        old[1, j, lane] = w[(rows.approach + j) * LANES + lane]
        old[2, j, lane] = w[(rows.switch + j) * LANES + lane]


@partial(compiled, forceinline=True)
def _first_switch(w: Array, contacts: int, rows: Rows, lane: int, step: float, old: Array) -> tuple[int, float]:
    """Contact that begins or ceases to push first within the step, and the part of the step at which; -1 for none."""
    event, part = -1, 1.0
    for j in range(contacts):
        s1 = w[(rows.switch + j) * LANES + lane]
        r1 = w[(rows.approach + j) * LANES + lane]
        where = 2.0
        if w[(rows.touching + j) * LANES + lane] > 0.5:
            if s1 < 0.0:
                s0 = old[2, j, lane]
                where = s0 / (s0 - s1) if s0 > 0.0 else 0.5
        elif s1 > 0.0 or old[1, j, lane] > 0.0 > r1:
            # Also where both ends are open but the pair came near and went: it may have touched in between.
            if old[0, j, lane] < 0.0:
                p1 = w[(rows.penetration + j) * LANES + lane]
                where = _crossing(old[0, j, lane], step * old[1, j, lane], p1, step * r1)
            elif s1 > 0.0:  # still inside after its force had gone: pressed in again
                s0 = old[2, j, lane]
                where = s0 / (s0 - s1) if s0 < 0.0 else 0.5
        if where <= 1.0 and (event < 0 or where < part):
            event, part = j, where
    return event, part


@partial(compiled, forceinline=True)
def _any_contact(w: Array, contacts: int, rows: Rows, lane: int) -> bool:
    """Whether any contact of the lane pushes over the step."""
    pushing = 0.0
    for j in range(contacts):
        pushing += w[(rows.touching + j) * LANES + lane]
    return pushing > 0.5


@compiled
def _restore_closures(project: int, w: Array, n: int, lanes: Structured, saved: Array) -> bool:
    """Restore the closures of the lanes that are due, and only of them; whether there were any.

    The others are left exactly as they are, so that no result depends on which cases run beside it.
    """
    due = False
    for lane in range(LANES):
        due = due or (lanes[lane].case >= 0 and lanes[lane].since >= PROJECT_EVERY)
    if not due:
        return False
    for i in range(2 * n * LANES):
        saved[i] = w[2 * LANES + i]
    for lane in range(LANES):
        w[lane] = lanes[lane].t
    call(project, w)
    for lane in range(LANES):
        mine, moved = lanes[lane], LOST
        if mine.case >= 0 and mine.since >= PROJECT_EVERY:
            mine.since = 0
            moved = 0.0
            for i in range(n):
                moved += abs(w[(2 + i) * LANES + lane] - saved[i * LANES + lane])
            if moved < LOST:
                mine.lost, mine.held_at = 0, mine.sample
            else:  # also a correction that is no number
                mine.lost += 1
        if not (moved < LOST):
            for i in range(2 * n):
                w[(2 + i) * LANES + lane] = saved[i * LANES + lane]
    return True


@compiled
def integrate(
    kernel: tuple[int, int, int, int], w: Array, n: int, contacts: int, rows: Rows, precision: float,
    queue: Queue, records: Records, state: Lanes,
) -> None:  # fmt: skip
    """Integrate a queue of cases of one model until all have ended, or a lane waits for room for its records.

    Parameters
    ----------
    kernel : tuple of int
        Addresses of ``prepare``, ``held``, ``dopri`` and ``project`` (0 for none).
    w : (total,) array
        Work array.
    n, contacts : int
        Coordinates, clearance joints.
    rows : Rows
    precision : float
        Penetration within which the instant of a switch must be met, m.
    queue : Queue
    records : Records
    state : Lanes
        Of the call before, or idle ones; its ended cases must have been taken, and their slots freed.
    """
    prepare, held, dopri, project = kernel
    jam = rows.jam
    # Taken out of their tuples once: compiled code counts references whenever an array is.
    cases, starts, parameters = queue.cases, queue.starts, queue.parameters
    lanes, old, saved, cursor = state.lanes, state.old, state.saved, state.cursor
    free, ended, remembering = state.free, state.ended, state.remembering
    channels, velocities = records.channels, records.velocities
    coordinates, accelerations, memories = records.coordinates, records.accelerations, records.memories
    interval = records.interval
    loading = True
    while True:
        if loading:
            if _load(w, n, contacts, rows, cases, starts, parameters, lanes, remembering, free, cursor) > 0:
                call(prepare, w)
                for lane in range(LANES):
                    w[lane] = lanes[lane].t
                call(held, w)
                # Whether a contact pushes at the start follows from the switch, which knows nothing of the assumption.
                for lane in range(LANES):
                    mine = lanes[lane]
                    if mine.case >= 0 and mine.fresh == 1:
                        mine.fresh = 0
                        mine.end = mine.begin + (cases[mine.case].samples - 1) * interval
                        for j in range(contacts):
                            pushes = w[(rows.switch + j) * LANES + lane] > 0.0
                            w[(rows.touching + j) * LANES + lane] = 1.0 if pushes else 0.0
                        _remember_impacts(w, rows, remembering, lane)  # a contact at the start begins there
                cursor[STALE] = 1
            loading = False
            if cursor[BUSY] < LANES and cursor[NEXT] < cases.size:
                return
        if cursor[BUSY] == 0:
            return
        if cursor[STALE] == 1:
            for lane in range(LANES):
                w[lane] = lanes[lane].t
            call(held, w)
            for i in range(n * LANES):
                w[rows.slopes * LANES + i] = w[(2 + 2 * n) * LANES + i]
            for lane in range(LANES):
                _remember_contacts(w, contacts, rows, lane, old)
            cursor[STALE] = 0
        for lane in range(LANES):
            w[lane] = lanes[lane].t
            w[LANES + lane] = lanes[lane].h if lanes[lane].case >= 0 else 0.0
            if jam >= 0:
                w[jam * LANES + lane] = 0.0
        call(dopri, w)
        for lane in range(LANES):
            mine = lanes[lane]
            if mine.case < 0:
                continue
            case = cases[mine.case]
            mine.trials += 1
            e = w[rows.error * LANES + lane]
            bearable = max(BEARABLE_PART, BEARABLE / case.tolerance)
            step, t = mine.h, mine.t
            now = t + step
            if abs(now - mine.end) <= SHORTEST * (abs(mine.end) + interval):
                now = mine.end  # to the last digit, or the last sample would need another step
            shortest = SHORTEST * (abs(t) + interval)
            jammed = jam >= 0 and w[jam * LANES + lane] > 0.5
            accept = e <= 1.0 and not jammed  # false for a number that is none
            tiny = step <= FLOOR * case.first_step
            patient = e < math.inf and not jammed and mine.forced < MOST_FORCED
            if not accept and patient and e <= bearable and (tiny or mine.over == 1):
                # Where closures lose their rank for an instant the estimate is rounding noise that no step removes.
                accept = True
                mine.forced += 1
                e = 1.0
            mine.over = 0
            event, part = -1, 1.0
            if accept:
                event, part = _first_switch(w, contacts, rows, lane, step, old)
                if event >= 0:
                    s1 = w[(rows.switch + event) * LANES + lane]
                    flipped = (s1 > 0.0) != (w[(rows.touching + event) * LANES + lane] > 0.5)
                    met = flipped and abs(s1) <= precision
                    if not met and step > 1e3 * shortest and abs(part - 1.0) > 1e-9:
                        # Shorten, aiming a little past the switch.
                        accept = False
                        mine.natural = max(mine.natural, step)
                        speed = abs(w[(rows.approach + event) * LANES + lane]) + 1e-12
                        mine.h = max(min(0.999 * step, part * step + PAST * precision / speed), 0.001 * step)
            else:
                growth = w[rows.growth * LANES + lane]
                mine.h = step * max(SHRINK, growth) if e < math.inf and not jammed else 0.1 * step
                if mine.uncut == 0.0 or e * mine.uncut * mine.uncut < mine.uncut_error * step * step:
                    mine.uncut, mine.uncut_error = step, e
                elif (
                    step <= NOISY_CUT * mine.uncut
                    and mine.uncut_error < min(e, bearable)
                    and patient
                    and project != 0
                    and not _any_contact(w, contacts, rows, lane)
                ):  # step over what shorter steps make worse
                    mine.h, mine.over, mine.uncut = mine.uncut, 1, 0.0
                    mine.forced += 1
                mine.natural = mine.h
                # Near a loss of rank it is the drift of the closures that spoils the accelerations.
                mine.since = PROJECT_EVERY
            tired = mine.trials > case.most_trials
            if not accept:
                for i in range(2 * n):
                    w[(2 + i) * LANES + lane] = w[(rows.kept + i) * LANES + lane]
                if mine.h < shortest or tired:
                    outcome = JAMMED if jammed else STALLED
                    _end(w, n, lane, outcome, mine.sample, cases, starts, lanes, ended, cursor, rows.memory)
                    loading = loading or cursor[NEXT] < cases.size
                continue
            case.accepted += 1
            size = w[rows.size * LANES + lane]
            lost = mine.lost >= PATIENCE
            mine.t = now
            if not (size < DIVERGED) or lost or tired:
                reached = mine.held_at if lost else mine.sample
                outcome = STALLED if tired else DIVERGING
                _end(w, n, lane, outcome, reached, cases, starts, lanes, ended, cursor, rows.memory)
                loading = loading or cursor[NEXT] < cases.size
                continue
            last = samples_until(now, mine.begin, interval, mine.sample, case.samples)
            if last > mine.sample:
                record(
                    w, rows.kept, rows.dense, n, lane, mine.begin, t, step, mine.sample, last, mine.slot, channels,
                    interval, records.oversampling, records.head, velocities, coordinates, accelerations, rows.memory,
                    memories,
                )  # fmt: skip
                mine.sample = last
                if last == case.samples:
                    _end(w, n, lane, OK, last, cases, starts, lanes, ended, cursor, rows.memory)
                    loading = loading or cursor[NEXT] < cases.size
                    continue
            for i in range(n):
                w[(rows.slopes + i) * LANES + lane] = w[(rows.last_slopes + i) * LANES + lane]
            _remember_contacts(w, contacts, rows, lane, old)
            grown = step * (GROW if tiny else min(GROW, w[rows.growth * LANES + lane]))
            if event >= 0:
                pushes = w[(rows.touching + event) * LANES + lane]
                w[(rows.touching + event) * LANES + lane] = 1.0 - pushes
                cursor[STALE] = 1
                grown = max(grown, mine.natural)
            _remember_impacts(w, rows, remembering, lane)
            mine.natural = 0.0
            if step >= mine.uncut:
                mine.uncut = 0.0
            mine.h = min(grown, case.longest_step)
            if now + 1.01 * mine.h > mine.end:
                mine.h = mine.end - now  # end where the last sample is
            mine.since += 1
        if project != 0 and _restore_closures(project, w, n, lanes, saved):
            cursor[STALE] = 1
