"""Straight-line vector code in LLVM's assembly language.

Every value is a row of lanes, ``<8 x double>``: the vectorisation is written down, not left to a compiler's heuristics.
In which order a processor computes them, and how many lanes at a time, is decided when it is compiled
(:mod:`jointplay.solver.compiler.arrange`).
"""

from __future__ import annotations

import math
import struct

#: Cases that run side by side: two AVX2 registers or one AVX-512 register of doubles.
LANES = 8
ROW = f"<{LANES} x double>"
_MASK = f"<{LANES} x i1>"
_WHOLE = f"<{LANES} x i64>"

#: Fast-math inside the kernels. Non-finite results are looked for outside, in code compiled without these.
_FAST = "nnan ninf nsz arcp contract"

#: 1.5 2^52: doubles of this size are whole numbers, which stand in their lowest bits.
_MAGIC = 6755399441055744.0
_MAGIC_BITS, _ROOT_OF_HALF = struct.unpack(">qq", struct.pack(">dd", _MAGIC, math.sqrt(0.5)))

#: ``fmuladd``: one instruction, rounded once, where the processor has one; else a product and a sum, not the C library.
_INTRINSICS = ("sqrt", "floor", "fabs", "maxnum", "minnum", "fmuladd")
_ARGUMENTS = {"maxnum": 2, "minnum": 2, "fmuladd": 3}

DECLARATIONS = "\n".join(
    f"declare {ROW} @llvm.{name}.v{LANES}f64({', '.join([ROW] * _ARGUMENTS.get(name, 1))})" for name in _INTRINSICS
)


def literal(value: float) -> str:
    """A double as LLVM reads it back exactly."""
    return f"0x{struct.unpack('>Q', struct.pack('>d', float(value)))[0]:016X}"


class Block:
    """Statements of one function ``void name(double* w)``; values are the names of rows, or constants.

    Attributes
    ----------
    lines : list of str
    operations : int
        Arithmetic statements so far.
    """

    def __init__(self, prefix: str = "t") -> None:
        self.lines: list[str] = []
        self.operations = 0
        self._prefix = prefix
        self._count = 0

    def _new(self, statement: str) -> str:
        self._count += 1
        name = f"%{self._prefix}{self._count}"
        self.lines.append(f"{name} = {statement}")
        return name

    def _arithmetic(self, statement: str) -> str:
        self.operations += 1
        return self._new(statement)

    def statement(self, text: str) -> None:
        """A statement without a value."""
        self.lines.append(text)

    def invoke(self, name: str) -> None:
        """Call another function of the kernel on the same work array."""
        self.statement(f"call void @{name}(ptr %w)")

    def constant(self, value: float) -> str:
        """The same number in every lane."""
        return "<" + ", ".join([f"double {literal(value)}"] * LANES) + ">"

    @staticmethod
    def is_constant(value: str) -> bool:
        """Whether a value is a literal, which every function can write down itself."""
        return value.startswith("<")

    def load(self, row: int) -> str:
        """A row of the work array."""
        address = self._new(f"getelementptr double, ptr %w, i64 {LANES * row}")
        return self._new(f"load {ROW}, ptr {address}, align 8")

    def store(self, row: int, value: str) -> None:
        """Write a row."""
        address = self._new(f"getelementptr double, ptr %w, i64 {LANES * row}")
        self.lines.append(f"store {ROW} {value}, ptr {address}, align 8")

    def binary(self, operation: str, a: str, b: str) -> str:
        """``fadd``, ``fsub``, ``fmul`` or ``fdiv``."""
        return self._arithmetic(f"{operation} {_FAST} {ROW} {a}, {b}")

    def add(self, a: str, b: str) -> str:
        """a + b."""
        return self.binary("fadd", a, b)

    def sub(self, a: str, b: str) -> str:
        """a - b."""
        return self.binary("fsub", a, b)

    def mul(self, a: str, b: str) -> str:
        """a b."""
        return self.binary("fmul", a, b)

    def div(self, a: str, b: str) -> str:
        """a / b."""
        return self.binary("fdiv", a, b)

    def neg(self, a: str) -> str:
        """-a."""
        return self._arithmetic(f"fneg {_FAST} {ROW} {a}")

    def call(self, intrinsic: str, *arguments: str) -> str:
        """One of the intrinsics that are single instructions: sqrt, floor, fabs, maxnum, minnum, fmuladd."""
        texts = ", ".join(f"{ROW} {a}" for a in arguments)
        return self._arithmetic(f"call {_FAST} {ROW} @llvm.{intrinsic}.v{LANES}f64({texts})")

    def fma(self, a: str, b: str, c: str) -> str:
        """a b + c, rounded once where the processor can."""
        return self.call("fmuladd", a, b, c)

    def nearest(self, x: str, factor: float) -> tuple[str, str]:
        """Whole number nearest to `factor` x, as a row of doubles and as a row of integers (low bits only)."""
        # Adding 1.5 2^52 rounds to a whole number and leaves it in the low bits of the mantissa.
        magic = self.constant(_MAGIC)
        shifted = self.fma(x, self.constant(factor), magic)
        return self.sub(shifted, magic), self._new(f"bitcast {ROW} {shifted} to {_WHOLE}")

    def split(self, x: str) -> tuple[str, str]:
        """Mantissa m in [sqrt(1/2), sqrt(2)) and exponent k, as rows of doubles, of x = m 2^k > 0 (normal numbers)."""
        bits = self._new(f"bitcast {ROW} {x} to {_WHOLE}")
        shifted = self.integer("sub", bits, _ROOT_OF_HALF)
        # Adding whole numbers to the bits of 1.5 2^52 adds them to its value.
        exponent = self.integer("add", self.integer("ashr", shifted, 52), _MAGIC_BITS)
        mantissa = self.integer("add", self.integer("and", shifted, (1 << 52) - 1), _ROOT_OF_HALF)
        whole = self._new(f"bitcast {_WHOLE} {exponent} to {ROW}")
        return self._new(f"bitcast {_WHOLE} {mantissa} to {ROW}"), self.sub(whole, self.constant(_MAGIC))

    def integer(self, operation: str, bits: str, value: int) -> str:
        """``shl``, ``and``, ``add`` ... of a row of integers and a constant."""
        self.operations += 1
        return self._new(f"{operation} {_WHOLE} {bits}, <{', '.join([f'i64 {value}'] * LANES)}>")

    def lowest_bit(self, bits: str) -> str:
        """Mask: set where a row of integers is odd."""
        return self._new(f"trunc {_WHOLE} {bits} to {_MASK}")

    def flip_sign(self, a: str, signs: str) -> str:
        """Exchange the sign of a row where the sign bit of a row of integers is set."""
        self.operations += 1
        flipped = self._new(f"xor {_WHOLE} {self._new(f'bitcast {ROW} {a} to {_WHOLE}')}, {signs}")
        return self._new(f"bitcast {_WHOLE} {flipped} to {ROW}")

    def power_of_two(self, n: str) -> str:
        """2^n for a row of integers between -1000 and 1000: n written into the exponent's bits."""
        biased = self.integer("add", self.integer("shl", n, 52), 1023 << 52)
        return self._new(f"bitcast {_WHOLE} {biased} to {ROW}")

    def compare(self, condition: str, a: str, b: str) -> str:
        """A mask: ordered comparison ``olt``, ``ole``, ``ogt``, ``oge``, ``oeq`` or ``one``."""
        return self._arithmetic(f"fcmp {_FAST} {condition} {ROW} {a}, {b}")

    def select(self, mask: str, a: str, b: str) -> str:
        """a where the mask is set, else b."""
        return self._new(f"select {_MASK} {mask}, {ROW} {a}, {ROW} {b}")

    def combine(self, operation: str, a: str, b: str) -> str:
        """``and``, ``or`` or ``xor`` of two masks."""
        return self._new(f"{operation} {_MASK} {a}, {b}")

    def negate(self, mask: str) -> str:
        """Complement of a mask."""
        return self.combine("xor", mask, "<" + ", ".join(["i1 true"] * LANES) + ">")

    def function(self, name: str) -> str:
        """The whole function as text."""
        body = "\n".join(f"  {line}" for line in self.lines)
        return f"define void @{name}(ptr noalias nocapture %w) noinline {{\n{body}\n  ret void\n}}\n"
