"""What findings teach about answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lives import JOINTS, answer

from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.following.teaching import Correction, Lesson, learn_from


def told(draw: np.random.Generator, *, worse: float, bias: float = 0.0) -> tuple[Diagnosis, dict[str, float], str]:
    """An answer of a machine with one worn joint whose errors are so many times what it says, and the truth."""
    worn = JOINTS[draw.integers(3)]
    true = dict.fromkeys(JOINTS, 8e-06) | {worn: 1e-4 * math.exp(draw.uniform(0.0, 1.5))}
    # Of evidence of mean 2 and variance 4 probabilities are true (logistic); of `worse` times it they are too sure.
    sides = {name: (1.0 if name == worn else -1.0) for name in JOINTS}
    evidence = {name: worse * (side * 2.0 + 2.0 * draw.normal()) for name, side in sides.items()}
    found = {name: max(true[name], 26e-6) * math.exp(bias + worse * draw.normal(0.0, 0.1)) for name in JOINTS}
    return answer(evidence, found, width=1.645 * 0.1), true, worn


def lessons(count: int, seed: int, **how: float) -> list[Lesson]:
    draw = np.random.default_rng(seed)
    found = []
    while len(found) < count:
        said, true, worn = told(draw, **how)
        found.append(Lesson(said, worn, true[worn] * math.exp(draw.normal(0.0, 0.05)), worn=True))
        other = next(name for name in JOINTS if name != worn)
        found.append(Lesson(said, other, true[other], worn=False))
    return found[:count]


def figures(correction: Correction, seed: int, **how: float) -> tuple[float, float]:
    """Share of intervals that hold, and log-loss of P(worn), over 400 answers."""
    draw = np.random.default_rng(seed)
    held, losses = 0, []
    for _ in range(400):
        said, true, worn = told(draw, **how)
        said = correction.apply(said)
        low, high = next(match.joints[worn].interval_um for match in said.hypotheses if worn in match.joints)
        held += low < 1e6 * true[worn] < high
        for name in JOINTS:
            p = sum(match.probability for match in said.hypotheses if name in match.joints)
            losses.append(-math.log(max(p if name == worn else 1.0 - p, 1e-9)))
    return held / 400, float(np.mean(losses))


def test_no_finding_teaches_nothing() -> None:
    said = answer({"A": 3.0, "B": -2.0, "O": 0.0}, dict.fromkeys(JOINTS, 1e-4))
    assert learn_from([]).apply(said) is said


def test_ten_findings_make_answers_that_were_too_sure_as_sure_as_they_may_be() -> None:
    how = {"worse": 3.0, "bias": 0.1}
    before, loss_before = figures(Correction(), 7, **how)
    after = np.array([figures(learn_from(lessons(20, seed, **how)), 7, **how) for seed in range(12)])
    assert before < 0.45
    # Ten findings of wear and ten of none: measured 0.78 in the mean, log-loss 0.74 of it.
    assert after[:, 0].mean() > 0.73
    assert after[:, 1].mean() < 0.85 * loss_before


def test_findings_leave_answers_that_are_right() -> None:
    loss = figures(Correction(), 8, worse=1.0)[1]
    after = np.array([figures(learn_from(lessons(20, seed, worse=1.0)), 8, worse=1.0) for seed in range(12)])
    assert 0.85 < after[:, 0].mean() < 0.95
    assert after[:, 1].mean() < 1.05 * loss


@pytest.mark.parametrize("clearance", [2e-6, 2.0])
def test_wrong_findings_are_noticed(clearance: float) -> None:
    """A joint measured in millimetres, or forgotten: what no answer can have meant is named, and teaches little."""
    known = lessons(20, 3, worse=1.0)
    sure = answer({"A": 12.0, "B": -12.0, "O": -12.0}, {"A": 2e-4, "B": 3e-5, "O": 3e-5})
    mistaken = Lesson(sure, "A", clearance, worn=clearance > 25e-6)
    found, without = learn_from([*known, mistaken]), learn_from(known)
    assert found.wrong == (20,)
    assert found.widening == pytest.approx(without.widening, rel=0.1)
    assert found.temperature == pytest.approx(without.temperature, rel=0.25)


def test_a_correction_keeps_what_is_likeliest() -> None:
    said = answer({"A": 3.0, "B": -2.0, "O": 0.5}, dict.fromkeys(JOINTS, 1e-4))
    cooler = Correction(temperature=2.0, shift=math.log(1.1), widening=1.5, lessons=5).apply(said)
    assert sum(match.probability for match in cooler.hypotheses) == pytest.approx(1.0)
    assert cooler.hypotheses[0].label == said.hypotheses[0].label
    assert cooler.hypotheses[0].probability < said.hypotheses[0].probability
    found, before = cooler.hypotheses[0].joints["A"], said.hypotheses[0].joints["A"]
    assert found.clearance_um == pytest.approx(110.0)
    low, high = found.interval_um
    assert math.log(high / low) == pytest.approx(1.5 * math.log(before.interval_um[1] / before.interval_um[0]))
