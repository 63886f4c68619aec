"""What contact laws make of a coefficient of restitution."""

from __future__ import annotations

import math

import pytest

from jointplay.solver.machines.restitution import (
    HYSTERESIS,
    effective_restitution,
    hysteresis_factor,
    remark,
    restitution_of,
)


def test_the_identity_holds_of_what_is_returned() -> None:
    """c - ln(1 + c) = -c e - ln(1 - c e). At c = 10 the last bit of e is 1e-11 of the right side."""
    for c in (1e-3, 0.1, 0.75, 1.5, 10.0):
        e = restitution_of(c)
        assert math.log1p(c) - c == pytest.approx(c * e + math.log1p(-c * e), rel=1e-9)


def test_without_hysteresis_nothing_is_lost() -> None:
    for law in HYSTERESIS:
        assert hysteresis_factor(law, 1.0) == 0
        assert effective_restitution(law, 1.0) == 1
    # To first order 1 - 2 c / 3; the limit and the root meet.
    assert restitution_of(0.99e-6) == pytest.approx(restitution_of(1.01e-6), abs=2e-8)
    assert restitution_of(1e-4) == pytest.approx(1 - 2e-4 / 3, abs=1e-8)


def test_restitution_falls_with_hysteresis_and_never_to_nothing() -> None:
    found = [restitution_of(c) for c in (0.0, 0.1, 1.0, 10.0, 1e3, 1e17)]
    assert found == sorted(found, reverse=True)
    assert found[-1] > 0


def test_a_law_far_off_says_so_with_both_numbers() -> None:
    said = "contact law lankarani-nikravesh asked for a restitution of 0.8 returns 0.847"
    assert remark("lankarani-nikravesh", 0.8) == said
    assert remark("lankarani-nikravesh", 0.85) == ""  # 0.8791: 3.4 %
    assert remark("gonthier", 0.3) == ""  # 0.3042: 1.4 %
    assert remark("flores", 0.3) == "contact law flores asked for a restitution of 0.3 returns 0.256"
