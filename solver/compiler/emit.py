"""CasADi functions as straight-line vector code, rows of lanes.

All data of a kernel live in one flat work array addressed with constant offsets. Work that depends on lane parameters
alone is hoisted into a function of its own that runs once.

A call into the C library would stop the lanes, so sine, cosine, tanh, arctan, exp and log are written out: arithmetic
and selects. ``tests/solver/test_elementary.py`` measures their accuracy: sine and cosine 1.2e-16 absolute for arguments
up to 1e6 rad, tanh 2e-15 relative, arctan 3e-16, exp 5e-16 and log 3e-16 relative (log of numbers near 1: 3e-16
absolute).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca

from jointplay.solver.compiler.ir import Block

#: pi/2 in three parts for the argument reduction; products of k < 2^24 with the first are exact.
_HALF_PI = (1.5707963109016418, 1.5893254712295857e-08, 6.123233995736766e-17)

_SINE = [(-1) ** k / math.factorial(2 * k + 1) for k in range(1, 8)]
_COSINE = [(-1) ** k / math.factorial(2 * k) for k in range(2, 9)]
#: expm1(r) = r + r^2 (1/2 + r/6 + ...) for |r| <= ln 2 / 2, where the first term left out is 2e-17 of the result.
_EXPM1 = [1 / math.factorial(k) for k in range(2, 14)]
#: ln 2 in two parts; products of k < 2^20 with the first are exact.
_LN2 = (0.693147180369123816490, 1.90821492927058770002e-10)
#: Beyond this tanh is 1 to the last bit.
_TANH_LIMIT = 20.0
#: Beyond this exp leaves the range of normal numbers.
_EXP_LIMIT = 700.0
#: log m = 2 s (1 + s^2/3 + s^4/5 ...) with s = (m - 1)/(m + 1), |s| <= 0.172; the first term left out is 1e-17.
_LOG = [2 / (2 * k + 1) for k in range(1, 11)]
#: arctan r = r + r^3 P(r^2) / Q(r^2) for |r| <= 0.66 (S. L. Moshier, Cephes); powers from the lowest up.
_ARCTAN = (
    (-64.85021904942025, -122.88666844901361, -75.00855792314705, -16.157537187333652, -0.8750608600031904),
    (194.5506571482614, 485.3903996359137, 432.88106049129027, 165.02700983169885, 24.858464901423063, 1.0),
)


def _polynomial(block: Block, x: str, coefficients: Sequence[float]) -> str:
    """Estrin's scheme: half the depth of Horner's, and the lanes wait for latency, not for arithmetic."""
    terms = [block.constant(c) for c in coefficients]
    power = x
    while len(terms) > 1:
        pairs = [
            block.fma(terms[i + 1], power, terms[i]) if i + 1 < len(terms) else terms[i]
            for i in range(0, len(terms), 2)
        ]
        terms = pairs
        if len(terms) > 1:
            power = block.mul(power, power)
    return terms[0]


def sine_cosine(block: Block, x: str) -> tuple[str, str]:
    """Sine and cosine of a row."""
    k, quadrant = block.nearest(x, 2 / math.pi)
    r = x
    for part in _HALF_PI:
        r = block.fma(k, block.constant(-part), r)
    z = block.mul(r, r)
    sine = block.fma(block.mul(r, z), _polynomial(block, z, _SINE), r)
    cosine = block.fma(z, block.constant(-0.5), block.constant(1.0))
    cosine = block.fma(block.mul(z, z), _polynomial(block, z, _COSINE), cosine)
    # Odd quadrants exchange the two; bit 1 of k is the sign of the sine, bit 1 of k + 1 that of the cosine.
    odd = block.lowest_bit(quadrant)
    signs = [
        block.integer("shl", block.integer("and", bits, 2), 62)
        for bits in (quadrant, block.integer("add", quadrant, 1))
    ]
    return (
        block.flip_sign(block.select(odd, cosine, sine), signs[0]),
        block.flip_sign(block.select(odd, sine, cosine), signs[1]),
    )


def _reduced_exponential(block: Block, x: str) -> tuple[str, str]:
    """expm1(r) and 2^k with x = r + k ln 2."""
    k, whole = block.nearest(x, 1 / math.log(2))
    r = x
    for part in _LN2:
        r = block.fma(k, block.constant(-part), r)
    reduced = block.fma(block.mul(r, r), _polynomial(block, r, _EXPM1), r)
    return reduced, block.power_of_two(whole)


def exponential(block: Block, x: str) -> str:
    """exp of a row, held between exp(-700) and exp(700)."""
    held = block.call("maxnum", x, block.constant(-_EXP_LIMIT))
    reduced, scale = _reduced_exponential(block, block.call("minnum", held, block.constant(_EXP_LIMIT)))
    return block.fma(scale, reduced, scale)


def logarithm(block: Block, x: str) -> str:
    """Natural logarithm of a row of positive normal numbers."""
    mantissa, exponent = block.split(x)
    one = block.constant(1.0)
    s = block.div(block.sub(mantissa, one), block.add(mantissa, one))
    z = block.mul(s, s)
    tail = block.fma(block.mul(s, z), _polynomial(block, z, _LOG), block.add(s, s))
    low = block.fma(exponent, block.constant(_LN2[1]), tail)
    return block.fma(exponent, block.constant(_LN2[0]), low)


def hyperbolic_tangent(block: Block, x: str) -> str:
    """tanh of a row, as E / (E + 2) with E = expm1(2 |x|), accurate relative to itself down to nothing."""
    size = block.call("minnum", block.call("fabs", x), block.constant(_TANH_LIMIT))
    y = block.add(size, size)
    reduced, scale = _reduced_exponential(block, y)
    e = block.fma(scale, reduced, block.sub(scale, block.constant(1.0)))
    value = block.div(e, block.add(e, block.constant(2.0)))
    return block.select(block.compare("olt", x, block.constant(0.0)), block.neg(value), value)


def arctangent(block: Block, x: str) -> str:
    """arctan of a row, by that of (x - 1)/(x + 1) or -1/x where it is nearer to nothing."""
    size, one = block.call("fabs", x), block.constant(1.0)
    far = block.compare("ogt", size, block.constant(1 + math.sqrt(2)))
    middle = block.compare("ogt", size, block.constant(0.66))
    above = block.select(far, block.constant(-1.0), block.select(middle, block.sub(size, one), size))
    below = block.select(far, size, block.select(middle, block.add(size, one), one))
    start = block.select(middle, block.constant(math.pi / 4), block.constant(0.0))
    start = block.select(far, block.constant(math.pi / 2), start)
    r = block.div(above, below)
    z = block.mul(r, r)
    p, q = (_polynomial(block, z, coefficients) for coefficients in _ARCTAN)
    value = block.add(start, block.fma(block.mul(r, z), block.div(p, q), r))
    return block.select(block.compare("olt", x, block.constant(0.0)), block.neg(value), value)


def sign(block: Block, x: str) -> str:
    """1, -1 or 0: the slope of a size."""
    zero = block.constant(0.0)
    below = block.select(block.compare("olt", x, zero), block.constant(-1.0), zero)
    return block.select(block.compare("ogt", x, zero), block.constant(1.0), below)


_ARITHMETIC = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul"}
_COMPARE = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "one"}
_LOGIC = {ca.OP_AND: "and", ca.OP_OR: "or"}
_CALLS = {ca.OP_SQRT: "sqrt", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_FMAX: "maxnum", ca.OP_FMIN: "minnum"}
_UNARY: dict[int, Callable[[Block, str], str]] = {
    ca.OP_NEG: lambda block, a: block.neg(a),
    ca.OP_SQ: lambda block, a: block.mul(a, a),
    ca.OP_TWICE: lambda block, a: block.add(a, a),
    ca.OP_SIGN: sign,
    ca.OP_TANH: hyperbolic_tangent,
    ca.OP_ATAN: arctangent,
    ca.OP_EXP: exponential,
    ca.OP_LOG: logarithm,
}
_OTHER_UNARY = (ca.OP_INV, ca.OP_SIN, ca.OP_COS, ca.OP_SQRT, ca.OP_FABS, ca.OP_FLOOR, ca.OP_NOT)


@dataclass(frozen=True)
class Program:
    """One function as straight-line code.

    Attributes
    ----------
    body, hoisted : Block
        What runs at every call, and what depends on the lane parameters alone.
    hoist_slots : int
        Rows that the hoisted part leaves in the work array.
    """

    body: Block
    hoisted: Block
    hoist_slots: int


@dataclass(frozen=True)
class _Value:
    text: str
    fixed: bool  # depends on lane parameters and literals alone
    mask: bool = False


class _Printer:
    def __init__(self, inputs: Sequence[Sequence[int]], hoist_at: int, tag: str) -> None:
        self.inputs, self.hoist_at = inputs, hoist_at
        self.body, self.hoisted = Block(), Block(f"{tag}h")
        self.slots = 0
        self.loaded: dict[tuple[int, int, bool], _Value] = {}
        self.source: dict[str, tuple[int, int]] = {}
        self.kept: dict[str, str] = {}
        self.inverses: dict[str, _Value] = {}
        self.waves: dict[str, tuple[str, str]] = {}

    def load(self, which: int, element: int, fixed: bool) -> _Value:
        key = (which, element, fixed)
        if key not in self.loaded:
            block = self.hoisted if fixed else self.body
            value = _Value(block.load(self.inputs[which][element]), fixed)
            self.loaded[key] = value
            self.source[value.text] = (which, element)
        return self.loaded[key]

    def in_body(self, value: _Value) -> str:
        """Name of a value inside the body: parameters are loaded there, hoisted results stored once and loaded back."""
        if not value.fixed or self.body.is_constant(value.text):
            return value.text
        if value.text in self.source:
            return self.load(*self.source[value.text], fixed=False).text
        if value.text not in self.kept:
            row = self.hoist_at + self.slots
            self.slots += 1
            self.hoisted.store(row, value.text)
            self.kept[value.text] = self.body.load(row)
        return self.kept[value.text]

    def reciprocal(self, value: _Value) -> _Value:
        """1 / value, once for each value: a division costs as much as ten products."""
        if value.text not in self.inverses:
            block = self.hoisted if value.fixed else self.body
            self.inverses[value.text] = _Value(block.div(block.constant(1.0), value.text), value.fixed)
        return self.inverses[value.text]

    def number(self, mask: _Value) -> _Value:
        """A mask as a row of ones and zeros."""
        return _Value(self.body.select(mask.text, self.body.constant(1.0), self.body.constant(0.0)), False)

    def apply(self, op: int, arguments: list[_Value]) -> _Value:
        # A mask is no row that could be kept; comparisons and what uses them stay in the body.
        fixed = all(a.fixed for a in arguments) and op not in _COMPARE and not any(a.mask for a in arguments)
        block = self.hoisted if fixed else self.body
        if op not in _LOGIC and op != ca.OP_NOT:
            # The derivative of a kink is a comparison that is reckoned with: 1 where it holds, else 0.
            condition = 1 if op == ca.OP_IF_ELSE_ZERO else 0
            arguments = [a if i < condition or not a.mask else self.number(a) for i, a in enumerate(arguments)]
        texts = [a.text if fixed or a.mask else self.in_body(a) for a in arguments]
        if op in (ca.OP_SIN, ca.OP_COS):
            if texts[0] not in self.waves:
                self.waves[texts[0]] = sine_cosine(block, texts[0])
            return _Value(self.waves[texts[0]][0 if op == ca.OP_SIN else 1], fixed)
        if op in (ca.OP_DIV, ca.OP_INV):
            inverse = self.reciprocal(arguments[-1])
            if op == ca.OP_INV:
                return inverse
            return self.apply(ca.OP_MUL, [arguments[0], inverse])
        if op in _ARITHMETIC:
            return _Value(block.binary(_ARITHMETIC[op], *texts), fixed)
        if op in _CALLS:
            return _Value(block.call(_CALLS[op], *texts), fixed)
        if op in _COMPARE:
            return _Value(block.compare(_COMPARE[op], *texts), False, mask=True)
        if op in _LOGIC:
            return _Value(block.combine(_LOGIC[op], *texts), False, mask=True)
        if op == ca.OP_NOT:
            return _Value(block.negate(texts[0]), False, mask=True)
        if op == ca.OP_IF_ELSE_ZERO:
            return _Value(block.select(texts[0], texts[1], block.constant(0.0)), False)
        return _Value(_UNARY[op](block, texts[0]), fixed)


def straight_line(
    function: ca.Function, inputs: Sequence[Sequence[int]], outputs: Sequence[Sequence[int]], *,
    fixed_input: int, hoist_at: int,
) -> Program:  # fmt: skip
    """Print an SX function.

    Parameters
    ----------
    function : casadi.Function
        Of SX, dense inputs and outputs.
    inputs, outputs : sequence of sequence of int
        Row of the work array of every element of every input and output. Outputs are stored after everything is
        read, so they may overlap the inputs.
    fixed_input : int
        Input that holds the lane parameters.
    hoist_at : int
        Row from which hoisted values are kept.

    Raises
    ------
    KeyError
        An operation that the equations were not expected to hold.
    """
    printer = _Printer(inputs, hoist_at, function.name())
    registers: dict[int, _Value] = {}
    stores: list[tuple[int, str]] = []
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        reads, writes = function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_INPUT:
            registers[writes[0]] = printer.load(reads[0], reads[1], reads[0] == fixed_input)
        elif op == ca.OP_CONST:
            registers[writes[0]] = _Value(printer.body.constant(function.instruction_constant(k)), True)
        elif op == ca.OP_OUTPUT:
            stores.append((outputs[writes[0]][writes[1]], printer.in_body(registers[reads[0]])))
        else:
            unary = op in _UNARY or op in _OTHER_UNARY
            registers[writes[0]] = printer.apply(op, [registers[r] for r in (reads[:1] if unary else reads[:2])])
    for row, value in stores:
        printer.body.store(row, value)
    return Program(printer.body, printer.hoisted, printer.slots)
