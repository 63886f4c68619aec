"""The probabilistic matcher on feature models whose posterior is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from feature_model import HIGH, LOW, FeatureModel

from jointplay.catalogue.errors import MatchingError
from jointplay.catalogue.matching import gaussian
from jointplay.catalogue.matching.calibration import calibration_error, is_held_out, log_loss
from jointplay.catalogue.matching.gaussian import FittedGaussian, fit_gaussian
from jointplay.catalogue.matching.matcher import DrawnFeatures, TrainingSet

MODEL = FeatureModel()
DRAWS = 160


@cache
def fitted(noise: float = MODEL.noise, separation: float = 1.0) -> FittedGaussian:
    model = FeatureModel(noise=noise, separation=separation)
    return fit_gaussian(model.training(DRAWS, np.random.default_rng(1)))


def test_posterior_is_near_the_exact_one_and_calibrated() -> None:
    model = FeatureModel(noise=4.0, separation=0.25)
    features, truth, _ = model.queries(250, np.random.default_rng(2))
    found = fitted(4.0, 0.25).posterior(features)
    exact = model.posterior(features)
    assert np.allclose(found.sum(axis=1), 1.0)
    top = (found.argmax(axis=1) == truth).mean()
    best = (exact.argmax(axis=1) == truth).mean()
    assert best < 0.98, "the task must not be trivial"
    assert top > best - 0.06
    assert log_loss(found, truth) < log_loss(exact, truth) + 0.15
    assert calibration_error(found, truth) < 0.04


def test_clearance_is_found_and_its_interval_covers_nine_in_ten() -> None:
    generator = np.random.default_rng(3)
    inside, errors = [], []
    for value in generator.uniform(LOW + 0.2, HIGH - 0.2, 150):
        feature = MODEL.draw("B", np.array([value]), generator)[0]
        estimate = next(m for m in fitted().match(feature).hypotheses if m.label == "B").clearances[0]
        assert estimate.joint == "B"
        assert estimate.low < estimate.median < estimate.high
        inside.append(estimate.low <= np.exp(value) <= estimate.high)
        errors.append(abs(np.log(estimate.median) - value))
    assert 0.83 <= np.mean(inside) <= 0.98
    assert np.median(errors) < 0.08


def test_more_noise_gives_wider_intervals() -> None:
    clearance = np.full(40, 0.5 * (LOW + HIGH))

    def width(noise: float) -> float:
        rows = FeatureModel(noise=noise).draw("A", clearance, np.random.default_rng(4))
        matches = [next(m for m in fitted(noise).match(row).hypotheses if m.label == "A") for row in rows]
        return float(np.mean([np.log(m.clearances[0].high / m.clearances[0].low) for m in matches]))

    assert width(1.0) < width(2.0) < width(6.0)


def test_an_unknown_pattern_gets_a_small_p_value_and_known_ones_do_not() -> None:
    features, truth, _ = MODEL.queries(60, np.random.default_rng(5))
    labels = fitted().labels
    known = [
        next(m for m in fitted().match(row).hypotheses if m.label == labels[index]).p_value
        for row, index in zip(features, truth, strict=True)
    ]
    assert np.mean(np.array(known) < 0.05) < 0.1
    strange = np.where(np.arange(MODEL.length) % 2, 12.0, -12.0)
    assert all(fitted().match(row + strange).best.p_value < 0.02 for row in features[::20])
    one_order = np.zeros(MODEL.length)
    one_order[1:4] = 12.0
    assert all(fitted().match(row + one_order).best.p_value < 0.05 for row in features[::20])


def test_order_of_hypotheses_and_of_rows_does_not_matter() -> None:
    training = MODEL.training(40, np.random.default_rng(6))
    features, _, _ = MODEL.queries(10, np.random.default_rng(7))
    turned = TrainingSet(training.hypotheses[::-1], training.watched)
    one, other = fit_gaussian(training), fit_gaussian(turned)
    assert other.labels == one.labels[::-1]
    # Folds are dealt by a generator running over the hypotheses, so calibration differs in small ways only.
    assert np.abs(one.posterior(features) - other.posterior(features)[:, ::-1]).max() < 0.05
    assert np.allclose(
        one.model.log_evidences(features),
        other.model.log_evidences(features)[:, ::-1],
    )
    shuffled = []
    for draws in training.hypotheses:
        order = np.random.default_rng(8).permutation(len(draws.features))
        shuffled.append(
            DrawnFeatures(
                draws.label, draws.joints, draws.features[order], draws.log_clearance[order], draws.entry[order]
            )
        )
    again = fit_gaussian(TrainingSet(tuple(shuffled), training.watched))
    assert np.allclose(one.posterior(features), again.posterior(features), atol=1e-9)


def test_order_of_features_does_not_matter() -> None:
    training = MODEL.training(40, np.random.default_rng(9))
    features, _, _ = MODEL.queries(10, np.random.default_rng(10))
    order = np.random.default_rng(11).permutation(MODEL.length)
    moved = TrainingSet(
        tuple(
            DrawnFeatures(d.label, d.joints, d.features[:, order], d.log_clearance, d.entry, d.prior)
            for d in training.hypotheses
        ),
        training.watched[order],
    )
    one, other = fit_gaussian(training), fit_gaussian(moved)
    assert np.allclose(one.posterior(features), other.posterior(features[:, order]), atol=1e-6)


def test_block_and_single_answers_agree() -> None:
    features, _, _ = MODEL.queries(5, np.random.default_rng(12))
    block = fitted().posterior(features)
    for row, expected in zip(features, block, strict=True):
        result = fitted().match(row)
        assert [result.probability(label) for label in fitted().labels] == pytest.approx(list(expected))
        assert sum(h.probability for h in result.hypotheses) == pytest.approx(1.0)
        joints = result.joint_probabilities()
        assert joints == pytest.approx({joint: result.probability(joint) for joint in MODEL.joints})
        assert result.candidate_set(0.95)[0] == result.best.label
        assert set(result.candidate_set(1.1)) == set(fitted().labels)


def test_prior_moves_the_answer() -> None:
    training = MODEL.training(40, np.random.default_rng(13))
    features, _, _ = FeatureModel(noise=6.0).queries(40, np.random.default_rng(14))
    first, *rest = training.hypotheses
    heavy = DrawnFeatures(first.label, first.joints, first.features, first.log_clearance, first.entry, prior=100.0)
    plain = fit_gaussian(training).posterior(features)
    moved = fit_gaussian(TrainingSet((heavy, *rest), training.watched)).posterior(features)
    assert moved[:, 0].mean() > plain[:, 0].mean()


def test_two_joints_are_estimated_together() -> None:
    generator = np.random.default_rng(15)

    def pair(clearances: np.ndarray) -> np.ndarray:
        power = [10.0 ** (0.1 * MODEL.mean(j, c)) for j, c in zip("AB", clearances.T, strict=True)]
        scatter = generator.normal(size=(len(clearances), MODEL.length)) @ np.linalg.cholesky(MODEL.covariance).T
        level: np.ndarray = 10.0 * np.log10(power[0] + power[1]) + scatter
        return level

    clearances = generator.uniform(LOW, HIGH, (300, 2))
    draws = DrawnFeatures("A+B", ("A", "B"), pair(clearances), clearances, np.arange(300), prior=0.15)
    singles = MODEL.training(DRAWS, generator)
    matcher = fit_gaussian(TrainingSet((*singles.hypotheses, draws), singles.watched))
    truth = generator.uniform(LOW + 0.5, HIGH - 0.5, (30, 2))
    right, errors = 0, []
    for feature, value in zip(pair(truth), truth, strict=True):
        best = matcher.match(feature).best
        right += best.label == "A+B"
        if best.label == "A+B":
            errors.append(np.abs(np.log([c.median for c in best.clearances]) - value))
    assert right >= 24
    assert np.median(errors) < 0.3


def test_three_joints_are_a_hypothesis() -> None:
    generator = np.random.default_rng(25)

    def triple(clearances: np.ndarray) -> np.ndarray:
        power = [10.0 ** (0.1 * MODEL.mean(j, c)) for j, c in zip("ABC", clearances.T, strict=True)]
        scatter = generator.normal(size=(len(clearances), MODEL.length)) @ np.linalg.cholesky(MODEL.covariance).T
        level: np.ndarray = 10.0 * np.log10(sum(power)) + scatter
        return level

    clearances = generator.uniform(LOW, HIGH, (400, 3))
    draws = DrawnFeatures("A+B+C", ("A", "B", "C"), triple(clearances), clearances, np.arange(400), prior=0.15**2)
    singles = MODEL.training(DRAWS, generator)
    matcher = fit_gaussian(TrainingSet((*singles.hypotheses, draws), singles.watched))
    truth = generator.uniform(LOW + 0.5, HIGH - 0.5, (20, 3))
    found = [matcher.match(feature).best for feature in triple(truth)]
    assert sum(best.label == "A+B+C" for best in found) >= 16
    errors = [
        np.abs(np.log([c.median for c in best.clearances]) - value)
        for best, value in zip(found, truth, strict=True)
        if best.label == "A+B+C"
    ]
    # The range of ln(clearance) is 3.5: knowing nothing would be 0.9.
    assert np.median(errors) < 0.5


def test_many_draws_are_split_once_and_few_are_held_out_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    many = MODEL.training(240, np.random.default_rng(26))
    split = fit_gaussian(many)
    monkeypatch.setattr(gaussian, "SPLIT_CASES", 1000)
    in_turn = fit_gaussian(many)
    assert len(split.calibration.distances[0].values) == np.sum(is_held_out(np.arange(240)))
    assert len(in_turn.calibration.distances[0].values) == 240
    features, truth, _ = MODEL.queries(60, np.random.default_rng(27))
    # Both know about the same: log-losses measured 0.003 apart.
    losses = [log_loss(fitted.posterior(features), truth) for fitted in (split, in_turn)]
    assert abs(losses[0] - losses[1]) < 0.05


def test_rows_count_as_much_as_their_weights() -> None:
    generator = np.random.default_rng(28)
    training = MODEL.training(120, generator)
    shifted = []
    for draws in training.hypotheses:
        wrong = np.arange(120) % 2 == 1
        features = draws.features + np.where(wrong, 15.0, 0.0)[:, None]
        weight = np.where(wrong, 1e-6, 1.0)
        shifted.append(
            DrawnFeatures(draws.label, draws.joints, features, draws.log_clearance, draws.entry, draws.prior, weight)
        )
    fitted = fit_gaussian(TrainingSet(tuple(shifted), training.watched))
    feature = MODEL.draw("B", np.array([np.log(3e-4)]), generator)[0]
    best = fitted.match(feature).best
    assert best.label == "B"
    assert best.distance_db < 4.0


def test_refuses_what_it_cannot_learn_or_match() -> None:
    training = MODEL.training(40, np.random.default_rng(16))
    with pytest.raises(MatchingError, match="must be 24 finite numbers"):
        fitted().match(np.zeros(3))
    with pytest.raises(MatchingError, match="finite"):
        fitted().match(np.full(MODEL.length, np.nan))
    short = training.hypotheses[0].rows(np.arange(40) < 3)
    with pytest.raises(MatchingError, match="3 draws: must be at least 4"):
        fit_gaussian(TrainingSet((short, *training.hypotheses[1:]), training.watched))
    with pytest.raises(MatchingError, match="its own label"):
        TrainingSet((training.hypotheses[0], training.hypotheses[0]), training.watched)
    with pytest.raises(MatchingError, match="finite numbers"):
        DrawnFeatures("A", ("A",), np.full((3, 2), np.inf), np.zeros((3, 1)), np.arange(3))


def test_curves_are_drawn_through_the_first_features_only() -> None:
    """What stands behind them, here nothing but noise, is for networks: answers are those without it."""
    training = MODEL.training(60, np.random.default_rng(5))
    generator = np.random.default_rng(6)
    longer = tuple(
        replace(draws, features=np.hstack([draws.features, generator.normal(0.0, 9.0, (len(draws.features), 7))]))
        for draws in training.hypotheses
    )
    more = TrainingSet(longer, training.watched, plain=training.length)
    feature = training.hypotheses[1].features[0]
    short, long = (
        fit_gaussian(each).match(asked)
        for each, asked in ((training, feature), (more, np.r_[feature, np.full(7, 99.0)]))
    )
    assert [each.label for each in long.hypotheses] == [each.label for each in short.hypotheses]
    assert [each.probability for each in long.hypotheses] == pytest.approx(
        [each.probability for each in short.hypotheses], abs=1e-9
    )
    assert long.best.clearances == short.best.clearances
