"""Extremely randomised trees: a cross-check that shares no model with the Gaussian method.

Trees give probabilities and clearances only. Predicted levels and the p-value are those of the nearest entry, because
trees do not say whether anything fits.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jointplay.catalogue.matching.calibration import fit_temperature, folds, probabilities, row_weights
from jointplay.catalogue.matching.conformal import Conformal
from jointplay.catalogue.matching.entry_matcher import FittedEntries, fit_entries
from jointplay.catalogue.matching.matcher import (
    ClearanceEstimate,
    FloatArray,
    HypothesisMatch,
    MatchResult,
    TrainingSet,
    ranked,
)
from jointplay.catalogue.matching.nearest import DecibelDistance

LEAST_SHARE = 1e-3
"""Share of the trees' votes a hypothesis is taken to have at least: 300 trees cannot tell smaller ones."""


@dataclass(frozen=True)
class ExtraTrees:
    """Settings of the method; :meth:`fit` learns a training set.

    Parameters
    ----------
    trees : int
    fold_count : int
        One part of so many is held out for calibration.
    seed : int
        Of the random splits.

    Notes
    -----
    P. Geurts, D. Ernst, L. Wehenkel, Machine Learning 63 (2006) 3; by scikit-learn.
    """

    trees: int = 300
    fold_count: int = 4
    seed: int = 0
    name: str = field(default="extra-trees", init=False)
    version: str = field(default="2", init=False)

    def fit(self, training: TrainingSet) -> FittedTrees:
        """Learn three quarters of a training set and calibrate on the rest.

        Raises
        ------
        MatchingError
            A hypothesis has fewer than two draws.
        """
        # Here, not above: the import takes a second, and only a cross-check needs it.
        from sklearn.ensemble import ExtraTreesClassifier, ExtraTreesRegressor

        entries = fit_entries(DecibelDistance(), training, self.fold_count)
        learned, held = next(folds(training, self.fold_count))
        features, index = learned.stacked()
        classifier = ExtraTreesClassifier(self.trees, random_state=self.seed)
        classifier.fit(features, index, sample_weight=row_weights(index) * len(index))
        regressors: list[Any] = []
        errors: list[FloatArray] = []
        for draws, apart in zip(learned.hypotheses, held.hypotheses, strict=True):
            if not draws.log_clearance.shape[1]:
                regressors.append(None)
                errors.append(np.zeros((3, 0)))
                continue
            regressor = ExtraTreesRegressor(self.trees // 3, random_state=self.seed)
            target = draws.log_clearance
            regressor.fit(draws.features, target if target.shape[1] > 1 else target[:, 0])
            left = apart.log_clearance - regressor.predict(apart.features).reshape(apart.log_clearance.shape)
            regressors.append(regressor)
            errors.append(np.quantile(left, [0.05, 0.5, 0.95], axis=0))
        bare = FittedTrees(entries, classifier, tuple(regressors), tuple(errors), 1.0, entries.conformal)
        held_features, truth = held.stacked()
        evidence, weights = bare.log_evidence(held_features), row_weights(truth)
        temperature = fit_temperature(evidence, truth, weights, between=(0.05, 8.0))
        fitted = replace(bare, temperature=temperature)
        return replace(fitted, conformal=Conformal.fit(fitted.posterior(held_features), truth, weights))


@dataclass(frozen=True, eq=False)
class FittedTrees:
    """A learned training set; answers one feature vector or a block of them.

    Parameters
    ----------
    entries : FittedEntries
        Nearest entries, for everything but probabilities and clearances.
    classifier : ExtraTreesClassifier
    regressors : tuple of ExtraTreesRegressor or None
        Of ln(clearance), per hypothesis; None where there is none.
    errors : tuple of ndarray, each (3, k)
        5, 50 and 95 % quantiles of the held-out error of ln(clearance), per hypothesis.
    temperature : float
    conformal : Conformal
    """

    entries: FittedEntries
    classifier: Any
    regressors: tuple[Any, ...]
    errors: tuple[FloatArray, ...]
    temperature: float
    conformal: Conformal

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the hypotheses, in the order of the training set."""
        return self.entries.labels

    def log_evidence(self, features: FloatArray) -> FloatArray:
        """Return ln(share of votes) (m, hypotheses), all hypotheses having had the same weight."""
        evidence: FloatArray = np.log(np.maximum(self.classifier.predict_proba(features), LEAST_SHARE))
        return evidence

    def posterior(self, features: FloatArray) -> FloatArray:
        """Return the probabilities (m, hypotheses) of a block of feature vectors (m, d)."""
        prior = np.log([draws.prior for draws in self.entries.training.hypotheses])
        return probabilities(self.log_evidence(features) / self.temperature + prior)

    def match(self, feature: FloatArray) -> MatchResult:
        """Return the full answer for one feature vector (d,).

        Raises
        ------
        MatchingError
            The vector has another length than those learned, or is not finite.
        """
        found = self.entries.match(feature)
        posterior = dict(zip(self.labels, self.posterior(feature[None, :])[0].tolist(), strict=True))
        matches = [
            replace(match, probability=posterior[match.label], clearances=self._clearances(match, feature))
            for match in found.hypotheses
        ]
        return ranked(matches, self.conformal)

    def _clearances(self, match: HypothesisMatch, feature: FloatArray) -> tuple[ClearanceEstimate, ...]:
        h = self.labels.index(match.label)
        if self.regressors[h] is None:
            return ()
        value = np.ravel(self.regressors[h].predict(feature[None, :]))
        low, median, high = np.exp(value + self.errors[h])
        return tuple(
            ClearanceEstimate(joint, float(median[j]), float(low[j]), float(high[j]))
            for j, joint in enumerate(match.joints)
        )
