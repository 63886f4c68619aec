"""Samples of a step's dense output, written in groups by vector instructions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.compiler.ir import LANES
from jointplay.solver.compiler.native import compiled, inlined
from jointplay.solver.compiler.rows import WorkRows
from jointplay.solver.integrators.lanes import GROUP, PHASES


@compiled
def samples_until(now: float, begin: float, interval: float, first: int, count: int) -> int:
    """One past the last of the samples `first` ... `count` - 1 that is not later than `now`."""
    last = int((now - begin) / interval) + 1
    while begin + last * interval <= now:
        last += 1
    while last > first and begin + (last - 1) * interval > now:
        last -= 1
    return max(first, min(last, count))


_INDEX = ir.IntType(32)
_VECTOR = ir.VectorType(ir.DoubleType(), GROUP)


def _pick(builder: Any, vector: Any, places: list[int]) -> Any:
    """Elements of a vector."""
    return builder.shuffle_vector(
        vector, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(ir.VectorType(_INDEX, len(places)), places)
    )


def _data(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Pointer to the elements of an array."""
    return context.make_array(kind)(context, builder, array).data


def _store(builder: Any, vector: Any, target: Any, where: Any) -> None:
    place = builder.bitcast(builder.gep(target, [where]), vector.type.as_pointer())
    builder.store(vector, place, align=8)


def _samples(
    builder: Any, formula: Callable[[Any, Any, Any, list[Any]], Any], source: Any, at: Any, start: Any, x0: Any, dx: Any
) -> Any:
    """Vector instructions for a group of samples; see :func:`_group`."""

    def all_of(scalar: Any) -> Any:
        one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), scalar, ir.Constant(_INDEX, 0))
        return _pick(builder, one, [0] * GROUP)

    rows = [builder.add(at, at.type(LANES * k)) for k in range(4)]
    numbers = [all_of(builder.load(builder.gep(source, [row]))) for row in rows]
    ramp = ir.Constant(_VECTOR, [float(k) for k in range(GROUP)])
    x = builder.fadd(all_of(x0), builder.fmul(ramp, all_of(dx), ("contract",)), ("contract",))
    y = builder.fsub(ir.Constant(_VECTOR, [1.0] * GROUP), x)
    return formula(builder, x, y, [all_of(start), *numbers])


def _group(formula: Callable[[Any, Any, Any, list[Any]], Any]) -> Any:
    """Compiled code that writes one group of samples: ``(w, at, out, where, start, scale, x0, dx)``.

    `formula` makes vector instructions for the value at x of the step from x, 1 - x and, in all elements, the
    polynomial's five coefficients: `start` and those in `w` from `at`, a row apart. The result times `scale` goes to
    ``out.flat[where:]``. Vector instructions by name, because compilers leave a loop of eight scalar.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        work, at, out, where, start, scale, x0, dx = arguments
        source, target = (_data(context, builder, signature.args[i], each) for i, each in ((0, work), (2, out)))
        value = _samples(builder, formula, source, at, start, x0, dx)
        factor = _pick(
            builder,
            builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), scale, ir.Constant(_INDEX, 0)),
            [0] * GROUP,
        )
        _store(builder, builder.fmul(value, factor, ("contract",)), target, where)
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


def _in_turn(typing_context: Any, w: Any, at: Any, out: Any, even: Any, odd: Any, start: Any, x0: Any, dx: Any) -> Any:
    """A group of values as :func:`_group` has it: the even ones to ``out.flat[even:]``, the odd ones to ``[odd:]``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        work, at, out, even, odd, start, x0, dx = arguments
        source, target = (_data(context, builder, signature.args[i], each) for i, each in ((0, work), (2, out)))
        value = _samples(builder, _value, source, at, start, x0, dx)
        for place, where in enumerate((even, odd)):
            _store(builder, _pick(builder, value, list(range(place, GROUP, PHASES))), target, where)
        return context.get_dummy_value()

    whole, real = types.int64, types.float64
    return types.void(w, whole, out, whole, whole, real, real, real), generate


_write_in_turn: Any = intrinsic(_in_turn)


@inlined
def record(
    w: FloatArray, rows: WorkRows[int], lane: int, begin: float, t: float, step: float, first: int, last: int,
    slot: int, channels: IntArray, interval: float, head: int, velocities: FloatArray,
    coordinates: FloatArray, accelerations: FloatArray, memories: FloatArray,
) -> None:  # fmt: skip
    """Write the samples `first` ... `last` - 1, which lie within the step.

    Parameters
    ----------
    w : (rows, LANES) array
        Work array.
    rows : WorkRows of int
        Its first rows.
    lane : int
    begin, t, step : float
        Time of sample 0, time at the start of the step, its length, s.
    first, last : int
        Samples.
    slot : int
        Place in the records.
    channels, interval, head, velocities, coordinates, accelerations, memories
        See :class:`jointplay.solver.integrators.lanes.Records`; one by one, because compiled code counts references of
        every array it takes out of a tuple.
    """
    count = channels.size
    scale = 1.0 / step
    x0, dx = (begin - t) * scale, interval * scale
    wide = PHASES * dx
    motion = coordinates.shape[0] > 0
    kept, kept_velocity = rows.kept, rows.kept + rows.v - rows.z
    low, high = (first + 1) // PHASES, (last + 1) // PHASES
    for r in range(count):
        start = w[kept_velocity + channels[r], lane]
        at = (rows.dense + 4 * (count + r)) * LANES + lane
        long = velocities.shape[3]
        even = (slot * count + r) * PHASES * long + head + first // PHASES
        odd = even + long
        if first % PHASES == 1:
            even, odd = odd, even + 1
        for s in range(0, last - first, GROUP):
            past = s // PHASES
            _write_in_turn(w, at, velocities, even + past, odd + past, start, x0 + (first + s) * dx, dx)
        if motion:
            row = (slot * count + r) * coordinates.shape[2]
            for s in range(low, high, GROUP):
                _write_slopes(w, at, accelerations, row + s, start, scale, x0 + s * wide, wide)
            start = w[kept + channels[r], lane]
            at = (rows.dense + 4 * r) * LANES + lane
            for s in range(low, high, GROUP):
                _write_values(w, at, coordinates, row + s, start, 1.0, x0 + s * wide, wide)
    if motion:
        for m in range(memories.shape[1]):
            for s in range(low, high):
                memories[slot, m, s] = w[rows.memory + m, lane]
