"""Error-controlled integration in lanes: every lane its own time, step and case.

A trial step is computed for all lanes at once; each lane then accepts it, refuses it, or shortens it to end where a
contact begins or ends to push. A lane whose case has ended takes the next one from the queue.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
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
    SAFETY,
    SHORTEST,
    SHRINK,
    STALLED,
    crossing,
    remember,
)
from solver.gill import DIVERGED, LOST, PATIENCE, call
from solver.ir import LANES

Array = NDArray[np.float64]

_crossing = njit(cache=True, error_model="numpy")(crossing)
_remember_one = njit(cache=True, error_model="numpy")(remember)


@njit(cache=True, error_model="numpy")
def _remember(w: Array, memory: int, contact: int, penetration: int, approach: int, lane: int) -> None:
    """Bring one memory of a lane up to date with an accepted state; rows in place of places."""
    rows = (penetration + contact) * LANES, (approach + contact) * LANES
    _remember_one(w, memory * LANES + lane, rows[0] + lane, rows[1] + lane)


@njit(cache=True, error_model="numpy", nogil=True)
def integrate(
    kernel: tuple[int, int, int, int],
    w: Array,
    n: int,
    contacts: int,
    recorded: NDArray[np.int64],
    remembering: NDArray[np.int64],
    parameter_row: int,
    jam: int,
    starts: Array,
    parameters: Array,
    ends: NDArray[np.int64],
    interval: float,
    tolerance: float,
    precision: float,
    first_steps: Array,
    longest_steps: Array,
    most_steps: NDArray[np.int64],
    oversampling: int,
    coordinates: Array,
    velocities: Array,
    accelerations: Array,
    memories: Array,
    outcome: NDArray[np.int64],
    reached: NDArray[np.int64],
    accepted: NDArray[np.int64],
    finals: Array,
) -> None:
    """Integrate a queue of cases of one model.

    Parameters
    ----------
    kernel : tuple of int
        Addresses of ``prepare``, ``held``, ``dopri`` and ``project`` (0 for none).
    w : (total,) array
        Work array.
    n, contacts : int
        Coordinates, clearance joints.
    recorded : (r,) array of int
        Coordinates with dense output.
    remembering : (m,) array of int
        Clearance joints whose law remembers.
    parameter_row : int
        Row of the first lane parameter; those of the memories follow the last.
    jam : int
        Row that says whether sliding joints jammed within a step, -1 where none rubs.
    starts : (cases, 2 n) array
        Coordinates and velocities.
    parameters : (cases, k) array
    ends : (cases,) array of int
        Samples wanted of every case.
    interval : float
        Time between samples, s.
    tolerance : float
        Bound of the scaled error of a step.
    precision : float
        Penetration within which the instant of a switch must be met, m.
    first_steps, longest_steps : (cases,) arrays
        s.
    most_steps : (cases,) array of int
        Trial steps of a case after which it counts as stalled.
    oversampling : int
        Coordinates and accelerations are recorded at every so many samples.
    coordinates, velocities, accelerations : (cases, r, samples) arrays
        Filled in.
    memories : (cases, m, samples) array
        What the contacts remember, recorded as the coordinates; filled in.
    outcome, reached : (cases,) arrays of int
        How each case ended, and the samples it has; filled in.
    accepted : (cases,) array of int
        Accepted steps of each case; filled in.
    finals : (cases, 1 + 2 n) array
        Time, coordinates and velocities with which each case ended; filled in.
    """
    prepare, held, dopri, project = kernel
    cases, channels = starts.shape[0], recorded.size
    rows = 2 + 5 * n
    touching, switch = rows, rows + contacts
    penetration, approach = rows + 2 * contacts, rows + 3 * contacts
    error = rows + 4 * contacts
    slopes = error + 1
    last = slopes + 6 * n
    dense = slopes + 12 * n
    kept = 2 + 3 * n
    memory = parameter_row + parameters.shape[1]
    case = np.full(LANES, -1)
    t = np.zeros(LANES)
    h = np.zeros(LANES)
    natural = np.zeros(LANES)
    sample = np.zeros(LANES, dtype=np.int64)
    trials = np.zeros(LANES, dtype=np.int64)
    steps = np.zeros(LANES, dtype=np.int64)
    forced = np.zeros(LANES, dtype=np.int64)
    lost = np.zeros(LANES, dtype=np.int64)
    held_at = np.zeros(LANES, dtype=np.int64)  # samples when the closures last held
    old = np.zeros((3, max(1, contacts), LANES))
    saved = np.zeros(2 * n * LANES)
    following = 0
    busy = 0
    stale = True  # slopes at the start of the step must be computed
    loading = True
    while True:
        if loading:
            for lane in range(LANES):
                if case[lane] >= 0 or following >= cases:
                    continue
                case[lane] = following
                t[lane], h[lane], natural[lane], sample[lane] = 0.0, first_steps[following], 0.0, 0
                trials[lane], steps[lane], forced[lane], lost[lane] = 0, 0, 0, 0
                held_at[lane] = 0
                for i in range(2 * n):
                    w[(2 + i) * LANES + lane] = starts[following, i]
                for i in range(parameters.shape[1]):
                    w[(parameter_row + i) * LANES + lane] = parameters[following, i]
                for j in range(contacts):
                    w[(touching + j) * LANES + lane] = 0.0
                for m in range(remembering.size):
                    w[(memory + m) * LANES + lane] = 0.0
                following += 1
                busy += 1
            call(prepare, w)
            for lane in range(LANES):
                w[lane] = t[lane]
            call(held, w)
            # Whether a contact pushes at the start follows from the switch, which does not depend on the assumption.
            for lane in range(LANES):
                if case[lane] >= 0 and sample[lane] == 0 and t[lane] == 0.0:
                    for j in range(contacts):
                        w[(touching + j) * LANES + lane] = 1.0 if w[(switch + j) * LANES + lane] > 0.0 else 0.0
                    for m in range(remembering.size):  # a contact at the start begins there
                        _remember(w, memory + m, remembering[m], penetration, approach, lane)
            loading, stale = False, True
        if busy == 0:
            return
        if stale:
            for lane in range(LANES):
                w[lane] = t[lane]
            call(held, w)
            for i in range(n * LANES):
                w[slopes * LANES + i] = w[(2 + 2 * n) * LANES + i]
            for j in range(contacts):
                for lane in range(LANES):
                    old[0, j, lane] = w[(penetration + j) * LANES + lane]
                    old[1, j, lane] = w[(approach + j) * LANES + lane]
                    old[2, j, lane] = w[(switch + j) * LANES + lane]
            stale = False
        for lane in range(LANES):
            w[lane] = t[lane]
            w[LANES + lane] = h[lane] if case[lane] >= 0 else 0.0
            if jam >= 0:
                w[jam * LANES + lane] = 0.0
        call(dopri, w)
        for lane in range(LANES):
            c = case[lane]
            if c < 0:
                continue
            trials[lane] += 1
            e = w[error * LANES + lane] / tolerance
            step = h[lane]
            jammed = jam >= 0 and w[jam * LANES + lane] > 0.5
            accept = e <= 1.0 and not jammed  # false for a number that is none
            noise = not accept and not jammed and e < math.inf and step <= FLOOR * first_steps[c]
            if noise and forced[lane] < MOST_FORCED:
                # Where closures lose their rank for an instant the estimate is rounding noise that no step removes.
                accept = True
                forced[lane] += 1
                e = 1.0
            event = -1
            part = 1.0
            if accept:
                for j in range(contacts):
                    s1 = w[(switch + j) * LANES + lane]
                    p1, r1 = w[(penetration + j) * LANES + lane], w[(approach + j) * LANES + lane]
                    pushes = w[(touching + j) * LANES + lane] > 0.5
                    where = 2.0
                    if pushes and s1 < 0.0:
                        s0 = old[2, j, lane]
                        where = s0 / (s0 - s1) if s0 > 0.0 else 0.5
                    elif not pushes and (s1 > 0.0 or old[1, j, lane] > 0.0 > r1):
                        # Also where both ends are open but the pair came near and went: it may have touched in between.
                        if old[0, j, lane] < 0.0:
                            where = _crossing(old[0, j, lane], step * old[1, j, lane], p1, step * r1)
                        elif s1 > 0.0:  # still inside after its force had gone: pressed in again
                            s0 = old[2, j, lane]
                            where = s0 / (s0 - s1) if s0 < 0.0 else 0.5
                    if where <= 1.0 and (event < 0 or where < part):
                        event, part = j, where
                if event >= 0:
                    s1 = w[(switch + event) * LANES + lane]
                    flipped = (s1 > 0.0) != (w[(touching + event) * LANES + lane] > 0.5)
                    met = flipped and abs(s1) <= precision
                    if not met and step > 1e3 * SHORTEST * (t[lane] + interval) and abs(part - 1.0) > 1e-9:
                        # Shorten, aiming a little past the switch.
                        accept = False
                        if natural[lane] < step:
                            natural[lane] = step
                        speed = abs(w[(approach + event) * LANES + lane]) + 1e-12
                        h[lane] = min(0.999 * step, part * step + PAST * precision / speed)
                        if h[lane] < 0.001 * step:
                            h[lane] = 0.001 * step
            else:
                if jammed or not (e < math.inf):
                    h[lane] = 0.1 * step
                else:
                    h[lane] = step * max(SHRINK, SAFETY / e**0.2)
                natural[lane] = h[lane]
                # Near a loss of rank it is the drift of the closures that spoils the accelerations.
                steps[lane] = PROJECT_EVERY
                event = -1
            if not accept:
                for i in range(2 * n):
                    w[(2 + i) * LANES + lane] = w[(kept + i) * LANES + lane]
                if h[lane] < SHORTEST * (t[lane] + interval) or trials[lane] > most_steps[c]:
                    outcome[c], reached[c] = JAMMED if jammed else STALLED, sample[lane]
                    finals[c, 0] = t[lane]
                    for i in range(2 * n):
                        finals[c, 1 + i] = w[(2 + i) * LANES + lane]
                    case[lane] = -1
                    busy -= 1
                    loading = loading or following < cases
                continue
            accepted[c] += 1
            size = 0.0
            for i in range(n):
                size += abs(w[(2 + i) * LANES + lane]) + abs(w[(2 + n + i) * LANES + lane])
            broken = not (size < DIVERGED) or lost[lane] >= PATIENCE
            now = t[lane] + step
            while not broken and sample[lane] < ends[c] and sample[lane] * interval <= now:
                x = (sample[lane] * interval - t[lane]) / step
                y = 1.0 - x
                for r in range(channels):
                    base = (dense + 4 * (channels + r)) * LANES + lane
                    c2, c3, c4, c5 = w[base], w[base + LANES], w[base + 2 * LANES], w[base + 3 * LANES]
                    start = w[(kept + n + recorded[r]) * LANES + lane]
                    velocities[c, r, sample[lane]] = start + x * (c2 + y * (c3 + x * (c4 + y * c5)))
                    if sample[lane] % oversampling == 0:
                        inner = c4 + y * c5
                        middle = c3 + x * inner
                        slope = c2 + y * middle - x * middle + x * y * (inner - x * c5)
                        accelerations[c, r, sample[lane] // oversampling] = slope / step
                        base = (dense + 4 * r) * LANES + lane
                        c2, c3, c4, c5 = w[base], w[base + LANES], w[base + 2 * LANES], w[base + 3 * LANES]
                        start = w[(kept + recorded[r]) * LANES + lane]
                        coordinates[c, r, sample[lane] // oversampling] = start + x * (
                            c2 + y * (c3 + x * (c4 + y * c5))
                        )
                if sample[lane] % oversampling == 0:
                    for m in range(remembering.size):
                        memories[c, m, sample[lane] // oversampling] = w[(memory + m) * LANES + lane]
                sample[lane] += 1
            t[lane] = now
            if broken or sample[lane] >= ends[c]:
                outcome[c] = DIVERGING if broken else OK
                finals[c, 0] = now
                for i in range(2 * n):
                    finals[c, 1 + i] = w[(2 + i) * LANES + lane]
                reached[c] = held_at[lane] if lost[lane] >= PATIENCE else sample[lane]
                case[lane] = -1
                busy -= 1
                loading = loading or following < cases
                continue
            for i in range(n):
                w[(slopes + i) * LANES + lane] = w[(last + i) * LANES + lane]
            for j in range(contacts):
                old[0, j, lane] = w[(penetration + j) * LANES + lane]
                old[1, j, lane] = w[(approach + j) * LANES + lane]
                old[2, j, lane] = w[(switch + j) * LANES + lane]
            grown = step * min(GROW, SAFETY / max(e, 1e-10) ** 0.2)
            if step <= FLOOR * first_steps[c]:
                grown = GROW * step
            if event >= 0:
                w[(touching + event) * LANES + lane] = 1.0 - w[(touching + event) * LANES + lane]
                stale = True
                grown = max(grown, natural[lane])
            for m in range(remembering.size):
                _remember(w, memory + m, remembering[m], penetration, approach, lane)
            natural[lane] = 0.0
            h[lane] = min(grown, longest_steps[c])
            steps[lane] += 1
        if project == 0:
            continue
        # Closures are restored every so many steps of a lane; the others are left exactly as they are, so that no
        # result depends on which cases run beside it.
        due = False
        for lane in range(LANES):
            due = due or (case[lane] >= 0 and steps[lane] >= PROJECT_EVERY)
        if not due:
            continue
        for i in range(2 * n * LANES):
            saved[i] = w[2 * LANES + i]
        for lane in range(LANES):
            w[lane] = t[lane]
        call(project, w)
        for lane in range(LANES):
            moved = LOST
            if case[lane] >= 0 and steps[lane] >= PROJECT_EVERY:
                steps[lane] = 0
                moved = 0.0
                for i in range(n):
                    moved += abs(w[(2 + i) * LANES + lane] - saved[i * LANES + lane])
                if moved < LOST:
                    lost[lane], held_at[lane] = 0, sample[lane]
                else:  # also a correction that is no number
                    lost[lane] += 1
            if not (moved < LOST):
                for i in range(2 * n):
                    w[(2 + i) * LANES + lane] = saved[i * LANES + lane]
        stale = True
