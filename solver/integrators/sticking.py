"""When surfaces with bristles begin to slip, and when they are caught again (equations in
:mod:`jointplay.solver.equations.friction`).

Whether a pair slips is held over a step. It begins to where what the bristles hold, y, passes 1. Where sliding turns
round, error-controlled steps let it slip the other way first, as Coulomb's law has it: bristles that had to be bent
back before would delay every reversal. Only if the next step shows that friction then drives it back, this step is
taken again with the surfaces at rest, and bristles bent by what it takes to hold them, from both slopes.
"""

from __future__ import annotations

from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.compiler.native import inlined
from jointplay.solver.compiler.rows import WorkRows

#: Part of the bristles' strength within which the instant is met: the force then jumps by no more.
MET = 0.01


@inlined
def margin(slips: float, deflection: float, pull: float) -> float:
    """What is left until a pair changes over, in parts of the bristles' strength; negative where it should have."""
    return slips * pull if slips != 0.0 else 1.0 - abs(deflection + pull)


@inlined
def change_over(w: FloatArray, bristle: int, slips: int, pull: int, lane: int) -> bool:
    """Let one pair slip or hold from now on, as its state wants it; whether that is new.

    Parameters
    ----------
    w : array
        Work array.
    bristle, slips, pull, lane : int
        Rows of these numbers of the pair, and the lane.
    """
    if w[slips, lane] != 0.0:
        if w[slips, lane] * w[pull, lane] < 0.0:
            w[bristle, lane] = w[slips, lane]
            w[slips, lane] = 0.0
            return True
    elif abs(w[bristle, lane] + w[pull, lane]) > 1.0:
        w[slips, lane] = 1.0 if w[bristle, lane] + w[pull, lane] > 0.0 else -1.0
        return True
    return False


@inlined
def first_change(
    w: FloatArray, rows: WorkRows[int], lane: int, step: float, shortest: float, rubbing: IntArray
) -> tuple[float, bool]:
    """Step to take in place of one in which surfaces begin to slip, turn round or are caught; 0 where it may stand.

    Parameters
    ----------
    w, rows, lane
        After the step.
    step, shortest : float
        The step, and the one below which a case stalls, s.
    rubbing : (k,) array of int
        The contact of each pair, -1 for guides without clearance.

    Returns
    -------
    (float, bool)
        The step, s, and whether surfaces are at rest from its start on.
    """
    shorter = 0.0
    for j in range(rubbing.size):
        if rubbing[j] >= 0 and w[rows.touching + rubbing[j], lane] < 0.5:
            continue
        slips, pull = w[rows.slips + j, lane], w[rows.pull + j, lane]
        after = margin(slips, w[rows.bristles + j, lane], pull)
        if after >= -MET:
            continue
        turned = w[rows.kept_bristles + j, lane]
        if slips != 0.0 and turned != 0.0:
            # The pull's slopes under friction one way (as it turned) and the other; both drive it back to 0.
            back = (pull - w[rows.stage_pulls + j, lane]) / step
            w[rows.kept_bristles + j, lane] = -slips * (turned + back) / (back - turned)
            w[rows.slips + j, lane] = 0.0
            return step, True
        if step <= 1e3 * shortest:
            continue
        before = max(margin(slips, w[rows.kept_bristles + j, lane], w[rows.stage_pulls + j, lane]), 0.0)
        # Aimed a little past it, so that the step ends on its other side.
        wanted = max((before + 0.5 * MET) / (before - after), 0.001) * step
        if shorter == 0.0 or wanted < shorter:
            shorter = wanted
    return shorter, False


@inlined
def change_all(w: FloatArray, rows: WorkRows[int], lane: int, step: float, rubbing: IntArray) -> bool:
    """Let all pairs of a lane slip or hold as the state after an accepted step wants it; whether any of it is new.

    Where a pair turns round, the slope of its pull stands in place of a deflection until the next step has ended.
    """
    changed = False
    for j in range(rubbing.size):
        if rubbing[j] >= 0 and w[rows.touching + rubbing[j], lane] < 0.5:
            continue
        slips, pull = w[rows.slips + j, lane], w[rows.pull + j, lane]
        if slips * pull < 0.0:
            w[rows.slips + j, lane] = -slips
            w[rows.bristles + j, lane] = (pull - w[rows.stage_pulls + j, lane]) / step
            changed = True
        elif slips != 0.0:
            w[rows.bristles + j, lane] = 0.0
        elif change_over(w, rows.bristles + j, rows.slips + j, rows.pull + j, lane):
            w[rows.bristles + j, lane] = 0.0
            changed = True
    return changed


@inlined
def release(w: FloatArray, rows: WorkRows[int], lane: int, contact: int, rubbing: IntArray) -> None:
    """Forget what bristles of a contact that begins or ends have been bent by."""
    for j in range(rubbing.size):
        if rubbing[j] == contact:
            w[rows.bristles + j, lane] = 0.0
            w[rows.slips + j, lane] = 0.0
