"""The nearest-entry matcher, and that it answers through the same interface."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from feature_model import HIGH, LOW, FeatureModel
from sklearn.linear_model import LogisticRegression
from sklearn.naive_bayes import GaussianNB
from sklearn.neighbors import KNeighborsClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

from jointplay.catalogue.errors import MatchingError
from jointplay.catalogue.evaluation.cross_checks import ClassifierMatcher, FittedClassifier, as_matcher, extra_trees
from jointplay.catalogue.evaluation.nearest_entry import (
    ChordDistance,
    DecibelDistance,
    FittedEntries,
    NearestEntry,
    cosine_entry,
)
from jointplay.catalogue.matching.calibration import Tail, calibration_error, combine, folds
from jointplay.catalogue.matching.gaussian import fit_gaussian
from jointplay.catalogue.matching.matcher import TrainingSet

MODEL = FeatureModel()


@cache
def fitted() -> FittedEntries:
    return NearestEntry().fit(MODEL.training(160, np.random.default_rng(1)))


def test_pair_is_the_definition_and_block_agrees() -> None:
    generator = np.random.default_rng(2)
    first, second = generator.normal(-60.0, 20.0, (7, 30)), generator.normal(-60.0, 20.0, (9, 30))
    metric = DecibelDistance()
    block = metric.block(first, second)
    assert block.shape == (7, 9)
    for i in range(7):
        for j in range(9):
            assert block[i, j] == pytest.approx(metric.pair(first[i], second[j]), rel=1e-9)
    assert np.allclose(np.diag(metric.block(first, first)), 0.0, atol=1e-5)
    assert np.allclose(block, metric.block(second, first).T)
    assert metric.pair(np.zeros(4), np.full(4, 3.0)) == 3.0


def test_finds_joint_and_clearance() -> None:
    features, truth, clearance = MODEL.queries(80, np.random.default_rng(3))
    posterior = fitted().posterior(features)
    assert (posterior.argmax(axis=1) == truth).mean() > 0.9
    assert calibration_error(posterior, truth) < 0.08
    inside = []
    for row, index, value in zip(features, truth, clearance, strict=True):
        result = fitted().match(row)
        assert [result.probability(label) for label in fitted().labels] == pytest.approx(
            list(fitted().posterior(row[None, :])[0])
        )
        own = next(m for m in result.hypotheses if m.label == fitted().labels[index])
        if own.clearances and LOW + 0.1 < value < HIGH - 0.1:
            inside.append(own.clearances[0].low <= np.exp(value) <= own.clearances[0].high)
    assert 0.8 < np.mean(inside) < 0.99


def test_an_unknown_pattern_gets_a_small_p_value() -> None:
    features, _, _ = MODEL.queries(5, np.random.default_rng(4))
    assert all(fitted().match(row + 25.0).best.p_value < 0.02 for row in features)
    assert np.mean([fitted().match(row).best.p_value for row in features]) > 0.1


@pytest.mark.parametrize(
    "fit",
    [NearestEntry().fit, fit_gaussian, cosine_entry().fit, extra_trees(60).fit],
    ids=["nearest", "own", "cosine", "trees"],
)
def test_all_stand_behind_the_same_interface(fit: Any) -> None:
    known = fit(MODEL.training(40, np.random.default_rng(5)))
    feature = MODEL.draw("C", np.array([np.log(3e-4)]), np.random.default_rng(6))[0]
    result = known.match(feature)
    assert result.best.label == "C"
    assert result.best.predicted.shape == result.best.spread.shape == feature.shape
    assert (result.best.spread > 0.0).all()
    assert known.match(feature).best.probability == result.best.probability
    with pytest.raises(MatchingError, match="must be 24 finite numbers"):
        known.match(feature[:-1])


def test_folds_hold_out_every_row_once_and_cases_together() -> None:
    training = MODEL.training(30, np.random.default_rng(7))
    parts = [
        type(draws)(draws.label, draws.joints, draws.features, draws.log_clearance, draws.entry // 3)
        for draws in training.hypotheses
    ]
    training = type(training)(tuple(parts), training.watched)
    seen = dict.fromkeys(training.labels, 0)
    for learned, held in folds(training, 4):
        for a, b in zip(learned.hypotheses, held.hypotheses, strict=True):
            assert not set(a.entry) & set(b.entry)
            seen[b.label] += len(b.features)
    assert seen == dict.fromkeys(training.labels, 30)


def test_tail_counts_and_is_never_zero() -> None:
    tail = Tail.of(np.array([3.0, 1.0, 2.0]))
    assert tail.p_value(0.0) == 1.0
    assert tail.p_value(2.0) == 0.75
    assert 0.0 < tail.p_value(90.0) < tail.p_value(9.0) < tail.p_value(3.0) <= 0.5
    # An exponential tail is continued as what it is; 10 % for the scatter of 4000 draws.
    many = Tail.of(np.random.default_rng(1).exponential(2.0, 4000))
    for value in (6.0, 12.0, 18.0):
        assert np.log(many.p_value(value)) == pytest.approx(-value / 2.0, rel=0.1)
    assert combine(0.01, 0.5) == 0.02
    assert combine(0.9, 0.8) == 1.0
    assert combine(0.04, 0.9, 0.8) == pytest.approx(0.05)
    assert combine(0.9, 0.01, 0.8) == pytest.approx(0.05)


def test_chord_is_the_definition_and_block_agrees() -> None:
    generator = np.random.default_rng(8)
    first, second = generator.normal(-60.0, 20.0, (7, 30)), generator.normal(-60.0, 20.0, (9, 30))
    metric = ChordDistance()
    block = metric.block(first, second)
    assert block == pytest.approx(np.array([[metric.pair(a, b) for b in second] for a in first]), rel=1e-9)
    assert np.allclose(block, metric.block(second, first).T)
    # Neither the mean level nor the range of levels counts.
    assert metric.pair(first[0], 3.0 * first[0] + 40.0) == pytest.approx(0.0, abs=1e-7)
    assert metric.pair(first[0], -first[0]) == pytest.approx(2.0)
    assert np.isfinite(metric.block(np.zeros((1, 4)), np.ones((1, 4)))).all()


@pytest.mark.parametrize("matcher", [cosine_entry(), extra_trees(100)], ids=lambda m: m.name)
def test_cross_checks_find_the_joint_and_know_how_sure_they_are(matcher: Any) -> None:
    features, truth, clearance = MODEL.queries(60, np.random.default_rng(9))
    known = matcher.fit(MODEL.training(160, np.random.default_rng(1)))
    posterior = known.posterior(features)
    assert posterior.sum(axis=1) == pytest.approx(np.ones(len(features)))
    assert (posterior.argmax(axis=1) == truth).mean() > 0.9
    assert calibration_error(posterior, truth) < 0.08
    rows = np.flatnonzero(truth > 0)[::12]
    errors = []
    for row in rows:
        result = known.match(features[row])
        assert result.probability(known.labels[truth[row]]) == pytest.approx(posterior[row, truth[row]])
        own = next(m for m in result.hypotheses if m.label == known.labels[truth[row]])
        errors.append(abs(np.log(own.clearances[0].median) - clearance[row]))
        assert own.clearances[0].low < own.clearances[0].median < own.clearances[0].high
    assert np.median(errors) < 0.25


@pytest.mark.parametrize(
    "classifier",
    [GaussianNB(), make_pipeline(StandardScaler(), KNeighborsClassifier(15)), LogisticRegression(max_iter=500)],
    ids=lambda each: type(each).__name__,
)
def test_any_classifier_of_scikit_learn_is_a_matcher(classifier: Any) -> None:
    features, truth, clearance = MODEL.queries(60, np.random.default_rng(9))
    training = MODEL.training(160, np.random.default_rng(1))
    matcher = as_matcher(classifier, "theirs")
    known = matcher.fit(training)
    assert isinstance(known, FittedClassifier)
    assert matcher.name == "theirs"
    assert not hasattr(classifier, "classes_")  # a clone has learned
    posterior = known.posterior(features)
    assert (posterior.argmax(axis=1) == truth).mean() > 0.9
    assert calibration_error(posterior, truth) < 0.08
    result = known.match(features[70])
    nearest = NearestEntry().fit(training).match(features[70])
    assert result.best.label == "A"
    assert result.best.clearances == next(m.clearances for m in nearest.hypotheses if m.label == "A")
    assert result.best.clearances[0].low < np.exp(clearance[70]) < result.best.clearances[0].high


def test_what_a_classifier_takes_for_probable_as_there_is_much_of_it_does_not_count() -> None:
    training = MODEL.training(160, np.random.default_rng(1))
    few = tuple(each.rows(each.entry < 40) if each.label == "A" else each for each in training.hypotheses)
    unlike = MODEL.queries(1, np.random.default_rng(9))[0][:1] + 400.0 * np.resize([1.0, -1.0], 24)
    # Far from everything all classes are among the neighbours as often as there are rows of them.
    everyone = KNeighborsClassifier(n_neighbors=390)
    known = ClassifierMatcher(everyone).fit(TrainingSet(few, training.watched))
    assert known.posterior(unlike)[0] == pytest.approx(np.full(4, 0.25), abs=0.02)


def test_a_classifier_without_probabilities_is_refused() -> None:
    with pytest.raises(MatchingError, match="method rough: has no predict_proba"):
        as_matcher(LinearSVC(), "rough").fit(MODEL.training(40, np.random.default_rng(5)))
