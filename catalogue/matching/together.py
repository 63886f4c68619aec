"""Several recordings of one machine: one posterior of what is worn and by how much.

The likelihood of a state - which joints are worn, with which clearances - is the product of what each recording says of
it, tempered: sensors, mounts and all that the model does not know are the same in every recording of a machine, so that
a second one does not say as much again. Recordings that are alike count for less together than apart, as measurements
with correlated errors do. Where each is heard beside the machine's own past, what all have wrong alike cancels, as far
as it is asked which joints are worn: a recording at another speed then tells that anew. How much they are worn by, it
does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointplay.catalogue.matching.curves import log_sum_exp
from jointplay.catalogue.matching.matcher import ClearanceEstimate, HypothesisMatch, MatchResult
from jointplay.catalogue.matching.modes import UNKNOWN_BELOW
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray

ALIKE_AT_ONE_SPEED, ALIKE = 0.7, 0.4
"""Correlation of what two recordings of a machine have wrong, at one stored speed and at two."""

SLIP = 1e-3
"""Share of recordings that say nothing of the machine, whatever they look like: none rules a state out alone."""

HELD, ALL_HELD = 0.05, 0.2
"""Share of recordings in which a load holds a worn joint shut, so that it looks as in order; and all that are worn, as
a load is carried from joint to joint. This is of the recordings that look in order where others do not."""

LEAST_DENSITY = 0.02
"""Of a clearance in any recording, against what was likely before: intervals do not always hold."""


@dataclass(frozen=True)
class Likeness:
    """How far recordings of one machine have the same wrong.

    Parameters
    ----------
    at_one_speed, apart : float
        Correlations of recordings at the same stored speed, and at two; 0 <= apart <= at_one_speed < 1.
    """

    at_one_speed: float = ALIKE_AT_ONE_SPEED
    apart: float = ALIKE

    def weights(self, speeds: Sequence[float] | FloatArray) -> FloatArray:
        """Return what each recording counts (n,), by its stored speed; one alone counts 1.

        Notes
        -----
        The weights of the best linear estimate from equally good measurements of this correlation R: w = R^-1 1, all
        above 0 (C. R. Rao, Linear Statistical Inference and Its Applications, 2nd ed. (1973), 4a).
        """
        same = np.equal.outer(np.array(speeds), np.array(speeds))
        correlation = np.where(same, self.at_one_speed, self.apart)
        np.fill_diagonal(correlation, 1.0)
        found = np.asarray(np.linalg.solve(correlation, np.ones(len(speeds))), np.float64)
        return found


BESIDE_PAST = Likeness(0.3, 0.1)
"""Of what recordings say of which joints are worn, where they were heard beside those of the machine in order: what
machine and sensors have wrong was in these, too (docs/decisions/0206)."""


@dataclass(frozen=True, eq=False)
class Together:
    """What several recordings say of one machine.

    Parameters
    ----------
    result : MatchResult
        The common answer.
    weights : ndarray, shape (n,)
        What each recording counts for which hypothesis is the most probable one.
    for_one_machine : ndarray, shape (n,)
        How much likelier each recording is as one of the machine of all others than of any other, ln.
    without : tuple of (str, float)
        Most probable hypothesis by all others, and its probability, for each; empty where there are no others.
    held_shut : tuple of (tuple of str)
        Joints of the most probable hypothesis that each recording looks to have in order.
    """

    result: MatchResult
    weights: FloatArray
    for_one_machine: FloatArray
    without: tuple[tuple[str, float], ...]
    held_shut: tuple[tuple[str, ...], ...]


def match_together(
    results: Sequence[MatchResult], prior: FloatArray, speeds: Sequence[float], likeness: Likeness | None = None
) -> Together:
    """Join what recordings of one machine say.

    Parameters
    ----------
    results : sequence of MatchResult
        Of each recording, all with the same hypotheses.
    prior : ndarray, shape (hypotheses,)
        Probability of each hypothesis of the first result beforehand, as all results have it.
    speeds : sequence of float
        Stored speed that each was matched at.
    likeness : Likeness, optional
        Of what they say of hypotheses and of clearances; as measured unless given.
    """
    if len(results) == 1:
        return Together(results[0], np.ones(1), np.zeros(1), (("", 0.0),), ((),))
    said = _Said.of(results, prior, speeds, (likeness or Likeness(), likeness or BESIDE_PAST))
    everyone = np.arange(len(results))
    without, for_one = [], []
    for i in everyone:
        others = np.delete(everyone, i)
        of_others = said.weights(others)
        rest, rest_total = said.weigh(others, of_others)
        once = np.ones_like(of_others[:, :1])
        _, own_total = said.weigh(np.array([i]), once)
        _, total = said.weigh(np.append(others, i), np.concatenate([of_others, once], axis=1))
        lead = int(rest.argmax())
        without.append((results[0].hypotheses[lead].label, float(rest[lead])))
        for_one.append(total - rest_total - own_total)
    weights = said.weights(everyone)
    probability, _ = said.weigh(everyone, weights)
    best = int(probability.argmax())
    return Together(
        said.join(weights[1], probability),
        weights[0, :, best],
        np.array(for_one),
        tuple(without),
        tuple(
            tuple(j for j in results[0].hypotheses[best].joints if j not in row[best].joints) for row in said.as_seen
        ),
    )


@dataclass(frozen=True, eq=False)
class _Said:
    """What recordings say of every hypothesis, against what was likely before.

    Parameters
    ----------
    results : sequence of MatchResult
    log_prior : ndarray, shape (h,)
    evidence : ndarray, shape (n, h)
        ln of how much likelier each hypothesis has become.
    densities : for each hypothesis and joint, (points (p,), probability beforehand (p,), ln ratio (n, p))
    as_seen : for each recording and hypothesis, the match of what it looks like: itself, or with some joints held shut
    p_values : ndarray, shape (n, h)
        Of each hypothesis as it is seen; where that does not fit, of that look that does best, if no joint is then held
        shut in all recordings.
    speeds : sequence of float
    alike : (Likeness, Likeness)
        Of recordings by themselves, and of what those beside the machine's past say of hypotheses.
    """

    results: Sequence[MatchResult]
    log_prior: FloatArray
    evidence: FloatArray
    densities: Sequence[Sequence[tuple[FloatArray, FloatArray, FloatArray]]]
    as_seen: Sequence[Sequence[HypothesisMatch]]
    p_values: FloatArray
    speeds: Sequence[float]
    alike: tuple[Likeness, Likeness]

    @classmethod
    def of(
        cls,
        results: Sequence[MatchResult],
        prior: FloatArray,
        speeds: Sequence[float],
        alike: tuple[Likeness, Likeness],
    ) -> _Said:
        first = results[0].hypotheses
        matches = [{match.label: match for match in result.hypotheses} for result in results]
        share = prior / prior.sum()
        found = np.array([[own[match.label].probability for match in first] for own in matches])
        likely = ((1.0 - SLIP) * found + SLIP * share) / share
        sets = [frozenset(match.joints) for match in first]
        held = _held_shut(sets)
        seen = (likely[:, None, :] * held).argmax(axis=2)
        # A joint that is held shut in every recording is heard in none: then it may as well not be worn.
        seen = np.where(_always_hidden(sets, seen), np.arange(len(sets)), seen)
        as_seen = tuple(
            tuple(own[first[s].label] for s in row) for own, row in zip(matches, seen.tolist(), strict=True)
        )
        densities = [
            [
                _densities([_estimate_of(row[h], joint) for row in as_seen], match, j)
                for j, joint in enumerate(match.joints)
            ]
            for h, match in enumerate(first)
        ]
        fits = np.array([[own[match.label].p_value for match in first] for own in matches])
        # What does not fit as it seems to look may look otherwise.
        fitting = np.where(held > 0.0, fits[:, None, :], -1.0).argmax(axis=2)
        looks = np.where(np.take_along_axis(fits, seen, axis=1) < UNKNOWN_BELOW, fitting, seen)
        looks = np.where(_always_hidden(sets, looks), seen, looks)
        p_values = np.take_along_axis(fits, looks, axis=1)
        own = np.arange(len(sets))
        evidence = np.log(np.take_along_axis(likely, seen, axis=1) * held[own, seen])
        return cls(results, np.log(share), evidence, densities, as_seen, p_values, speeds, alike)

    def showing(self, h: int) -> BoolArray:
        """Which recordings (n,) show a hypothesis: not those in which a load holds all of its joints shut."""
        worn = bool(self.results[0].hypotheses[h].joints)
        return np.array([bool(row[h].joints) == worn for row in self.as_seen])

    def weights(self, chosen: IntArray) -> FloatArray:
        """What each of some recordings counts for each hypothesis, and for its clearances, (2, m, h).

        Those that show it have the same wrong; what a load holds shut in others is hidden by the load. And what those
        beside the past still have wrong is another thing than what the others have.
        """
        found, speeds = np.zeros((2, len(chosen), len(self.log_prior))), np.array(self.speeds)[chosen]
        beside = np.array([self.results[n].beside for n in chosen.tolist()])
        usual, since = self.alike
        for h in range(found.shape[2]):
            showing = self.showing(h)[chosen]
            for part in (showing, ~showing):
                found[1, part, h] = usual.weights(speeds[part])
                for own, likeness in ((part & beside, since), (part & ~beside, usual)):
                    found[0, own, h] = likeness.weights(speeds[own])
        return found

    def weigh(self, chosen: IntArray, weights: FloatArray) -> tuple[FloatArray, float]:
        """Probabilities (h,) by some recordings, and ln of how much likelier they are together than by chance."""
        of_sets, of_clearances = weights
        log_weight = self.log_prior + np.sum(of_sets * self.evidence[chosen], axis=0)
        for h, joints in enumerate(self.densities):
            for _, before, ratio in joints:
                log_weight[h] += float(log_sum_exp(np.log(before) + of_clearances[:, h] @ ratio[chosen]))
        total = float(log_sum_exp(log_weight))
        return np.exp(log_weight - total), total

    def join(self, weights: FloatArray, probability: FloatArray) -> MatchResult:
        """The answer of all recordings, by what each counts for clearances (n, h), and what is probable then (h,)."""
        results, first = self.results, self.results[0]
        matches = []
        for h, (match, joints, share) in enumerate(
            zip(first.hypotheses, self.densities, probability.tolist(), strict=True)
        ):
            own = [row[h] for row in self.as_seen]
            clearances = tuple(
                _estimate(found.joint, edges, np.log(before) + weights[:, h] @ ratio)
                for found, (edges, before, ratio) in zip(match.clearances, joints, strict=True)
            )
            distance = math.sqrt(math.fsum(each.distance_db**2 for each in own) / len(own))
            # A load that holds joints shut is in no file: the others say whether the machine is as filed.
            p_value = _least(self.p_values[self.showing(h), h].tolist())
            matches.append(
                replace(match, probability=share, clearances=clearances, distance_db=distance, p_value=p_value)
            )
        showing = np.flatnonzero(self.showing(int(probability.argmax()))).tolist()
        trusted = [each for n in showing if (each := results[n].trusted_p_value) is not None]
        return replace(
            first,
            hypotheses=tuple(sorted(matches, key=lambda match: -match.probability)),
            mode="robust" if any(each.mode == "robust" for each in results) else "trusted",
            trusted_p_value=_least(trusted) if trusted else None,
            notes=tuple(dict.fromkeys(note for each in results for note in each.notes)),
            beside=all(each.beside for each in results),
        )


def _held_shut(sets: Sequence[frozenset[str]]) -> FloatArray:
    """How often a machine of each set looks as of each (h, h): some of its joints may be held shut that day, or all."""

    def share(worn: frozenset[str], seen: frozenset[str]) -> float:
        if not seen <= worn:
            return 0.0
        return ALL_HELD if worn and not seen else HELD ** len(worn - seen)

    return np.array([[share(worn, seen) for seen in sets] for worn in sets])


def _always_hidden(sets: Sequence[frozenset[str]], seen: IntArray) -> list[bool]:
    """Of which hypotheses (h) some joint is held shut in every recording, by what they look like in each (n, h)."""
    return [bool(frozenset.intersection(*(worn - sets[s] for s in seen[:, h]))) for h, worn in enumerate(sets)]


def _estimate_of(match: HypothesisMatch, joint: str) -> ClearanceEstimate | None:
    """The clearance of a joint; None where it looks as in order."""
    return next((found for found in match.clearances if found.joint == joint), None)


def _densities(
    estimates: Sequence[ClearanceEstimate | None], match: HypothesisMatch, place: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Cells of ln(clearance) (p + 1,), probability of each beforehand, and ln of how much denser each recording has it.

    Clearances are log-uniform beforehand; a recording in which the joint is held shut says nothing of it. The cells are
    those of the joint in some recording, the first result's at the least.
    """
    known = [estimate or match.clearances[place] for estimate in estimates]
    courses = [estimate.course or _log_normal(estimate) for estimate in known]
    edges = np.unique(np.concatenate([course[0] for course in courses]))
    before = np.diff(edges) / (edges[-1] - edges[0])
    below = np.array([np.interp(edges, *course, left=0.0, right=1.0) for course in courses])
    ratio = np.log(np.maximum(np.diff(below, axis=1) / before, LEAST_DENSITY))
    ratio[[estimate is None for estimate in estimates]] = 0.0
    return edges, before, ratio


def _log_normal(estimate: ClearanceEstimate) -> tuple[FloatArray, FloatArray]:
    """The course of an estimate that has none: over five half widths of its interval."""
    low, high = np.log(estimate.low), np.log(estimate.high)
    edges = np.linspace(low - 2.0 * (high - low), high + 2.0 * (high - low), 121)
    return edges, estimate.below(edges)


def _estimate(joint: str, edges: FloatArray, log_law: FloatArray) -> ClearanceEstimate:
    """Median and interval of ln of weights (p,) of cells (p + 1,) of ln(clearance)."""
    below = np.concatenate([[0.0], np.cumsum(np.exp(log_law - log_law.max()))])
    below /= below[-1]
    low, median, high = np.exp(np.interp([0.05, 0.5, 0.95], below, edges)).tolist()
    return ClearanceEstimate(joint, median, low, high, (edges, below))


def _least(p_values: Sequence[float]) -> float:
    """The least of n p-values by Bonferroni's bound."""
    return min(1.0, len(p_values) * min(p_values))
