"""Feature models with known answers, for tests of the matchers.

Every joint bends the spectrum in a smooth way of its own as its clearance grows; a draw adds correlated scatter. Being
Gaussian with known mean and covariance, the model has a posterior that can be written down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from jointplay.catalogue.matching.matcher import DrawnFeatures, TrainingSet

FloatArray = NDArray[np.float64]

LOW, HIGH = float(np.log(30e-6)), float(np.log(1e-3))


@dataclass(frozen=True)
class FeatureModel:
    """`joints` curves in `length` features with scatter `noise` dB, correlated over neighbours.

    `separation` scales what the joints do not have in common.
    """

    joints: tuple[str, ...] = ("A", "B", "C")
    length: int = 24
    noise: float = 2.0
    separation: float = 1.0
    seed: int = 7

    def mean(self, joint: str | None, log_clearance: FloatArray) -> FloatArray:
        """Mean levels (n, d) at clearances (n,)."""
        generator = np.random.default_rng(self.seed)
        healthy = generator.normal(0.0, 10.0, self.length)
        if joint is None:
            return np.repeat(healthy[None, :], len(log_clearance), axis=0)
        generator = np.random.default_rng([self.seed, self.joints.index(joint)])
        slope = 3.0 + self.separation * generator.normal(0.0, 3.0, self.length)
        offset = 8.0 * self.separation + self.separation * generator.normal(0.0, 4.0, self.length)
        bend = self.separation * generator.normal(0.0, 1.0, self.length)
        t = (log_clearance - LOW)[:, None]
        curve: FloatArray = healthy + offset + slope * t + bend * np.sin(1.5 * t)
        return curve

    @property
    def covariance(self) -> FloatArray:
        """Covariance (d, d) of a draw."""
        lag = np.abs(np.arange(self.length)[:, None] - np.arange(self.length)[None, :])
        matrix: FloatArray = self.noise**2 * (np.exp(-((lag / 2.0) ** 2)) + 0.1 * np.eye(self.length))
        return matrix

    def draw(self, joint: str | None, log_clearance: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Feature vectors (n, d) at clearances (n,)."""
        factor = np.linalg.cholesky(self.covariance)
        scatter = generator.normal(size=(len(log_clearance), self.length)) @ factor.T
        drawn: FloatArray = self.mean(joint, log_clearance) + scatter
        return drawn

    def training(self, count: int, generator: np.random.Generator) -> TrainingSet:
        """Return `count` draws of every single and of the healthy machine."""
        sets = []
        for joint in (None, *self.joints):
            clearance = generator.uniform(LOW, HIGH, count)
            features = self.draw(joint, clearance, generator)
            column = clearance[:, None] if joint else np.zeros((count, 0))
            label = joint or "healthy"
            sets.append(DrawnFeatures(label, (joint,) if joint else (), features, column, np.arange(count)))
        watched = np.zeros(self.length, dtype=bool)
        watched[:8] = True
        return TrainingSet(tuple(sets), watched)

    def queries(self, count: int, generator: np.random.Generator) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
        """Return features (m, d), hypothesis index (m,) and ln(clearance) (m,) of new draws of every hypothesis."""
        features, truth, clearances = [], [], []
        for h, joint in enumerate((None, *self.joints)):
            clearance = generator.uniform(LOW, HIGH, count)
            features.append(self.draw(joint, clearance, generator))
            truth.append(np.full(count, h))
            clearances.append(clearance)
        return np.concatenate(features), np.concatenate(truth).astype(np.int64), np.concatenate(clearances)

    def posterior(self, features: FloatArray) -> FloatArray:
        """Exact posterior (m, hypotheses) by integration over the clearance."""
        inverse = np.linalg.inv(self.covariance)
        grid = np.linspace(LOW, HIGH, 400)
        columns = []
        for joint in (None, *self.joints):
            mean = self.mean(joint, grid)
            difference = features[:, None, :] - mean[None, :, :]
            squared = np.einsum("mgd,de,mge->mg", difference, inverse, difference)
            columns.append(logsumexp(-0.5 * squared, axis=1))
        evidence = np.stack(columns, axis=1)
        exact: FloatArray = np.exp(evidence - logsumexp(evidence, axis=1, keepdims=True))
        return exact
