"""The machine as its past tells it, simulated once for all recordings of it to come: effort thorough with a baseline.

What recordings of the machine in order have told - its load, ripple, frame and mounts - is in all of its cases. They
lie over all clearances and about a speed of the catalogue, on days on which mounts are warm or cold and one may have
come loose, so that the next recording finds them again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from operator import add

from jointplay.catalogue.diagnosing.as_found import (
    Refined,
    answer_by,
    blend_found,
    networks_of,
    sets_to_simulate,
    settled,
    with_prior,
)
from jointplay.catalogue.diagnosing.found_cases import counting, draw_cases
from jointplay.catalogue.diagnosing.found_spectra import FoundSpectra
from jointplay.catalogue.diagnosing.kept_cases import simulate_once
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.loose_mounts import name_loose_mount
from jointplay.catalogue.diagnosing.told_numbers import CASES
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import Observed
from jointplay.catalogue.matching.modes import ModeAsked
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.plans.plan_parts import SPEED
from jointplay.catalogue.storage.store import Catalogue

KNOWN_SETS = 16
"""Sets of joints that are simulated, at most: all of a machine with four joints."""

TOLD_BY = 4
"""The likeliest sets, whose cases tell whether a mount is loose: at eight visits of a slider-crank with one below 0.65
four named it at all, 0.03 off in the mean, two at seven; four take 2.3 s of a core, two 0.5, eight 15."""

LEAST_CASES = 576
"""Cases of a set, at least: 0.76 of the held-out ones with two worn joints come first, where answers learn from 192 of
a set 0.60 (docs/decisions/0215)."""


def refine_known(
    observed: Observed,
    catalogue: Catalogue,
    result: MatchResult,
    candidates: Sequence[str],
    known: KnownMachine,
    *,
    is_otherwise: bool,
    mode: ModeAsked = "auto",
    prior: Prior | None = None,
    cases: int,
    progress: Callable[[int, int], None] | None = None,
) -> Refined | None:
    """Match a recording with simulations of its machine as recordings of it in order have told it.

    Parameters
    ----------
    observed : Observed
    catalogue : Catalogue
    result : MatchResult
        The catalogue's own answer.
    candidates : sequence of str
        Labels of its candidate set.
    known : KnownMachine
    is_otherwise : bool
        Whether the recording differs from those: only then a mount that has come loose is looked for.
    mode, prior
        As for :func:`~jointplay.catalogue.diagnosing.as_found.refine`.
    cases : int
        How many are simulated, of all sets together; some of each in any case. Those of the machine in order are more.
    progress : callable, optional
        Called with the number of cases done and their total, where they are simulated.

    Returns
    -------
    Refined or None
        The same for the same arguments, whatever has been simulated before; None where nothing is told, or the
        recording is of no speed of the catalogue.
    """
    if reason := settled(result, candidates, mode):
        return Refined(result, 0, 0, reason)
    nominal = catalogue.recipe.nominal_drive_speed
    factor = 1.0 if observed.speed is None else catalogue.matrix.nearest_speed(observed.speed)
    if observed.speed is not None and not SPEED[0] <= observed.speed / (factor * abs(nominal)) <= SPEED[1]:
        return None
    load, numbers = known.tell(catalogue, progress)
    if numbers is None:
        return None
    speed = factor * nominal
    sets = sorted(match.joints for match in sets_to_simulate(result, KNOWN_SETS))
    count = max(LEAST_CASES, cases // len(sets))
    machine, drawn = draw_cases(catalogue, speed, sets, load, count, doubted=True, told=numbers, to_come=True)
    by_set = [[entry for entry in drawn if entry.worn == joints] for joints in sets]
    simulated: list[FoundSpectra] = []
    done = 0
    for each in by_set:
        simulated.append(simulate_once(catalogue, machine, each, counting(progress, done, len(drawn))))
        done += len(each)
    if any(len(each.entries) < LEAST_CASES // 2 for each in simulated):
        return Refined(result, len(drawn), 1, "some hypotheses could not be simulated, so that nothing changes")
    every = reduce(add, simulated)
    networks = networks_of(every, observed, catalogue.layout.machines)
    found = with_prior(answer_by(every, observed, mode, networks), result, prior or Prior(), len(every.joints))
    refined = blend_found(result, found, every, len(drawn), load, told=True)
    if refined.told and is_otherwise:
        likeliest = [match.label for match in found.hypotheses[:TOLD_BY]]
        refined = replace(refined, cause=name_loose_mount(machine, every, observed, likeliest))
    reason = f"{refined.reason}; numbers by {CASES} cases of the machine in order"
    return replace(refined, generations=1, reason=reason)
