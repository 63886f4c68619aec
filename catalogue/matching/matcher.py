"""What a matcher is given and what it answers.

A *hypothesis* is a set of joints with clearance ("healthy" is the empty one). A matcher learns from feature vectors of
simulated machines, each with its hypothesis and its clearances, and answers for a measured feature vector how probable
every hypothesis is, with which clearance, and whether any of them explains the measurement at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtr

from jointplay.catalogue.errors import MatchingError
from jointplay.catalogue.matching.conformal import CandidateSet, Conformal
from jointplay.catalogue.matching.modes import Mode
from jointplay.catalogue.matching.sightings import Sightings
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray

HEALTHY = "healthy"

NORMAL_90 = 1.645
"""Half the width of a central 90 % interval, in standard deviations of a normal law."""

DOUBTED_BELOW = 0.05
"""P-value of the trusted mode below which the robust one has a say."""


@dataclass(frozen=True, eq=False)
class DrawnFeatures:
    """Feature vectors of one hypothesis, as the sensors would report them.

    Parameters
    ----------
    label : str
        Name of the hypothesis.
    joints : tuple of str
        Joints with clearance, in the order of the columns of `log_clearance`; empty for the healthy machine.
    features : ndarray, shape (n, d)
        Band levels, dB, then coherences: :func:`jointplay.catalogue.matching.coherence.compose`.
    log_clearance : ndarray, shape (n, k)
        Natural logarithm of the radial clearances in m; k = len(joints), or 0 where the clearances of a hypothesis
        are not to be told apart.
    entry : ndarray of int, shape (n,)
        Which simulated machine the row is of. Rows of one differ only in noise, or speed, so they stay together
        whenever rows are held out.
    prior : float
        Weight of the hypothesis before the measurement, > 0; only ratios matter.
    weight : ndarray, shape (n,), optional
        How much each row counts, > 0; only ratios matter. All count the same unless given.
    """

    label: str
    joints: tuple[str, ...]
    features: FloatArray
    log_clearance: FloatArray
    entry: IntArray
    prior: float = 1.0
    weight: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(self.features)
        if self.features.ndim != 2 or n == 0:
            raise MatchingError(
                f"hypothesis {self.label}: features of shape {self.features.shape}: must be (n, d), n > 0"
            )
        if self.log_clearance.ndim != 2 or len(self.log_clearance) != n or len(self.entry) != n:
            raise MatchingError(
                f"hypothesis {self.label}: clearances and cases must have one row for each of {n} draws"
            )
        if self.log_clearance.shape[1] not in (0, len(self.joints)):
            raise MatchingError(
                f"hypothesis {self.label}: {self.log_clearance.shape[1]} clearances for joints {self.joints}"
            )
        if self.weight is not None and (self.weight.shape != (n,) or not (self.weight > 0.0).all()):
            raise MatchingError(f"hypothesis {self.label}: weights must be {n} numbers greater than 0")
        if not self.prior > 0.0:
            raise MatchingError(f"hypothesis {self.label}: prior {self.prior}: must be greater than 0")
        if not (np.isfinite(self.features).all() and np.isfinite(self.log_clearance).all()):
            raise MatchingError(f"hypothesis {self.label}: features and clearances must be finite numbers")

    @property
    def cases(self) -> int:
        """Number of different simulated cases behind the rows."""
        return len(np.unique(self.entry))

    def rows(self, keep: BoolArray) -> DrawnFeatures:
        """Return the same hypothesis with only the rows where `keep` is true."""
        return DrawnFeatures(
            self.label,
            self.joints,
            self.features[keep],
            self.log_clearance[keep],
            self.entry[keep],
            self.prior,
            None if self.weight is None else self.weight[keep],
        )

    @property
    def weights(self) -> FloatArray:
        """Weights of the rows (n,), of mean 1."""
        return np.ones(len(self.entry)) if self.weight is None else self.weight / float(self.weight.mean())


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """All hypotheses a matcher is to tell apart.

    Parameters
    ----------
    hypotheses : tuple of DrawnFeatures
        At least one; labels are unique and feature lengths equal.
    watched : ndarray of bool, shape (l,)
        Levels checked one by one besides the overall distance: the low orders, where foreign forces show. The first l
        features are levels, dB, the others coherences.
    plain : int, optional
        Features that curves are drawn through, the first so many; what is locked to the crank stands behind them, and
        is a network's to hear. All unless given.
    """

    hypotheses: tuple[DrawnFeatures, ...]
    watched: BoolArray
    plain: int | None = None

    def __post_init__(self) -> None:
        labels = [draws.label for draws in self.hypotheses]
        if not labels or len(set(labels)) != len(labels):
            raise MatchingError(f"hypotheses {labels}: must be at least one, each with its own label")
        lengths = {draws.features.shape[1] for draws in self.hypotheses}
        if len(lengths) != 1 or min(lengths) < len(self.watched):
            rule = f"must all be equal, and at least {len(self.watched)}, the number of levels"
            raise MatchingError(f"feature vectors of lengths {sorted(lengths)}: {rule}")

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the hypotheses, in order."""
        return tuple(draws.label for draws in self.hypotheses)

    @property
    def joints(self) -> tuple[str, ...]:
        """All joints that a hypothesis names, in alphabetical order."""
        return tuple(sorted({joint for draws in self.hypotheses for joint in draws.joints}))

    @property
    def length(self) -> int:
        """Number of features d."""
        return int(self.hypotheses[0].features.shape[1])

    def only_levels(self) -> TrainingSet:
        """Return the same without coherences."""
        levels = len(self.watched)
        cut = (replace(draws, features=draws.features[:, :levels]) for draws in self.hypotheses)
        return TrainingSet(tuple(cut), self.watched)

    @property
    def cases(self) -> int:
        """Smallest number of simulated cases behind a hypothesis that has clearances (all, if none has)."""
        worn = [draws.cases for draws in self.hypotheses if draws.log_clearance.shape[1]]
        return min(worn or [draws.cases for draws in self.hypotheses])

    def log_clearances(self) -> FloatArray:
        """Return ln(clearance) of each joint (n, joints) that is worn in each row of all; NaN where it is not."""
        found = np.full((sum(len(draws.features) for draws in self.hypotheses), len(self.joints)), np.nan)
        begin = 0
        for draws in self.hypotheses:
            end = begin + len(draws.features)
            for column, joint in zip(draws.log_clearance.T, draws.joints, strict=False):
                found[begin:end, self.joints.index(joint)] = column
            begin = end
        return found

    def stack(self) -> tuple[FloatArray, IntArray]:
        """Return features of all rows (n, d) and the hypothesis index of each row (n,)."""
        features = np.concatenate([draws.features for draws in self.hypotheses])
        index = np.repeat(np.arange(len(self.hypotheses)), [len(draws.features) for draws in self.hypotheses])
        return features, index.astype(np.int64)


@dataclass(frozen=True)
class ClearanceEstimate:
    """Posterior of one joint's radial clearance, m: median and central 90 % interval.

    Parameters
    ----------
    joint : str
    median, low, high : float
    course : (ndarray, ndarray), optional
        ln(clearance) in rising order, and the probability below each; log-normal halves on either side of the median
        unless given.
    """

    joint: str
    median: float
    low: float
    high: float
    course: tuple[FloatArray, FloatArray] | None = field(default=None, compare=False, repr=False)

    def below(self, log_clearance: FloatArray) -> FloatArray:
        """Return the probability (n,) of a clearance smaller than each, given by its logarithm."""
        if self.course is not None:
            return np.asarray(np.interp(log_clearance, *self.course, left=0.0, right=1.0))
        away = log_clearance - np.log(self.median)
        lower, upper = np.log(self.median / self.low), np.log(self.high / self.median)
        found: FloatArray = ndtr(NORMAL_90 * away / np.maximum(np.where(away < 0.0, lower, upper), 1e-9))
        return found


@dataclass(frozen=True, eq=False)
class HypothesisMatch:
    """One hypothesis against one measurement.

    Parameters
    ----------
    label, joints
        The hypothesis.
    probability : float
        Posterior probability among the hypotheses of the training set.
    clearances : tuple of ClearanceEstimate
        In the order of `joints`; empty where the hypothesis has none.
    distance_db : float
        Root mean square difference between measured and predicted levels, dB.
    p_value : float
        How rarely a held-out draw of this hypothesis is as far from its prediction, in (0, 1]: ranks of the distance,
        of the orders, and of doubts where there are any, joined by Bonferroni's bound.
    predicted, spread : ndarray, shape (l,)
        Expected levels at the best clearance and their standard deviation, dB.
    """

    label: str
    joints: tuple[str, ...]
    probability: float
    clearances: tuple[ClearanceEstimate, ...]
    distance_db: float
    p_value: float
    predicted: FloatArray
    spread: FloatArray


@dataclass(frozen=True)
class MatchResult:
    """Answer of a matcher: hypotheses in falling order of probability (ties in the order of the training set).

    Parameters
    ----------
    hypotheses : tuple of HypothesisMatch
    conformal : Conformal, optional
        What :meth:`set` goes by; without it a set is the fewest hypotheses whose probabilities add up.
    mode : {"trusted", "robust"}
        How the draws it learned from were made.
    trusted_p_value : float, optional
        P-value in the trusted mode, where it was tried.
    notes : tuple of str
        What was done, and what is doubtful, in words.
    network : str, optional
        SHA-256 of the network whose opinion counted, too.
    sightings : Sightings, optional
        What held-out draws showed of each joint.
    beside : bool
        Whether a network heard how the recording, or each of several, differs from the machine's own past.
    """

    hypotheses: tuple[HypothesisMatch, ...]
    conformal: Conformal | None = None
    mode: Mode = "trusted"
    trusted_p_value: float | None = None
    notes: tuple[str, ...] = ()
    network: str | None = None
    sightings: Sightings | None = None
    beside: bool = False

    @property
    def best(self) -> HypothesisMatch:
        """The most probable hypothesis."""
        return self.hypotheses[0]

    @property
    def p_worn(self) -> float:
        """Probability that any joint is worn."""
        return min(1.0, sum(match.probability for match in self.hypotheses if match.joints))

    @property
    def p_value(self) -> float:
        """P-value of the best fitting hypothesis of the 95 % set: whether any likely cause explains the measurement."""
        return self.p_value_within(0.95)

    @property
    def is_doubted(self) -> bool:
        """Whether the trusted mode was tried, and hardly explains the measurement."""
        return self.trusted_p_value is not None and self.trusted_p_value < DOUBTED_BELOW

    def p_value_within(self, coverage: float) -> float:
        """Return the largest p-value in the set of a coverage; that of the first hypothesis where the set is empty."""
        likely = self.set(coverage).labels
        values = [match.p_value for match in self.hypotheses if match.label in likely]
        return max(values, default=self.best.p_value)

    def set(self, coverage: float) -> CandidateSet:
        """Return the hypotheses that hold the truth with probability `coverage`, if it is among them."""
        if self.conformal is None:
            return CandidateSet(self.candidate_set(coverage), coverage)
        probability = np.array([match.probability for match in self.hypotheses])
        return self.conformal.members([match.label for match in self.hypotheses], probability, coverage)

    def probability(self, label: str) -> float:
        """Return the probability of the hypothesis `label`; 0 if it is not among them."""
        return sum(h.probability for h in self.hypotheses if h.label == label)

    def joint_probabilities(self) -> dict[str, float]:
        """Return for each joint the total probability of the hypotheses it is worn in."""
        joints = sorted({joint for h in self.hypotheses for joint in h.joints})
        return {joint: sum(h.probability for h in self.hypotheses if joint in h.joints) for joint in joints}

    def candidate_set(self, coverage: float) -> tuple[str, ...]:
        """Return the fewest hypotheses whose probabilities add up to `coverage`, most probable first."""
        chosen: list[str] = []
        total = 0.0
        for hypothesis in self.hypotheses:
            chosen.append(hypothesis.label)
            total += hypothesis.probability
            if total >= coverage:
                break
        return tuple(chosen)


def rank(
    matches: Sequence[HypothesisMatch], conformal: Conformal | None = None, sightings: Sightings | None = None
) -> MatchResult:
    """Sort hypotheses by falling probability; equal ones keep their order."""
    hypotheses = tuple(sorted(matches, key=lambda match: -match.probability))
    return MatchResult(hypotheses, conformal, sightings=sightings)
