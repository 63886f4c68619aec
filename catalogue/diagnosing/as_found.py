"""A small catalogue of the machine as a recording shows it, simulated for that recording alone: effort thorough.

A load that a catalogue does not hold hides which of two joints is worn. Here it is fitted to the low orders, and the
leading sets of joints are simulated with it at the recording's speed, once over all clearances, and once more around
what the first cases say of clearances and load. Both go through the matcher that answers from catalogues.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.found_cases import changed, counting, draw_cases, simulate_cases
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.diagnosing.stroke_loads import FoundLoad, find_load
from jointplay.catalogue.matching.learning import Learning, training_set
from jointplay.catalogue.matching.matcher import HypothesisMatch, MatchResult, rank
from jointplay.catalogue.matching.model_library import ModelLibrary, Observed, one_thread
from jointplay.catalogue.matching.modes import ModeAsked
from jointplay.catalogue.matching.network import NetworkTraining
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.refit import weight_as_filed
from jointplay.catalogue.plans.entry import Entry
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray

CERTAIN = 0.9
"""Nothing is simulated where the machine is as its file says, and one hypothesis alone is in the candidate set and has
more probability than this."""

SETS = 6
"""Sets of joints that are simulated, at most."""

LIKELY = 0.01
"""Probability of a set from which on it is simulated before any neighbour of the leading ones."""

FIRST_SHARE = 1.0 / 3.0
"""Part of the cases that are drawn over all clearances; the others lie around what these say."""

LEAST_CASES = 48
"""Cases of a set, at least: fewer teach no curve."""

BEYOND = 1.5
"""How far beyond their 90 % intervals clearances are drawn, as a factor."""

FOUND_SHARE, UNTOLD_SHARE = 2.0 / 3.0, 1.0 / 3.0
"""Weight of what the machine as found says against what the catalogue's machines do, which are less like it; and where
these were heard beside the machine's own past and no load is told, which is all that it has been given of the machine.
"""

KNOWN_SHARE = 0.8
"""Weight of what the machine says whose load and numbers its past has told."""

TRAINING = NetworkTraining(rows=20_000, blocks=20)
"""Of the network that learns the cases of one recording, some 2000: 60 000 rows take three times as long and know no
more."""

CASE_ROWS = 5
"""Rows of a case, at least: of 8640 cases twice as many as 20 000 know more."""

NEAR = 0.5
"""Difference in ln(clearance) within which cases speak for an answer (standard deviation)."""

RIDGES = np.geomspace(0.3, 300.0, 7)
"""Penalties of regressions that are compared by leaving one out."""


@dataclass(frozen=True)
class Refined:
    """What simulating anew gave.

    Parameters
    ----------
    result : MatchResult
    simulations, generations : int
    reason : str
        What was done, or why nothing was, in words.
    cause : NamedCause, optional
        Found beside wear, where the machine with it explains the recording: a load, or, where recordings in order have
        told that, a mount that has come loose since.
    told : bool
        Whether what was simulated has the numbers that these have told, and explains the recording.
    """

    result: MatchResult
    simulations: int
    generations: int
    reason: str
    cause: NamedCause | None = None
    told: bool = False


def refine(
    prepared: PreparedMeasurement,
    observed: Observed,
    catalogue: Catalogue,
    result: MatchResult,
    candidates: Sequence[str],
    *,
    mode: ModeAsked = "auto",
    prior: Prior | None = None,
    cases: int,
    progress: Callable[[int, int], None] | None = None,
) -> Refined:
    """Simulate the machine as found where that can change the answer.

    Parameters
    ----------
    prepared : PreparedMeasurement
    observed : Observed
        The same recording, as a library is asked about it.
    catalogue : Catalogue
    result : MatchResult
        The catalogue's own answer.
    candidates : sequence of str
        Labels of its candidate set.
    mode : {"auto", "trusted", "robust"}
        How the cases are learned from; with "robust" none are simulated.
    prior : Prior, optional
        That of the answer; the usual one unless given.
    cases : int
        How many may be simulated, of all sets together; some are in any case.
    progress : callable, optional
        Called with the number of cases done and their total.

    Returns
    -------
    Refined
        The same for the same arguments.
    """
    prior = prior or Prior()
    if reason := settled(result, candidates, mode):
        return Refined(result, 0, 0, reason)
    chosen = sets_to_simulate(result)
    speed = math.copysign(prepared.drive_speed, catalogue.recipe.nominal_drive_speed)
    load = None
    if result.is_doubted:
        with one_thread():
            shown = [(prepared, match.label, match.probability) for match in result.hypotheses[:3]]
            load = find_load(catalogue, shown, speed)
    count = max(LEAST_CASES, cases // len(chosen))
    first = round(FIRST_SHARE * count)
    sets = [match.joints for match in chosen]
    machine, drawn = draw_cases(catalogue, speed, sets, load, count)
    paths = load.paths if load else ()
    whole = {
        match.label: _Region.of([e for e in drawn if e.hypothesis.label == match.label], paths) for match in chosen
    }

    def simulate(cases: Sequence[Entry], regions: Mapping[str, _Region], before: int = 0) -> FoundSpectra:
        moved = []
        for entry in cases:
            old, new = whole[entry.hypothesis.label], regions[entry.hypothesis.label]
            clearances, sizes = old.clearances(entry, new), old.numbers(entry, new, paths)
            moved.append(changed(entry, machine, catalogue.recipe, clearances, sizes))
        return simulate_cases(catalogue, machine, moved, counting(progress, before, len(drawn)))

    wide = {match.label: whole[match.label].around(match) for match in chosen}
    broad = simulate([entry for entry in drawn if entry.draw < first], wide)
    if any(len(broad.rows(match.label)) < LEAST_CASES // 6 for match in chosen):
        tried = sum(entry.draw < first for entry in drawn)
        return Refined(result, tried, 1, "some hypotheses could not be simulated, so that nothing changes")
    near = {}
    for match in answer_by(broad, observed, mode).hypotheses:
        region = wide[match.label].around(match)
        if paths:
            with one_thread():
                mean, error = _regress(broad, match.label, observed, paths)
            region = replace(region, load=mean, error=error)
        near[match.label] = region
    rest = [entry for entry in drawn if entry.draw >= first]
    later = simulate(rest, near, len(drawn) - len(rest))
    if not later.entries:
        return Refined(result, len(drawn), 2, "cases near the answer could not be simulated, so that nothing changes")
    inside = [row for row, entry in enumerate(broad.entries) if near[entry.hypothesis.label].holds(entry)]
    every = broad.kept(inside) + later
    found = answer_by(every, observed, mode, networks=networks_of(every, observed))
    # What a set says of a part of its clearances is what it says of all of them times that part.
    shares = {match.label: near[match.label].share(whole[match.label]) for match in found.hypotheses}
    found = with_prior(found, result, prior, len(every.joints), shares)
    return blend_found(result, found, every, len(drawn), load)


def settled(result: MatchResult, candidates: Sequence[str], mode: ModeAsked) -> str:
    """Why no simulation can change an answer; empty where one can.

    Parameters
    ----------
    result : MatchResult
    candidates : sequence of str
        Labels of its candidate set.
    mode : {"auto", "trusted", "robust"}
    """
    if mode == "robust":
        return "simulated is a machine like its file, which mode robust does not take it to be"
    if not result.is_doubted and result.best.probability > CERTAIN and len(candidates) <= 1:
        return f"certain already: {result.best.label} has more than {CERTAIN:g}"
    return "" if len(sets_to_simulate(result)) > 1 else "only one hypothesis is probable at all"


def with_prior(
    found: MatchResult, result: MatchResult, prior: Prior, count: int, shares: Mapping[str, float] | None = None
) -> MatchResult:
    """Return what cases of some sets of an answer say with its prior; so many joints may wear.

    Parameters
    ----------
    found : MatchResult
        Of these sets, with the usual prior.
    result : MatchResult
        The answer.
    prior : Prior
    count : int
    shares : mapping of str to float, optional
        What each set multiplies by, by its label.
    """
    most, of_found = (max(len(match.joints) for match in each.hypotheses) for each in (result, found))
    weights = [
        match.probability
        * (shares or {}).get(match.label, 1.0)
        * prior.weight(match.joints, count, most)
        / Prior().weight(match.joints, count, of_found)
        for match in found.hypotheses
    ]
    again = [
        replace(match, probability=weight / sum(weights))
        for match, weight in zip(found.hypotheses, weights, strict=True)
    ]
    return replace(found, hypotheses=rank(again).hypotheses)


def networks_of(spectra: FoundSpectra, observed: Observed, folder: Path | None = None) -> NetworkShelf:
    """Train a network on cases as the sensors of a recording see them; none where there are too few.

    One that is in the folder already is not trained again.
    """
    training = replace(TRAINING, rows=max(TRAINING.rows, CASE_ROWS * len(spectra.entries)))
    shelf = NetworkShelf(spectra, observed.sensing, folder, training)
    learning = Learning.of("trusted")
    asked = (observed.sensing, learning, observed.speed)
    if shelf.applies(*asked) and shelf.get(*asked) is None:
        shelf.train(learning, observed.speed or spectra.nominal_speed)
    return shelf


def answer_by(
    spectra: FoundSpectra, observed: Observed, mode: ModeAsked, networks: NetworkShelf | None = None
) -> MatchResult:
    """Match a recording with cases that were simulated for it, or its machine."""
    return ModelLibrary(spectra, networks=networks).answer(
        observed.sensing, observed.feature, observed.watched, "standard", mode, speed=observed.speed
    )


def sets_to_simulate(result: MatchResult, most: int = SETS) -> tuple[HypothesisMatch, ...]:
    """The likely sets, then those that have a joint more or less than one of the two first, then others; so many."""
    leading = [set(match.joints) for match in result.hypotheses[:2]]

    def place(match: HypothesisMatch) -> int:
        if match.probability >= LIKELY:
            return 0
        return 1 if any(len(joints.symmetric_difference(match.joints)) == 1 for joints in leading) else 2

    return tuple(sorted(result.hypotheses, key=place)[:most])


@dataclass(frozen=True, eq=False)
class _Region:
    """Where cases of a set lie: logarithms of the least and greatest clearance (k, 2) of its worn joints; loads.

    Parameters
    ----------
    joints : tuple of str
    ends : (k, 2) array
    load, error : (p,) array
        Mean and standard deviation of the loads [N], of which there may be none.
    """

    joints: tuple[str, ...]
    ends: FloatArray
    load: FloatArray
    error: FloatArray

    @classmethod
    def of(cls, entries: Sequence[Entry], paths: Sequence[str]) -> _Region:
        """That of some cases."""
        joints = entries[0].worn
        own = np.log([[entry.fault[joint] for joint in joints] for entry in entries])
        sizes = np.array([[entry.parameters[path] for path in paths] for entry in entries])
        return cls(joints, np.column_stack([own.min(axis=0), own.max(axis=0)]), sizes.mean(axis=0), sizes.std(axis=0))

    def around(self, match: HypothesisMatch) -> _Region:
        """The part of it that an answer finds likely."""
        reach = np.log([[each.low / BEYOND, each.high * BEYOND] for each in match.clearances]).reshape(-1, 2)
        return replace(self, ends=np.clip(reach, self.ends[:, :1], self.ends[:, 1:]))

    def share(self, whole: _Region) -> float:
        """Part of the clearances of another one."""
        return float(np.prod(np.ptp(self.ends, axis=1) / np.ptp(whole.ends, axis=1)))

    def holds(self, entry: Entry) -> bool:
        """Whether a case has such clearances."""
        own = np.log([entry.fault[joint] for joint in self.joints])
        return bool(((own >= self.ends[:, 0] - 1e-9) & (own <= self.ends[:, 1] + 1e-9)).all())

    def clearances(self, entry: Entry, new: _Region) -> tuple[float, ...]:
        """Clearances of a case of this region, moved to where they are in a new one."""
        own = np.log([entry.fault[joint] for joint in self.joints])
        part = (own - self.ends[:, 0]) / np.ptp(self.ends, axis=1)
        worn = dict(zip(self.joints, np.exp(new.ends[:, 0] + part * np.ptp(new.ends, axis=1)).tolist(), strict=True))
        return tuple(worn.get(joint, entry.fault[joint]) for joint in entry.joints)

    def numbers(self, entry: Entry, new: _Region, paths: Sequence[str]) -> dict[str, float]:
        """Numbers of a case of this region, its loads moved to where they are in a new one."""
        sizes = np.array([entry.parameters[path] for path in paths])
        moved = new.load + (sizes - self.load) / self.error * new.error
        return {**entry.parameters, **dict(zip(paths, moved.tolist(), strict=True))}


def _regress(
    broad: FoundSpectra, label: str, observed: Observed, paths: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    """Numbers (p,) of the recording as levels of its low orders say, and their errors, by the cases of a set.

    Ridge regression on levels and their squares; the penalty is that of the least error where one case is left out.
    """
    rows = broad.rows(label)
    numbers = np.array([[broad.entries[row].parameters[path] for path in paths] for row in rows.tolist()])
    learning = Learning(rows=1)
    (draws,) = training_set(broad, observed.sensing, observed.watched, learning, rows={label: rows}).hypotheses
    low = np.flatnonzero(observed.watched)
    levels, own = draws.features[:, low], observed.feature[low]
    middle, scale = levels.mean(axis=0), levels.std(axis=0)
    away, here = (levels - middle) / scale, np.clip((own - middle) / scale, -3.0, 3.0)
    terms, term = np.hstack([away, away**2 - 1.0]), np.r_[here, here**2 - 1.0]
    mean = numbers.mean(axis=0)
    found, errors = [], []
    for ridge in RIDGES:
        inverse = np.linalg.inv(terms.T @ terms + ridge * np.eye(terms.shape[1]))
        slopes = inverse @ terms.T @ (numbers - mean)
        hat = np.einsum("ni,ij,nj->n", terms, inverse, terms)
        left = (numbers - mean - terms @ slopes) / (1.0 - hat)[:, None]
        found.append(mean + term @ slopes)
        errors.append(np.sqrt(np.mean(left**2, axis=0)))
    best, each = np.argmin(errors, axis=0), np.arange(len(mean))
    return np.array(found)[best, each], np.array(errors)[best, each]


def blend_found(
    result: MatchResult,
    found: MatchResult,
    every: FoundSpectra,
    simulated: int,
    load: FoundLoad | None,
    *,
    told: bool = False,
) -> Refined:
    """Share the probability of the simulated sets out anew: by both answers, if the machine as found can be believed.

    They have seen other machines and other noise, so their weighted geometric mean is better than either. It counts as
    far as the machine as found explains the recording, and as there are cases near it.
    """
    near = _cases_near(every, found.best)
    p_value = found.p_value if found.trusted_p_value is None else found.trusted_p_value
    trust = weight_as_filed(p_value) * near / (1.0 + near)
    cause = None if load is None or told else load.cause(trust)
    share = KNOWN_SHARE if told else UNTOLD_SHARE if result.beside and cause is None else FOUND_SHARE
    before = {match.label: match.probability for match in result.hypotheses}
    total = sum(before[match.label] for match in found.hypotheses)
    pooled = {
        match.label: match.probability**share * (before[match.label] / total) ** (1.0 - share)
        for match in found.hypotheses
    }
    whole = sum(pooled.values())
    anew = {
        match.label: replace(
            match,
            probability=trust * total * pooled[match.label] / whole + (1.0 - trust) * before[match.label],
        )
        for match in found.hypotheses
    }
    matches = rank([anew.get(match.label, match) for match in result.hypotheses]).hypotheses
    named = (
        "" if load is None else " and loads of {:.0f} and {:.0f} N on the strokes forward and back".format(*load.mean)
    )
    changed = f": {matches[0].label} in place of {result.best.label}" * (matches[0].label != result.best.label)
    said = f"{simulated} cases of {len(anew)} sets of joints{named}, effective sample size {near:.0f}{changed}"
    if trust < 0.5:
        said += "; that does not explain the recording either"
        shares = {match.label: match.probability for match in matches}
        own = rank([replace(match, probability=shares[match.label]) for match in result.hypotheses]).hypotheses
        return Refined(replace(result, hypotheses=own), simulated, 2, said)
    # Held-out draws of so few and so near cases are told apart more easily than the machines of the catalogue.
    leading = replace(
        found, hypotheses=matches, conformal=result.conformal, sightings=result.sightings, notes=result.notes,
        network=result.network, beside=result.beside,
    )  # fmt: skip
    return Refined(leading, simulated, 2, said, cause, told)


def _cases_near(every: FoundSpectra, match: HypothesisMatch) -> float:
    """Effective number of cases of a hypothesis at the clearances found: those that its curve is drawn by there."""
    rows = every.rows(match.label)
    columns = [every.joints.index(each.joint) for each in match.clearances]
    away = np.log(every.clearance(rows)[:, columns]) - np.log([each.median for each in match.clearances])
    weights = np.exp(-0.5 * np.sum((away / NEAR) ** 2, axis=1))
    return float(weights.sum() ** 2 / np.sum(weights**2))
