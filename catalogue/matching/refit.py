"""Answers made of two: a model fitted once more to one recording, and both modes heard together.

A refit knows the noise of the recording, the hypotheses it leaves open, and the entries near it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from jointplay.catalogue.matching.gaussian import FittedGaussian, fit_gaussian
from jointplay.catalogue.matching.learning import Learning, SpectraSource, band_widths, rows_of, training_set
from jointplay.catalogue.matching.matcher import HypothesisMatch, MatchResult, rank
from jointplay.catalogue.matching.network_shelf import Networks
from jointplay.catalogue.matching.observation import Sensing
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray

OPEN_ABOVE = 1e-4
"""Probability above which a hypothesis takes part in a refit."""

MOST_OPEN = 6
"""Hypotheses that take part, at most."""

NEAR, SPREAD = 600, 200
"""Entries of a hypothesis that are learned from: those nearest in clearance, and the first draws."""


@dataclass(frozen=True, eq=False)
class Refit:
    """How a looked-up model is refined for one recording.

    Parameters
    ----------
    matrix : SpectraSource
    model : FittedGaussian
        Gives the whitening.
    learning : Learning
    speed : float, optional
        Drive speed, rad/s.
    weights : ndarray, shape (rows of the matrix,), optional
        How much each entry counts.
    networks : Networks
        Whose opinions count, too.
    """

    matrix: SpectraSource
    model: FittedGaussian
    learning: Learning
    speed: float | None = None
    weights: FloatArray | None = None
    networks: Networks = field(default_factory=Networks)

    def match(self, sensing: Sensing, feature: FloatArray, watched: BoolArray, first: MatchResult) -> MatchResult:
        """Return the answer among the hypotheses that `first` leaves open."""
        rows = {match.label: self._rows(match) for match in _open(first)}
        training = training_set(self.matrix, sensing, watched, self.learning, rows=rows, weights=self.weights)
        opinion, witness = self.networks.opinions(sensing, band_widths(self.matrix))
        return fit_gaussian(training, self.model.model.projection, opinion, witness).match(feature)

    def has_more_entries(self, first: MatchResult) -> bool:
        """Whether there are more entries of a hypothesis that `first` leaves open than its model has learned from."""
        more = replace(self.learning, most=self.learning.reach)
        return any(
            len(rows_of(self.matrix, match.label, more, self.speed))
            > len(rows_of(self.matrix, match.label, self.learning, self.speed))
            for match in _open(first)
        )

    def _rows(self, match: HypothesisMatch) -> IntArray:
        if not match.clearances:
            # Nothing is nearer: the first draws, shared out among the strata as the mode has it.
            few = min(NEAR + SPREAD, self.learning.reach)
            return rows_of(self.matrix, match.label, replace(self.learning, most=few), self.speed)
        learning = replace(self.learning, most=self.learning.reach)
        rows = rows_of(self.matrix, match.label, learning, self.speed)
        if len(rows) <= NEAR + SPREAD:
            return rows
        columns = [self.matrix.joints.index(found.joint) for found in match.clearances]
        estimate = np.log([found.median for found in match.clearances])
        distance = np.sum((np.log(self.matrix.clearance(rows)[:, columns]) - estimate) ** 2, axis=1)
        distance[:SPREAD] = -1.0
        order = np.argsort(distance, kind="stable")[: NEAR + SPREAD]
        return rows[np.sort(order)]


def _open(first: MatchResult) -> list[HypothesisMatch]:
    """Hypotheses that an answer leaves open."""
    return [match for match in first.hypotheses[:MOST_OPEN] if match.probability > OPEN_ABOVE]


def merge(first: MatchResult, refitted: MatchResult) -> MatchResult:
    """Put a refitted answer in the place of what it refits; the other hypotheses keep their probabilities.

    Both fits saw other noise and held out other draws, so their geometric mean is better than either: log-loss 0.090
    instead of 0.112 and 0.088 (quick-return, singles and pairs), 0.073 instead of 0.072 and 0.089 (four-bar).
    """
    again = {match.label: match for match in refitted.hypotheses}
    before = {match.label: match.probability for match in first.hypotheses}
    mean = {label: float(np.sqrt(before[label] * match.probability)) for label, match in again.items()}
    scale = sum(before[label] for label in again) / (sum(mean.values()) or 1.0)
    matches = [
        replace(again[match.label], probability=mean[match.label] * scale) if match.label in again else match
        for match in first.hypotheses
    ]
    # What can be seen of a joint is known of all hypotheses, not only of those that were refitted.
    found = rank(matches, refitted.conformal, first.sightings)
    return replace(found, mode=first.mode, notes=first.notes, network=first.network, beside=first.beside)


AS_FILED_BEFORE = 0.9
"""Probability, before any recording, that a machine is what its file says."""


def weight_as_filed(p_value: float) -> float:
    """Return the probability that a machine is what its file says, from the p-value of that.

    Notes
    -----
    The Bayes factor of a p-value is at least -e p ln p, below 1 / e (T. Sellke, M. J. Bayarri, J. O. Berger, Am. Stat.
    55 (2001) 62).
    """
    factor = -math.e * p_value * math.log(p_value) if p_value < 1.0 / math.e else 1.0
    odds = AS_FILED_BEFORE / (1.0 - AS_FILED_BEFORE) * factor
    return odds / (1.0 + odds)


def blend(trusted: MatchResult, robust: MatchResult) -> MatchResult:
    """Return the answer of both modes, each with the probability that its machine is the recording's.

    Sets, clearances and levels of a hypothesis are those of the mode that says more for it; a recording is explained as
    well as the better one explains it.
    """
    weight = weight_as_filed(trusted.p_value)
    by_label = {match.label: match for match in trusted.hypotheses}
    matches: list[HypothesisMatch] = []
    for match in robust.hypotheses:
        own = by_label[match.label]
        first, second = weight * own.probability, (1.0 - weight) * match.probability
        said = own if first > second else match
        matches.append(replace(said, probability=first + second, p_value=max(own.p_value, match.p_value)))
    leading = trusted if weight >= 0.5 else robust
    return replace(
        rank(matches, leading.conformal, leading.sightings),
        mode=leading.mode,
        trusted_p_value=trusted.p_value,
        notes=tuple(dict.fromkeys((*trusted.notes, *robust.notes))),
        network=leading.network,
        beside=leading.beside,
    )
