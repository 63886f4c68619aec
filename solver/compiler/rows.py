"""Where everything is in the work array of a kernel: one table of rows, each a number of every lane."""

from __future__ import annotations

from itertools import accumulate
from typing import Generic, NamedTuple, TypeVar

Each = TypeVar("Each")


class WorkRows(NamedTuple, Generic[Each]):
    """Something of every quantity of a work array, in the order in which they lie there.

    How many rows it has, these rows, or the first of them, which is what compiled drivers take.

    Attributes
    ----------
    time, step
        t and h, s.
    z, v, a
        Coordinates, velocities and accelerations, n rows each.
    kept
        2 n: coordinates and velocities at the start of the step; Gill's running correction of them.
    touching
        1 where a contact pushes over the step, else 0.
    switch, penetration, approach
        Switch function of contacts at the end of the step, m, penetration, m, and its rate, m/s. Gill's method has the
        last two of the contacts that remember.
    begun
        The three of them at the start of the step.
    suspect, taken
        1 in lanes in which a contact may have switched within the step, and where it was taken; else 0.
    error
        Largest scaled error of the step in parts of what is allowed.
    growth
        Next step in parts of this one, as the error wants it.
    size
        Sum of the sizes of coordinates and velocities at the end of the step.
    pace
        Given: time in which the machine moves by its own size, s; errors of velocities count times this.
    strictness
        Given: 1 / the scaled error that is allowed.
    root
        16th root of the error, which holds back the step after the next (see ``docs/explanation/solver.md``).
    slopes, last_slopes
        Accelerations of the stages, n rows each; the first are those at the start of the step, the last those at its
        end.
        Velocities of the stages between, n rows each.
    pull, stage_pulls
        What pulls at bristles in parts of their strength (:mod:`jointplay.solver.equations.friction`), k rows: at the
        state evaluated last; of all stages, those at the start of the step first.
    kept_bristles
        Deflections of bristles at the start of the step, k rows; Gill's running correction of them.
    jacobian
        Of the implicit step, column by column (:mod:`jointplay.solver.integrators.rosenbrock`).
    dense
        Dense output: four rows for each recorded coordinate, then for its velocity.
    jam
        1 once a sliding joint has jammed, where sliding joints rub.
    parameters
        Of the lane.
    memory
        What contacts remember (:mod:`jointplay.solver.equations.contact`).
    bristles, slips
        Deflections of bristles, and 1 or -1 where they slip over the step, 0 where they hold; k rows each.
    hoisted
        What depends on the parameters alone.
    """

    time: Each
    step: Each
    z: Each
    v: Each
    a: Each
    kept: Each
    touching: Each
    switch: Each
    penetration: Each
    approach: Each
    begun: Each
    suspect: Each
    taken: Each
    error: Each
    growth: Each
    size: Each
    pace: Each
    strictness: Each
    root: Each
    slopes: Each
    last_slopes: Each
    pull: Each
    stage_pulls: Each
    kept_bristles: Each
    jacobian: Each
    dense: Each
    jam: Each
    parameters: Each
    memory: Each
    bristles: Each
    slips: Each
    hoisted: Each


def work_rows(n: int, parameters: int, memories: int, bristles: int, **own: int) -> WorkRows[range]:
    """Rows of a method's work array.

    Parameters
    ----------
    n, parameters, memories, bristles : int
        Coordinates; lane parameters; contacts that remember; surfaces that can stick.
    **own : int
        Rows of the quantities that the method has beside those that every method has; of all others there are none.
    """
    counts = dict.fromkeys(WorkRows._fields, 0) | {
        "time": 1, "step": 1, "z": n, "v": n, "a": n, "kept": 2 * n, "jam": 1,
        "parameters": parameters, "memory": memories,
        "pull": bristles, "kept_bristles": bristles, "bristles": bristles, "slips": bristles,
    }  # fmt: skip
    table = WorkRows(**counts | own)
    return WorkRows(*(range(end - count, end) for count, end in zip(table, accumulate(table), strict=True)))
