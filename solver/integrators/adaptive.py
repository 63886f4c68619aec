"""Error-controlled integration in lanes: every lane its own time, step and case.

A trial step is computed for all lanes at once; each lane then accepts it, refuses it, or shortens it to end where a
contact begins or ends to push. A lane whose case has ended takes the next one from the queue, and the closures of
lanes that are due are restored.
"""

from __future__ import annotations

import numpy as np

from jointplay.solver.arrays import FloatArray, IntArray, StructuredArray
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.compiler.native import compiled, inlined
from jointplay.solver.compiler.rows import WorkRows
from jointplay.solver.integrators.control import (
    CAUTION,
    DIVERGING,
    JAMMED,
    OK,
    PROJECT_EVERY,
    SHORTEST,
    STALLED,
    accepts,
    after_switch,
    arrival,
    before_row,
    is_met,
    next_step,
    refuse_step,
    remember,
    shorten,
    switch_part,
)
from jointplay.solver.integrators.dense import record, samples_until
from jointplay.solver.integrators.gill import DIVERGED, LOST, PATIENCE, call
from jointplay.solver.integrators.lanes import BUSY, ENDED, FREE, NEXT, STALE, Lanes, Queue, Records
from jointplay.solver.integrators.sticking import change_all, first_change, release


@compiled
def load(
    w: FloatArray, rows: WorkRows[int], cases: StructuredArray, starts: FloatArray, parameters: FloatArray,
    lanes: StructuredArray, free: IntArray, cursor: IntArray,
) -> int:  # fmt: skip
    """Give idle lanes the next cases of the queue, as long as there is room for their records; how many got one."""
    loaded, n = 0, rows.v - rows.z
    for lane in range(LANES):
        c = cursor[NEXT]
        if lanes[lane].case >= 0 or c >= cases.size or cursor[FREE] == 0:
            continue
        cursor[FREE] -= 1
        mine, case = lanes[lane], cases[c]
        mine.case, mine.slot, mine.fresh = c, free[cursor[FREE]], 1
        mine.begin = mine.t = case.begin
        mine.h, mine.natural = CAUTION * case.first_step, 0.0
        mine.pressed, mine.root = np.inf, 1.0
        mine.uncut, mine.over = 0.0, 0
        mine.sample = mine.trials = mine.since = mine.forced = mine.lost = mine.held_at = 0
        for i in range(2 * n):
            w[rows.z + i, lane] = starts[c, i]
        w[rows.pace, lane], w[rows.strictness, lane] = case.pace, 1.0 / case.tolerance
        for i in range(parameters.shape[1]):
            w[rows.parameters + i, lane] = parameters[c, i]
        for i in range(rows.touching, rows.switch):
            w[i, lane] = 0.0
        for m in range(rows.hoisted - rows.memory):
            w[rows.memory + m, lane] = starts[c, 2 * n + m]
        cursor[NEXT] += 1
        cursor[BUSY] += 1
        loaded += 1
    return loaded


@inlined
def put_away(
    w: FloatArray, rows: WorkRows[int], lane: int, outcome: int, reached: int, cases: StructuredArray,
    starts: FloatArray, lanes: StructuredArray, ended: IntArray, cursor: IntArray,
) -> None:  # fmt: skip
    """Put the lane's case away: how it ended, and where it stands."""
    mine = lanes[lane]
    case = cases[mine.case]
    case.outcome, case.reached, case.begin = outcome, reached, mine.t
    moving = rows.a - rows.z
    for i in range(moving):
        starts[mine.case, i] = w[rows.z + i, lane]
    for i in range(moving, starts.shape[1]):
        starts[mine.case, i] = w[rows.memory + i - moving, lane]
    ended[cursor[ENDED], 0], ended[cursor[ENDED], 1] = mine.case, mine.slot
    cursor[ENDED] += 1
    cursor[BUSY] -= 1
    mine.case = -1


@compiled
def restore_closures(
    project: int, w: FloatArray, rows: WorkRows[int], lanes: StructuredArray, saved: FloatArray
) -> bool:
    """Restore the closures of the lanes that are due, and only of them; whether there were any.

    The others are left exactly as they are, so that no result depends on which cases run beside it.
    """
    due = False
    for lane in range(LANES):
        due = due or (lanes[lane].case >= 0 and lanes[lane].since >= PROJECT_EVERY)
    if not due:
        return False
    saved[:] = w[rows.z : rows.a]
    for lane in range(LANES):
        w[rows.time, lane] = lanes[lane].t
    call(project, w)
    for lane in range(LANES):
        mine, moved = lanes[lane], LOST
        if mine.case >= 0 and mine.since >= PROJECT_EVERY:
            mine.since = 0
            moved = 0.0
            for i in range(rows.v - rows.z):
                moved += abs(w[rows.z + i, lane] - saved[i, lane])
            if moved < LOST:
                mine.lost, mine.held_at = 0, mine.sample
            else:  # also a correction that is no number
                mine.lost += 1
        if not (moved < LOST):
            for i in range(rows.a - rows.z):
                w[rows.z + i, lane] = saved[i, lane]
    return True


@inlined
def _remember_impacts(w: FloatArray, rows: WorkRows[int], remembering: IntArray, lane: int) -> None:
    """Bring what the contacts of a lane remember up to date with an accepted state."""
    for m in range(remembering.size):
        contact = remembering[m]
        remember(w, rows.memory + m, rows.penetration + contact, rows.approach + contact, lane)


@inlined
def _first_switch(
    w: FloatArray, rows: WorkRows[int], lane: int, step: float, precision: float, shortest: float
) -> tuple[int, float]:
    """Contact that begins or ceases to push first within the step (-1 for none), and the shorter step to it, or 0.

    0 only where no contact needs a shorter one: what has switched by then has done so at the end of the step.
    """
    event, first, shorter = -1, 1.0, 0.0
    contacts = rows.switch - rows.touching
    for j in range(contacts):
        begun = rows.begun + j
        pushing = w[rows.touching + j, lane] > 0.5
        before, switch, approach = w[begun, lane], w[rows.switch + j, lane], w[rows.approach + j, lane]
        if is_met(pushing, switch, precision):
            where = before / (before - switch) if (before > 0.0) != (switch > 0.0) else 0.0
        else:
            where = switch_part(
                pushing, before, switch, w[begun + contacts, lane], w[rows.penetration + j, lane],
                w[begun + 2 * contacts, lane], approach, step,
            )  # fmt: skip
        if where <= 1.0:
            wanted = shorten(step, where, pushing, switch, approach, precision, shortest)
            if wanted > 0.0 and (shorter == 0.0 or wanted < shorter):
                event, shorter = j, wanted
            elif shorter == 0.0 and (event < 0 or where < first):
                event, first = j, where
    return event, shorter


@inlined
def _switch(w: FloatArray, rows: WorkRows[int], lane: int, event: int, rubbing: IntArray) -> bool:
    """Let the contact of the event push or cease to, with those that switched at the same time; whether it pushes."""
    for j in range(rows.switch - rows.touching):
        pushes = w[rows.touching + j, lane] > 0.5
        if j == event or pushes != (w[rows.switch + j, lane] > 0.0):
            w[rows.touching + j, lane] = 0.0 if pushes else 1.0
            release(w, rows, lane, j, rubbing)
    return bool(w[rows.touching + event, lane] > 0.5)


@inlined
def _any_contact(w: FloatArray, rows: WorkRows[int], lane: int) -> bool:
    """Whether any contact of the lane pushes over the step."""
    pushing = 0.0
    for i in range(rows.touching, rows.switch):
        pushing += w[i, lane]
    return pushing > 0.5


@inlined
def _heed_rows(
    lanes: StructuredArray, lane: int, cases: StructuredArray, table: FloatArray, cursor: IntArray
) -> None:  # fmt: skip
    """Shorten the trial of a lane to end before the next row of a table, or let it begin there."""
    mine = lanes[lane]
    mine.at_row = 0
    shortest = SHORTEST * (abs(mine.t) + cases[mine.case].interval)
    place = np.searchsorted(table, mine.t, side="right")
    if place < table.size:
        t, step = before_row(mine.t, mine.h, table[place], shortest)
        if t > mine.t:  # what follows the row holds from now on
            mine.t, cursor[STALE] = t, 1
            if place + 1 < table.size:
                t, step = before_row(mine.t, mine.h, table[place + 1], shortest)
        if step < mine.h:
            mine.natural, mine.h, mine.at_row = max(mine.natural, mine.h), step, 1


@compiled
def integrate(
    kernel: tuple[int, int, int, int, int, int], w: FloatArray, rows: WorkRows[int], queue: Queue, records: Records,
    state: Lanes,
) -> None:  # fmt: skip
    """Integrate a queue of cases of one model until all have ended, or a lane waits for room for its records.

    It also returns when a case has the samples that are to be looked at. Between calls more may be asked of that case;
    one that is given no more than the samples it has ends with the next call.

    Parameters
    ----------
    kernel : tuple of int
        Addresses of ``prepare``, ``begin``, ``dopri``, ``project`` (0 for none), ``suspect`` and ``advance``.
    w : (rows, LANES) array
        Work array.
    rows : WorkRows of int
        Its first rows.
    queue : Queue
    records : Records
    state : Lanes
        Of the call before, or idle ones; its ended cases must have been taken, and their slots freed.
    """
    prepare, begin, dopri, project, suspect, advance = kernel
    n, contacts = rows.v - rows.z, rows.switch - rows.touching
    # Taken out of their tuples once: compiled code counts references whenever an array is.
    cases, starts, parameters, table = queue.cases, queue.starts, queue.parameters, queue.rows
    lanes, saved, cursor = state.lanes, state.saved, state.cursor
    free, ended, remembering, rubbing = state.free, state.ended, state.remembering, state.rubbing
    sticking = rubbing.size
    channels, velocities = records.channels, records.velocities
    coordinates, accelerations, memories = records.coordinates, records.accelerations, records.memories
    for lane in range(LANES):
        mine = lanes[lane]
        if mine.case >= 0 and mine.sample >= cases[mine.case].samples:
            put_away(w, rows, lane, OK, mine.sample, cases, starts, lanes, ended, cursor)
    loading, looking = True, False
    while not looking:
        if loading:
            if load(w, rows, cases, starts, parameters, lanes, free, cursor) > 0:
                call(prepare, w)
                for lane in range(LANES):
                    w[rows.time, lane] = lanes[lane].t
                call(begin, w)
                # Whether a contact pushes at the start follows from the switch, which knows nothing of the assumption.
                for lane in range(LANES):
                    mine = lanes[lane]
                    if mine.case >= 0 and mine.fresh == 1:
                        mine.fresh = 0
                        mine.end = mine.begin + (cases[mine.case].samples - 1) * cases[mine.case].interval
                        for j in range(contacts):
                            w[rows.touching + j, lane] = 1.0 if w[rows.switch + j, lane] > 0.0 else 0.0
                        _remember_impacts(w, rows, remembering, lane)  # a contact at the start begins there
                        change_all(w, rows, lane, 1.0, rubbing)
                cursor[STALE] = 1
            loading = False
            if cursor[BUSY] < LANES and cursor[NEXT] < cases.size:
                return
        if cursor[BUSY] == 0:
            return
        for lane in range(LANES if table.size > 0 else 0):
            if lanes[lane].case >= 0:
                _heed_rows(lanes, lane, cases, table, cursor)
        if cursor[STALE] == 1:
            for lane in range(LANES):
                w[rows.time, lane] = lanes[lane].t
            call(begin, w)
            cursor[STALE] = 0
        for lane in range(LANES):
            w[rows.time, lane] = lanes[lane].t
            w[rows.step, lane] = lanes[lane].h if lanes[lane].case >= 0 else 0.0
            w[rows.jam, lane] = 0.0
        call(dopri, w)
        call(suspect, w)
        for lane in range(LANES):
            mine = lanes[lane]
            if mine.case < 0:
                continue
            case = cases[mine.case]
            interval = case.interval
            mine.trials += 1
            e, step, t = w[rows.error, lane], mine.h, mine.t
            now = arrival(t, step, mine.end, interval)
            shortest = SHORTEST * (abs(t) + interval)
            jammed = w[rows.jam, lane] > 0.5
            accept, noise = accepts(
                e, jammed, step, case.first_step, case.tolerance, mine.over == 1, mine.forced
            )  # fmt: skip
            mine.forced += noise
            mine.over = 0
            event = -1
            if accept:
                shorter = 0.0
                if w[rows.suspect, lane] > 0.5:
                    event, shorter = _first_switch(w, rows, lane, step, case.precision, shortest)
                if shorter > 0.0:
                    accept = False
                    mine.natural, mine.h = max(mine.natural, step), shorter
                elif sticking > 0:
                    shorter, caught = first_change(w, rows, lane, step, shortest, rubbing)
                    if shorter > 0.0:
                        accept = False
                        mine.natural, mine.h = max(mine.natural, step), shorter
                        if caught:
                            cursor[STALE] = 1
            else:
                smooth = project != 0 and not _any_contact(w, rows, lane)
                mine.h, mine.uncut, mine.uncut_error, over, restore = refuse_step(
                    step, e, jammed, w[rows.growth, lane], case.tolerance, mine.forced, smooth, mine.uncut,
                    mine.uncut_error,
                )  # fmt: skip
                mine.over = over
                mine.forced += over
                mine.natural = mine.h
                if restore:
                    mine.since = PROJECT_EVERY
            tired = mine.trials > case.most_trials
            w[rows.taken, lane] = 1.0 if accept else 0.0
            if not accept:
                if mine.h < shortest or tired:
                    for i in range(2 * n):
                        w[rows.z + i, lane] = w[rows.kept + i, lane]
                    outcome = JAMMED if jammed else STALLED
                    put_away(w, rows, lane, outcome, mine.sample, cases, starts, lanes, ended, cursor)
                    loading = loading or cursor[NEXT] < cases.size
                continue
            case.accepted += 1
            size = w[rows.size, lane]
            lost = mine.lost >= PATIENCE
            mine.t = now
            if not (size < DIVERGED) or lost or tired:
                reached = mine.held_at if lost else mine.sample
                outcome = STALLED if tired else DIVERGING
                put_away(w, rows, lane, outcome, reached, cases, starts, lanes, ended, cursor)
                loading = loading or cursor[NEXT] < cases.size
                continue
            if mine.begin + mine.sample * interval <= now:
                last = samples_until(now, mine.begin, interval, mine.sample, case.samples)
                record(
                    w, rows, lane, mine.begin, t, step, mine.sample, last, mine.slot, channels,
                    interval, records.head, velocities, coordinates, accelerations, memories,
                )  # fmt: skip
                mine.sample = last
                if last == case.samples:
                    put_away(w, rows, lane, OK, last, cases, starts, lanes, ended, cursor)
                    loading = loading or cursor[NEXT] < cases.size
                    continue
                looking = looking or last >= case.look
            natural, longest = 0.0, case.longest_step
            if event >= 0:
                natural, pushes = mine.natural, _switch(w, rows, lane, event, rubbing)
                mine.pressed, longest = after_switch(natural, step, mine.pressed, longest, pushes)
                cursor[STALE] = 1
            if sticking > 0 and change_all(w, rows, lane, step, rubbing):
                natural = max(natural, mine.natural)
                cursor[STALE] = 1
            _remember_impacts(w, rows, remembering, lane)
            # Refusals in a contact say nothing of the closures.
            if mine.uncut > 0.0 and (step >= mine.uncut or _any_contact(w, rows, lane)):
                mine.uncut = 0.0
            if mine.at_row == 1:
                natural = max(natural, mine.natural)
            mine.natural = 0.0
            growth = w[rows.growth, lane] * mine.root
            mine.root = w[rows.root, lane] if event < 0 else 1.0
            mine.h = next_step(step, case.first_step, growth, natural, longest, now, mine.end)
            mine.since += 1
        call(advance, w)
        if project != 0 and restore_closures(project, w, rows, lanes, saved):
            cursor[STALE] = 1
