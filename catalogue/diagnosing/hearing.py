"""What one recording says: matched, looked at for other causes, simulated anew where that is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from jointplay.catalogue.diagnosing.answer import EffortSpent, Verdict
from jointplay.catalogue.diagnosing.as_found import refine
from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.comparison import beside_past, exact_sensing, features_of, watched_levels
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.past import PastComparison, compare_with_past
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.verdict import OTHERWISE_BELOW, SURE_ABOVE, find_causes, judge, needs_cause
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import DOUBTED_BELOW, ModelLibrary, Observed, one_thread
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import with_filed_suspension
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Heard:
    """What one recording says.

    Parameters
    ----------
    prepared : PreparedMeasurement
        As it was compared.
    sha256 : str
        Of the recording.
    sensing : Sensing
    feature : ndarray, shape (d,)
    result : MatchResult
        Posterior of what is worn.
    causes : tuple of NamedCause
        Other than play, the most probable first.
    p_value : float
    verdict : Verdict
    spent : EffortSpent
    known : KnownMachine, optional
        What a recording of the machine in order has shown.
    weighed : bool
        Whether entries counted by how near they are to that.
    past : PastComparison, optional
        The recording beside those of the machine in order.
    """

    prepared: PreparedMeasurement
    sha256: str
    sensing: Sensing
    feature: FloatArray
    result: MatchResult
    causes: tuple[NamedCause, ...]
    p_value: float
    verdict: Verdict
    spent: EffortSpent
    known: KnownMachine | None = None
    weighed: bool = False
    past: PastComparison | None = None


def hear(
    prepared: PreparedMeasurement,
    sha256: str,
    catalogue: Catalogue,
    question: Question,
    library: ModelLibrary,
    *,
    known: KnownMachine | None = None,
    without: tuple[str, ...] = (),
    most: int | None = None,
) -> Heard:
    """Return what a recording says that has been prepared; arguments as for
    :func:`~jointplay.catalogue.diagnosing.diagnosis.answer`.
    """
    weights, past = None, None
    earlier: list[PreparedMeasurement] = []
    before: list[PreparedMeasurement] = []
    if known:
        if not prepared.flaws:
            with one_thread():
                past = compare_with_past(prepared, known.past, catalogue)
        earlier = [known.baseline.correct(each, catalogue.machine) for each in known.past]
        if library.hears_past(exact_sensing(prepared), prepared.drive_speed):
            speed = catalogue.matrix.nearest_speed(prepared.drive_speed)
            before = [each for each in earlier if catalogue.matrix.nearest_speed(each.drive_speed) == speed]
        prepared = known.baseline.correct(prepared, catalogue.machine)
        if beside_past(prepared, before) is None:
            before = []
        # A recording that was converted is of the machine file's frame and supports: no entries are nearer to it.
        if not before and all(step.name != "suspension" for step in prepared.steps):
            weights = known.weights(catalogue)
    p_since = past.p_value if past else None
    is_otherwise = p_since is not None and p_since < OTHERWISE_BELOW
    look = partial(
        _match, before=before, catalogue=catalogue, library=library, question=question, without=without, most=most
    )
    sensing, feature, result = look(prepared, weights)
    causes: tuple[NamedCause, ...] = ()
    if not prepared.flaws and (question.effort != "fast" or needs_cause(result) or is_otherwise):
        with one_thread():
            causes = find_causes(prepared, catalogue, result, past, earlier)
    p_value, verdict = judge(result, question.coverage, causes, prepared.flaws, p_since)
    if causes and causes[0].suspension:
        # Seen as if its frame stood as the file says, a machine shows whether it is worn as well.
        seen = with_filed_suspension(prepared, catalogue.machine, causes[0].suspension)
        other_sensing, other_feature, other = look(seen, None)
        if (other.trusted_p_value or 0.0) > (result.trusted_p_value or 0.0) and not needs_cause(other):
            prepared, sensing, feature, result = seen, other_sensing, other_feature, other
            p_value, verdict = judge(other, question.coverage)
            verdict = verdict if verdict == "worn" and other.p_worn >= SURE_ABOVE else "changed"
    spent = EffortSpent(simulations=0, generations=0, note="")
    if question.effort == "thorough" and library.simulates_anew:
        is_loaded = bool(causes) and causes[0].name.startswith("load")
        if prepared.flaws:
            spent = EffortSpent(simulations=0, generations=0, note="the sensors contradict each other")
        elif causes and not is_loaded and (known is None or not needs_cause(result) or result.p_worn <= 0.5):
            spent = EffortSpent(simulations=0, generations=0, note="the machine is not as its file says")
        elif weights is not None:
            note = "the baseline says more of the machine's numbers than its file, which is simulated"
            spent = EffortSpent(simulations=0, generations=0, note=note)
        else:
            # A load that has come since, the machine in order has not shown. What else is named beside wear it may have
            # had, too little of it to be named: how well that then explains the recording says so.
            own = {"tell": partial(known.tell, catalogue)} if known and not is_loaded else {}
            refined = refine(
                prepared,
                Observed(sensing, feature, watched_levels(prepared), prepared.drive_speed),
                catalogue,
                result,
                result.set(question.coverage).labels,
                mode=question.mode,
                prior=question.prior,
                cases=question.cases,
                **own,
            )
            # What a machine has always had, which its file has not, is neither a cause nor a change.
            is_as_it_was = p_since is not None and not is_otherwise
            was_changed, p_before = needs_cause(result) and not is_as_it_was, result.trusted_p_value
            was_worn, result = result.p_worn > 0.5, refined.result
            is_its_own = refined.told and not refined.load and not needs_cause(result)
            if is_as_it_was:
                # Nor is what was looked for beside wear that is none.
                causes = () if was_worn and result.p_worn <= 0.5 else causes
            elif refined.load:
                causes = (refined.load,)
            elif is_its_own and (p_since is None or result.p_worn > 0.5):
                causes = ()
            spent = EffortSpent(simulations=refined.simulations, generations=refined.generations, note=refined.reason)
            if refined.simulations:
                p_value, verdict = judge(result, question.coverage, causes, p_since=p_since)
                is_explained = is_its_own and p_since is None
                if was_changed and not is_explained and not (verdict == "worn" and result.p_worn >= SURE_ABOVE):
                    # With a load that neither file nor past has it is not in order, however well that explains it.
                    verdict = "unknown" if verdict == "unknown" else "changed"
                elif p_before is not None and p_before < DOUBTED_BELOW and verdict == "worn":
                    verdict = "worn" if result.p_worn >= SURE_ABOVE else "unknown"  # as without the simulation
    weighed = weights is not None
    return Heard(prepared, sha256, sensing, feature, result, causes, p_value, verdict, spent, known, weighed, past)


def _match(
    prepared: PreparedMeasurement,
    weights: FloatArray | None,
    *,
    before: Sequence[PreparedMeasurement],
    catalogue: Catalogue,
    library: ModelLibrary,
    question: Question,
    without: tuple[str, ...],
    most: int | None,
) -> tuple[Sensing, FloatArray, MatchResult]:
    """How a recording is seen, its features, and what the catalogue says of them beside those of the machine before."""
    sensing = exact_sensing(prepared)
    feature = features_of(prepared, sensing)
    asked, shown = beside_past(prepared, before) or (sensing, feature)
    result = library.answer(
        asked,
        shown,
        watched_levels(prepared),
        question.effort,
        question.mode,
        speed=prepared.drive_speed,
        weights=weights,
        without=without,
        most=most,
    )
    return sensing, feature, question.prior.apply(result, len(catalogue.matrix.joints))
