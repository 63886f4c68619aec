"""The matcher as a classifier of scikit-learn: in a pipeline or a cross-validation, beside any other classifier.

Nothing else of the product imports this module, or scikit-learn with it: that takes a second.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from jointplay.catalogue.errors import DiagnosisError, MatchingError
from jointplay.catalogue.matching.gaussian import FittedGaussian, fit_gaussian
from jointplay.catalogue.matching.learning import Learning, band_widths, training_set
from jointplay.catalogue.matching.matcher import DrawnFeatures, MatchResult, TrainingSet
from jointplay.catalogue.matching.network import FULL_BAND
from jointplay.catalogue.matching.network_shelf import own_sensing
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray, IntArray


class ClearanceClassifier(ClassifierMixin, BaseEstimator):  # type: ignore[misc]  # they carry no types
    """Which joints are worn, from feature vectors: a curve over the clearance for every hypothesis.

    Parameters
    ----------
    levels : int, optional
        Features that are levels in dB, the first so many; the others are coherences. All unless given.
    watched : int
        Levels whose largest misfit is looked at besides the overall distance, the first so many: it makes p-values,
        not probabilities.
    prior : mapping of label to float, optional
        Weights of the hypotheses before a measurement; all the same unless given.

    Attributes
    ----------
    classes_ : ndarray
        Labels of the hypotheses.
    matcher_ : FittedGaussian
        What was learned.
    """

    def __init__(
        self, *, levels: int | None = None, watched: int = 0, prior: Mapping[Any, float] | None = None
    ) -> None:
        self.levels = levels
        self.watched = watched
        self.prior = prior

    def fit(self, X: Any, y: Any, *, clearance: Any = None, case: Any = None) -> Self:
        """Learn feature vectors of simulated machines.

        Parameters
        ----------
        X : array-like, shape (n, d)
        y : array-like, shape (n,)
            Label of each row's hypothesis; four rows of each at least.
        clearance : array-like, shape (n, joints), optional
            Radial clearances, m, > 0; NaN where a joint is in order. The joints of a hypothesis are those that all its
            rows have a clearance of. Without it hypotheses are not drawn out along their clearances.
        case : array-like, shape (n,), optional
            Which simulated case a row was made from: rows of one are held out together. Each its own unless given.

        Raises
        ------
        ValueError
            Something has another shape or kind, or there are too few rows.
        """
        X, y = validate_data(self, X, y, dtype=np.float64, ensure_min_samples=4, ensure_min_features=2)
        check_classification_targets(y)
        self.classes_, index = np.unique(y, return_inverse=True)
        known = np.full((len(X), 0), np.nan)
        if clearance is not None:
            known = check_array(clearance, dtype=np.float64, ensure_all_finite="allow-nan")
        cases = np.arange(len(X)) if case is None else np.unique(np.asarray(case), return_inverse=True)[1]
        if len(known) != len(X) or len(cases) != len(X):
            raise ValueError(f"clearance and case must have one row for each of {len(X)} rows")
        watched = np.arange(X.shape[1] if self.levels is None else self.levels) < self.watched
        prior = self.prior or {}
        try:
            sets = (
                _draws(label, X[index == h], known[index == h], cases[index == h], prior.get(label, 1.0))
                for h, label in enumerate(self.classes_.tolist())
            )
            self.matcher_: FittedGaussian = fit_gaussian(TrainingSet(tuple(sets), watched))
        except MatchingError as error:
            raise ValueError(str(error)) from error
        return self

    def predict_proba(self, X: Any) -> FloatArray:
        """Return the probabilities (m, classes) of feature vectors (m, d), classes as in `classes_`."""
        check_is_fitted(self)
        return self.matcher_.posterior(validate_data(self, X, reset=False, dtype=np.float64))

    def predict(self, X: Any) -> npt.NDArray[Any]:
        """Return the label of the most probable hypothesis of each feature vector (m,)."""
        posterior = self.predict_proba(X)
        found: npt.NDArray[Any] = self.classes_[posterior.argmax(axis=1)]
        return found

    def match(self, X: Any) -> list[MatchResult]:
        """Return the full answer for each feature vector: with clearances, p-values and sets; joints are columns."""
        check_is_fitted(self)
        return [self.matcher_.match(row) for row in validate_data(self, X, reset=False, dtype=np.float64)]


def _draws(label: object, features: FloatArray, known: FloatArray, cases: IntArray, prior: float) -> DrawnFeatures:
    given = np.isfinite(known)
    worn = given.all(axis=0)
    if (given.any(axis=0) != worn).any():
        raise MatchingError(f"hypothesis {label}: rows differ in which joints have a clearance")
    if (known[:, worn] <= 0.0).any():
        raise MatchingError(f"hypothesis {label}: clearances must be greater than 0, or NaN where a joint is in order")
    joints = tuple(str(column) for column in np.flatnonzero(worn))
    return DrawnFeatures(str(label), joints, features, np.log(known[:, worn]), cases, prior)


@dataclass(frozen=True, eq=False)
class Rows:
    """What a catalogue teaches, as arrays.

    Parameters
    ----------
    X : ndarray, shape (n, d)
        Feature vectors: levels in dB, then coherences where sensors are compared.
    y : ndarray of str, shape (n,)
        Labels of the hypotheses.
    clearance : ndarray, shape (n, joints)
        Radial clearances, m; NaN where a joint is in order.
    case : ndarray of int, shape (n,)
        Simulated machine that a row is of.
    joints : tuple of str
        Columns of `clearance`.
    levels : int
        Features that are levels.
    """

    X: FloatArray
    y: npt.NDArray[np.str_]
    clearance: FloatArray
    case: IntArray
    joints: tuple[str, ...]
    levels: int

    @classmethod
    def of(cls, catalogue: Catalogue, *, noise: float = 0.03, seconds: float = 4.0) -> Self:
        """Return a catalogue as recordings of all sensors of its machine see it.

        Parameters
        ----------
        catalogue : Catalogue
        noise : float
            Of each sensor, white, m/s2 rms up to 5 kHz.
        seconds : float
            Length of the recordings.

        Raises
        ------
        DiagnosisError
            The machine has no sensors, or the catalogue fewer than three entries of a hypothesis.
        """
        sensing = seen_by_all_sensors(catalogue, noise, seconds)
        training = training_set(catalogue.matrix, sensing, np.zeros(sensing.noise.size, bool), Learning.of("trusted"))
        features, index = training.stack()
        return cls(
            features[:, : training.plain],
            np.array(training.labels)[index],
            np.exp(training.log_clearances()),
            np.concatenate([draws.entry for draws in training.hypotheses]),
            training.joints,
            sensing.noise.size,
        )


def seen_by_all_sensors(catalogue: Catalogue, noise: float, seconds: float) -> Sensing:
    """Return what recordings of some seconds by all sensors see, with white noise [m/s2 rms up to 5 kHz].

    Raises
    ------
    DiagnosisError
        The machine has no sensors.
    """
    own = own_sensing(catalogue.machine, catalogue.matrix.cuts)
    if own is None:
        raise DiagnosisError(f"machine {catalogue.machine.name}: has no sensors that see its frame move")
    width = band_widths(catalogue.matrix)[: own.bands]
    density = noise**2 / FULL_BAND * np.sum(own.channels**2, axis=1)
    freedom = 2.0 * np.maximum(1.0, seconds * width)
    return replace(own, noise=density * width[:, None], degrees_of_freedom=freedom)
