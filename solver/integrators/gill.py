"""Runge-Kutta-Gill with fixed steps: the paper's integrator.

Fourth order, with Gill's running correction q of the rounding error (S. Gill, Proc. Camb. Phil. Soc. 47, 1951). Each of
the four stages is

    d = a (h f(y) - b q);  y <- y + d;  q <- q + 3 d - c h f(y_old)

with a = 1/2, 1 - sqrt(1/2), 1 + sqrt(1/2), 1/6; b = 2, 1, 1, 2; c = a, but 1/2 in the last stage.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.compiler.ir import LANES, Block
from jointplay.solver.compiler.native import compiled
from jointplay.solver.compiler.rows import WorkRows, work_rows
from jointplay.solver.equations.model import Model
from jointplay.solver.integrators.control import remember
from jointplay.solver.integrators.dopri import deflection_rate
from jointplay.solver.integrators.sticking import change_over

#: Sum of coordinates and velocities (absolute, SI) beyond which a case counts as diverged: no machine is that fast.
DIVERGED = 1e8
#: Correction of a coordinate (m, rad) that is not believed: where closures lose their rank for an instant it is noise.
LOST = 1e-3
#: Unbelieved corrections one after the other with which the closures count as lost.
PATIENCE = 20
#: How a lane stands.
RUNNING, ENDED, JAMMED = 0, 1, 2

_ROOT = math.sqrt(0.5)
#: (a, b, c, time of the stage's result in steps)
_STAGES = (
    (0.5, 2.0, 0.5, 0.5),
    (1.0 - _ROOT, 1.0, 1.0 - _ROOT, None),
    (1.0 + _ROOT, 1.0, 1.0 + _ROOT, 1.0),
    (1.0 / 6.0, 2.0, 0.5, None),
)


def gill_rows(model: Model) -> WorkRows[range]:
    """Work array of a step; penetration and approach are those of the contacts that remember or can stick."""
    memories, bristles = len(model.remembering), len(model.bristles.contacts)
    return work_rows(
        model.size, len(model.parameters), memories, bristles,
        penetration=memories, approach=memories, switch=bristles,
    )  # fmt: skip


def gill_step(rows: WorkRows[range]) -> str:
    """One step as vector code: ``void gill(double* work)``, with the first right-hand side evaluated already."""
    block = Block()
    n = len(rows.z)
    h, t = block.load(rows.step[0]), block.load(rows.time[0])
    for stage, (a, b, c, time) in enumerate(_STAGES):
        turning = [deflection_rate(block, *map(block.load, pair)) for pair in zip(rows.slips, rows.pull, strict=True)]
        # Coordinates first: their rate is the velocity that the second pass overwrites.
        for y, f, q in (
            (rows.z, rows.v, rows.kept[:n]), (rows.v, rows.a, rows.kept[n:]),
            (rows.bristles, turning, rows.kept_bristles),
        ):  # fmt: skip
            for i in range(len(y)):
                k = block.mul(h, f[i] if isinstance(f, list) else block.load(f[i]))
                kept = block.load(q[i])
                d = block.mul(block.constant(a), block.fma(block.constant(-b), kept, k))
                block.store(y[i], block.add(block.load(y[i]), d))
                kept = block.fma(block.constant(3.0), d, kept)
                block.store(q[i], block.fma(block.constant(-c), k, kept))
        if time is not None:
            block.store(rows.time[0], block.fma(block.constant(time), h, t))
        if stage < 3:
            block.invoke("rhs")
    return block.function("gill")


def _call(typing_context: Any, address: Any, work: Any) -> Any:
    """Call ``void f(double*)`` at an address with the data of the work array."""
    signature = types.void(types.int64, work)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[1])(context, builder, arguments[1])
        kind = ir.FunctionType(ir.VoidType(), [array.data.type])
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [array.data])
        return context.get_dummy_value()

    return signature, generate


#: ``call(address, work)`` inside compiled code.
call: Any = intrinsic(_call)


@compiled
def _remember(w: FloatArray, rows: WorkRows[int]) -> None:
    """Memories of all lanes after the right-hand side of an accepted state.

    It need not be evaluated again: with nothing remembered it took the same velocity that is remembered now.
    """
    for m in range(rows.bristles - rows.memory):
        for lane in range(LANES):
            remember(w, rows.memory + m, rows.penetration + m, rows.approach + m, lane)
    for j in range(rows.slips - rows.bristles):
        for lane in range(LANES):
            if w[rows.switch + j, lane] > 0.0:
                change_over(w, rows.bristles + j, rows.slips + j, rows.pull + j, lane)
            else:
                w[rows.bristles + j, lane] = w[rows.slips + j, lane] = 0.0


@compiled
def _note(w: FloatArray, rows: WorkRows[int], lane: int, how: int, finals: FloatArray) -> None:
    """Keep how a lane has ended, its time and its state."""
    finals[lane, 0] = how
    finals[lane, 1] = w[rows.time, lane]
    finals[lane, 2:] = w[rows.z : rows.a, lane]


@compiled
def _note_jams(w: FloatArray, rows: WorkRows[int], finals: FloatArray) -> None:
    """Keep time and state of lanes that have just jammed."""
    for lane in range(LANES):
        if finals[lane, 0] == RUNNING and w[rows.jam, lane] > 0.5:
            _note(w, rows, lane, JAMMED, finals)


@compiled
def integrate(
    kernel: tuple[int, int, int, int], w: FloatArray, rows: WorkRows[int], begins: FloatArray, h: float,
    substeps: int, record: IntArray, out: FloatArray, broken: IntArray,
    counts: IntArray, finals: FloatArray,
) -> None:  # fmt: skip
    """Integrate one group of lanes with a fixed step and record samples.

    Parameters
    ----------
    kernel : tuple of int
        Addresses of the kernel's ``prepare``, ``rhs``, ``gill`` and ``project``; the last 0 for none.
    w : (rows, LANES) array
        Work array with parameters, coordinates and velocities at the start.
    rows : WorkRows of int
        Its first rows.
    begins : (LANES,) array
        Time of the first sample, s.
    h : float
        Step, s.
    substeps : int
        Steps from sample to sample; closures are restored at every sample.
    record : (r,) array of int
        Rows to record.
    out : (LANES, r, samples) array
        Filled in.
    broken : (LANES,) array of int
        First sample at which a lane had jammed or was no longer finite, else -1; filled in.
    counts : (LANES,) array of int
        Samples wanted of every lane.
    finals : (LANES, 2 + 2 n) array
        :data:`JAMMED`, :data:`ENDED` or :data:`RUNNING`; time, coordinates and velocities there or at the last sample;
        filled in.

    Notes
    -----
    Compiled without the fast-math flags of the right-hand side: this is where non-finite numbers are looked for.
    """
    prepare, rhs, gill, project = kernel
    samples, n = out.shape[2], rows.v - rows.z
    call(prepare, w)
    before = np.zeros((2 * n, LANES))
    lost = np.zeros(LANES, dtype=np.int64)
    for lane in range(LANES):
        broken[lane] = -1
    w[rows.step] = h
    w[rows.kept : rows.kept + 2 * n] = 0.0  # nothing to correct yet
    w[rows.kept_bristles : rows.kept_bristles + rows.slips - rows.bristles] = 0.0
    w[rows.jam] = 0.0
    finals[:] = RUNNING
    for s in range(samples):
        for lane in range(LANES):
            w[rows.time, lane] = begins[lane] + s * substeps * h
        call(rhs, w)
        _remember(w, rows)
        alive = 0
        _note_jams(w, rows, finals)
        for lane in range(LANES):
            if s + 1 == counts[lane] and finals[lane, 0] == RUNNING:
                _note(w, rows, lane, ENDED, finals)
            size = 0.0
            for i in range(rows.z, rows.a):
                size += abs(w[i, lane])
            for i in range(rows.a, rows.a + n):
                size += 0.0 * w[i, lane]  # nothing, or no number
            if broken[lane] < 0:
                if size < DIVERGED and lost[lane] < PATIENCE and finals[lane, 0] != JAMMED:
                    alive += 1
                else:
                    broken[lane] = max(0, s - lost[lane])
        for r in range(record.size):
            for lane in range(LANES):
                out[lane, r, s] = w[record[r], lane]
        if alive == 0 or s + 1 == samples:
            return
        for k in range(substeps):
            if k > 0:
                for lane in range(LANES):
                    w[rows.time, lane] = begins[lane] + (s * substeps + k) * h
                call(rhs, w)
                _remember(w, rows)
            call(gill, w)
            _note_jams(w, rows, finals)
        if project != 0:
            before[:] = w[rows.z : rows.a]
            call(project, w)
            for lane in range(LANES):
                moved = 0.0
                for i in range(n):
                    moved += abs(w[rows.z + i, lane] - before[i, lane])
                if moved < LOST:  # false for a correction that is no number
                    lost[lane] = 0
                else:
                    lost[lane] += 1
                    w[rows.z : rows.a, lane] = before[:, lane]


@compiled
def repeat(kernel: tuple[int, int, int, int], w: FloatArray, count: int) -> None:
    """The right-hand side alone, `count` times; for benchmarks."""
    call(kernel[0], w)
    for _ in range(count):
        call(kernel[1], w)
