"""CasADi functions as straight-line vector code, rows of lanes.

All data of a kernel live in one flat work array addressed with constant offsets. Work that depends on lane parameters
alone is hoisted into a function of its own that runs once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca

from jointplay.solver.compiler.elementary import exponential, hyperbolic_tangent, logarithm, sine_cosine
from jointplay.solver.compiler.ir import Block

_ARITHMETIC = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul"}
_COMPARE = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "one"}
_LOGIC = {ca.OP_AND: "and", ca.OP_OR: "or"}
_CALLS = {ca.OP_SQRT: "sqrt", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_FMAX: "maxnum", ca.OP_FMIN: "minnum"}
_UNARY: dict[int, Callable[[Block, str], str]] = {
    ca.OP_NEG: lambda block, a: block.neg(a),
    ca.OP_SQ: lambda block, a: block.mul(a, a),
    ca.OP_TWICE: lambda block, a: block.add(a, a),
    ca.OP_TANH: hyperbolic_tangent,
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
