"""What one recording says beside simulations of its machine as found: effort thorough."""

from __future__ import annotations

from dataclasses import replace

from jointplay.catalogue.diagnosing.answer import EffortSpent
from jointplay.catalogue.diagnosing.as_found import Refined, refine
from jointplay.catalogue.diagnosing.as_known import refine_known
from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.comparison import watched_levels
from jointplay.catalogue.diagnosing.heard import Heard
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.verdict import SURE_ABOVE, judge, needs_cause
from jointplay.catalogue.matching.model_library import Observed
from jointplay.catalogue.storage.store import Catalogue


def hear_anew(heard: Heard, catalogue: Catalogue, question: Question) -> Heard:
    """Return what a recording says beside simulations of its machine as found.

    Parameters
    ----------
    heard : Heard
        What it says without.
    catalogue : Catalogue
    question : Question

    Returns
    -------
    Heard
        The same, with the reason, where simulations could not change it.
    """
    if heard.prepared.flaws:
        spent = EffortSpent(simulations=0, generations=0, note="the sensors contradict each other")
        return replace(heard, spent=spent)
    refined = _simulate(heard, catalogue, question)
    spent = EffortSpent(simulations=refined.simulations, generations=refined.generations, note=refined.reason)
    if not refined.simulations:
        return replace(heard, spent=spent)
    result, before = refined.result, heard.result
    # The machine in order has told numbers with which the recording is explained: what was named is its own.
    is_its_own = refined.told and not needs_cause(result)
    causes = _causes(heard, refined, is_its_own)
    p_value, verdict = judge(result, question.coverage, causes, p_since=heard.p_since)
    if (heard.verdict, verdict) == ("worn", "unknown") and result.p_worn >= SURE_ABOVE:
        p_value, verdict = heard.p_value, heard.verdict  # what explained it without still does
    is_surely_worn = verdict == "worn" and result.p_worn >= SURE_ABOVE
    if not is_surely_worn and verdict != "unknown":
        is_explained = heard.is_as_it_was or (is_its_own and heard.past is None)
        if needs_cause(before) and not is_explained:
            # With a load that neither file nor past has it is not in order, however well that explains it.
            verdict = "changed"
        elif verdict == "worn" and before.is_doubted:
            verdict = "unknown"  # as without the simulation
    seen = heard.as_recorded if refined.told and heard.as_recorded else heard
    return replace(
        heard,
        prepared=seen.prepared,
        sensing=seen.sensing,
        feature=seen.feature,
        result=result,
        causes=causes,
        p_value=p_value,
        verdict=verdict,
        spent=spent,
    )


def _simulate(heard: Heard, catalogue: Catalogue, question: Question) -> Refined:
    """The machine as its past tells it, or as the recording shows it where that tells nothing."""
    labels = heard.result.set(question.coverage).labels
    # A load that has come since the machine in order has not shown.
    if heard.known and not _is_loaded(heard):
        refined = refine_known(
            _observed(heard.as_recorded or heard),
            catalogue,
            heard.result,
            labels,
            heard.known,
            is_otherwise=not heard.is_as_it_was,
            mode=question.mode,
            prior=question.prior,
            cases=question.cases,
            progress=question.progress,
        )
        if refined:
            return refined
    if heard.causes and not _is_loaded(heard):
        return Refined(heard.result, 0, 0, "the machine is not as its file says")
    if heard.weighed:
        note = "the baseline says more of the machine's numbers than its file, which is simulated"
        return Refined(heard.result, 0, 0, note)
    return refine(
        heard.prepared,
        _observed(heard),
        catalogue,
        heard.result,
        labels,
        mode=question.mode,
        prior=question.prior,
        cases=question.cases,
        progress=question.progress,
    )


def _observed(heard: Heard) -> Observed:
    """A recording as a library is asked about it."""
    return Observed(heard.sensing, heard.feature, watched_levels(heard.prepared), heard.prepared.drive_speed)


def _is_loaded(heard: Heard) -> bool:
    """Whether a load is what it is likeliest to have beside wear."""
    return bool(heard.causes) and heard.causes[0].name.startswith("load")


def _causes(heard: Heard, refined: Refined, is_its_own: bool) -> tuple[NamedCause, ...]:
    """Causes other than play that stay when the machine as found has been simulated.

    What a machine has always had, which its file has not, is neither a cause nor a change; nor is what was looked for
    beside wear that is none. What it has not had when it was in order stays.
    """
    is_worn, was_worn = refined.result.p_worn > 0.5, heard.result.p_worn > 0.5
    if heard.is_as_it_was:
        return () if was_worn and not is_worn else heard.causes
    if refined.cause:
        # What a search takes for the frame, or for another mount, is this one; forces are not.
        beside = [cause for cause in heard.causes if refined.cause.since and cause.since and not cause.suspension]
        return tuple(sorted((refined.cause, *beside), key=lambda cause: -cause.probability))
    if is_its_own and (is_worn or heard.past is None):
        return tuple(cause for cause in heard.causes if cause.since)
    return heard.causes
