"""One error-controlled step as straight-line code: Dormand and Prince's pair of orders 5 and 4, with dense output.

Coefficients: J. R. Dormand, P. J. Prince, J. Comp. Appl. Math. 6 (1980) 19-26; dense output of order 4 after E. Hairer,
S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.6.

Every lane has its own time and step. A step starts from rows that the last accepted step left and writes to others, so
that nothing of a rejected step survives. Which contacts push is held over the step: the right-hand side stays smooth,
and the driver (:mod:`jointplay.solver.integrators.adaptive`) looks for the switch afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from jointplay.solver.compiler.ir import Block
from jointplay.solver.compiler.rows import WorkRows, work_rows
from jointplay.solver.equations.friction import RETARDATION
from jointplay.solver.equations.model import Model
from jointplay.solver.integrators.control import SAFETY

_NODES = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
_STAGES: tuple[tuple[float, ...], ...] = (
    (),
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_ERROR = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
_DENSE = (
    -12715105075 / 11282082432, 0.0, 87487479700 / 32700410799, -10690763975 / 1880347072,
    701980252875 / 199316789632, -1453857185 / 822651844, 69997945 / 29380423,
)  # fmt: skip
_COUNT = len(_STAGES)
#: What is left of sums of coefficients that are nothing; the least of the others is 2.7e-3.
_ROUNDING = 1e-13


def _twice(weights: Sequence[float]) -> tuple[float, ...]:
    """What a sum of the stages' velocities weighs their accelerations with: velocities are sums of those."""
    sums = (
        math.fsum(weight * _STAGES[stage][j] for stage, weight in enumerate(weights) if j < len(_STAGES[stage]))
        for j in range(_COUNT - 1)
    )
    return tuple(total if abs(total) > _ROUNDING else 0.0 for total in sums)


#: Least error that step sizes are taken from.
_LEAST_ERROR = 1e-10
#: Least 16th root of an error, of 1e-4: after a step that could not be longer the next but one is not to be too short.
_LEAST_ROOT = 0.5623
#: Coefficients of the dense output of one quantity, beside its value at the start.
DENSE_ROWS = 4


def adaptive_rows(model: Model, recorded: int) -> WorkRows[range]:
    """Work array of the error-controlled step, with dense output of so many coordinates."""
    n, contacts, bristles = model.size, len(model.contacts), len(model.bristles.contacts)
    return work_rows(
        n, len(model.parameters), len(model.remembering), bristles,
        touching=contacts, switch=contacts, penetration=contacts, approach=contacts, begun=3 * contacts,
        suspect=1, taken=1, error=1, growth=1, size=1, pace=1, strictness=1, root=1,
        stage_pulls=(_COUNT - 1) * bristles,
        slopes=(_COUNT - 1) * n, last_slopes=n, dense=2 * DENSE_ROWS * recorded,
    )  # fmt: skip


def combination(block: Block, weights: Sequence[float], values: Sequence[str]) -> str:
    """Sum of the values with weights."""
    total = ""
    for weight, value in zip(weights, values, strict=True):
        if weight:
            w = block.constant(weight)
            total = block.fma(w, value, total) if total else block.mul(w, value)
    return total


def _growth(block: Block, error: str) -> tuple[str, str]:
    """SAFETY error^(-3/16), and error^(1/16): roots are single instructions, and 3/16 is near enough to 1/5."""
    root = block.call("maxnum", error, block.constant(_LEAST_ERROR))
    for _ in range(4):
        root = block.call("sqrt", root)
    return block.div(block.constant(SAFETY), block.mul(block.mul(root, root), root)), block.call(
        "maxnum", root, block.constant(_LEAST_ROOT)
    )


def leave_error(block: Block, rows: WorkRows[range], error: str) -> None:
    """Store the error of a step, what the next one may grow by, and the size of the state that was reached."""
    block.store(rows.error[0], error)
    growth, root = _growth(block, error)
    block.store(rows.growth[0], growth)
    block.store(rows.root[0], root)
    size = block.constant(0.0)
    for row in (*rows.z, *rows.v):
        size = block.add(size, block.call("fabs", block.load(row)))
    block.store(rows.size[0], size)


def deflection_rate(block: Block, slips: str, pull: str) -> str:
    """Rate of a bristle's deflection, 1/s: its pull over the retardation at rest, nothing while it slips."""
    holds = block.sub(block.constant(1.0), block.mul(slips, slips))
    return block.mul(block.mul(holds, block.constant(1 / RETARDATION)), pull)


def dopri_step(rows: WorkRows[range], recorded: Sequence[int], scales: Sequence[float]) -> str:
    """``dopri``: a trial step from (z, v, first slopes) with the step and time rows.

    Parameters
    ----------
    rows : WorkRows
        As :func:`adaptive_rows` has them.
    recorded : sequence of int
        Coordinates with dense output.
    scales : sequence of float
        Sizes of the coordinates that errors are compared with; n numbers.
    """
    z, v, a, kept = rows.z, rows.v, rows.a, rows.kept
    n = len(z)
    block = Block()
    h, t = block.load(rows.step[0]), block.load(rows.time[0])
    square = block.mul(h, h)
    slopes = [*(rows.slopes[n * i : n * (i + 1)] for i in range(_COUNT - 1)), rows.last_slopes]
    for i in range(n):
        block.store(kept[i], block.load(z[i]))
        block.store(kept[n + i], block.load(v[i]))
    sticking = len(rows.bristles)
    for k in range(sticking):
        block.store(rows.kept_bristles[k], block.load(rows.bristles[k]))
    for stage in range(1, _COUNT):
        weights, twice = _STAGES[stage], _twice(_STAGES[stage])
        for k in range(sticking):
            pull = combination(block, weights, [block.load(rows.stage_pulls[sticking * j + k]) for j in range(stage)])
            rate = deflection_rate(block, block.load(rows.slips[k]), pull)
            block.store(rows.bristles[k], block.fma(h, rate, block.load(rows.kept_bristles[k])))
        along = block.mul(block.constant(_NODES[stage]), h)
        for i in range(n):
            before, values = block.load(kept[n + i]), [block.load(slopes[j][i]) for j in range(stage)]
            block.store(v[i], block.fma(h, combination(block, weights, values), before))
            travel = block.fma(along, before, block.load(kept[i]))
            if stage > 1:
                travel = block.fma(square, combination(block, twice[:stage], values), travel)
            block.store(z[i], travel)
        block.store(rows.time[0], block.fma(block.constant(_NODES[stage]), h, t))
        block.invoke("held")
        for i in range(n):
            block.store(slopes[stage][i], block.load(a[i]))
        if stage < _COUNT - 1:  # those at the end are taken where they are
            for k in range(sticking):
                block.store(rows.stage_pulls[sticking * stage + k], block.load(rows.pull[k]))
    largest = [block.constant(0.0)] * 2
    for i in range(n):
        values = [block.load(slopes[j][i]) for j in range(_COUNT)]
        for k, weights in enumerate((_twice(_ERROR), _ERROR)):
            error = combination(block, weights, values[: len(weights)])
            scaled = block.mul(block.call("fabs", error), block.constant(1 / scales[i]))
            largest[k] = block.call("maxnum", largest[k], scaled)
    error = block.call("maxnum", block.mul(largest[0], h), block.mul(largest[1], block.load(rows.pace[0])))
    error = block.mul(block.mul(error, h), block.load(rows.strictness[0]))
    leave_error(block, rows, error)
    dense = iter(rows.dense)
    for first, ends, begin, end, scale, weights in (
        (kept[:n], z, kept[n:], v, square, _twice(_DENSE)), (kept[n:], v, slopes[0], slopes[-1], h, _DENSE),
    ):  # fmt: skip
        for i in recorded:
            change = block.sub(block.load(ends[i]), block.load(first[i]))
            bend = block.sub(block.mul(h, block.load(begin[i])), change)
            last = block.sub(block.sub(change, block.mul(h, block.load(end[i]))), bend)
            values = [block.load(slopes[j][i]) for j in range(len(weights))]
            quartic = block.mul(scale, combination(block, weights, values))
            for coefficient in (change, bend, last, quartic):
                block.store(next(dense), coefficient)
    return block.function("dopri")
