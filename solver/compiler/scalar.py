"""Kernels as scalar Python source, for compilers of Python: one case a call where the vector code has a row of lanes.

Every function is ``f(w)`` with the case's own work array. Instructions and their order are those of the vector code;
only sine, cosine, tanh, exp and log are left to the library, whose calls stop nothing here.
"""

from __future__ import annotations

from collections.abc import Callable

from jointplay.solver.compiler.emit import Dialect
from jointplay.solver.compiler.ir import Block

_BINARY = {"fadd": "+", "fsub": "-", "fmul": "*", "fdiv": "/"}
_CALLS = {"fabs": "abs", "maxnum": "max", "minnum": "min"}
_COMPARE = {"olt": "<", "ole": "<=", "ogt": ">", "oge": ">=", "oeq": "==", "one": "!="}


class ScalarBlock(Block):
    """Statements of one function ``name(w)``; values are local variables, or literals."""

    def _new(self, statement: str) -> str:
        self._count += 1
        name = f"{self._prefix}{self._count}"
        self.lines.append(f"{name} = {statement}")
        return name

    def invoke(self, name: str) -> None:
        """Call another function of the kernel on the same work array."""
        self.statement(f"{name}(w)")

    def constant(self, value: float) -> str:
        """A number."""
        return repr(float(value))

    @staticmethod
    def is_constant(value: str) -> bool:
        """Whether a value is a literal."""
        return value[0] in "-0123456789"

    def load(self, offset: int) -> str:
        """Row `offset` of the work array."""
        return self._new(f"w[{offset}]")

    def store(self, offset: int, value: str) -> None:
        """Write a row."""
        self.lines.append(f"w[{offset}] = {value}")

    def binary(self, operation: str, a: str, b: str) -> str:
        """``fadd``, ``fsub``, ``fmul`` or ``fdiv``."""
        return self._arithmetic(f"{a} {_BINARY[operation]} {b}")

    def neg(self, a: str) -> str:
        """-a."""
        return self._arithmetic(f"-{a}")

    def call(self, intrinsic: str, *arguments: str) -> str:
        """A function of :mod:`math` or one of Python's own; ``fmuladd`` as a product and a sum."""
        if intrinsic == "fmuladd":
            a, b, c = arguments
            return self._arithmetic(f"{a} * {b} + {c}")
        return self._arithmetic(f"{_CALLS.get(intrinsic, intrinsic)}({', '.join(arguments)})")

    def compare(self, condition: str, a: str, b: str) -> str:
        """A truth value."""
        return self._arithmetic(f"{a} {_COMPARE[condition]} {b}")

    def select(self, mask: str, a: str, b: str) -> str:
        """a where the mask holds, else b."""
        return self._new(f"{a} if {mask} else {b}")

    def combine(self, operation: str, a: str, b: str) -> str:
        """``and`` or ``or`` of two truth values."""
        return self._new(f"{a} {operation} {b}")

    def negate(self, mask: str) -> str:
        """Opposite of a truth value."""
        return self._new(f"not {mask}")

    def function(self, name: str) -> str:
        """The whole function as text."""
        body = "\n".join(f"    {line}" for line in self.lines or ["pass"])
        return f"def {name}(w):\n{body}\n"


def _sine_cosine(block: Block, x: str) -> tuple[str, str]:
    return block.call("sin", x), block.call("cos", x)


def _function(name: str) -> Callable[[Block, str], str]:
    return lambda block, x: block.call(name, x)


#: One case a call, in Python.
SCALAR = Dialect(
    ScalarBlock, _sine_cosine, _function("tanh"), _function("exp"), _function("log"), 1,
    "from math import cos, exp, floor, log, sin, sqrt, tanh\n",
)  # fmt: skip
