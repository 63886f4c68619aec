"""What one recording says: matched, looked at for other causes, simulated anew where that is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.comparison import beside_past, exact_sensing, features_of, watched_levels
from jointplay.catalogue.diagnosing.heard import Heard
from jointplay.catalogue.diagnosing.hearing_anew import hear_anew
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.past import PastComparison, compare_with_past
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.verdict import OTHERWISE_BELOW, SURE_ABOVE, find_causes, judge, needs_cause
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import ModelLibrary, one_thread
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.suspension import with_filed_suspension
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray

Seen: TypeAlias = tuple[Sensing, FloatArray, MatchResult]
"""How a recording is seen, its features (d,), and what the catalogue says of them."""


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
    before = _Before.of(prepared, known, catalogue, library)

    def look(seen: PreparedMeasurement, weights: FloatArray | None = None) -> Seen:
        sensing = exact_sensing(seen)
        feature = features_of(seen, sensing)
        asked, shown = beside_past(seen, before.beside) or (sensing, feature)
        result = library.answer(
            asked,
            shown,
            watched_levels(seen),
            question.effort,
            question.mode,
            speed=seen.drive_speed,
            weights=weights,
            without=without,
            most=most,
        )
        return sensing, feature, question.prior.apply(result, len(catalogue.matrix.joints))

    prepared = before.recording
    sensing, feature, result = look(prepared, before.weights)
    causes: tuple[NamedCause, ...] = ()
    p_since = before.comparison.p_value if before.comparison else None
    is_otherwise = p_since is not None and p_since < OTHERWISE_BELOW
    if not prepared.flaws and (question.effort != "fast" or needs_cause(result) or is_otherwise):
        with one_thread():
            causes = find_causes(prepared, catalogue, result, before.comparison, before.earlier)
    p_value, verdict = judge(result, question.coverage, causes, prepared.flaws, p_since)
    heard = Heard(
        prepared,
        sha256,
        sensing,
        feature,
        result,
        causes,
        p_value,
        verdict,
        known=known,
        weighed=before.weights is not None,
        past=before.comparison,
    )
    if causes and causes[0].suspension:
        heard = _as_filed(heard, causes[0].suspension, look, catalogue, question)
    if question.effort == "thorough" and library.simulates_anew:
        heard = hear_anew(heard, catalogue, question)
    return heard


@dataclass(frozen=True, eq=False)
class _Before:
    """A recording corrected by what is known of its machine, and what there is to hear it beside.

    Parameters
    ----------
    recording : PreparedMeasurement
    comparison : PastComparison or None
        As it was recorded beside those of the machine in order.
    earlier : sequence of PreparedMeasurement
        These, corrected as well.
    beside : sequence of PreparedMeasurement
        Those of them that it is heard with, as the catalogue has machines at two times.
    weights : ndarray, shape (n,), optional
        How much each entry is of this machine, where it is heard by itself.
    """

    recording: PreparedMeasurement
    comparison: PastComparison | None = None
    earlier: Sequence[PreparedMeasurement] = ()
    beside: Sequence[PreparedMeasurement] = ()
    weights: FloatArray | None = None

    @classmethod
    def of(
        cls, prepared: PreparedMeasurement, known: KnownMachine | None, catalogue: Catalogue, library: ModelLibrary
    ) -> _Before:
        """That of a recording as it was prepared."""
        if not known:
            return cls(prepared)
        comparison = None
        if not prepared.flaws:
            with one_thread():
                comparison = compare_with_past(prepared, known.past, catalogue)
        earlier = [known.baseline.correct(each, catalogue.machine) for each in known.past]
        beside = []
        if library.hears_past(exact_sensing(prepared), prepared.drive_speed):
            speed = catalogue.matrix.nearest_speed(prepared.drive_speed)
            beside = [each for each in earlier if catalogue.matrix.nearest_speed(each.drive_speed) == speed]
        recording = known.baseline.correct(prepared, catalogue.machine)
        if beside_past(recording, beside):
            return cls(recording, comparison, earlier, beside)
        # A recording that was converted is of the machine file's frame and supports: no entries are nearer to it.
        is_converted = any(step.name == "suspension" for step in recording.steps)
        return cls(recording, comparison, earlier, weights=None if is_converted else known.weights(catalogue))


def _as_filed(
    heard: Heard,
    suspension: Mapping[str, float],
    look: Callable[[PreparedMeasurement], Seen],
    catalogue: Catalogue,
    question: Question,
) -> Heard:
    """What is heard as if its frame stood as the file says, where that explains more: its wear is seen as well then."""
    prepared = with_filed_suspension(heard.prepared, catalogue.machine, suspension)
    sensing, feature, result = look(prepared)
    if (result.trusted_p_value or 0.0) <= (heard.result.trusted_p_value or 0.0) or needs_cause(result):
        return heard
    p_value, verdict = judge(result, question.coverage)
    is_surely_worn = verdict == "worn" and result.p_worn >= SURE_ABOVE
    return replace(
        heard,
        prepared=prepared,
        sensing=sensing,
        feature=feature,
        result=result,
        p_value=p_value,
        verdict="worn" if is_surely_worn else "changed",
        as_recorded=heard,
    )
