"""Samples of a step's dense output, written in groups by vector instructions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from solver.compiler.compiled import compiled, inlined
from solver.compiler.ir import LANES
from solver.integrators.lanes import GROUP

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@compiled
def samples_until(now: float, begin: float, interval: float, first: int, count: int) -> int:
    """One past the last of the samples `first` ... `count` - 1 that is not later than `now`."""
    last = int((now - begin) / interval) + 1
    while begin + last * interval <= now:
        last += 1
    while last > first and begin + (last - 1) * interval > now:
        last -= 1
    return max(first, min(last, count))


def _group(formula: Callable[[Any, Any, Any, list[Any]], Any]) -> Any:
    """Compiled code that writes one group of samples: ``(w, at, out, where, start, scale, x0, dx)``.

    `formula` makes vector instructions for the value at x of the step from x, 1 - x and, in all elements, the
    polynomial's five coefficients: `start` and those in `w` from `at`, a row apart. The result times `scale` goes to
    ``out.flat[where:]``. Vector instructions by name, because compilers leave a loop of eight scalar.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        work, at, out, where, start, scale, x0, dx = arguments
        vector = ir.VectorType(ir.DoubleType(), GROUP)
        spread = ir.Constant(ir.VectorType(ir.IntType(32), GROUP), [0] * GROUP)

        def all_of(scalar: Any) -> Any:
            one = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
            return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), spread)

        source = context.make_array(signature.args[0])(context, builder, work).data
        rows = [builder.add(at, at.type(LANES * k)) for k in range(4)]
        numbers = [all_of(builder.load(builder.gep(source, [row]))) for row in rows]
        ramp = ir.Constant(vector, [float(k) for k in range(GROUP)])
        x = builder.fadd(all_of(x0), builder.fmul(ramp, all_of(dx), ("contract",)), ("contract",))
        y = builder.fsub(ir.Constant(vector, [1.0] * GROUP), x)
        value = builder.fmul(formula(builder, x, y, [all_of(start), *numbers]), all_of(scale), ("contract",))
        target = context.make_array(signature.args[2])(context, builder, out).data
        place = builder.bitcast(builder.gep(target, [where]), vector.as_pointer())
        builder.store(value, place, align=8)
        return context.get_dummy_value()

    def typed(
        typing_context: Any, w: Any, at: Any, out: Any, where: Any, start: Any, scale: Any, x0: Any, dx: Any
    ) -> Any:
        whole, real = types.int64, types.float64
        return types.void(w, whole, out, whole, real, real, real, real), generate

    return intrinsic(typed)


def _value(builder: Any, x: Any, y: Any, c: list[Any]) -> Any:
    """c0 + x (c1 + y (c2 + x (c3 + y c4)))."""
    total = c[4]
    for factor, coefficient in ((y, c[3]), (x, c[2]), (y, c[1]), (x, c[0])):
        total = builder.fadd(coefficient, builder.fmul(factor, total, ("contract",)), ("contract",))
    return total


def _slope(builder: Any, x: Any, y: Any, c: list[Any]) -> Any:
    """Its derivative after x."""
    flags = ("contract",)
    inner = builder.fadd(c[3], builder.fmul(y, c[4], flags), flags)
    middle = builder.fadd(c[2], builder.fmul(x, inner, flags), flags)
    bend = builder.fsub(inner, builder.fmul(x, c[4], flags), flags)
    first = builder.fadd(c[1], builder.fmul(builder.fsub(y, x), middle, flags), flags)
    return builder.fadd(first, builder.fmul(builder.fmul(x, y), bend, flags), flags)


_write_values, _write_slopes = _group(_value), _group(_slope)


@inlined
def record(
    w: Array, kept: int, dense: int, n: int, lane: int, begin: float, t: float, step: float, first: int, last: int,
    slot: int, channels: Integers, interval: float, oversampling: int, head: int, velocities: Array,
    coordinates: Array, accelerations: Array, memory: int, memories: Array,
) -> None:  # fmt: skip
    """Write the samples `first` ... `last` - 1, which lie within the step.

    Parameters
    ----------
    w : (total,) array
        Work array.
    kept, dense : int
        Rows of the state at the start of the step and of the dense output's coefficients.
    n, lane : int
        Coordinates; lane.
    begin, t, step : float
        Time of sample 0, time at the start of the step, its length, s.
    first, last : int
        Samples.
    slot : int
        Place in the records.
    memory : int
        Row of the first contact's memory.
    channels, interval, oversampling, head, velocities, coordinates, accelerations, memories
        See :class:`solver.integrators.lanes.Records`; one by one, because compiled code counts references of every
        array it takes out of a tuple.
    """
    count = channels.size
    scale = 1.0 / step
    x0, dx = (begin - t) * scale, interval * scale
    wide = oversampling * dx
    motion = coordinates.shape[0] > 0
    # Integer divisions are dear: these two serve all phases. Phase k begins at the first whole number of turns from
    # which its samples are not before `first`, and ends likewise.
    whole, rest = first // oversampling, first % oversampling
    end, over = last // oversampling, last % oversampling
    low, high = whole + (rest > 0), end + (over > 0)
    for r in range(count):
        start = w[(kept + n + channels[r]) * LANES + lane]
        at = (dense + 4 * (count + r)) * LANES + lane
        for phase in range(oversampling):
            row = ((slot * count + r) * oversampling + phase) * velocities.shape[3] + head
            for s in range(whole + (phase < rest), end + (phase < over), GROUP):
                _write_values(w, at, velocities, row + s, start, 1.0, x0 + phase * dx + s * wide, wide)
        if motion:
            row = (slot * count + r) * coordinates.shape[2]
            for s in range(low, high, GROUP):
                _write_slopes(w, at, accelerations, row + s, start, scale, x0 + s * wide, wide)
            start = w[(kept + channels[r]) * LANES + lane]
            at = (dense + 4 * r) * LANES + lane
            for s in range(low, high, GROUP):
                _write_values(w, at, coordinates, row + s, start, 1.0, x0 + s * wide, wide)
    if motion:
        for m in range(memories.shape[1]):
            for s in range(low, high):
                memories[slot, m, s] = w[(memory + m) * LANES + lane]
