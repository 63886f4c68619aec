"""A study: methods, efforts and modes side by side, on the same held-out recordings of some protocols."""

from __future__ import annotations

import dataclasses
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any

from jointplay.catalogue.diagnosing.diagnosis import answer
from jointplay.catalogue.diagnosing.joint_states import plays_of_fits
from jointplay.catalogue.diagnosing.question import Question
from jointplay.catalogue.errors import DiagnosisError, MeasurementError
from jointplay.catalogue.evaluation.cross_checks import METHODS, OWN, Matcher, MethodLibrary, as_matcher
from jointplay.catalogue.evaluation.differences import with_differences
from jointplay.catalogue.evaluation.metrics import Answered, FiguresOfMerit, figures
from jointplay.catalogue.evaluation.protocols import EvaluationProtocol, draw_truth, protocols_of
from jointplay.catalogue.evaluation.recordings import TOGETHER, Recordings, hidden, recorded
from jointplay.catalogue.evaluation.spoiling import with_spoiling
from jointplay.catalogue.evaluation.truth import Truth
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.network_shelf import NetworkShelf, own_sensing
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray


@dataclass(frozen=True)
class Setup:
    """How recordings are diagnosed.

    Parameters
    ----------
    method : str
        Name in :data:`~jointplay.catalogue.evaluation.cross_checks.METHODS`.
    effort : {"fast", "standard", "thorough"}
    mode : {"auto", "trusted", "robust"}
    """

    method: str = OWN
    effort: Effort = "standard"
    mode: ModeAsked = "auto"


@dataclass(frozen=True)
class Row:
    """Figures of one protocol and one setup.

    Parameters
    ----------
    protocol : EvaluationProtocol
    setup : Setup
    failed, refused : int
        Cases that could not be simulated; recordings that were refused.
    reasons : mapping of str to int
        Why they were, as the first of each kind said it, and how many were of that kind.
    figures : FiguresOfMerit
    """

    protocol: EvaluationProtocol
    setup: Setup
    failed: int
    refused: int
    reasons: Mapping[str, int]
    figures: FiguresOfMerit


@dataclass(frozen=True)
class Study:
    """Quality of diagnosis on held-out recordings.

    Parameters
    ----------
    machine : str
        Its name.
    catalogue : str
        SHA-256 of the catalogue's content.
    entries : int
        Entries of the catalogue.
    seed, count : int
        Of what was drawn; recordings asked for in each protocol.
    rows : tuple of Row
        Protocol by protocol, setup by setup.
    """

    machine: str
    catalogue: str
    entries: int
    seed: int
    count: int
    rows: tuple[Row, ...]

    def content(self) -> dict[str, object]:
        """Return everything as plain data, for JSON."""
        return dataclasses.asdict(self)


def setups_of(methods: Sequence[str], efforts: Sequence[Effort], modes: Sequence[ModeAsked]) -> tuple[Setup, ...]:
    """Return all combinations; cross-check methods have the effort ``standard`` only.

    Raises
    ------
    DiagnosisError
        An unknown method.
    """
    found = [
        Setup(method, effort if method == OWN else "standard", mode)
        for method, effort, mode in product(methods, efforts, modes)
    ]
    _check(found, METHODS)
    return tuple(dict.fromkeys(found))


def _check(setups: Sequence[Setup], known: Mapping[str, object]) -> None:
    for setup in setups:
        if setup.method not in known:
            raise DiagnosisError(f"method: {setup.method}: must be one of {', '.join(known)}")


def evaluate(
    catalogue: Catalogue,
    protocols: Sequence[str | EvaluationProtocol] = ("hard",),
    count: int = 120,
    seed: int = 1,
    *,
    setups: Sequence[Setup] = (Setup(),),
    methods: Mapping[str, Any] | None = None,
    recordings: Recordings | None = None,
    most: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Measure diagnoses on recordings that no catalogue has seen.

    Parameters
    ----------
    catalogue : Catalogue
    protocols : sequence of str or EvaluationProtocol
        Names in :data:`jointplay.catalogue.evaluation.protocols.PROTOCOLS`, groups of them, or conditions of one's own.
    count : int
        Recordings a protocol, at least one a hypothesis; of sets of joints fewer.
    seed : int
        Of everything drawn.
    setups : sequence of Setup
        Compared on the same recordings.
    methods : mapping of str to Matcher or classifier, optional
        Methods that setups name besides :data:`~jointplay.catalogue.evaluation.cross_checks.METHODS`; a classifier is
        one of scikit-learn, not fitted.
    recordings : Recordings, optional
        Where simulations are kept; nowhere without it.
    most : int, optional
        Entries of a hypothesis that are learned from, at most: the first draws of each.
    progress : callable, optional
        Called with the number of recordings done and their total.

    Returns
    -------
    Study

    Raises
    ------
    DiagnosisError
        An unknown protocol, too few recordings, a machine without sensors, or nothing could be diagnosed.
    """
    wanted = tuple(protocol.of(catalogue) for protocol in protocols_of(protocols))
    if not catalogue.machine.sensors:
        raise DiagnosisError(f"machine {catalogue.machine.name}: has no sensors to record with")
    known_methods = {**METHODS, **{name: partial(as_matcher, each, name) for name, each in (methods or {}).items()}}
    _check(setups, known_methods)
    networks = networks_of(catalogue, setups, most)
    run = _StudyRun(catalogue, count, seed, tuple(setups), known_methods, recordings or Recordings(), most, networks)
    for protocol in wanted:
        run.hypotheses(protocol)  # Refused before anything is simulated.
    total = sum(2 if protocol.foreign else 1 for protocol in wanted) * count
    done = 0

    def told() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, total), total)

    known: dict[tuple[EvaluationProtocol, tuple[str, ...]], dict[Setup, list[Answered]]] = {}
    rows: list[Row] = []
    for protocol in wanted:
        without = run.without(protocol)
        found = run.answers(protocol, without, told)
        listed: Mapping[Setup, Sequence[Answered]] = {}
        if protocol.foreign:
            # The same machines without the foreign cause, asked of the same catalogue.
            plain = replace(
                protocol, name="listed", kind="singles", differences=(), spoiling="", foreign=False, unlisted=False
            )
            if (plain, without) not in known:
                known[plain, without] = run.answers(plain, without, told).answers
            listed = known[plain, without]
        for setup, answers in found.answers.items():
            largest = 1e6 * catalogue.plan.clearance.high
            made = figures(answers, run.columns(without), listed.get(setup, ()), largest)
            rows.append(Row(protocol, setup, found.failed, found.refused, found.reasons, made))
    if progress is not None:
        progress(total, total)
    return Study(catalogue.machine.name, catalogue.id, len(catalogue.entries), seed, count, tuple(rows))


def networks_of(catalogue: Catalogue, setups: Sequence[Setup], most: int | None) -> NetworkShelf:
    """Return networks that have seen `most` draws of a hypothesis, those trained first that are asked for."""
    kept = NetworkShelf.of(catalogue)
    shelf = (
        kept
        if most is None
        else NetworkShelf(catalogue.matrix, own_sensing(catalogue.machine, catalogue.matrix.cuts), None)
    )
    modes = {setup.mode for setup in setups if setup.method == OWN}
    for learning, speed in shelf.missing(most):
        if learning.mode in modes or "auto" in modes:
            shelf.train(learning, speed)
    return shelf


@dataclass
class _Found:
    answers: dict[Setup, list[Answered]]
    failed: int = 0
    refusals: list[str] = field(default_factory=list)

    @property
    def refused(self) -> int:
        return len(self.refusals)

    @property
    def reasons(self) -> dict[str, int]:
        """First refusal of each kind, and how many are of it: those that differ in their numbers alone."""
        kinds: dict[str, list[str]] = {}
        for text in self.refusals:
            kinds.setdefault(re.sub(r"\d[\d.]*(e[-+]?\d+)?", "#", text), []).append(text)
        return {texts[0]: len(texts) for texts in sorted(kinds.values(), key=len, reverse=True)}


@dataclass(frozen=True)
class _StudyRun:
    catalogue: Catalogue
    count: int
    seed: int
    setups: tuple[Setup, ...]
    methods: Mapping[str, Callable[[], Matcher] | None]
    recordings: Recordings
    most: int | None
    networks: NetworkShelf

    def hypotheses(self, protocol: EvaluationProtocol) -> tuple[Hypothesis, ...]:
        found = protocol.hypotheses(self.catalogue, self.seed)
        if self.count < len(found) and protocol.kind != "sets":
            rule = f"must be at least {len(found)}, one a hypothesis of protocol {protocol.name}"
            raise DiagnosisError(f"count: {self.count}: {rule}")
        return found

    def without(self, protocol: EvaluationProtocol) -> tuple[str, ...]:
        """Hypotheses that are taken out of the catalogue."""
        worn = {len(each.joints) for each in self.hypotheses(protocol)} if protocol.unlisted else set()
        return tuple(each.label for each in self.catalogue.entries.hypotheses if len(each.joints) in worn)

    def columns(self, without: Sequence[str]) -> dict[str, frozenset[str]]:
        listed = self.catalogue.entries.hypotheses
        return {each.label: frozenset(each.joints) for each in listed if each.label not in without}

    def truths(self, protocol: EvaluationProtocol) -> list[Truth]:
        machine, hypotheses = self.catalogue.machine, self.hypotheses(protocol)
        found = []
        for index in range(self.count):
            hypothesis, number = hypotheses[index % len(hypotheses)], index // len(hypotheses)
            truth = draw_truth(machine, hypothesis, protocol, self.seed, number)
            truth = with_differences(truth, protocol.differences, self.seed, number)
            found.append(with_spoiling(truth, protocol.spoiling, self.seed, number))
        return found

    def make_library(self, method: str) -> ModelLibrary:
        made = self.methods[method]
        matrix = self.catalogue.matrix
        return ModelLibrary(matrix, networks=self.networks) if made is None else MethodLibrary(matrix, made())

    def answers(self, protocol: EvaluationProtocol, without: tuple[str, ...], told: Callable[[], None]) -> _Found:
        truths, found = self.truths(protocol), _Found({setup: [] for setup in self.setups})
        libraries = {setup.method: self.make_library(setup.method) for setup in self.setups}
        numbers: dict[Setup, list[int]] = {setup: [] for setup in self.setups}
        signals: dict[int, FloatArray] = {}
        worn = sorted({joint for joints in self.columns(without).values() for joint in joints})
        fits = {joint: plays_of_fits(self.catalogue, joint) for joint in worn}
        unseen: set[int] = set()
        for index, signal in self.recordings.ideal(protocol, truths):
            told()
            if signal is None:
                found.failed += 1
                continue
            if "load" in protocol.differences:
                signals[index] = signal
                if len(signals) == TOGETHER:
                    unseen |= hidden(protocol, truths, signals, self.recordings)
                    signals.clear()
            try:
                recording = recorded(protocol, truths[index], signal)
                scheme, nominal = self.catalogue.scheme, self.catalogue.recipe.nominal_drive_speed
                prepared = prepare(recording, self.catalogue.machine, scheme=scheme, nominal=nominal)
            except MeasurementError as error:
                found.refusals.append(str(error))
                continue
            for setup in self.setups:
                question = Question(setup.effort, setup.mode)
                begin = time.perf_counter()
                got, result = answer(
                    prepared,
                    recording.sha256,
                    self.catalogue,
                    question,
                    library=libraries[setup.method],
                    without=without,
                    most=self.most,
                )
                took = time.perf_counter() - begin
                found.answers[setup].append(Answered.of(truths[index], got, result, fits, took))
                numbers[setup].append(index)
        unseen |= hidden(protocol, truths, signals, self.recordings)
        for setup, answers in found.answers.items():
            marked = zip(numbers[setup], answers, strict=True)
            found.answers[setup] = [replace(each, hidden=True) if i in unseen else each for i, each in marked]
        if not any(found.answers.values()):
            why = f" ({next(iter(found.reasons))})" if found.refusals else ""
            rule = f"{found.failed} failed, {found.refused} were refused{why}"
            raise DiagnosisError(
                f"none of {self.count} recordings of protocol {protocol.name} could be diagnosed: {rule}"
            )
        return found
