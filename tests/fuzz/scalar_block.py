"""Statements of Python in place of vector instructions: the printed step, for one case without compilation."""

from __future__ import annotations

from jointplay.solver.compiler.ir import Block

HEAD = "from math import sqrt\n"
_OPERATORS = {"fadd": "+", "fsub": "-", "fmul": "*", "fdiv": "/"}
_COMPARISONS = {"olt": "<", "ogt": ">", "one": "!="}
_CALLS = {"fabs": "abs", "maxnum": "max", "minnum": "min"}


class ScalarBlock(Block):
    """Statements of one function ``name(w)`` of what steps are made of; values are local variables, or literals."""

    def _new(self, statement: str) -> str:
        self._count += 1
        name = f"{self._prefix}{self._count}"
        self.lines.append(f"{name} = {statement}")
        return name

    def invoke(self, name: str) -> None:
        self.statement(f"{name}(w)")

    def constant(self, value: float) -> str:
        return repr(float(value))

    def load(self, offset: int) -> str:
        return self._new(f"w[{offset}]")

    def store(self, offset: int, value: str) -> None:
        self.statement(f"w[{offset}] = {value}")

    def binary(self, operation: str, a: str, b: str) -> str:
        return self._new(f"{a} {_OPERATORS[operation]} {b}")

    def call(self, intrinsic: str, *arguments: str) -> str:
        if intrinsic == "fmuladd":
            a, b, c = arguments
            return self._new(f"{a} * {b} + {c}")
        return self._new(f"{_CALLS.get(intrinsic, intrinsic)}({', '.join(arguments)})")

    def neg(self, a: str) -> str:
        return self._new(f"-({a})")

    def compare(self, condition: str, a: str, b: str) -> str:
        return self._new(f"{a} {_COMPARISONS[condition]} {b}")

    def select(self, mask: str, a: str, b: str) -> str:
        return self._new(f"{a} if {mask} else {b}")

    def combine(self, operation: str, a: str, b: str) -> str:
        return self._new(f"{a} {operation} {b}")

    def negate(self, mask: str) -> str:
        return self._new(f"not {mask}")

    def function(self, name: str) -> str:
        body = "\n".join(f"    {line}" for line in self.lines)
        return f"def {name}(w):\n{body}\n"
