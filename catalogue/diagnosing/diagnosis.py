"""From a recording and a catalogue to ranked hypotheses, with how sure, how well they fit, and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from jointplay.catalogue.diagnosing.answer import Diagnosis
from jointplay.catalogue.diagnosing.hearing import hear
from jointplay.catalogue.diagnosing.known_machine import KnownMachine
from jointplay.catalogue.diagnosing.past_recordings import InOrder
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.diagnosing.telling import tell
from jointplay.catalogue.diagnosing.together import diagnose_together
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import ModelLibrary, library_of
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.prior import Prior
from jointplay.catalogue.measurements.measured_spectrum import MeasuredSpectrum
from jointplay.catalogue.measurements.measurement import Recording
from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.storage.store import Catalogue


def diagnose(
    measurement: Recording | MeasuredSpectrum,
    catalogue: Catalogue,
    *,
    speed: float | None = None,
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
    """Say which joints are worn, by how much, and how sure that is.

    Parameters
    ----------
    measurement : Recording or MeasuredSpectrum
        Recording of sensors on the frame, or spectra of them. One in which the drive speed changes is cut into
        pieces about the speeds of the catalogue, see :func:`~jointplay.catalogue.signals.speedpieces.cut_by_speed`;
        they have one answer.
    catalogue : Catalogue
        Of the same machine.
    speed : float, optional
        Drive speed, rad/s; estimated from the recording where it is not given. Nothing is cut where it is.
    effort, mode, coverage, cases, prior, limits_um
        See :class:`Question`.
    mapping : mapping of str to str, optional
        Sensor of each column, for columns not named like their sensor.
    baseline : Recording, InOrder or sequence of these, optional
        Recordings of the same machine in order by the same sensors: they fit what is uncertain about machine and
        sensors, and are what the recording is compared with as such. Each by `mapping` and at the speed that is
        estimated, unless an :class:`~jointplay.catalogue.diagnosing.past_recordings.InOrder` says otherwise.
    library : ModelLibrary, optional
        Answers, and keeps what was learned for the next recording; the catalogue's own unless given. One of another
        method is a :class:`jointplay.catalogue.evaluation.cross_checks.MethodLibrary`.
    progress : callable, optional
        See :class:`Question`.

    Returns
    -------
    Diagnosis

    Raises
    ------
    MeasurementError
        The recording cannot be compared: no column is a sensor, too short, no drive speed to be found.
    DiagnosisError
        A setting breaks a rule, or the catalogue holds too little.
    """
    return diagnose_together(
        [measurement],
        catalogue,
        speeds=[speed],
        effort=effort,
        mode=mode,
        mapping=mapping,
        coverage=coverage,
        cases=cases,
        prior=prior,
        limits_um=limits_um,
        baseline=baseline,
        library=library,
        progress=progress,
    )


def answer(
    prepared: PreparedMeasurement,
    sha256: str,
    catalogue: Catalogue,
    question: Question,
    *,
    mapping: Mapping[str, str] | None = None,
    known: KnownMachine | None = None,
    suggesting: bool = False,
    library: ModelLibrary | None = None,
    without: tuple[str, ...] = (),
    most: int | None = None,
) -> tuple[Diagnosis, MatchResult]:
    """Diagnose a recording that has been prepared, and return what the answer was made of, too.

    Parameters
    ----------
    prepared : PreparedMeasurement
    sha256 : str
        Of the recording.
    catalogue : Catalogue
        The one it was prepared for.
    question : Question
    known : KnownMachine, optional
        What a recording of the machine in order has shown.
    suggesting : bool
        Whether to say what would tell the first hypotheses apart, where they are not.
    mapping, library
        As for :func:`diagnose`.
    without : tuple of str
        Hypotheses that are left out.
    most : int, optional
        Entries of a hypothesis that are learned from, at most.

    Returns
    -------
    (Diagnosis, MatchResult)
        The answer, and the posterior that it shows.

    Raises
    ------
    DiagnosisError
        The catalogue holds too little.
    """
    question.prior.check(catalogue.matrix.joints)
    library = library or library_of(catalogue)
    heard = hear(prepared, sha256, catalogue, question, library, known=known, without=without, most=most)
    shown = tell(heard, catalogue, question, library, mapping=mapping, suggesting=suggesting)
    return shown, heard.result
