"""Curves of hypotheses through feature space, and how likely a feature vector is along each of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from jointplay.catalogue.matching.calibration import largest
from jointplay.catalogue.matching.log_sums import log_sum_exp
from jointplay.catalogue.matching.tube import ClearanceGrid, Tube
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Curve:
    """One hypothesis: a curve over its clearance, or a surface, with the scatter around it.

    Parameters
    ----------
    label : str
    joints : tuple of str
    prior : float
    grid : ClearanceGrid
        Points over the logarithm of the clearances.
    whitened, full : Tube
        In the discriminant directions, which tell hypotheses apart; in all levels, which judge the fit.
    """

    label: str
    joints: tuple[str, ...]
    prior: float
    grid: ClearanceGrid
    whitened: Tube
    full: Tube

    def surprise(self, features: FloatArray, best: IntArray, watched: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Return full-space distance (m,) and mean of the largest watched z (m,) at the fine points `best` (m,)."""
        levels = features[:, : len(watched)]
        z = (levels - self.full.mean[best]) / self.full.spread_at(best)
        return self.full.distance_at(levels, best), largest(z, watched)


@dataclass(frozen=True, eq=False)
class CurveModel:
    """All hypotheses in one whitened space; not calibrated yet.

    Parameters
    ----------
    projection : ndarray, shape (d, r)
    curves : tuple of Curve
    watched : ndarray of bool, shape (l,)
    degrees_of_freedom : float
        Of the Student-t likelihood.
    """

    projection: FloatArray
    curves: tuple[Curve, ...]
    watched: BoolArray
    degrees_of_freedom: float

    def log_likelihood(self, whitened: FloatArray, index: int) -> FloatArray:
        """Return the log density (m, f) of whitened features (m, r) at each fine point of one hypothesis."""
        tube = self.curves[index].whitened
        d, nu = whitened.shape[1], self.degrees_of_freedom
        constant = float(gammaln(0.5 * (nu + d)) - gammaln(0.5 * nu)) - 0.5 * d * float(np.log((nu - 2.0) * np.pi))
        half = 0.5 * tube.log_determinant[tube.nearest]
        squared = tube.squared_distance(whitened)
        density: FloatArray = constant - half[None, :] - 0.5 * (nu + d) * np.log1p(squared / (nu - 2.0))
        return density

    @property
    def log_prior(self) -> FloatArray:
        """Logarithm of the weight (hypotheses,) of each hypothesis before the measurement."""
        return np.log([curve.prior for curve in self.curves])

    def log_evidences(self, features: FloatArray) -> FloatArray:
        """Return the log evidence (m, hypotheses) of features (m, d), priors left out."""
        whitened = features @ self.projection
        columns = [averaged(self.log_likelihood(whitened, h)) for h in range(len(self.curves))]
        return np.stack(columns, axis=1)


def averaged(likelihood: FloatArray) -> FloatArray:
    """Average a log likelihood (m, f) over a log-uniform clearance: (m,)."""
    evidence: FloatArray = log_sum_exp(likelihood) - np.log(likelihood.shape[1])
    return evidence
