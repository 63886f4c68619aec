"""What the error-controlled driver works on: the queue of cases, the state of every lane, the records of their motion.

StructuredArray arrays and named tuples, which compiled code takes as they are. Python keeps them between calls of the
driver, so that a long queue needs the records of a few cases only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from jointplay.solver.arrays import FloatArray, IntArray, StructuredArray
from jointplay.solver.compiler.ir import LANES

#: Samples are written in groups of so many, beyond the end of a step: what is too many is overwritten by the next one.
GROUP = 8
#: Velocities are recorded so many times as often as the rest, the first of every so many together, then the second.
PHASES = 2
#: Cases whose records are kept: eight in hand, and as many that have ended and wait to be taken.
SLOTS = 2 * LANES

#: A case of the queue: time of its first sample (the time reached is written over it), time between samples of the
#: velocity, s; bound of the scaled error of a step; penetration within which the instant of a switch must be met, m;
#: time in which the machine moves by its own size, first and longest step, s; samples wanted; samples after which the
#: driver returns for them to be looked at; trial steps after which it counts as stalled; how it ended; samples it has;
#: its accepted steps.
CASE = np.dtype(
    [
        ("begin", np.float64), ("interval", np.float64), ("tolerance", np.float64), ("precision", np.float64),
        ("pace", np.float64), ("first_step", np.float64), ("longest_step", np.float64), ("samples", np.int64),
        ("look", np.int64), ("most_trials", np.int64), ("outcome", np.int64), ("reached", np.int64),
        ("accepted", np.int64),
    ]
)  # fmt: skip

#: A lane: time of the first sample, of the last, time, step to try, step that error control asked for before a contact
#: shortened it, the same at the end of the last contact, s; 16th root of the error of the last step; step at which
#: refusals for error began, s (0 for none), that error, 1 where the next trial is that step again; case in hand (-1 for
#: none) and the place of its records; 1 until its first step; next sample; trial steps; accepted steps since closures
#: were restored, and at the noise of the error estimate; corrections in a row that did not restore closures, and the
#: sample when they last held; 1 where the trial was shortened to a row of a table.
LANE = np.dtype(
    [
        ("begin", np.float64), ("end", np.float64), ("t", np.float64), ("h", np.float64), ("natural", np.float64),
        ("pressed", np.float64), ("root", np.float64),
        ("uncut", np.float64), ("uncut_error", np.float64), ("over", np.int64),
        ("case", np.int64), ("slot", np.int64), ("fresh", np.int64), ("sample", np.int64), ("trials", np.int64),
        ("since", np.int64), ("forced", np.int64), ("lost", np.int64), ("held_at", np.int64), ("at_row", np.int64),
    ]
)  # fmt: skip


class Queue(NamedTuple):
    """The cases.

    Attributes
    ----------
    cases : (cases,) array of CASE
    starts : (cases, 2 n + m) array
        Coordinates, velocities and what is remembered at the start; those at the end are written over them.
    parameters : (cases, k) array
        Lane parameters.
    rows : (r,) array
        Times of the rows of the model's tables, growing, s.
    """

    cases: StructuredArray
    starts: FloatArray
    parameters: FloatArray
    rows: FloatArray


class Records(NamedTuple):
    """Recorded motion of some coordinates.

    Attributes
    ----------
    channels : (r,) array of int
        Coordinates.
    head : int
        Places left free before the first velocity of each phase.
    velocities : (slots, r, PHASES, head + reduced samples + GROUP) array
        By phase, see :func:`jointplay.solver.spectra.sampling.phases`.
    coordinates, accelerations : (slots, r, reduced samples + GROUP) arrays
        With no slots where they are not wanted.
    memories : (slots, m, reduced samples + GROUP) array
        What contacts remember, where the coordinates are wanted.
    """

    channels: IntArray
    head: int
    velocities: FloatArray
    coordinates: FloatArray
    accelerations: FloatArray
    memories: FloatArray


class Lanes(NamedTuple):
    """Where the driver is.

    Attributes
    ----------
    lanes : (LANES,) array of LANE
    saved : (2 n, LANES) array
        Coordinates and velocities before a correction.
    remembering : (m,) array of int
        Contacts whose law remembers.
    rubbing : (k,) array of int
        Contact of each pair of surfaces that can stick, -1 for guides without clearance.
    free : (slots,) array of int
        Stack of free slots.
    ended : (slots, 2) array of int
        Cases that ended and their slots.
    cursor : (5,) array of int
        Next case; lanes at work; free slots; ended cases; whether the slopes at the start of the step are to be
        computed.
    """

    lanes: StructuredArray
    saved: FloatArray
    remembering: IntArray
    rubbing: IntArray
    free: IntArray
    ended: IntArray
    cursor: IntArray


#: Places in :attr:`Lanes.cursor`.
NEXT, BUSY, FREE, ENDED, STALE = range(5)


def idle_lanes(n: int, remembering: IntArray, rubbing: IntArray, slots: int) -> Lanes:
    """Lanes without work.

    Parameters
    ----------
    n : int
        Coordinates.
    remembering, rubbing : array of int
        See :class:`Lanes`.
    slots : int
        Places for records; at least one more than lanes lets all of them work.
    """
    lanes = np.zeros(LANES, LANE)
    lanes["case"] = -1
    cursor = np.zeros(5, dtype=np.int64)
    cursor[FREE], cursor[STALE] = slots, 1
    return Lanes(
        lanes, np.zeros((2 * n, LANES)), remembering, rubbing,
        np.arange(slots)[::-1].copy(),
        np.zeros((slots, 2), dtype=np.int64), cursor,
    )  # fmt: skip


def empty_records(
    channels: IntArray,
    head: int,
    slots: int,
    samples: int,
    memories: int,
    motion: bool,
) -> Records:
    """Records for `slots` cases of up to `samples` samples; without `motion` of their velocities alone."""
    reduced = (slots if motion else 0, len(channels), -(-samples // PHASES) + GROUP)
    velocities = np.zeros((slots, len(channels), PHASES, head + reduced[2]))
    remembered = np.zeros((reduced[0], memories, reduced[2]))
    return Records(channels, head, velocities, np.zeros(reduced), np.zeros(reduced), remembered)
