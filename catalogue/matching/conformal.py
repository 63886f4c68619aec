"""Sets of hypotheses that hold the truth as often as is asked: split-conformal prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointplay.solver.arrays import FloatArray, IntArray

WIDER = 0.99
"""Coverage that is asked of a set instead, where the one asked for leaves it empty. What such sets hold is not it: they
are looked at only where an answer is doubtful, and there the truth is among them less often than on average."""

SURE = 0.5
"""Probability that is always enough for the wider set: an answer that leans one way is not called unknown for being
less sure than held-out draws were."""


@dataclass(frozen=True)
class CandidateSet:
    """Hypotheses that hold the truth with a given probability, if it is among those of the catalogue.

    Parameters
    ----------
    labels : tuple of str
        Most probable first; empty where no hypothesis is as probable as true ones are: the cause is unknown.
    coverage : float
        As asked.
    widened : bool
        Whether the set of this coverage was empty, and this is the one of 0.99. Then the coverage is approximate: it
        was promised of all recordings, not of doubtful ones.
    """

    labels: tuple[str, ...]
    coverage: float
    widened: bool = False


@dataclass(frozen=True, eq=False)
class Conformal:
    """Probabilities that held-out draws gave to their true hypothesis.

    Parameters
    ----------
    values : ndarray, shape (n,)
        In rising order.
    share : ndarray, shape (n,)
        Weight of the values up to and including each, of the total 1 that includes one more draw than there are.

    Notes
    -----
    Score 1 - p(true hypothesis), least ambiguous sets: Sadinle, Lei and Wasserman, J. Am. Stat. Assoc. 114 (2019) 223;
    split-conformal quantile: Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World (2005).
    """

    values: FloatArray
    share: FloatArray

    @classmethod
    def fit(cls, posterior: FloatArray, truth: IntArray, weights: FloatArray) -> Conformal:
        """Learn from held-out draws.

        Parameters
        ----------
        posterior : ndarray, shape (m, h)
        truth : ndarray of int, shape (m,)
            Index of the true hypothesis.
        weights : ndarray, shape (m,)
            > 0; only ratios matter.
        """
        own = posterior[np.arange(len(truth)), truth]
        order = np.argsort(own, kind="stable")
        # The recording in question counts as one more draw of mean weight: that is what makes the coverage hold.
        total = float(weights.sum()) + float(weights.mean())
        return cls(own[order], np.cumsum(weights[order]) / total)

    def threshold(self, coverage: float) -> float:
        """Return the probability a hypothesis needs to be in the set; 0 if so few draws cannot promise that much."""
        allowed = 1.0 - coverage - (1.0 - float(self.share[-1])) + 1e-12
        if allowed < 0.0:
            return 0.0
        return float(self.values[min(int(np.searchsorted(self.share, allowed, side="right")), len(self.values) - 1)])

    def members(self, labels: Sequence[str], probability: FloatArray, coverage: float) -> CandidateSet:
        """Return the set of one recording.

        Parameters
        ----------
        labels : sequence of str
        probability : ndarray, shape (h,)
            Of the labels, in any order.
        coverage : float
            In (0, 1).
        """
        order = np.argsort(-probability, kind="stable")
        wider = max(coverage, WIDER)
        # A probability as high as the coverage is always enough, which only makes sets hold more often.
        for asked, enough in ((coverage, coverage), (wider, SURE)):
            least = min(self.threshold(asked), enough)
            chosen = tuple(labels[i] for i in order if probability[i] >= least)
            if chosen:
                return CandidateSet(chosen, coverage, widened=asked > coverage)
        return CandidateSet((), coverage, widened=True)
