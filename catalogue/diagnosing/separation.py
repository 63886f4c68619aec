"""What would tell the first hypotheses apart: another sensor, another direction, another speed, another load.

Entries of the catalogue near the clearances in question are looked at through the sensors there are, and through one
more; how far the hypotheses lie apart in what is then seen, measured in their own scatter, says what is worth doing.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import scipy.linalg
import scipy.spatial.distance
from scipy.special import log_softmax, ndtr, ndtri

from jointplay.catalogue.diagnosing.answer import Suggestion
from jointplay.catalogue.diagnosing.comparison import LEAST_NOISE_DENSITY, exact_sensing, features_of
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.matching.matcher import HypothesisMatch, MatchResult
from jointplay.catalogue.matching.observation import Sensing, observe
from jointplay.catalogue.matching.together import Likeness
from jointplay.catalogue.plans.cases import load_shares
from jointplay.catalogue.plans.day_load import DayLoad, loads_held
from jointplay.catalogue.signals.feature_bands import join_bands
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.sensors import free_motions
from jointplay.catalogue.storage.matrix import FeatureMatrix
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import BoolArray, FloatArray, IntArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.spectra.bands import LEAST_POWER
from jointplay.solver.spectra.sensor import rigid_body, sensor_transform

#: Hypotheses that are told apart, and the least probability of one that is worth it.
CONTENDERS = 3
LEAST_PROBABILITY = 1e-3
#: Entries of a hypothesis: those within its interval of clearance, but at least and at most so many of the nearest;
#: each is drawn so often with noise and discrepancies.
LEAST_ENTRIES = 40
MOST_ENTRIES = 120
COPIES = 3
#: Splits into entries that a direction is learned from and entries it is judged by.
SPLITS = 2
#: Standard deviations of what is projected over which the border is blurred: adds a twentieth to the spread.
BLUR = 0.3
#: Error from which on something is suggested at all, and the share of it that must go to be worth a word.
LEAST_ERROR = 5e-3
LEAST_GAIN = 0.05
#: Points of Gauss and Hermite's rule along either axis: 48 give errors to 0.0032, the largest probability has a kink.
NODES = 48
#: Two points [m] that count as one.
SAME_POINT = 1e-6


def suggest(
    catalogue: Catalogue,
    prepared: PreparedMeasurement,
    result: MatchResult,
    *,
    others: Sequence[PreparedMeasurement] = (),
    count: int = 5,
) -> tuple[Suggestion, ...]:
    """Rank what would tell the first hypotheses apart.

    Parameters
    ----------
    catalogue : Catalogue
    prepared : PreparedMeasurement
        The recording that was matched.
    result : MatchResult
        Its answer.
    others : sequence of PreparedMeasurement
        Further recordings that the answer is of.
    count : int
        Suggestions at most.

    Returns
    -------
    tuple of Suggestion
        What tells most first; what takes away less than a twentieth of the error is left out. Empty where there is one
        hypothesis only, or less than one in two hundred is mistaken as it is.

    Notes
    -----
    The separation is that of the best linear combination of levels (Fisher's), learned from half of the entries and
    measured on the others, with the entries' own scatter, noise and discrepancies: the share on the wrong side of the
    middle, and d' with Phi(-d' / 2) = error. Another sensor is taken to be as noisy as the median of those there are;
    several recordings count as they do in a common answer that has not heard the machine's past
    (:class:`~jointplay.catalogue.matching.together.Likeness`), one under another load as one more at its speed; where
    the first load holds joints shut, this foresees too little. Where a plan has loads,
    those that recordings seem to be under are no suggestions.
    What the answer is sure of already is known: what is gained follows from what separates the hypotheses *more* than
    now, beginning with their probabilities (:func:`foresee`).
    """
    contenders = [match for match in result.hypotheses[:CONTENDERS] if match.probability >= LEAST_PROBABILITY]
    if len(contenders) < 2:
        contenders = list(result.hypotheses[:2])
    question = _Separation(catalogue, prepared, tuple(contenders))
    if len(contenders) < 2 or not question.answerable(Day(prepared.drive_speed)):
        return ()
    if 1.0 - question.probability.max() < LEAST_ERROR:
        return ()
    heard = [question.day_of(each) for each in (prepared, *others)]
    now = question.of_recordings(heard)
    found = []
    for kind, what, sensing in _more_sensors(prepared, catalogue.machine):
        found.append(question.suggestion(kind, what, now, question.of_recordings(heard, sensing)))
    for day in question.other_speeds(heard):
        then = question.of_recordings([*heard, day])
        found.append(question.suggestion("speed", f"{day.speed * 30 / math.pi:.4g} rpm", now, then))
    for day in question.other_loads(heard):
        then = question.of_recordings([*heard, day])
        found.append(question.suggestion("load", str(day.load), now, then))
    worth = [each for each in found if each.error < (1.0 - LEAST_GAIN) * each.error_now]
    return tuple(sorted(worth, key=lambda each: -each.information_bits)[:count])


class Day(NamedTuple):
    """Of a recording: drive speed [rad/s], and load of the plan, where that has several."""

    speed: float
    load: DayLoad | None = None


@dataclass(frozen=True, eq=False)
class _Separation:
    """Which of these hypotheses is it?"""

    catalogue: Catalogue
    prepared: PreparedMeasurement
    contenders: tuple[HypothesisMatch, ...]
    known: dict[tuple[float, DayLoad | None], FloatArray] = field(default_factory=dict)
    """Separation by the recording's own sensors, by stored speed and load."""

    @property
    def matrix(self) -> FeatureMatrix:
        return self.catalogue.matrix

    @cached_property
    def loads(self) -> tuple[DayLoad, ...]:
        """Those of the catalogue's plan, where there are several."""
        loads = self.catalogue.plan.loads or ()
        return loads if len(loads) > 1 else ()

    @cached_property
    def load_of_rows(self) -> IntArray:
        """Which of these every entry of the catalogue is under (n,); -1 where under none of them."""
        shares = load_shares(self.catalogue.machine)
        drawn = np.zeros(len(self.matrix))
        for path, numbers in self.matrix.numbers(shares).items():
            drawn += shares[path] * numbers
        return loads_held(self.loads, drawn)

    def entries(self, match: HypothesisMatch, day: Day) -> IntArray:
        """Rows of a hypothesis at a drive speed, and under a load where one is given."""
        if day.load is None:
            return np.asarray(self.matrix.rows(match.label, speed=day.speed), dtype=np.int64)
        # Wide draws have loads of their own besides.
        rows = np.asarray(self.matrix.rows(match.label, "trusted", speed=day.speed), dtype=np.int64)
        return np.asarray(rows[self.load_of_rows[rows] == self.loads.index(day.load)])

    def answerable(self, day: Day) -> bool:
        """Whether every hypothesis has entries enough for a day."""
        return all(len(self.entries(match, day)) >= LEAST_ENTRIES // 2 for match in self.contenders)

    def day_of(self, prepared: PreparedMeasurement) -> Day:
        """The day of a recording: its speed, and of the plan's loads the one that it is likeliest under."""
        days = [day for load in self.loads if self.answerable(day := Day(prepared.drive_speed, load))]
        if len(days) < 2:
            return Day(prepared.drive_speed)
        sensing = exact_sensing(prepared)
        feature = features_of(prepared, sensing)
        return min(days, key=lambda day: min(_distance(feature, drawn) for drawn in self.glance(sensing, day)))

    def other_speeds(self, heard: Sequence[Day]) -> Iterator[Day]:
        """Days at speeds of the catalogue's plan but those next to recordings, under the load of the first."""
        nominal = abs(self.catalogue.recipe.nominal_drive_speed)
        speeds = [nominal * factor for factor in self.catalogue.plan.speeds]
        near = {min(speeds, key=lambda speed: abs(math.log(speed / day.speed))) for day in heard}
        days = (heard[0]._replace(speed=speed) for speed in speeds if speed not in near)
        yield from filter(self.answerable, days)

    def other_loads(self, heard: Sequence[Day]) -> Iterator[Day]:
        """Days under loads of the catalogue's plan that no recording seems to be under, at the speed of the first."""
        known = {day.load for day in heard}
        if None not in known:
            yield from filter(
                self.answerable, (heard[0]._replace(load=each) for each in self.loads if each not in known)
            )

    def of_recordings(self, days: Sequence[Day], sensing: Sensing | None = None) -> FloatArray:
        """Squared separation of every pair of hypotheses by recordings of some days, the first by other sensors
        where these are given.
        """
        stored = [self.matrix.nearest_speed(day.speed) for day in days]
        kinds = [(factor, day.load) for factor, day in zip(stored, days, strict=True)]
        for kind, day in zip(kinds, days, strict=True):
            if kind not in self.known:
                self.known[kind] = self.squared_distances(exact_sensing(self.prepared), day)
        apart = [self.known[kind] for kind in kinds]
        if sensing is not None:
            apart[0] = self.squared_distances(sensing, days[0])
        found: FloatArray = Likeness().weights(stored) @ np.array(apart)
        return found

    def rows(self, match: HypothesisMatch, day: Day) -> IntArray:
        """Entries of a hypothesis for a day whose clearances lie within its intervals, or nearest to them."""
        rows = self.entries(match, day)
        clearances = self.matrix.clearance(rows)
        away = np.zeros(len(rows))
        for estimate in match.clearances:
            clearance = np.maximum(clearances[:, self.matrix.joints.index(estimate.joint)], 1e-12)
            half = max(0.5 * math.log(estimate.high / estimate.low), 1e-3)
            away = np.maximum(away, np.abs(np.log(clearance / estimate.median)) / half)
        order = np.argsort(away, kind="stable")
        keep = int(np.clip(np.sum(away <= 1.0), LEAST_ENTRIES, MOST_ENTRIES))
        return rows[order[:keep]]

    def draw(self, sensing: Sensing, day: Day) -> list[tuple[FloatArray, IntArray]]:
        """Features (m, d) of every hypothesis for a day, seen through these sensors, and the entry of each."""
        found = []
        for number, match in enumerate(self.contenders):
            rows = self.rows(match, day)
            copies = np.full(len(rows), COPIES, dtype=np.int64)
            found.append(observe(self.matrix.packed(rows), sensing, Discrepancy(), copies, number))
        return found

    def glance(self, sensing: Sensing, day: Day) -> Iterator[FloatArray]:
        """Features (m, d) of the nearest entries of every hypothesis for a day, each once."""
        for number, match in enumerate(self.contenders):
            rows = self.rows(match, day)[:LEAST_ENTRIES]
            yield observe(self.matrix.packed(rows), sensing, Discrepancy(), np.ones(len(rows), np.int64), number)[0]

    def squared_distances(self, sensing: Sensing, day: Day) -> FloatArray:
        """Squared separation of every pair of hypotheses, seen through these sensors on a day."""
        drawn = self.draw(sensing, day)
        return np.array([_separate_held_out(*one, *other) for one, other in itertools.combinations(drawn, 2)])

    @property
    def probability(self) -> FloatArray:
        """Of each of the hypotheses (k,), if it is one of them."""
        found = np.array([max(match.probability, LEAST_PROBABILITY) for match in self.contenders])
        return np.asarray(found / found.sum(), np.float64)

    def mistaken(self, squared: FloatArray) -> float:
        """Share of machines that these levels alone take for another, pairs weighed by how likely both of them are."""
        weights = np.array([p * q for p, q in itertools.combinations(self.probability, 2)])
        return float(weights @ ndtr(-0.5 * np.sqrt(squared)) / weights.sum())

    def suggestion(
        self, kind: Literal["sensor", "direction", "speed", "load"], what: str, now: FloatArray, then: FloatArray
    ) -> Suggestion:
        """What it brings that pairs are as far apart as `then`, in place of `now`, squared."""
        error, information = foresee(self.probability, np.maximum(then - now, 0.0))
        apart = [float(-2.0 * ndtri(self.mistaken(squared))) for squared in (now, then)]
        return Suggestion(
            kind=kind,
            what=what,
            hypotheses=tuple(match.label for match in self.contenders),
            separation_now=apart[0],
            separation=apart[1],
            error_now=float(1.0 - self.probability.max()),
            error=error,
            information_bits=information,
        )


def foresee(probability: FloatArray, squared: FloatArray) -> tuple[float, float]:
    """Return the error to be expected after an observation, and its expected information.

    Parameters
    ----------
    probability : ndarray, shape (k,)
        Of each hypothesis now; k is 2 or more.
    squared : ndarray, shape (k (k - 1) / 2,)
        Squared separations of its pairs by the observation, in standard deviations.

    Returns
    -------
    error : float
        Probability that the most probable hypothesis is not the true one then.
    information : float
        Bits of the hypothesis that the observation is expected to give (D. V. Lindley, Ann. Math. Stat. 27 (1956) 986).

    Notes
    -----
    Hypotheses are points at these distances, as far as there are such (W. S. Torgerson, Psychometrika 17 (1952) 401),
    and the observation is normal about one of them; its law is summed up by Gauss and Hermite's rule.
    """
    count = len(probability)
    centred = np.eye(count) - 1.0 / count
    value, vector = np.linalg.eigh(-0.5 * centred @ scipy.spatial.distance.squareform(squared) @ centred)
    points = vector[:, -2:] * np.sqrt(np.maximum(value[-2:], 0.0))
    node, weight = np.polynomial.hermite_e.hermegauss(NODES)
    offset = np.stack(np.meshgrid(node, node, indexing="ij"), axis=-1).reshape(-1, 2)
    share = np.outer(weight, weight).ravel() / weight.sum() ** 2
    # (truth, node, hypothesis)
    away = points[:, None, None] + offset[None, :, None] - points[None, None]
    said = log_softmax(np.log(probability) - 0.5 * np.sum(away**2, axis=-1), axis=-1)
    error = 1.0 - probability @ (np.exp(said.max(axis=-1)) @ share)
    own = said[np.arange(count), :, np.arange(count)]
    information = probability @ (own @ share - np.log(probability)) / math.log(2.0)
    return float(np.clip(error, 0.0, 1.0)), max(0.0, float(information))


def _distance(feature: FloatArray, drawn: FloatArray) -> float:
    """How unlikely a feature vector (d,) is to be one of those drawn (m, d), by each of its numbers by itself."""
    variance = np.maximum(drawn.var(axis=0), 1e-12)
    return float(np.mean((feature - drawn.mean(axis=0)) ** 2 / variance + np.log(variance)))


def _separate_held_out(first: FloatArray, first_case: IntArray, second: FloatArray, second_case: IntArray) -> float:
    """Squared separation along Fisher's direction, learned and measured on different entries.

    The error is counted, with borders a little blurred so that few rows give a smooth number: levels of rattling joints
    have longer tails than a normal law.
    """
    generator = np.random.default_rng(0)
    found = []
    for _ in range(SPLITS):
        learned = [_half(case, generator) for case in (first_case, second_case)]
        for flip in (False, True):
            one, two = learned[0] ^ flip, learned[1] ^ flip
            direction = _fisher(first[one], second[two])
            border = 0.5 * float((first[one] @ direction).mean() + (second[two] @ direction).mean())
            a, b = border - first[~one] @ direction, second[~two] @ direction - border
            blur = BLUR * math.sqrt(max(0.5 * (a.var() + b.var()), 1e-300))
            found += [ndtr(-a / blur).mean(), ndtr(-b / blur).mean()]
    error = float(np.clip(np.mean(found), 1e-12, 0.5))
    return float(2.0 * ndtri(error)) ** 2


def _half(case: IntArray, generator: np.random.Generator) -> BoolArray:
    """Draw half of the cases; copies of a case stay together."""
    count = int(case.max()) + 1
    chosen = generator.permutation(count) < count // 2
    return np.asarray(chosen[case], dtype=np.bool_)


def _fisher(first: FloatArray, second: FloatArray) -> FloatArray:
    """Direction of the best separation; the covariance is shrunk to its diagonal as far as rows are few."""
    residual = np.concatenate([first - first.mean(axis=0), second - second.mean(axis=0)])
    count, size = residual.shape
    own = count / (count + 3.0 * size)
    diagonal = np.mean(residual**2, axis=0)
    inverse = 1.0 / ((1.0 - own) * diagonal + 1e-6 * diagonal.mean())
    # Rows are fewer than features: the covariance is inverted by way of their products (Woodbury 1950).
    scaled = residual * inverse
    apart = second.mean(axis=0) - first.mean(axis=0)
    within = scaled @ residual.T + np.eye(count) * (count / own)
    found: FloatArray = inverse * apart - scaled.T @ scipy.linalg.solve(within, scaled @ apart, assume_a="pos")
    return found


def _sensing(prepared: PreparedMeasurement, machine: Machine, more: FloatArray) -> Sensing:
    """The sensors of a recording and one more (3,): what they compare, and with what noise."""
    sensors, scheme = prepared.sensing, prepared.scheme
    edges = scheme.edges_hz(prepared.drive_speed)
    own = prepared.floor.band_power(edges, sensors.derivatives)
    # Vibration from elsewhere: what the motions have more of than independent sensors explain, however many they are.
    common = np.maximum(prepared.noise_power - own @ (sensors.channels**2).T, 0.0)
    own = np.maximum(own, LEAST_NOISE_DENSITY * np.diff(edges)[:, None])
    transform = np.vstack([sensors.transform, more])
    own = np.hstack([own, np.median(own, axis=1, keepdims=True)])
    inverse = rigid_body(transform[:, free_motions(machine)]).inverse
    channels = np.eye(len(transform)) if inverse is None else inverse
    noise = own @ (channels**2).T
    if sensors.rigid_body and inverse is not None:
        noise = noise + common
    noise = np.maximum(join_bands(noise, prepared.cuts), LEAST_POWER)
    return Sensing(transform, channels, prepared.cuts, noise, prepared.group_degrees_of_freedom, sensors.phases)


def _more_sensors(
    prepared: PreparedMeasurement, machine: Machine
) -> Iterator[tuple[Literal["sensor", "direction"], str, Sensing]]:
    """One more sensor each: those of the machine file that were not used, then x and y at the corners of the frame."""
    used = [sensor for sensor in machine.sensors if sensor.name in prepared.sensing.sensors]
    centre = machine.links[machine.frame].cg
    seen = list(prepared.sensing.transform)
    candidates: list[tuple[Literal["sensor", "direction"], str, tuple[float, float], tuple[float, float]]] = [
        ("sensor", sensor.name, sensor.at, sensor.direction)
        for sensor in machine.sensors
        if sensor.name not in prepared.sensing.sensors
    ]
    points = [*(sensor.at for sensor in used), *_corners(machine)]
    for at, (axis, direction) in itertools.product(points, (("x", (1.0, 0.0)), ("y", (0.0, 1.0)))):
        there = any(math.dist(at, sensor.at) < SAME_POINT for sensor in used)
        text = f"{axis} at ({at[0]:.4g}, {at[1]:.4g}) m"
        candidates.append(("direction" if there else "sensor", text, at, direction))
    for kind, what, at, direction in candidates:
        row = sensor_transform([at], [direction], centre)[0]
        if not any(min(np.abs(row - other).max(), np.abs(row + other).max()) < SAME_POINT for other in seen):
            seen.append(row)
            yield kind, what, _sensing(prepared, machine, row)


def _corners(machine: Machine) -> list[tuple[float, float]]:
    """Corners of the frame, as far as the drawing knows it: the convex hull of all its points."""
    frame = machine.frame
    points = [joint.at for joint in machine.joints.values() if frame in joint.links]
    points += [support.at for support in machine.supports if support.link == frame]
    points += [sensor.at for sensor in machine.sensors]
    unique = np.unique(np.array(points, dtype=np.float64).reshape(-1, 2), axis=0)
    if len(unique) < 3 or np.linalg.matrix_rank(unique - unique.mean(axis=0), tol=SAME_POINT) < 2:
        return [(float(x), float(y)) for x, y in unique]
    return [(float(x), float(y)) for x, y in unique[scipy.spatial.ConvexHull(unique).vertices]]
