"""Several recordings of one machine in one state: one answer, and what each recording has contributed to it."""

from __future__ import annotations

import math
import statistics
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointplay.catalogue.diagnosing.answer import Diagnosis, EffortSpent, RecordingShare
from jointplay.catalogue.diagnosing.causes import NamedCause
from jointplay.catalogue.diagnosing.heard import Heard
from jointplay.catalogue.diagnosing.hearing import hear
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.past_recordings import (
    InOrder,
    prepare_past,
    recordings_in_order,
    sensors_by_column,
)
from jointplay.catalogue.diagnosing.question import MOST_TOGETHER, Question
from jointplay.catalogue.diagnosing.telling import tell
from jointplay.catalogue.diagnosing.verdict import SURE_ABOVE, judge, needs_cause
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import ModelLibrary, library_of
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.matching.together import Together, match_together
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.signals.speedpieces import Cut, cut_by_speed
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray

CONTRADICTS_BELOW = 0.05
"""A recording that is so much likelier to be of another machine, or of another day of its wear, contradicts."""


def diagnose_together(
    recordings: Sequence[Recording | MeasuredSpectrum],
    catalogue: Catalogue,
    *,
    speeds: Sequence[float | None] | None = None,
    effort: Effort = "standard",
    mode: ModeAsked = "auto",
    mapping: Mapping[str, str] | None = None,
    coverage: float = 0.95,
    cases: int = 2304,
    prior: Prior | None = None,
    limits_um: Mapping[str, float] | None = None,
    baseline: Recording | InOrder | Sequence[Recording | InOrder] | None = None,
    library: ModelLibrary | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Diagnosis:
    """Say which joints are worn, by how much, and how sure that is, from several recordings of one machine.

    The machine is taken to be in the same state in all of them; speeds, loads and sensors may differ.

    Parameters
    ----------
    recordings : sequence of Recording or MeasuredSpectrum
        The same bytes given twice count once. One in which the drive speed changes is cut into pieces about the speeds
        of the catalogue, see :func:`~jointplay.catalogue.signals.speedpieces.cut_by_speed`.
    catalogue : Catalogue
        Of the same machine, best with several speeds.
    speeds : sequence of float or None, optional
        Drive speed of each, rad/s; estimated where it is not given.
    effort, mode, mapping, coverage, cases, prior, limits_um, baseline, library, progress
        As for :func:`~jointplay.catalogue.diagnosing.diagnosis.diagnose`; cases are for each recording.

    Returns
    -------
    Diagnosis

    Raises
    ------
    MeasurementError
        A recording cannot be compared.
    DiagnosisError
        A setting breaks a rule, there are no or too many recordings, one of several is the baseline, or the catalogue
        holds too little.
    """
    question = Question(effort, mode, coverage, cases, prior or Prior(), limits_um or {}, progress)
    question.prior.check(catalogue.matrix.joints)
    given = list(speeds) if speeds is not None else [None] * len(recordings)
    if not 1 <= len(recordings) <= MOST_TOGETHER:
        raise DiagnosisError(f"measurements: {len(recordings)}: must be 1 to {MOST_TOGETHER}")
    if len(given) != len(recordings):
        raise DiagnosisError(f"speed: {len(given)} for {len(recordings)} measurements: must be one for each, or none")
    different = _different(recordings, given)
    columns = {name for recording, _ in different for name in recording.channel_names}
    in_order = recordings_in_order(baseline)
    columns.update(name for each in in_order.values() for name in each.recording.channel_names)

    def own(recording: Recording | MeasuredSpectrum) -> dict[str, str]:
        """A column that only some have is mapped there; one that none has is refused by name."""
        names = recording.channel_names
        return {name: said for name, said in (mapping or {}).items() if name in names or name not in columns}

    scale = (catalogue.scheme, catalogue.recipe.nominal_drive_speed, catalogue.drive_speeds)
    warnings = [f"{len(recordings) - len(different)} given twice: counted once"] * (len(different) < len(recordings))
    for recording, _ in different:
        if in_order.pop(recording.sha256, None):
            if len(different) > 1:
                raise DiagnosisError(f"baseline: {recording.name}: must be none of those that are compared with it")
            warnings.append(f"baseline {recording.name}: is what is diagnosed: left out")
    pieces = []
    for recording, speed in different:
        cut = Cut((recording,))
        if speed is None:
            cut = cut_by_speed(recording, catalogue.machine, catalogue.drive_speeds, own(recording))
            warnings += cut.left_out
        pieces += [
            (prepare(piece, catalogue.machine, own(recording), speed, *scale), piece.sha256) for piece in cut.pieces
        ]
    known = None
    if in_order:
        columns_of_all = [sensors_by_column(recording, catalogue.machine, own(recording)) for recording, _ in different]
        used = {name for prepared, _ in pieces if prepared.sensing.phases for name in prepared.sensing.sensors}
        past, told = prepare_past(in_order, own, columns_of_all, used, catalogue)
        known = KnownMachine.of(past, catalogue) if past else None
        warnings += told
    shelf = library or library_of(catalogue)
    heard = [hear(prepared, sha256, catalogue, question, shelf, known=known) for prepared, sha256 in pieces]
    if len(heard) == 1:
        asks = question.effort != "fast"
        return tell(heard[0], catalogue, question, shelf, mapping=mapping, suggesting=asks, warnings=warnings)
    return conclude(heard, catalogue, question, shelf, mapping=mapping, warnings=warnings)


def conclude(
    heard: Sequence[Heard],
    catalogue: Catalogue,
    question: Question,
    library: ModelLibrary,
    *,
    mapping: Mapping[str, str] | None = None,
    warnings: Sequence[str] = (),
) -> Diagnosis:
    """Return the common answer to what several recordings say, two or more."""
    reasons = _left_out(heard)
    used = [each for each, reason in zip(heard, reasons, strict=True) if not reason]
    speeds = [catalogue.matrix.nearest_speed(each.prepared.drive_speed) for each in used]
    joined = match_together([each.result for each in used], _prior(used[0].result, catalogue, question), speeds)
    causes = _causes(used)
    flaws = used[0].prepared.flaws if all(each.prepared.flaws for each in used) else ()
    # The least of several p-values, by Bonferroni's bound.
    since = [each.past.p_value for each in used if each.past]
    p_since = min(1.0, len(used) * min(since)) if since else None
    p_value, verdict = judge(joined.result, question.coverage, causes, flaws, p_since)
    is_sure = verdict == "worn" and joined.result.p_worn >= SURE_ABOVE
    changed = 2 * sum(each.verdict == "changed" for each in used) - len(used)
    if (changed > 0 and verdict != "unknown" and not is_sure) or (changed == 0 and verdict == "in_order"):
        # Each alone is never in order, and worn only where that is nearly sure: nor are they together. But a load that
        # one of two has may have held shut what the other shows.
        verdict = "changed"
    together = replace(
        used[0],
        result=joined.result,
        past=min((each.past for each in used if each.past), key=lambda past: past.p_value, default=None),
        causes=causes,
        p_value=p_value,
        verdict=verdict,
        spent=EffortSpent(
            simulations=sum(each.spent.simulations for each in heard),
            generations=max(each.spent.generations for each in heard),
            note="; ".join(dict.fromkeys(each.spent.note for each in heard if each.spent.note)),
        ),
    )
    shares = _shares(heard, reasons, joined)
    told = [
        *warnings,
        *(f"{each.prepared.name}: {line}" for each in heard if each is not used[0] for line in each.prepared.warnings),
    ]
    told += [f"{share.measurement}: left out: {share.left_out}" for share in shares if share.left_out]
    told += [
        f"{share.measurement}: contradicts the others: alone it says {share.alone}, they say {share.without}"
        for share in shares
        if share.contradicts
    ]
    for share in shares:
        if share.held_shut and not share.contradicts:
            worn = " and ".join(share.held_shut)
            told.append(
                f"{share.measurement}: looks to have {worn} in order; it agrees if a load held {worn} shut, not if it"
                " was made before the wear or after a repair: then diagnose it apart from the others"
            )
    return tell(
        together,
        catalogue,
        question,
        library,
        mapping=mapping,
        suggesting=question.effort != "fast",
        others=[each.prepared for each in used[1:]],
        recordings=shares,
        warnings=told,
        said=[[each.sha256, each.prepared.drive_speed, list(each.prepared.notes)] for each in heard],
    )


def _different(
    recordings: Sequence[Recording | MeasuredSpectrum], speeds: Sequence[float | None]
) -> list[tuple[Recording | MeasuredSpectrum, float | None]]:
    """Recordings with their speeds, each once."""
    found: dict[str, tuple[Recording | MeasuredSpectrum, float | None]] = {}
    for recording, speed in zip(recordings, speeds, strict=True):
        first, its_speed = found.setdefault(recording.sha256, (recording, speed))
        if (first.channels, its_speed) != (recording.channels, speed) or not np.array_equal(
            _values(first), _values(recording)
        ):
            rule = "is given twice, and something else is said of it: give it once"
            raise DiagnosisError(f"measurements: {recording.name}: {rule}")
    return list(found.values())


def _values(recording: Recording | MeasuredSpectrum) -> FloatArray:
    return recording.signal if isinstance(recording, Recording) else recording.density


def _left_out(heard: Sequence[Heard]) -> list[str]:
    """Why each recording is left out, empty where it counts: where others are explained, it is not."""
    reasons = [
        "its sensors contradict each other"
        if each.prepared.flaws
        else "no state of the machine explains it"
        if needs_cause(each.result)
        else ""
        for each in heard
    ]
    sound = sum(not reason and not each.result.is_doubted for each, reason in zip(heard, reasons, strict=True))
    # What most recordings have is of the machine, not of a recording.
    if 2 * sound <= len(heard):
        flawed = [reason if each.prepared.flaws else "" for each, reason in zip(heard, reasons, strict=True)]
        return flawed if not all(flawed) else [""] * len(heard)
    return reasons


def _prior(result: MatchResult, catalogue: Catalogue, question: Question) -> FloatArray:
    most = max(len(match.joints) for match in result.hypotheses)
    count = len(catalogue.matrix.joints)
    return np.array([question.prior.weight(match.joints, count, most) for match in result.hypotheses])


def _causes(heard: Sequence[Heard]) -> tuple[NamedCause, ...]:
    """Causes that half of the recordings or more name, of the mean of their probabilities, the most probable first."""
    found: dict[str, list[NamedCause]] = defaultdict(list)
    for each in heard:
        for cause in {cause.name: cause for cause in reversed(each.causes)}.values():
            found[cause.name].append(cause)
    joined = [
        replace(
            named[0],
            size=statistics.median(cause.size for cause in named),
            probability=math.fsum(cause.probability for cause in named) / len(heard),
            since=2 * sum(cause.since for cause in named) > len(named),
        )
        for named in found.values()
        if 2 * len(named) >= len(heard)
    ]
    return tuple(sorted(joined, key=lambda cause: -cause.probability))


def _shares(heard: Sequence[Heard], reasons: Sequence[str], joined: Together) -> list[RecordingShare]:
    """What each recording has contributed."""
    shares, used = [], 0
    for each, reason in zip(heard, reasons, strict=True):
        counts = not reason
        # What was left out changes nothing: without it the answer is the same.
        best = joined.result.best
        without, p_without = joined.without[used] if counts else (best.label, best.probability)
        likelier = math.exp(min(joined.for_one_machine[used], 50.0)) if counts else 1.0
        shares.append(
            RecordingShare(
                measurement=each.prepared.name,
                sha256=each.sha256,
                drive_speed_rpm=each.prepared.drive_speed * 30.0 / math.pi,
                alone=each.result.best.label,
                p_alone=min(1.0, each.result.best.probability),
                verdict=each.verdict,
                weight=float(joined.weights[used]) if counts else 0.0,
                without=without,
                p_without=min(1.0, p_without),
                one_machine=likelier,
                contradicts=likelier < CONTRADICTS_BELOW,
                left_out=reason,
                held_shut=joined.held_shut[used] if counts else (),
            )
        )
        used += counts
    return shares
