"""Straight-line code of eight lanes, in the order and by as many lanes at a time as suits a processor.

Where a register holds four doubles, eight lanes at once leave room for eight values: half of the instructions move
values to the stack and back, and there are more of them than the processor keeps decoded. Four lanes after the other
four do the same arithmetic in half the code. What hides the latency of divisions and roots is then the order: what most
is waiting for comes first.
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Sequence

from jointplay.solver.compiler.ir import LANES

#: Raised with every change of what this module does: kernels are kept by it.
VERSION = 1

_FUNCTION = re.compile(r"^define void @(\w+)\(ptr noalias nocapture %w\) noinline \{\n(.*?)^\}\n", re.M | re.S)
_VALUE = re.compile(r"%[\w.]+")
_DEFINED = re.compile(r"\s*(%[\w.]+) = ")
_PLACE = re.compile(r"getelementptr double, ptr %w, i64 (\d+)")
_VECTOR = re.compile(rf"<{LANES} x (double|i1|i64)>")
_LITERAL = re.compile(r"<((?:double|i1|i64) [^<>]*)>")
#: Cycles until a result is there, about those of recent processors.
_LATENCY = {"fdiv": 13, "@llvm.sqrt": 20, "= load": 8, "fadd": 4, "fsub": 4, "fmul": 4, "@llvm.fmuladd": 4}


def arrange(text: str, features: str) -> str:
    """Code of all lanes at once for a processor with these features, ``+avx2,-avx512f`` say; calls are the same."""
    wide = "+avx512f" in features.split(",")
    return _FUNCTION.sub(lambda found: _function(found[1], found[2], halved=not wide), _vectors(text, wide))


def _vectors(text: str, wide: bool) -> str:
    """Rows of all lanes, or of half of them."""
    if wide:
        return text
    half = LANES // 2
    text = _VECTOR.sub(rf"<{half} x \1>", text).replace(f".v{LANES}f64", f".v{half}f64")
    return _LITERAL.sub(lambda found: f"<{', '.join(found[1].split(', ')[:half])}>", text)


def _function(name: str, body: str, *, halved: bool) -> str:
    *lines, end = body.splitlines()
    ordered = "\n".join([*in_order(lines), end])
    if not halved:
        return f"define void @{name}(ptr noalias nocapture %w) noinline {{\n{ordered}\n}}\n"
    ordered = ordered.replace("call void @", "call void @half.")
    return (
        f"define internal void @half.{name}(ptr noalias nocapture %w) noinline {{\n{ordered}\n}}\n"
        f"define void @{name}(ptr noalias nocapture %w) noinline {{\n"
        f"  call void @half.{name}(ptr %w)\n"
        f"  %other = getelementptr double, ptr %w, i64 {LANES // 2}\n"
        f"  call void @half.{name}(ptr %other)\n  ret void\n}}\n"
    )


def in_order(lines: Sequence[str]) -> list[str]:
    """Statements ordered by how long what needs their results takes, the longest first.

    Parameters
    ----------
    lines : sequence of str
        Those of one function of :class:`jointplay.solver.compiler.ir.Block`, which reads and writes rows of its work
        array, without its end. One that calls others is left as it is: between calls it mostly reads and writes rows.
    """
    if any("call void" in line for line in lines):
        return list(lines)
    defined = {match[1]: i for i, line in enumerate(lines) if (match := _DEFINED.match(line))}
    after: list[list[int]] = [[] for _ in lines]
    waiting = [0] * len(lines)
    written: dict[str, int] = {}
    read: dict[str, list[int]] = {}
    for i, line in enumerate(lines):
        before = {defined[name] for name in _VALUE.findall(line) if defined.get(name, i) < i}
        rows = [match[1] for j in before if (match := _PLACE.search(lines[j]))]
        if "= load" in line or line.lstrip().startswith("store"):
            (row,) = rows
            before |= {written[row]} if row in written else set()
            if "= load" in line:
                read.setdefault(row, []).append(i)
            else:
                before |= set(read.pop(row, ()))
                written[row] = i
        waiting[i] = len(before)
        for j in before:
            after[j].append(i)
    heights = [0] * len(lines)
    for i in reversed(range(len(lines))):
        own = next((cycles for what, cycles in _LATENCY.items() if what in lines[i]), 1)
        heights[i] = own * ("getelementptr" not in lines[i]) + max((heights[j] for j in after[i]), default=0)
    ready = [(-heights[i], i) for i, count in enumerate(waiting) if not count]
    heapq.heapify(ready)
    ordered = []
    while ready:
        _, i = heapq.heappop(ready)
        ordered.append(lines[i])
        for j in after[i]:
            waiting[j] -= 1
            if not waiting[j]:
                heapq.heappush(ready, (-heights[j], j))
    return ordered
