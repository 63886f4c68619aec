"""Causes other than play over a machine's life: whether one is there, since when, and how its size moves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np

from jointplay.catalogue.diagnosing.answer import Answer, Cause
from jointplay.catalogue.following.play import YEAR
from jointplay.catalogue.following.state import CauseFollowed

COMES, GOES = 0.1 / YEAR, 0.05 / YEAR
"""How often a cause comes, and goes, 1/s."""

USUAL = COMES / (COMES + GOES)
"""Probability of a cause of which nothing was heard for long."""

LEAST_SPAN = 7.0 / 365.25
"""Years over which a size's course is told at least."""

THERE_AT_FIRST = 0.05
"""Probability beforehand."""

LEAST_SAID, MOST_SAID = 0.25, 30.0
"""How much likelier a recording makes a cause, at least, where it does not name it, and at most."""


def follow_causes(answers: Sequence[tuple[datetime, Answer]]) -> Mapping[str, CauseFollowed]:
    """Return the causes that some answer names, by what all of them say, in the order of time."""
    named = dict.fromkeys(cause.name for _, answer in answers for cause in answer.causes)
    return {name: _follow(name, answers) for name in named}


def _follow(name: str, answers: Sequence[tuple[datetime, Answer]]) -> CauseFollowed:
    there, before = THERE_AT_FIRST, None
    since: datetime | None = None
    told: list[tuple[datetime, Cause]] = []
    for at, answer in answers:
        passed = (at - before).total_seconds() if before else 0.0
        # Of two states, after long with what is usual, which is below a half where a recording does not name it.
        there = USUAL + (there - USUAL) * math.exp(-(COMES + GOES) * passed)
        before = at
        said = next((cause for cause in answer.causes if cause.name == name), None)
        share = min(said.probability, 1.0 - 1e-9) if said else 0.0
        likelier = min(max(share / (1.0 - share), LEAST_SAID), MOST_SAID)
        there = there * likelier / (there * likelier + 1.0 - there)
        if said:
            told.append((at, said))
        since = since or at if there > 0.5 else None
    lately = [(at, cause) for at, cause in told if since is None or at >= since]
    times = np.array([(at - lately[-1][0]).total_seconds() / YEAR for at, _ in lately])
    sizes = np.array([cause.size for _, cause in lately])
    if len(lately) < 3 or np.ptp(times) < LEAST_SPAN:
        slope, size = 0.0, float(np.median(sizes))
    else:
        slope, size = np.polyfit(times, sizes, 1, w=np.sqrt([cause.probability for _, cause in lately])).tolist()
    last = lately[-1][1]
    return CauseFollowed(
        unit=last.unit, probability=there, size=size, per_year=slope, since=since, since_baseline=last.since
    )
