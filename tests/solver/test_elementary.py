"""Accuracy of the functions written out for the lanes, against the C library."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable

import numpy as np
import pytest

from jointplay.solver.compiler import native
from jointplay.solver.compiler.emit import arctangent, exponential, hyperbolic_tangent, logarithm, sine_cosine
from jointplay.solver.compiler.ir import DECLARATIONS, LANES, Block

Evaluate = Callable[[np.ndarray], tuple[np.ndarray, ...]]


@pytest.fixture(scope="module")
def evaluate() -> Evaluate:
    """Sine, cosine, tanh, exp, log and arctan of any number of arguments, through the compiled code."""
    block = Block()
    x = block.load(0)
    sine, cosine = sine_cosine(block, x)
    others = (f(block, x) for f in (hyperbolic_tangent, exponential, logarithm, arctangent))
    for i, value in enumerate((sine, cosine, *others)):
        block.store(i + 1, value)
    address = native.load("\n".join([DECLARATIONS, block.function("elementary")]))("elementary")
    function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(address)

    def run(values: np.ndarray) -> tuple[np.ndarray, ...]:
        rows = values.reshape(-1, LANES)
        out = np.zeros((len(rows), 7, LANES))
        out[:, 0] = rows
        for row in out:
            function(row.ctypes.data)
        return tuple(out[:, i].ravel() for i in range(1, 7))

    return run


@pytest.mark.parametrize("size", [1.0, 100.0, 1e4, 1e6])
def test_sine_and_cosine(evaluate: Evaluate, size: float) -> None:
    x = np.random.default_rng(1).uniform(-size, size, 8000)
    sine, cosine, *_ = evaluate(x)
    # Half a unit in the last place of 1 is 1.1e-16; one more for the argument reduction.
    assert np.abs(sine - np.sin(x)).max() < 2.3e-16
    assert np.abs(cosine - np.cos(x)).max() < 2.3e-16


def test_quadrants(evaluate: Evaluate) -> None:
    x = np.arange(-16, 16) * (math.pi / 4) + 1e-9
    sine, cosine, *_ = evaluate(x)
    assert np.allclose(sine, np.sin(x), rtol=0, atol=3e-16)
    assert np.allclose(cosine, np.cos(x), rtol=0, atol=3e-16)


def test_hyperbolic_tangent_is_accurate_relative_to_itself(evaluate: Evaluate) -> None:
    x = 10.0 ** np.random.default_rng(2).uniform(-12, 3, 8000)
    for sign in (1, -1):
        tangent = evaluate(sign * x)[2]
        assert np.abs(tangent / np.tanh(sign * x) - 1).max() < 2e-15


def test_exponential(evaluate: Evaluate) -> None:
    x = np.random.default_rng(3).uniform(-690, 690, 8000)
    x[::2] *= 1e-3
    assert np.abs(evaluate(x)[3] / np.exp(x) - 1).max() < 5e-16
    # Held where it would leave the range of normal numbers.
    ends = evaluate(np.repeat([-1e3, 1e3], LANES // 2))[3]
    assert np.allclose(ends[[0, -1]], np.exp([-700.0, 700.0]), rtol=5e-16, atol=0)


def test_logarithm(evaluate: Evaluate) -> None:
    rng = np.random.default_rng(4)
    x = np.concatenate([10.0 ** rng.uniform(-30, 30, 8000), rng.uniform(0.5, 2, 8000), 2.0 ** np.arange(-40, 40)])
    found = evaluate(x)[4]
    # Relative; absolute within a factor of two around 1, where the logarithm is nothing.
    assert (np.abs(found - np.log(x)) / np.maximum(1, np.abs(np.log(x)))).max() < 3e-16
    assert (evaluate(np.ones(LANES))[4] == 0).all()


def test_arctangent(evaluate: Evaluate) -> None:
    rng = np.random.default_rng(5)
    x = np.concatenate([10.0 ** rng.uniform(-30, 30, 8000), rng.uniform(0.4, 3, 8000), [0.66, 1, 1 + math.sqrt(2)] * 8])
    for sign in (1, -1):
        assert np.abs(evaluate(sign * x)[5] / np.arctan(sign * x) - 1).max() < 3.5e-16


def test_exact_at_zero(evaluate: Evaluate) -> None:
    sine, cosine, tangent, exponential_of_zero, _, arctangent_of_zero = evaluate(np.zeros(LANES))
    assert (exponential_of_zero == 1).all()
    assert (sine == 0).all()
    assert (cosine == 1).all()
    assert (tangent == 0).all()
    assert (arctangent_of_zero == 0).all()
