"""Rules of the verdict, branch by branch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.verdict import (
    CHANGED_BELOW,
    NAMED_ABOVE,
    OTHERWISE_BELOW,
    SURE_ABOVE,
    SURE_P_VALUE,
    judge,
    needs_cause,
)
from jointplay.catalogue.matching.conformal import Conformal
from jointplay.catalogue.matching.matcher import DOUBTED_BELOW, HypothesisMatch, MatchResult, rank
from jointplay.catalogue.matching.modes import UNKNOWN_BELOW
from jointplay.catalogue.signals.sensor_flaws import SensorContradiction

NOTHING = np.zeros(1)
MOUNT = NamedCause("mount 1", 0.5, "x stiffness", 0.9)
FLAW = SensorContradiction("inverted", ("s1-x",), "s1-x is inverted")


def answer(trusted_p_value: float | None = 0.5, **hypotheses: tuple[float, float]) -> MatchResult:
    """Hypotheses by probability and p-value; each worn in the joints of its name."""
    matches = []
    for label, (probability, p_value) in hypotheses.items():
        joints = () if label == "healthy" else tuple(label)
        matches.append(HypothesisMatch(label, joints, probability, (), 1.0, p_value, NOTHING, NOTHING))
    return replace(rank(matches), trusted_p_value=trusted_p_value)


def test_the_likelier_of_worn_and_in_order() -> None:
    assert judge(answer(A=(0.98, 0.3), healthy=(0.02, 0.001)), 0.95) == (0.3, "worn")
    assert judge(answer(A=(0.02, 0.3), healthy=(0.98, 0.5)), 0.95) == (0.5, "in_order")
    # Wear is what all sets of worn joints have together; but then one of them has to lead.
    assert judge(answer(A=(0.45, 0.5), healthy=(0.4, 0.3), B=(0.15, 0.2)), 0.95) == (0.5, "worn")
    assert judge(answer(healthy=(0.4, 0.5), A=(0.35, 0.3), B=(0.25, 0.2)), 0.95) == (0.5, "unknown")
    # Neither is the likelier one: no joint is called worn.
    assert judge(answer(healthy=(0.5, 0.5), A=(0.5, 0.3)), 0.95) == (0.5, "in_order")


def test_what_fits_no_likely_hypothesis_is_unknown() -> None:
    assert judge(answer(A=(0.99, 0.002), B=(0.01, 0.9)), 0.95) == (0.002, "unknown")
    # One likely explanation that fits is enough, and what is likely depends on the coverage.
    assert judge(answer(A=(0.7, 0.002), B=(0.3, 0.2)), 0.95) == (0.2, "worn")
    assert judge(answer(A=(0.7, 0.002), B=(0.3, 0.2)), 0.5) == (0.002, "unknown")
    at, below = UNKNOWN_BELOW, 0.99 * UNKNOWN_BELOW
    assert judge(answer(A=(0.99, at), healthy=(0.01, 0.9)), 0.95) == (at, "worn")
    assert judge(answer(A=(0.99, below), healthy=(0.01, 0.9)), 0.95) == (below, "unknown")


def test_an_empty_set_is_unknown_however_well_the_best_fits() -> None:
    # True hypotheses have 0.999 in all held-out draws: none of these is as probable.
    sure = Conformal.fit(np.tile([0.999, 0.001], (10_000, 1)), np.zeros(10_000, dtype=np.int64), np.ones(10_000))
    even = replace(answer(A=(0.4, 0.5), B=(0.35, 0.5), healthy=(0.25, 0.5)), conformal=sure)
    assert even.set(0.95).labels == ()
    assert judge(even, 0.95) == (0.5, "unknown")
    # The same of a machine that is not as filed, unless something is known that it is.
    changed = replace(even, trusted_p_value=1e-6)
    assert judge(changed, 0.95) == (0.5, "unknown")
    assert judge(changed, 0.95, [MOUNT]) == (0.5, "changed")


def test_a_machine_that_is_not_as_it_was_is_not_in_order() -> None:
    """Neither one that differs from its own past, nor one of which a cause explains how it does; wear stays wear."""
    in_order, worn = answer(healthy=(0.98, 0.5), A=(0.02, 0.3)), answer(A=(0.98, 0.5), healthy=(0.02, 0.3))
    for p_since, verdict in ((OTHERWISE_BELOW, "in_order"), (0.99 * OTHERWISE_BELOW, "changed")):
        assert judge(in_order, 0.95, p_since=p_since) == (0.5, verdict)
        assert judge(worn, 0.95, p_since=p_since) == (0.5, "worn")
    faint = replace(MOUNT, probability=0.4)
    assert judge(in_order, 0.95, [faint]) == (0.5, "in_order")
    assert judge(in_order, 0.95, [replace(faint, since=True)]) == (0.5, "changed")


def test_a_machine_that_is_as_it_was_is_in_order_whatever_its_file_says() -> None:
    at, below = OTHERWISE_BELOW, 0.99 * OTHERWISE_BELOW
    for fits in (0.5, 1e-3):
        other = answer(1e-6, healthy=(0.98, fits), A=(0.02, fits))
        assert judge(other, 0.95, p_since=at)[1] == "in_order"
        assert judge(other, 0.95, p_since=below)[1] == judge(other, 0.95)[1] == ("changed" if fits > 0.1 else "unknown")
    # Wear that is likelier than none is not in order, and has to be nearly sure.
    likely, sure = (answer(1e-6, A=(p, 0.5), healthy=(1.0 - p, 0.5)) for p in (0.8, 0.95))
    assert judge(likely, 0.95, p_since=at) == (0.5, "unknown")
    assert judge(sure, 0.95, p_since=at) == (0.5, "worn")


def test_a_machine_is_not_as_filed_below_a_p_value() -> None:
    for trusted_p, needed in ((None, False), (0.5, False), (CHANGED_BELOW, False), (0.99 * CHANGED_BELOW, True)):
        assert needs_cause(answer(trusted_p, healthy=(0.9, 0.5), A=(0.1, 0.5))) is needed


@pytest.mark.parametrize("causes", [[], [MOUNT]])
def test_a_machine_that_is_not_as_filed_is_never_in_order(causes: list[NamedCause]) -> None:
    assert judge(answer(1e-4, healthy=(0.97, 0.5), A=(0.03, 0.5)), 0.95, causes) == (0.5, "changed")
    believed = judge(answer(2e-3, healthy=(0.97, 0.5), A=(0.03, 0.5)), 0.95, causes)
    assert believed == (0.5, "changed" if causes else "in_order")


def test_a_machine_that_is_not_as_filed_is_worn_only_where_that_is_nearly_sure_and_nothing_else_found() -> None:
    for probability, verdict in ((SURE_ABOVE, "worn"), (0.99 * SURE_ABOVE, "changed")):
        found = answer(1e-4, A=(probability, 0.5), healthy=(1.0 - probability, 0.5))
        assert judge(found, 0.95) == (0.5, verdict)
        assert judge(found, 0.95, [MOUNT]) == (0.5, "changed")
        # What is not probable enough is not what has changed.
        assert judge(found, 0.95, [replace(MOUNT, probability=0.99 * NAMED_ABOVE)]) == (0.5, verdict)
        assert judge(found, 0.95, [replace(MOUNT, probability=NAMED_ABOVE)]) == (0.5, "changed")
    for p_value, verdict in ((SURE_P_VALUE, "worn"), (0.99 * SURE_P_VALUE, "changed")):
        found = answer(1e-4, A=(0.99, p_value), healthy=(0.01, p_value))
        assert judge(found, 0.95) == (p_value, verdict)


def test_wear_that_is_nearly_sure_beside_the_own_past_is_worn_whatever_the_file_has_wrong() -> None:
    for probability, verdict in ((SURE_ABOVE, "worn"), (0.99 * SURE_ABOVE, "changed")):
        found = answer(1e-4, A=(probability, 0.5), healthy=(1.0 - probability, 0.5))
        assert judge(found, 0.95, [MOUNT]) == (0.5, "changed")
        assert judge(replace(found, beside=True), 0.95, [MOUNT]) == (0.5, verdict)
        # It need fit no better than what is explained at all.
        fits = answer(1e-4, A=(probability, UNKNOWN_BELOW), healthy=(1.0 - probability, 0.5))
        assert judge(replace(fits, beside=True), 0.6, [MOUNT]) == (UNKNOWN_BELOW, verdict)
    # Nor is it where nothing explains the recording, or its sensors contradict each other.
    unexplained = replace(answer(1e-6, A=(0.99, 1e-3), healthy=(0.01, 1e-4)), beside=True)
    assert judge(unexplained, 0.95, [MOUNT]) == (1e-3, "changed")
    assert judge(unexplained, 0.95) == (1e-3, "unknown")
    sure = replace(answer(1e-4, A=(0.99, 0.5), healthy=(0.01, 0.5)), beside=True)
    assert judge(sure, 0.95, [], (FLAW,)) == (0.5, "unknown")


def test_a_doubted_machine_is_worn_only_where_that_is_nearly_sure() -> None:
    likely = {"A": (0.8, 0.5), "healthy": (0.2, 0.5)}
    sure = {"A": (0.95, 0.5), "healthy": (0.05, 0.5)}
    assert judge(answer(DOUBTED_BELOW, **likely), 0.95) == (0.5, "worn")
    assert judge(answer(0.99 * DOUBTED_BELOW, **likely), 0.95) == (0.5, "unknown")
    assert judge(answer(0.99 * DOUBTED_BELOW, **sure), 0.95) == (0.5, "worn")
    # In order it may be all the same.
    assert judge(answer(0.99 * DOUBTED_BELOW, healthy=(0.6, 0.5), A=(0.4, 0.5)), 0.95) == (0.5, "in_order")


def test_a_machine_that_nothing_explains_is_changed_only_where_a_cause_was_found() -> None:
    unexplained = answer(1e-6, A=(0.99, 1e-3), healthy=(0.01, 1e-4))
    assert judge(unexplained, 0.95) == (1e-3, "unknown")
    assert judge(unexplained, 0.95, [MOUNT]) == (1e-3, "changed")
    # Of a machine that could be as filed only clear causes are found; they are a reason, unless wear is one.
    as_filed = answer(0.01, A=(0.99, 1e-3), healthy=(0.01, 1e-4))
    assert judge(as_filed, 0.95, [MOUNT]) == (1e-3, "changed")
    assert judge(answer(0.5, A=(0.99, 0.5), healthy=(0.01, 1e-4)), 0.95, [MOUNT]) == (0.5, "worn")


@pytest.mark.parametrize("trusted_p", [None, 0.5, 1e-6])
def test_what_flawed_sensors_say_is_unknown(trusted_p: float | None) -> None:
    for found in (answer(trusted_p, A=(0.99, 0.5), healthy=(0.01, 0.1)), answer(trusted_p, healthy=(1.0, 0.5))):
        assert judge(found, 0.95, [], [FLAW]) == (0.5, "unknown")
        assert judge(found, 0.95, [MOUNT], [FLAW]) == (0.5, "unknown")
