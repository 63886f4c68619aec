"""Figures of lives: what the state of wear says of machines over many visits, against single answers and the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer
from jointplay.catalogue.following.follow import follow
from jointplay.catalogue.following.play import JointBounds
from jointplay.catalogue.following.state import WearState
from jointplay.catalogue.following.visits import Inspection, Visit

FALSE_ALARMS = 1 / 200
"""Share of visits at which a joint that is not worn may be called so, in comparing first sure detections."""

SEEN_WITHIN = 2
"""Visits after a repair, the first one among them, within which it has to be seen."""

_RESAMPLED = 2000


@dataclass(frozen=True)
class LifeVisit:
    """A recording, what is true of it, and what was answered.

    Parameters
    ----------
    at : datetime
    sha256 : str
        Of the recording.
    clearances : mapping of str to float
        True ones of all joints, m.
    answer : Answer or None
        None where the recording was refused.
    arrivals : tuple of int
        Places in the order in which files came: one, or more where it came again.
    alone : Answer, optional
        By the recording alone, without what is known of the machine; the same unless given.
    """

    at: datetime
    sha256: str
    clearances: Mapping[str, float]
    answer: Answer | None
    arrivals: tuple[int, ...]
    alone: Answer | None = None


@dataclass(frozen=True)
class Life:
    """A machine's life.

    Parameters
    ----------
    name : str
    visits : tuple of LifeVisit
        In the order of time.
    inspections : tuple of Inspection
        What the filter is told besides.
    repairs : tuple of (int, str)
        Place of the first visit after each repair, and its joint, told or not.
    loosening : str
        Name of the cause that comes up, with a size that falls; empty for none.
    """

    name: str
    visits: tuple[LifeVisit, ...]
    inspections: tuple[Inspection, ...]
    repairs: tuple[tuple[int, str], ...]
    loosening: str = ""


@dataclass
class JudgedLife:
    """What one life says; by name of a figure (right, of how many), and what is compared over all lives.

    Parameters
    ----------
    counts : dict of str to (int, int)
    losses : dict of str to list of float
        -ln P of what is true of each joint at each visit, of the filter and of single answers.
    unworn : dict of str to list of float
        Largest P(worn) of a joint that is not worn, at each visit.
    growing : dict of str to list of (ndarray, ndarray)
        Of each joint that wears, up to its repair: P(worn) and true clearance [m] at each visit from its first wear on.
    """

    counts: dict[str, tuple[int, int]] = field(default_factory=dict)
    losses: dict[str, list[float]] = field(default_factory=lambda: {"filter": [], "single": []})
    unworn: dict[str, list[float]] = field(default_factory=lambda: {"filter": [], "single": []})
    growing: dict[str, list[tuple[np.ndarray, np.ndarray]]] = field(
        default_factory=lambda: {"filter": [], "single": []}
    )

    def count(self, name: str, right: bool) -> None:
        """Count one case."""
        before, of = self.counts.get(name, (0, 0))
        self.counts[name] = before + bool(right), of + 1


@dataclass(frozen=True)
class LifeFigure:
    """A figure with its 95 % interval over lives (percentiles of 2000 draws of as many lives, with replacement).

    Parameters
    ----------
    name : str
    value : float
    interval : (float, float)
    right, of : int
        Of shares; 0 for other figures.
    """

    name: str
    value: float
    interval: tuple[float, float]
    right: int = 0
    of: int = 0

    def shown(self) -> tuple[str, str, str]:
        """Return name, value and interval as text."""
        seen = f"{self.right} of {self.of}, {self.value:.2f}" if self.of else f"{self.value:.3g}"
        return self.name, seen, "{:.2g} to {:.2g}".format(*self.interval)


def judge_life(life: Life, bounds: Mapping[str, JointBounds]) -> JudgedLife:
    """Follow a machine over its life, and compare with the truth at every visit.

    Joints between fit and least wear are neither worn nor not: they are left out where that is asked.
    """
    judged = JudgedLife()
    heard = [visit for visit in life.visits if visit.answer is not None]
    judged.counts["visits answered"] = (len(heard), len(life.visits))
    if not heard:
        return judged
    state = _followed(heard, life.inspections, bounds)
    _judge_visits(judged, life, heard, state, bounds)
    _judge_growth(judged, life, heard, state, bounds)
    _judge_end(judged, life, heard[-1], state, bounds)
    _judge_repairs(judged, life, heard, bounds)
    _judge_dates(judged, life, heard, bounds)
    arrived = sorted((place, visit) for visit in heard for place in visit.arrivals)  # places differ
    again = _followed([visit for _, visit in arrived], tuple(reversed(life.inspections)), bounds)
    judged.count("late and doubled files change nothing", again == state)
    return judged


def _followed(
    visits: Sequence[LifeVisit], inspections: Sequence[Inspection], bounds: Mapping[str, JointBounds]
) -> WearState:
    heard = [Visit(visit.at, visit.sha256, visit.answer) for visit in visits if visit.answer is not None]
    return follow(heard, inspections, bounds=bounds)


def _is_worn(clearance: float, bounds: JointBounds) -> bool | None:
    """Whether so much is wear; None between fit and least wear."""
    return True if clearance >= bounds.worn_from else False if clearance <= bounds.fit[1] else None


def _judge_visits(
    judged: JudgedLife, life: Life, heard: Sequence[LifeVisit], state: WearState, bounds: Mapping[str, JointBounds]
) -> None:
    """Intervals, log-loss, and what joints that are not worn look like."""
    fresh = {(life.visits[place].at, joint) for place, joint in life.repairs}
    for place, visit in enumerate(heard):
        highest = {"filter": 0.0, "single": 0.0}
        for joint, limits in bounds.items():
            point, alone = state.joints[joint].course[place], _alone(visit).joints[joint]
            clearance = visit.clearances[joint]
            is_worn = _is_worn(clearance, limits)
            if is_worn is None:
                continue
            for name, p_worn in (("filter", point.p_worn), ("single", alone.p_worn)):
                judged.losses[name].append(-math.log(max(p_worn if is_worn else 1.0 - p_worn, 1e-6)))
                if not is_worn:
                    highest[name] = max(highest[name], p_worn)
            if is_worn:
                um = 1e6 * clearance
                judged.count("90 % interval of worn joints holds: single answer", _within(um, alone.interval_um))
                judged.count("90 % interval of worn joints holds: filter", _within(um, point.interval_um))
                if place and (visit.at, joint) not in fresh:
                    judged.count("90 % interval of the next visit holds", _within(um, point.foretold_um))
        for name, p_worn in highest.items():
            judged.unworn[name].append(p_worn)


def _within(value: float, interval: tuple[float, float]) -> bool:
    return interval[0] <= value <= interval[1]


def _judge_growth(
    judged: JudgedLife, life: Life, heard: Sequence[LifeVisit], state: WearState, bounds: Mapping[str, JointBounds]
) -> None:
    """What joints look like from their first wear on, up to a repair."""
    for joint, limits in bounds.items():
        ends = [life.visits[place].at for place, repaired in life.repairs if repaired == joint]
        places = [
            place
            for place, visit in enumerate(heard)
            if (not ends or visit.at < ends[0]) and visit.clearances[joint] >= limits.worn_from
        ]
        if not places:
            continue
        true = np.array([heard[place].clearances[joint] for place in places])
        by_filter = np.array([state.joints[joint].course[place].p_worn for place in places])
        alone = np.array([_alone(heard[place]).joints[joint].p_worn for place in places])
        judged.growing["filter"].append((by_filter, true))
        judged.growing["single"].append((alone, true))


def _alone(visit: LifeVisit) -> Answer:
    found = visit.alone or visit.answer
    assert found is not None
    return found


def _judge_end(
    judged: JudgedLife, life: Life, last: LifeVisit, state: WearState, bounds: Mapping[str, JointBounds]
) -> None:
    """Which joints are worn at the last visit, and what else is the matter."""
    true = {joint: _is_worn(last.clearances[joint], limits) for joint, limits in bounds.items()}
    by_filter = {joint: state.joints[joint].p_worn for joint in bounds}
    alone = {joint: _alone(last).joints[joint].p_worn for joint in bounds}
    for name, said in (("filter", by_filter), ("single answer", alone)):
        right = all(true[joint] in (None, p_worn >= 0.5) for joint, p_worn in said.items())
        judged.count(f"worn joints exactly right at the last visit: {name}", right)
    likely = {name: cause for name, cause in state.causes.items() if cause.probability >= 0.5}
    if not life.loosening:
        judged.count("a cause told where there is none", bool(likely))
        come = any(cause.since_baseline for cause in likely.values())
        judged.count("a cause told to have come since the baseline where none has", come)
        return
    calm = all(by_filter[joint] < 0.5 for joint, is_worn in true.items() if is_worn is False)
    found = likely.get(life.loosening)
    judged.count("loosening mount: no joint called worn that is not", calm)
    judged.count("loosening mount: named", found is not None)
    judged.count("loosening mount: told from wear", calm and found is not None and found.per_year < 0.0)


def _judge_repairs(
    judged: JudgedLife, life: Life, heard: Sequence[LifeVisit], bounds: Mapping[str, JointBounds]
) -> None:
    """Repairs of which the filter is not told, and those that there were not."""
    for place, joint in life.repairs:
        since = life.visits[place].at
        later = [number for number, visit in enumerate(heard) if visit.at >= since][:SEEN_WITHIN]
        if not later:
            continue
        told = _followed(heard[: later[-1] + 1], (), bounds).repairs
        judged.count("repairs seen within two visits", any(r.joint == joint and r.at >= since for r in told))
    true = {(joint, life.visits[place].at) for place, joint in life.repairs}
    told = _followed(heard, (), bounds).repairs
    false = [each for each in told if not any(each.joint == joint and each.at >= at for joint, at in true)]
    judged.count("lives with a repair told that there was not", bool(false))


def _judge_dates(judged: JudgedLife, life: Life, heard: Sequence[LifeVisit], bounds: Mapping[str, JointBounds]) -> None:
    """Dates of reaching the limit, as foretold at every visit from the first wear on until it is reached."""
    states: dict[int, WearState] = {}
    for joint, limits in bounds.items():
        over = next((n for n, visit in enumerate(life.visits) if visit.clearances[joint] >= limits.limit), 0)
        repaired = min((place for place, each in life.repairs if each == joint), default=len(life.visits))
        if not 0 < over < repaired:
            continue
        before, after = life.visits[over - 1], life.visits[over]
        low, high = before.clearances[joint], after.clearances[joint]
        reached = before.at + (after.at - before.at) * ((limits.limit - low) / (high - low))
        for place, visit in enumerate(heard):
            if visit.at < reached and visit.clearances[joint] >= limits.worn_from:
                if place not in states:
                    known = [found for found in life.inspections if found.at <= visit.at]
                    states[place] = _followed(heard[: place + 1], known, bounds)
                early, _, late = states[place].joints[joint].limit_at
                holds = early is not None and early <= reached and (late is None or reached <= late)
                judged.count("date of reaching the limit: 90 % interval holds", holds)


def figures_of_lives(lives: Sequence[JudgedLife]) -> tuple[LifeFigure, ...]:
    """Return all figures, each with its interval over lives."""
    names = dict.fromkeys(name for life in lives for name in life.counts)
    found = []
    for name in names:
        right, of = (sum(life.counts.get(name, (0, 0))[k] for life in lives) for k in (0, 1))
        found.append(LifeFigure(name, right / of if of else math.nan, _spread(lives, partial(_share, name)), right, of))
    for figure, value in (
        ("log-loss of P(worn): filter", partial(_loss, "filter")),
        ("log-loss of P(worn): single answer", partial(_loss, "single")),
        ("first sure detection, clearance filter / single, median", ratio_of_detection),
        ("the same of whoever is sure at the first visit of wear", least_ratio_of_detection),
        ("first sure detection, filter, um, median", partial(_median_detected, "filter")),
        ("first sure detection, single answer, um, median", partial(_median_detected, "single")),
    ):
        found.append(LifeFigure(figure, value(lives), _spread(lives, value)))
    return tuple(found)


def _spread(lives: Sequence[JudgedLife], value: Callable[[Sequence[JudgedLife]], float]) -> tuple[float, float]:
    draw = np.random.default_rng(1)
    drawn = [value([lives[k] for k in draw.integers(len(lives), size=len(lives))]) for _ in range(_RESAMPLED)]
    kept = np.sort([each for each in drawn if not math.isnan(each)])
    if not len(kept):
        return math.nan, math.nan
    return float(kept[int(0.025 * len(kept))]), float(kept[int(0.975 * (len(kept) - 1))])


def _share(name: str, lives: Sequence[JudgedLife]) -> float:
    right, of = (sum(life.counts.get(name, (0, 0))[k] for life in lives) for k in (0, 1))
    return right / of if of else math.nan


def _loss(name: str, lives: Sequence[JudgedLife]) -> float:
    found = [each for life in lives for each in life.losses[name]]
    return float(np.mean(found)) if found else math.nan


def detected(name: str, lives: Sequence[JudgedLife]) -> list[float]:
    """Return the clearance [m] at which each joint that wears is first surely so; infinite where it never is.

    Sure is a P(worn) that one in 200 visits exceeds in a joint that is not worn.
    """
    calm = np.sort([each for life in lives for each in life.unworn[name]])
    threshold = calm[len(calm) - 1 - int(FALSE_ALARMS * len(calm))] if len(calm) else 0.0
    found = []
    for p_worn, true in (each for life in lives for each in life.growing[name]):
        over = np.flatnonzero(p_worn > threshold)
        found.append(float(true[over[0]]) if len(over) else math.inf)
    return found


def ratio_of_detection(lives: Sequence[JudgedLife]) -> float:
    """Return the median of the clearance at which the filter is first sure to that at which a single answer is.

    Joints that neither is ever sure of are left out; 0 and infinite count where only one of them is.
    """
    return _ratio(detected("filter", lives), detected("single", lives))


def least_ratio_of_detection(lives: Sequence[JudgedLife]) -> float:
    """Return what that median would be, were the filter sure at the first visit at which a joint is worn at all.

    It cannot be sure before. The smaller the wear that single answers are sure of, and the fewer the visits, the nearer
    it is to one; joints of which they never are count 0.
    """
    first = [float(true[0]) for life in lives for _, true in life.growing["single"]]
    return _ratio(first, detected("single", lives))


def _ratio(clearances: Sequence[float], alone: Sequence[float]) -> float:
    """The median of ratios; of joints of which nothing is ever sure there are none."""
    ratios = [
        0.0 if math.isinf(single) else clearance / single
        for clearance, single in zip(clearances, alone, strict=True)
        if not (math.isinf(clearance) and math.isinf(single))
    ]
    return float(np.median(ratios)) if ratios else math.nan


def _median_detected(name: str, lives: Sequence[JudgedLife]) -> float:
    found = detected(name, lives)
    return 1e6 * float(np.median(found)) if found else math.nan
