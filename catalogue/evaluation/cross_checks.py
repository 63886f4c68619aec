"""Methods to hold the product's own against: the nearest entry, any classifier of scikit-learn, what others install."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import EntryPoint
from typing import Any, Protocol

import numpy as np
from cachetools import LRUCache

from jointplay.catalogue.errors import MatchingError
from jointplay.catalogue.evaluation.nearest_entry import (
    FOLDS,
    FittedEntries,
    NearestEntry,
    cosine_entry,
    error_quantiles,
    estimates,
)
from jointplay.catalogue.matching.calibration import fit_temperature, folds, probabilities, row_weights
from jointplay.catalogue.matching.conformal import Conformal
from jointplay.catalogue.matching.learning import Learning, SpectraSource
from jointplay.catalogue.matching.matcher import MatchResult, TrainingSet, rank
from jointplay.catalogue.matching.model_library import ModelLibrary, Observed
from jointplay.catalogue.matching.modes import Effort
from jointplay.solver.arrays import FloatArray
from jointplay.solver.extensions import entry_points_of

OWN = "gaussian"
"""Name of the product's own method among the others."""

LEAST_SHARE = 1e-3
"""Probability that a classifier gives a hypothesis at least: 300 trees cannot tell smaller ones."""


class FittedMatcher(Protocol):
    """A matcher that has learned a training set."""

    def match(self, feature: FloatArray) -> MatchResult:
        """Return the full answer for one feature vector (d,)."""


class Matcher(Protocol):
    """A way of matching, with its settings."""

    @property
    def name(self) -> str:
        """Short name of the method."""

    @property
    def version(self) -> str:
        """Changes whenever the same input may give another answer."""

    def fit(self, training: TrainingSet) -> FittedMatcher:
        """Learn a training set."""


class MethodLibrary(ModelLibrary):
    """Answers by a method in place of the product's own, at every effort by models for about the recording's noise.

    Effort thorough simulates nothing anew: what that would say of probabilities follows from the product's own matcher.

    Parameters
    ----------
    matrix : SpectraSource
        Feature matrix of the catalogue.
    method : Matcher
    """

    simulates_anew = False

    def __init__(self, matrix: SpectraSource, method: Matcher) -> None:
        super().__init__(matrix)
        self.name, self.version, self._method = method.name, method.version, method
        self._fitted: LRUCache[str, FittedMatcher] = LRUCache(int(self._known.maxsize))

    def match(self, observed: Observed, effort: Effort, learning: Learning) -> MatchResult:
        """Return the answer of the method, having learned in one of the modes."""
        coarse = self.coarse(observed)
        key = self.key(coarse, learning)
        with self._lock:
            fitted = self._fitted.get(key)
        if fitted is None:
            fitted = self._method.fit(self.training(coarse, learning))
            with self._lock:
                self._fitted[key] = fitted
        return replace(fitted.match(coarse.feature), mode=learning.mode, notes=self.notes(learning))


@dataclass(frozen=True)
class ClassifierMatcher:
    """Any classifier of scikit-learn with ``predict_proba`` as a method of matching.

    What a classifier does not say is that of the nearest entry: predicted levels, whether anything fits, and clearances
    where no regressor is given.

    Parameters
    ----------
    classifier : estimator
        Not fitted here: a clone of it is.
    regressor : estimator, optional
        Of ln(clearance); a clone of it for each hypothesis.
    name, version : str
    """

    classifier: Any
    regressor: Any = None
    name: str = "classifier"
    version: str = "1"

    def fit(self, training: TrainingSet) -> FittedClassifier:
        """Learn three quarters of a training set and calibrate on the rest.

        Raises
        ------
        MatchingError
            A hypothesis has fewer than two draws, or the classifier gives no probabilities.
        """
        # Here, not above: the import takes a second, and only a cross-check needs it.
        from sklearn.base import clone
        from sklearn.utils.validation import has_fit_parameter

        if not hasattr(self.classifier, "predict_proba"):
            raise MatchingError(f"method {self.name}: has no predict_proba: a matcher must give probabilities")
        entries = NearestEntry().fit(training)
        learned, held = next(folds(training, FOLDS))
        features, index = learned.stack()
        share = row_weights(index) * len(index)
        classifier, log_share = clone(self.classifier), np.zeros(len(learned.hypotheses))
        if has_fit_parameter(classifier, "sample_weight"):
            classifier.fit(features, index, sample_weight=share)
        else:
            classifier.fit(features, index)
            log_share = np.log(np.bincount(index) / len(index))  # what there is much of it takes for probable
        regressors: list[Any] = []
        errors = []
        for h, (draws, apart) in enumerate(zip(learned.hypotheses, held.hypotheses, strict=True)):
            if self.regressor is None or not draws.log_clearance.shape[1]:
                regressors.append(None)
                errors.append(entries.errors[h])
                continue
            target = draws.log_clearance
            regressor = clone(self.regressor).fit(draws.features, target if target.shape[1] > 1 else target[:, 0])
            found = regressor.predict(apart.features).reshape(apart.log_clearance.shape)
            regressors.append(regressor)
            errors.append(error_quantiles(apart.log_clearance - found))
        kept = (classifier, log_share, tuple(regressors), tuple(errors))
        bare = FittedClassifier(entries, *kept, 1.0, entries.conformal)
        held_features, truth = held.stack()
        evidence, weights = bare.log_evidence(held_features), row_weights(truth)
        temperature = fit_temperature(evidence, truth, weights, between=(0.05, 8.0))
        fitted = replace(bare, temperature=temperature)
        return replace(fitted, conformal=Conformal.fit(fitted.posterior(held_features), truth, weights))


@dataclass(frozen=True, eq=False)
class FittedClassifier:
    """A learned training set; answers one feature vector or a block of them.

    Parameters
    ----------
    entries : FittedEntries
        Nearest entries, for what the classifier does not say.
    classifier : estimator
    log_share : ndarray, shape (hypotheses,)
        ln(share of each among the rows), where the classifier takes it for its probability; else 0.
    regressors : tuple of estimator or None
        Of ln(clearance), per hypothesis; None where there is none.
    errors : tuple of ndarray, each (3, k)
        5, 50 and 95 % quantiles of the held-out error of ln(clearance), per hypothesis.
    temperature : float
    conformal : Conformal
    """

    entries: FittedEntries
    classifier: Any
    log_share: FloatArray
    regressors: tuple[Any, ...]
    errors: tuple[FloatArray, ...]
    temperature: float
    conformal: Conformal

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the hypotheses, in the order of the training set."""
        return self.entries.labels

    def log_evidence(self, features: FloatArray) -> FloatArray:
        """Return what the classifier says (m, hypotheses), all hypotheses having been equally probable."""
        said: FloatArray = np.log(np.maximum(self.classifier.predict_proba(features), LEAST_SHARE)) - self.log_share
        return said

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
        matches = []
        found = self.entries.match(feature).hypotheses
        posterior = self.posterior(feature[None, :])[0]
        for match in found:
            h = self.labels.index(match.label)
            matches.append(replace(match, probability=float(posterior[h])))
            if self.regressors[h] is not None:
                value = np.ravel(self.regressors[h].predict(feature[None, :]))
                matches[-1] = replace(matches[-1], clearances=estimates(match.joints, value, self.errors[h]))
        return rank(matches, self.conformal)


def extra_trees(trees: int = 300) -> ClassifierMatcher:
    """Return extremely randomised trees as a method: a cross-check that shares no model with the product's own.

    Parameters
    ----------
    trees : int
        That vote for a hypothesis; a third as many each for its clearances.

    Notes
    -----
    P. Geurts, D. Ernst, L. Wehenkel, Machine Learning 63 (2006) 3; by scikit-learn.
    """
    from sklearn.ensemble import ExtraTreesClassifier, ExtraTreesRegressor

    classifier = ExtraTreesClassifier(trees, random_state=0)
    return ClassifierMatcher(classifier, ExtraTreesRegressor(trees // 3, random_state=0), "extra-trees", "2")


def as_matcher(method: Any, name: str) -> Matcher:
    """Return a method as a matcher: itself, or a classifier of scikit-learn behind :class:`ClassifierMatcher`."""
    found: Matcher = ClassifierMatcher(method, None, name) if hasattr(method, "get_params") else method
    return found


def _make(point: EntryPoint) -> Matcher:
    return as_matcher(point.load()(), point.name)


METHODS: Mapping[str, Callable[[], Matcher] | None] = {
    **{name: partial(_make, method) for name, method in entry_points_of("matchers").items()},
    OWN: None,
    "cosine": cosine_entry,
    "nearest": NearestEntry,
    "extra-trees": extra_trees,
}
"""Methods by name: the one that a diagnosis uses by itself, and cross-checks, those of other packages among them."""
