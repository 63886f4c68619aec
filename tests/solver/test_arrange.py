"""Order and width of a kernel's code: the same arithmetic on the same rows, whatever the processor."""

from __future__ import annotations

import ctypes
import re

import numpy as np
import pytest

from jointplay.solver.compiler import native
from jointplay.solver.compiler.arrange import arrange, in_order
from jointplay.solver.compiler.ir import DECLARATIONS, LANES, Block


def _code() -> str:
    """Rows are read before and after they are written, by two functions of which one calls the other."""
    inner, outer = Block(), Block()
    before = inner.load(0)
    inner.store(0, inner.fma(before, before, inner.load(1)))
    inner.store(1, inner.div(inner.load(0), inner.call("sqrt", inner.load(2))))
    inner.store(0, inner.constant(3.0))
    inner.store(2, inner.add(inner.load(0), before))
    nearest, bits = outer.nearest(outer.load(3), 1.0)
    outer.store(3, outer.select(outer.lowest_bit(bits), outer.neg(nearest), nearest))
    outer.invoke("inner")
    outer.store(4, outer.load(2))
    return "\n".join([DECLARATIONS, inner.function("inner"), outer.function("outer")])


@pytest.mark.parametrize("features", ["+avx2,-avx512f", "+avx2,+avx512f", ""])
def test_what_is_computed_depends_on_neither(features: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # A comment tells the kernels apart: they are kept by their text.
    code = f"; {features}\n{_code()}"
    monkeypatch.setattr(native, "arrange", lambda text, _: arrange(text, features))
    work = np.random.default_rng(1).uniform(1.0, 9.0, (5, LANES))
    a, b, c, d = work[:4].copy()
    ctypes.CFUNCTYPE(None, ctypes.c_void_p)(native.load(code)("outer"))(work.ctypes.data)
    nearest = np.rint(d)
    expected = [
        np.full(LANES, 3.0),
        (a * a + b) / np.sqrt(c),
        3.0 + a,
        np.where(nearest % 2, -nearest, nearest),
        3.0 + a,
    ]
    # A product and a sum are rounded once where the processor can.
    np.testing.assert_allclose(work, expected, rtol=1e-15)


def test_four_lanes_at_a_time_without_wide_registers() -> None:
    narrow, wide = (arrange(_code(), features) for features in ("+avx2", "+avx512f"))
    assert "<8 x" not in narrow and ".v8f64" not in narrow
    assert "<4 x" not in wide
    assert re.findall(r"define void @(\w+)", narrow) == re.findall(r"define void @(\w+)", wide) == ["inner", "outer"]


def test_what_most_waits_for_comes_first_and_rows_keep_their_order() -> None:
    block = Block()
    block.store(5, block.load(4))  # nothing waits for it
    block.store(0, block.div(block.load(1), block.call("sqrt", block.load(2))))
    block.store(1, block.load(0))
    ordered = in_order(block.lines)
    assert sorted(ordered) == sorted(block.lines)
    places = dict(re.findall(r"(%\w+) = getelementptr double, ptr %w, i64 (\d+)", "\n".join(ordered)))
    found = [re.search(r"(load|store) .*ptr (%\w+),", line) for line in ordered]
    accesses = [(each[1], int(places[each[2]]) // LANES) for each in found if each]
    assert accesses == [("load", 2), ("load", 1), ("store", 0), ("load", 4), ("load", 0), ("store", 5), ("store", 1)]
