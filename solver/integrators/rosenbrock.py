"""One error-controlled implicit step as straight-line code: a Rosenbrock method of orders 4 and 3, with dense output.

For scenes in which something settles or swings so fast that explicit steps would follow nothing else. Coefficients:
RODASP of G. Steinebach (Order reduction of ROW methods for DAEs and method of lines applications, Preprint 1741, TH
Darmstadt, 1995), in the form of E. Hairer and G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., IV.7;
L-stable, as its embedded method is. With y = (z, v, x), x the deflections of bristles, J and f_t the derivatives of
y' = f(t, y) at the start of a step h, and g = 1 / (GAMMA h), stages are

    (g - J) k_i = f(t + c_i h, y + sum a_ij k_j) + sum C_ij k_j / h + d_i h f_t.

The step ends at the state of the last stage plus its k, which is also the error. As z' = v, and as x' follows from z
and v alone, what is left to solve is a system of the n velocities.

A step takes and leaves the rows of :mod:`jointplay.solver.integrators.dopri`; the driver is the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from jointplay.solver.compiler.ir import Block
from jointplay.solver.compiler.rows import WorkRows, work_rows
from jointplay.solver.equations.friction import RETARDATION
from jointplay.solver.equations.model import Model
from jointplay.solver.integrators.dopri import DENSE_ROWS, combination, deflection_rate, leave_error

_GAMMA = 0.25
_NODES = (0.0, 0.75, 0.21, 0.63, 1.0, 1.0)
_DRIFTS = (0.25, -0.5, -0.023504, -0.0362, 0.0, 0.0)
_LAST = (-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401)
_STAGES: tuple[tuple[float, ...], ...] = (
    (),
    (3.0,),
    (1.831036793486759, 0.4955183967433795),
    (2.304376582692669, -0.05249275245743001, -1.176798761832782),
    _LAST,
    (*_LAST, 1.0),
)
_COUPLING: tuple[tuple[float, ...], ...] = (
    (),
    (-12.0,),
    (-8.791795173947035, -2.207865586973518),
    (10.81793056857153, 6.780270611428266, 19.53485944642410),
    (34.19095006749676, 15.49671153725963, 54.74760875964130, 14.16005392148534),
    (34.62605830930532, 15.30084976114473, 56.99955578662667, 18.40807009793095, -5.714285714285717),
)
_DENSE = (
    (25.09876703708589, 11.62013104361867, 28.49148307714626, -5.664021568594133),
    (1.638054557396973, -0.7373619806678748, 8.477918219238990, 15.99253148779520, -1.882352941176471),
)


def jacobian_of(model: Model) -> ca.SX:
    """Derivatives of z'' and x' by z, v, x and t, column by column, as one column; contacts and slips held."""
    slips, k = model.memory[model.memory.shape[0] - len(model.bristles.contacts) :], len(model.bristles.contacts)
    rates = (1 - slips**2) / RETARDATION * model.bristles.pull if k else ca.SX(0, 1)
    by = ca.vertcat(model.z, model.v, *model.bristles.deflections, model.t)
    return ca.vec(ca.densify(ca.jacobian(ca.vertcat(model.held_acceleration, rates), by)))


def rosenbrock_rows(model: Model, recorded: int) -> WorkRows[range]:
    """Work array of the implicit step, with dense output of so many coordinates."""
    n, contacts, bristles = model.size, len(model.contacts), len(model.bristles.contacts)
    return work_rows(
        n, len(model.parameters), len(model.remembering), bristles,
        touching=contacts, switch=contacts, penetration=contacts, approach=contacts, begun=3 * contacts,
        suspect=1, taken=1, error=1, growth=1, size=1, pace=1, strictness=1, root=1,
        stage_pulls=bristles, slopes=n, last_slopes=n, dense=2 * DENSE_ROWS * recorded,
        jacobian=(n + bristles) * (2 * n + bristles + 1),
    )  # fmt: skip


class _Factors:
    """Elimination with a choice of pivots by neighbours, lane by lane: of two rows the one with the larger leading
    element stays above (D. C. Sorensen, IEEE Trans. Computers 34 (1985) 274). Selects, no branches.
    """

    def __init__(self, block: Block, matrix: list[list[str]]) -> None:
        self.block, self.upper = block, [list(row) for row in matrix]
        self.steps: list[tuple[int, int, str, str]] = []
        self.inverses: list[str] = []
        rows, size = self.upper, len(matrix)
        for k in range(size):
            for i in range(k + 1, size):
                swap = block.compare("ogt", block.call("fabs", rows[i][k]), block.call("fabs", rows[k][k]))
                for j in range(k, size):
                    rows[k][j], rows[i][j] = self._ordered(swap, rows[k][j], rows[i][j])
                factor = block.neg(block.div(rows[i][k], rows[k][k]))
                for j in range(k + 1, size):
                    rows[i][j] = block.fma(factor, rows[k][j], rows[i][j])
                self.steps.append((k, i, swap, factor))
            self.inverses.append(block.div(block.constant(1.0), rows[k][k]))

    def _ordered(self, swap: str, above: str, below: str) -> tuple[str, str]:
        return self.block.select(swap, below, above), self.block.select(swap, above, below)

    def solve(self, right: list[str]) -> list[str]:
        """Solution for one right side."""
        block, x = self.block, list(right)
        for k, i, swap, factor in self.steps:
            x[k], below = self._ordered(swap, x[k], x[i])
            x[i] = block.fma(factor, x[k], below)
        for k in reversed(range(len(x))):
            for j in range(k + 1, len(x)):
                x[k] = block.sub(x[k], block.mul(self.upper[k][j], x[j]))
            x[k] = block.mul(x[k], self.inverses[k])
        return x


def _dot(block: Block, start: str, row: Sequence[str], column: Sequence[str]) -> str:
    for a, b in zip(row, column, strict=True):
        start = block.fma(a, b, start)
    return start


def rosenbrock_step(
    rows: WorkRows[range], recorded: Sequence[int], scales: Sequence[float], rates: Sequence[float]
) -> str:
    """``rosenbrock``: a trial step.

    Parameters
    ----------
    rows, recorded, scales
        As :func:`jointplay.solver.integrators.dopri.dopri_step`.
    rates : sequence of float
        Sizes that errors of velocities times the case's pace are compared with; n numbers.
    """
    z, v, kept, bristles = rows.z, rows.v, rows.kept, rows.bristles
    n, k = len(z), len(bristles)
    block = Block()
    h, t = block.load(rows.step[0]), block.load(rows.time[0])
    short = block.mul(block.constant(_GAMMA), h)  # 1 / g
    rate, per_step = block.div(block.constant(1.0), short), block.div(block.constant(1.0), h)
    for place, source in ((kept, (*z, *v)), (rows.kept_bristles, bristles)):
        for to, row in zip(place, source, strict=True):
            block.store(to, block.load(row))
    start = [block.load(row) for row in (*z, *v, *bristles)]
    block.invoke("jacobian")
    height = n + k
    entry = [[block.load(rows.jacobian[height * j + i]) for j in range(2 * n + k + 1)] for i in range(height)]
    by_z, by_v, by_x = ([row[a:b] for row in entry] for a, b in ((0, n), (n, 2 * n), (2 * n, 2 * n + k)))
    # Through z = (v + r_z) / g, then through x: what velocities do to accelerations in the end.
    through = [[block.fma(short, by_z[i][j], by_v[i][j]) for j in range(n)] for i in range(height)]
    matrix = []
    for i in range(n):
        held = [block.mul(short, by_x[i][m]) for m in range(k)]
        line = [_dot(block, through[i][j], held, [through[n + m][j] for m in range(k)]) for j in range(n)]
        matrix.append([block.sub(rate, each) if i == j else block.neg(each) for j, each in enumerate(line)])
    factors = _Factors(block, matrix)
    found: list[list[str]] = []  # k of the stages, those of z, v and x
    for stage, node in enumerate(_NODES):
        if stage:
            state = list(start)
            for j, weight in enumerate(_STAGES[stage]):
                state = [block.fma(block.constant(weight), found[j][i], state[i]) for i in range(len(state))]
            for row, value in zip((*z, *v, *bristles), state, strict=True):
                block.store(row, value)
            block.store(rows.time[0], block.fma(block.constant(node), h, t))
            block.invoke("held")
        speeds = state[n : 2 * n] if stage else start[n : 2 * n]
        slopes, pulls = (rows.a, rows.pull) if stage else (rows.slopes, rows.stage_pulls)
        values = [*speeds, *(block.load(row) for row in slopes)]
        values += [deflection_rate(block, block.load(rows.slips[m]), block.load(pulls[m])) for m in range(k)]
        if stage:
            parts = ([earlier[i] for earlier in found] for i in range(len(values)))
            back = [combination(block, _COUPLING[stage], part) for part in parts]
            values = [block.fma(per_step, past, value) for past, value in zip(back, values, strict=True)]
        if _DRIFTS[stage]:
            drift = block.mul(block.constant(_DRIFTS[stage]), h)
            values[n:] = [block.fma(drift, row[-1], value) for row, value in zip(entry, values[n:], strict=True)]
        behind = [block.mul(short, value) for value in values[:n]]
        bent = [block.mul(short, _dot(block, values[2 * n + m], by_z[n + m], behind)) for m in range(k)]
        right = [_dot(block, _dot(block, values[n + i], by_z[i], behind), by_x[i], bent) for i in range(n)]
        velocities = factors.solve(right)
        places = [block.fma(short, velocities[i], behind[i]) for i in range(n)]
        held = [_dot(block, bent[m], [block.mul(short, e) for e in through[n + m]], velocities) for m in range(k)]
        found.append([*places, *velocities, *held])
    error = found[-1]
    for row, at, each in zip((*z, *v, *bristles), state, error, strict=True):
        block.store(row, block.add(at, each))
    block.invoke("held")
    for to, row in zip(rows.last_slopes, rows.a, strict=True):
        block.store(to, block.load(row))
    # A sum, not the largest: what is no number stays none.
    sums = []
    for part, sizes in ((error[:n], scales), (error[n : 2 * n], rates)):
        scaled = [block.mul(each, block.constant(1 / size)) for each, size in zip(part, sizes, strict=True)]
        sums.append(block.call("sqrt", _dot(block, block.constant(0.0), scaled, scaled)))
    total = block.fma(sums[1], block.load(rows.pace[0]), sums[0])
    total = block.mul(total, block.load(rows.strictness[0]))
    leave_error(block, rows, total)
    dense = iter(rows.dense)
    ends = [*z, *v]
    for i in (*recorded, *(n + i for i in recorded)):
        block.store(next(dense), block.sub(block.load(ends[i]), start[i]))
        for weights in _DENSE:
            block.store(next(dense), combination(block, weights, [each[i] for each in found[: len(weights)]]))
        block.store(next(dense), block.constant(0.0))
    return block.function("rosenbrock")
