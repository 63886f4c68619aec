"""Searches side by side, on functions whose least values are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from jointplay.catalogue.diagnosing.causes import least_of

FloatArray = NDArray[np.float64]


def bowl(numbers: FloatArray) -> FloatArray:
    """Least at (1.3, -0.4), steep one way and flat the other."""
    away = numbers - [1.3, -0.4]
    return np.asarray(50.0 * (away[:, 0] + away[:, 1]) ** 2 + 2.0 * (away[:, 0] - away[:, 1]) ** 2)


def cusp(numbers: FloatArray) -> FloatArray:
    """Least at 0.7, with a corner there, as a level that is cancelled has."""
    return np.asarray(30.0 * np.sqrt(np.abs(numbers[:, 0] - 0.7)))


def two_valleys(numbers: FloatArray) -> FloatArray:
    """A shallow valley next to 1, and the deep one at 1.5."""
    at = numbers[:, 0]
    return np.asarray(np.minimum(100.0 * (at - 0.95) ** 2, 400.0 * (at - 1.5) ** 2 - 20.0))


def test_least_values_of_several_functions_are_found_at_once() -> None:
    calls: list[list[int]] = []

    def together(numbers: Sequence[FloatArray]) -> list[FloatArray]:
        calls.append([len(each) for each in numbers])
        return [function(each) for function, each in zip((bowl, cusp, two_valleys), numbers, strict=True)]

    found = least_of(together, [np.array([1.0, 0.0]), np.array([1.0]), np.array([1.0])])
    assert found[0][0] == pytest.approx([1.3, -0.4], abs=0.02)
    assert found[0][1] == pytest.approx(0.0, abs=0.02)
    assert found[1][0] == pytest.approx([0.7], abs=0.005)
    assert found[2][0] == pytest.approx([1.5], abs=0.005)
    assert len(calls) <= 21


def test_a_search_that_starts_at_its_end_stays_there() -> None:
    ((numbers, value),) = least_of(lambda numbers: [bowl(numbers[0])], [np.array([1.3, -0.4])])
    assert numbers == pytest.approx([1.3, -0.4], abs=1e-6)
    assert value == pytest.approx(0.0, abs=1e-6)
