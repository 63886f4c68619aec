"""Analysis by synthesis: simulate anew around the most probable hypotheses, in the neighbourhood of the recording.

A catalogue's draws lie some way off every recording. Around the nearest draws of each hypothesis new cases are drawn,
the best are kept, and the next ones are drawn where those lie (a cross-entropy search). All that were drawn so are a
sample of the posterior with importance weights, which count as far as they can be believed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from jointplay.catalogue.building.chunk import cut_chunks, simulate_chunk
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.coherence import compose
from jointplay.catalogue.matching.matcher import NORMAL_90, ClearanceEstimate, HypothesisMatch, MatchResult, rank
from jointplay.catalogue.matching.modes import Mode
from jointplay.catalogue.matching.observation import Sensing, group
from jointplay.catalogue.matching.population import Population, weigh
from jointplay.catalogue.plans.driving import DRIVE_SPEED
from jointplay.catalogue.plans.entry import Entry, Stratum, seed_from
from jointplay.catalogue.storage.cross_power import pack
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray, IntArray
from jointplay.solver.machines.machine import has_known_effort

CERTAIN = 0.9
"""Nothing is simulated where one hypothesis alone is in the candidate set and has more probability than this."""

HYPOTHESES, LEAST = 3, 1e-3
"""How many are simulated, the most probable first, and the probability below which none is."""

SIZE, ELITE = 16, 6
"""Cases of a hypothesis in each generation, and how many of all its cases the next ones are drawn around."""

LEVEL_DB = 1.0
"""Standard deviation of the levels that no simulation explains: as much as a trusted model is believed."""

DEGREES_OF_FREEDOM = 8.0
"""Of the Student-t score of a level: a few odd bands, as chaotic motion has them, do not decide. A normal score was
certain, and wrong, of a quarter of doubtful recordings (docs/decisions/0039)."""

SEED = 0
"""Of everything drawn."""

LEAST_WIDTH = 0.5
"""Least width of a clearance's interval, as a part of the catalogue's own: few cases agree by chance, too."""

NOISES = 400
"""Draws of the error of a sample's mean weight, over which probabilities are averaged."""

MOST = 800
"""Draws of a hypothesis and stratum, at most, that say where new cases may lie."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """What a recording is compared by.

    Parameters
    ----------
    feature : ndarray, shape (d,)
        Levels, dB.
    sensing : Sensing
        What its sensors see of a motion of the frame.
    drive_speed : float
        Measured, rad/s, > 0.
    """

    feature: FloatArray
    sensing: Sensing
    drive_speed: float


@dataclass(frozen=True)
class Refined:
    """What simulating anew gave.

    Parameters
    ----------
    result : MatchResult
    simulations, generations : int
    changed : bool
        Whether another hypothesis is the most probable one now.
    reason : str
        What was done, or why nothing was, in words.
    """

    result: MatchResult
    simulations: int
    generations: int
    changed: bool
    reason: str


def refine(
    recorded: Recorded,
    catalogue: Catalogue,
    result: MatchResult,
    candidates: Sequence[str],
    *,
    mode: Mode = "trusted",
    cases: int = 240,
) -> Refined:
    """Simulate around the most probable hypotheses where that can change the answer.

    Parameters
    ----------
    recorded : Recorded
    catalogue : Catalogue
    result : MatchResult
        The catalogue's own answer.
    candidates : sequence of str
        Labels of its candidate set.
    mode : {"trusted", "robust"}
        In the robust mode the machine's own data are varied, too, as far as the catalogue varies them.
    cases : int
        How many may be simulated, of all hypotheses: two generations at least are.

    Returns
    -------
    Refined
        The same for the same arguments.
    """
    if result.best.probability > CERTAIN and len(candidates) <= 1:
        return _leave_unchanged(result, f"certain already: {result.best.label} has more than {CERTAIN:g}")
    tried = [each for each in result.hypotheses if each.probability >= LEAST][:HYPOTHESES]
    if len(tried) < 2:
        return _leave_unchanged(result, "only one hypothesis is probable at all")
    searches = [_Search.of(recorded, catalogue, match, mode) for match in tried]
    generations = max(2, cases // (SIZE * len(searches)))
    for _ in range(generations):
        _simulate(recorded, catalogue, searches)
    refined, judged = _combine(recorded, result, searches)
    changed = refined.best.label != result.best.label
    count = sum(len(search.scores) for search in searches)
    names = ", ".join(search.match.label for search in searches)
    said = f"{count} cases around {names} in {generations} generations{judged}"
    if changed:
        said += f": {refined.best.label} in place of {result.best.label}"
    return Refined(refined, count, generations, changed, said)


def _leave_unchanged(result: MatchResult, reason: str) -> Refined:
    return Refined(result, 0, 0, False, reason)


@dataclass(eq=False)
class _Search:
    """One hypothesis: where its cases are drawn, and how well those simulated so far fit."""

    match: HypothesisMatch
    population: Population
    generator: np.random.Generator
    cases: list[Entry]
    scores: list[float]
    importances: list[float]
    levels: list[FloatArray]

    @classmethod
    def of(cls, recorded: Recorded, catalogue: Catalogue, match: HypothesisMatch, mode: Mode) -> _Search:
        rows, first = _rows(catalogue, match.label, mode)
        powers, _ = recorded.sensing.powers(catalogue.matrix.packed(rows))
        levels = compose(powers + recorded.sensing.noise, None)
        order = np.argsort(np.mean((levels - recorded.feature) ** 2, axis=1), kind="stable")
        near = rows[order[:SIZE]]
        # What is drawn shows in the first draws; reading all of 100 000 cases from their shards takes seconds.
        wanted = np.union1d(first, near)
        entries = dict(zip(wanted.tolist(), (entry for entry, _ in catalogue.cases(wanted)), strict=True))
        seed = seed_from("synthesis", SEED, match.label)
        population = Population.of(list(entries.values()), [entries[row] for row in near.tolist()])
        return cls(match, population, np.random.default_rng(seed), [], [], [], [])

    def sampled(self, first: int) -> list[int]:
        """Places of the cases that were drawn anew, all but the `first` ones, and could be simulated."""
        return [place for place in range(first, len(self.scores)) if np.isfinite(self.scores[place])]

    def best(self, count: int) -> list[int]:
        """Places of the cases that fit best, of those that could be simulated."""
        order = np.argsort(-np.array(self.scores), kind="stable")[:count]
        return [int(place) for place in order if np.isfinite(self.scores[place])]


def _rows(catalogue: Catalogue, label: str, mode: Mode) -> tuple[IntArray, IntArray]:
    """Rows of a hypothesis that the search may begin from, and those of its first draws."""
    strata: tuple[Stratum, ...] = ("trusted",) if mode == "trusted" else ("trusted", "wide")
    if not any(len(catalogue.matrix.rows(label, stratum)) for stratum in strata):
        strata = ("trusted", "wide")
    every, first = (
        np.concatenate([catalogue.matrix.rows(label, stratum, draws=draws) for stratum in strata])
        for draws in (None, MOST)
    )
    if len(every) < 3:
        raise DiagnosisError(
            f"catalogue {catalogue.path}: {len(every)} entries of hypothesis {label}: at least 3 needed"
        )
    return every, first


def _simulate(recorded: Recorded, catalogue: Catalogue, searches: Sequence[_Search]) -> None:
    """Draw and simulate one generation of all hypotheses, those of one model together."""
    drawn: list[tuple[_Search, Entry, float]] = []
    for search in searches:
        elite = [search.cases[place] for place in search.best(ELITE)]
        for parent, clearances, parameters, importance in search.population.draw(elite, SIZE, search.generator):
            speed = float(np.copysign(recorded.drive_speed, catalogue.recipe.nominal_drive_speed))
            # What a motor turns at follows from its numbers, which are drawn.
            turned = {} if has_known_effort(catalogue.machine) else {DRIVE_SPEED: speed}
            case = Entry.of(
                catalogue.machine,
                catalogue.recipe,
                hypothesis=parent.hypothesis,
                joints=parent.joints,
                clearances=clearances,
                parameters={**parameters, **turned},
                draw=parent.draw,
                stratum=parent.stratum,
                variant=parent.variant,
            )
            drawn.append((search, case, importance))
    found = {}
    for chunk in cut_chunks(catalogue.machine, catalogue.recipe, [case for _, case, _ in drawn], len(drawn)):
        for entry, outcome in zip(chunk.entries, simulate_chunk(chunk), strict=True):
            found[entry.key] = outcome
    for search, case, importance in drawn:
        power = found[case.key].power
        if power is None:
            score, levels = -np.inf, np.zeros_like(recorded.feature)
        else:
            score, levels = _score(recorded, np.asarray(power))
        search.cases.append(case)
        search.scores.append(score)
        search.importances.append(importance)
        search.levels.append(levels)


def _score(recorded: Recorded, power: np.ndarray) -> tuple[float, FloatArray]:
    """Log density of the recording given one simulated case, and that case's levels (d,)."""
    sensing = recorded.sensing
    clean, noise = sensing.powers(group(pack(power[None]), sensing.cuts))[0][0], sensing.noise
    levels = compose((clean + noise)[None], None)[0]
    cells = 0.5 * sensing.degrees_of_freedom[:, None]
    # Of a level in dB, from the relative variance of the power (see catalogue.observation.observe).
    scatter = (10.0 / np.log(10.0)) ** 2 * (noise**2 + 2.0 * clean * noise) / (cells * (clean + noise) ** 2)
    variance = LEVEL_DB**2 + scatter.ravel()
    nu = DEGREES_OF_FREEDOM
    z = (recorded.feature - levels) ** 2 / variance
    return float(-0.5 * np.sum((nu + 1.0) * np.log1p(z / nu) + np.log(variance))), levels


def _combine(recorded: Recorded, result: MatchResult, searches: Sequence[_Search]) -> tuple[MatchResult, str]:
    """Share the probability of the simulated hypotheses out anew, and say how far their samples can be believed.

    What a hypothesis has from the catalogue counts times the mean weight of its sample. Nothing changes where no sample
    of a hypothesis could be simulated.
    """
    sampled = [search.sampled(SIZE) for search in searches]
    if not all(len(places) for places in sampled):
        return result, ": some hypotheses could not be simulated, so that nothing changes"
    logs = [
        np.array([search.scores[place] + search.importances[place] for place in places])
        for search, places in zip(searches, sampled, strict=True)
    ]
    weighed, temperature = weigh(logs)
    before = np.log([search.match.probability for search in searches])
    # No surer than the samples allow: averaged over the errors of their means.
    noise = np.random.default_rng(SEED).normal(size=(NOISES, len(searches)))
    means = np.array([each.log_mean for each in weighed]) + noise * [each.error for each in weighed]
    share = softmax(before + means, axis=1).mean(axis=0)
    total = sum(search.match.probability for search in searches)
    anew: Mapping[str, HypothesisMatch] = {
        search.match.label: _refit(recorded, search, places, each.weights, float(total * part))
        for search, places, each, part in zip(searches, sampled, weighed, share, strict=True)
    }
    matches = [anew.get(match.label, match) for match in result.hypotheses]
    effective, k = min(each.effective for each in weighed), max(each.k for each in weighed)
    said = f", effective sample size {effective:.0f} and Pareto k {k:.2f} at temperature {temperature:.3g}"
    return replace(result, hypotheses=rank(matches).hypotheses), said


def _refit(
    recorded: Recorded,
    search: _Search,
    places: Sequence[int],
    weights: FloatArray,
    probability: float,
) -> HypothesisMatch:
    """Clearances of a hypothesis from its weighed sample, predicted levels and distance from its best cases."""
    estimates = []
    for found in search.match.clearances:
        logs = np.log([search.cases[place].fault[found.joint] for place in places])
        middle = float(weights @ logs)
        half = NORMAL_90 * float(np.sqrt(weights @ (logs - middle) ** 2))
        half = max(half, 0.5 * LEAST_WIDTH * float(np.log(found.high / found.low)))
        low, median, high = np.exp([middle - half, middle, middle + half])
        estimates.append(ClearanceEstimate(found.joint, float(median), float(low), float(high)))
    predicted = np.mean([search.levels[place] for place in search.best(ELITE)], axis=0)
    return replace(
        search.match,
        probability=probability,
        clearances=tuple(estimates),
        distance_db=float(np.sqrt(np.mean((recorded.feature - predicted) ** 2))),
        predicted=predicted,
    )
