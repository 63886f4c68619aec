"""Cases into lanes and out of them, and the closures of lanes that are due restored."""

from __future__ import annotations

import numpy as np

from jointplay.solver.arrays import FloatArray, IntArray, StructuredArray
from jointplay.solver.compiler.compiled import compiled, inlined
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.compiler.rows import Rows
from jointplay.solver.integrators.control import (
    CAUTION,
    PROJECT_EVERY,
)
from jointplay.solver.integrators.gill import LOST, call
from jointplay.solver.integrators.lanes import BUSY, ENDED, FREE, NEXT


@compiled
def load(
    w: FloatArray, rows: Rows[int], cases: StructuredArray, starts: FloatArray, parameters: FloatArray,
    lanes: StructuredArray, remembering: IntArray, free: IntArray, cursor: IntArray,
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
        for m in range(remembering.size):
            w[rows.memory + m, lane] = starts[c, 2 * n + m]
        cursor[NEXT] += 1
        cursor[BUSY] += 1
        loaded += 1
    return loaded


@inlined
def put_away(
    w: FloatArray, rows: Rows[int], lane: int, outcome: int, reached: int, cases: StructuredArray, starts: FloatArray,
    lanes: StructuredArray, ended: IntArray, cursor: IntArray,
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
def restore_closures(project: int, w: FloatArray, rows: Rows[int], lanes: StructuredArray, saved: FloatArray) -> bool:
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
