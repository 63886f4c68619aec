"""Fitted models kept for the next recording, and answers at an effort: looked up, or refitted to the recording."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from jointplay.catalogue import FEATURES_VERSION
from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.blending import blended
from jointplay.catalogue.matching.coherence import with_more_noise
from jointplay.catalogue.matching.gaussian import FittedGaussian, GaussianAlongClearance
from jointplay.catalogue.matching.learning import Learning, rows_of, training_set
from jointplay.catalogue.matching.matcher import BoolArray, FittedMatcher, FloatArray, Matcher, MatchResult
from jointplay.catalogue.matching.modelfile import as_read, read_model, write_model, written
from jointplay.catalogue.matching.network import Network
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.matching.observation import Sensing, rounded_sensing
from jointplay.catalogue.matching.refit import Refit, merged
from jointplay.catalogue.matching.spectra import Spectra, band_widths
from jointplay.catalogue.matching.threads import one_thread
from jointplay.catalogue.plans.keys import content_digest

Effort = Literal["fast", "standard", "thorough"]
Choice = Literal["auto", "trusted", "robust"]

NOISE_STEP_DB = 3.0
"""Steps a noise floor is rounded up to, so that a learned model serves all recordings of about the same noise."""

LOADED = 4
"""Models read from files at once when a server starts: two modes at two steps of noise, some 100 MB."""

DOUBTED_BELOW = 0.05
"""P-value of the trusted mode below which the robust one has a say."""


class ModelLibrary:
    """Models fitted to one catalogue, in memory and as files; safe to share between threads.

    An answer is a function of catalogue, recording and settings alone: what is kept only saves time.

    Parameters
    ----------
    matrix : Spectra
        Feature matrix of the catalogue.
    folder : Path, optional
        Where models are kept as files; nothing is written unless given. Files may be deleted at any time.
    networks : NetworkShelf, optional
        Networks that give a second opinion; none without it.
    size : int
        Models kept in memory (some 10 MB each with 17 hypotheses).
    """

    def __init__(
        self, matrix: Spectra, folder: Path | None = None, networks: NetworkShelf | None = None, *, size: int = 16
    ) -> None:
        self._matrix, self._folder, self._networks, self._size = matrix, folder, networks, size
        self._lock = threading.Lock()
        self._known: OrderedDict[str, FittedMatcher] = OrderedDict()

    @property
    def matrix(self) -> Spectra:
        """What its models are fitted to."""
        return self._matrix

    def answer(
        self,
        sensing: Sensing,
        feature: FloatArray,
        watched: BoolArray,
        effort: Effort = "standard",
        mode: Choice = "auto",
        *,
        speed: float | None = None,
        matcher: Matcher | None = None,
        weights: FloatArray | None = None,
        without: tuple[str, ...] = (),
        most: int | None = None,
    ) -> MatchResult:
        """Match one recording.

        Parameters
        ----------
        sensing : Sensing
            With the recording's own noise.
        feature : ndarray, shape (d,)
            Levels and coherences, see :meth:`Sensing.features`.
        watched : ndarray of bool, shape (d,)
            Levels checked one by one.
        effort : {"fast", "standard", "thorough"}
            ``fast`` looks up the model of the next higher noise step. ``standard`` refits the hypotheses it leaves open
            to the recording's noise; ``thorough`` does the same here (what it does beyond is no matter of models).
        mode : {"auto", "trusted", "robust"}
            ``auto`` trusts the model unless the recording then has a p-value below 0.05; both modes are then heard.
        speed : float, optional
            Drive speed, rad/s: which entries are used where the catalogue has several speeds.
        matcher : Matcher, optional
            Another method, which then answers from the looked-up model at every effort.
        weights : ndarray, shape (rows of the matrix,), optional
            How much each entry counts, > 0: closeness to what a baseline recording has shown. Models fitted so are not
            kept as files.
        without : tuple of str
            Hypotheses that are left out.
        most : int, optional
            Entries of a hypothesis that are learned from, at most: the first draws. As many as :class:`Learning` says
            without it.

        Raises
        ------
        DiagnosisError
            A setting breaks a rule, or the catalogue holds too little.
        MatchingError
            The feature vector does not fit the sensing.
        """
        if effort not in ("fast", "standard", "thorough"):
            raise DiagnosisError(f"effort: {effort}: must be fast, standard or thorough")
        if mode not in ("auto", "trusted", "robust"):
            raise DiagnosisError(f"mode: {mode}: must be auto, trusted or robust")
        question = _Question(sensing, feature, watched, speed, weights)
        with one_thread():
            if mode == "robust":
                return self._answer(question, effort, Learning.of(mode, without=without, most=most), matcher)
            trusted = self._answer(question, effort, Learning.of("trusted", without=without, most=most), matcher)
            if mode == "trusted" or trusted.p_value >= DOUBTED_BELOW:
                return replace(trusted, trusted_p_value=trusted.p_value)
            robust = self._answer(question, effort, Learning.of("robust", without=without, most=most), matcher)
        return blended(trusted, robust)

    def fitted(
        self,
        sensing: Sensing,
        watched: BoolArray,
        learning: Learning,
        matcher: Matcher | None = None,
        *,
        speed: float | None = None,
        weights: FloatArray | None = None,
        network: Network | None = None,
        strata: Network | None = None,
    ) -> FittedMatcher:
        """Return a matcher fitted to exactly this sensing; from memory or a file if it is known."""
        method = matcher or GaussianAlongClearance()
        widths = band_widths(self._matrix)
        opinion = None if network is None else network.opinion(sensing, widths)
        witness = None if strata is None else strata.opinion(sensing, widths)
        rows = {known.label: rows_of(self._matrix, known.label, learning, speed) for known in self._matrix.hypotheses}
        rows = {label: chosen for label, chosen in rows.items() if label not in learning.without}
        ends = [[label, len(chosen), int(chosen.sum())] for label, chosen in rows.items()]
        weighed = None if weights is None else np.asarray(weights, np.float64).tobytes().hex()
        judges = [None if each is None else each.network.digest for each in (opinion, witness)]
        asked = [sensing.digest, watched.tolist(), repr(method), method.version, repr(learning), ends, weighed, judges]
        key = f"{self._state}-{content_digest([self._matrix.id, FEATURES_VERSION, *asked])}"
        with self._lock:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        # Fitted outside the lock: two threads may fit the same, which costs time but nothing else.
        kept = self._folder if weights is None and isinstance(method, GaussianAlongClearance) else None
        found: FittedMatcher | None = None if kept is None else read_model(kept, key)
        if found is None:
            chosen = None if weights is None else {label: weights[each] for label, each in rows.items()}
            training = training_set(self._matrix, sensing, watched, learning, rows=rows, weights=chosen)
            if isinstance(method, GaussianAlongClearance):
                found = method.fit(training, opinion=opinion, witness=witness)
            else:
                found = method.fit(training)
            if isinstance(found, FittedGaussian):
                found = as_read(found)
                if kept is not None:
                    write_model(kept, key, found)
        with self._lock:
            self._known[key] = found
            while len(self._known) > self._size:
                self._known.popitem(last=False)
        return found

    def load(self, most: int = LOADED) -> int:
        """Read models that were kept as files for this state of the catalogue, those written last; return how many.

        The next recordings are likely to be as noisy as the last ones. It only saves time: what is not loaded here is
        read when it is needed.
        """
        if self._folder is None:
            return 0
        files = sorted(self._folder.glob(f"{self._state}-*.npz"), key=written, reverse=True)
        found = [(file.stem, read_model(self._folder, file.stem)) for file in files[: min(most, self._size)]]
        with self._lock:
            for key, model in found:
                if model is not None and key not in self._known and len(self._known) < self._size:
                    self._known[key] = model
        return sum(model is not None for _, model in found)

    @property
    def _state(self) -> str:
        """Beginning of the names of models of this state of the catalogue."""
        return self._matrix.id[:12]

    def _answer(self, question: _Question, effort: Effort, learning: Learning, matcher: Matcher | None) -> MatchResult:
        coarse = rounded_sensing(question.sensing, band_widths(self._matrix), NOISE_STEP_DB)
        network, strata, notes = None, None, self._notes(learning)
        own_method = matcher is None or isinstance(matcher, GaussianAlongClearance)
        # Where entries have weights none counts: a network has learned all entries alike.
        if self._networks is not None and own_method and question.weights is None:
            network = self._networks.get(question.sensing, learning, question.speed)
            if learning.mode == "trusted":
                strata = self._networks.get(question.sensing, replace(learning, subject="strata"), question.speed)
            if network is None and self._networks.applies(question.sensing, learning, question.speed):
                notes = (*notes, "the catalogue's networks are not trained yet: building it again does that")
        model = self.fitted(
            coarse,
            question.watched,
            learning,
            matcher,
            speed=question.speed,
            weights=question.weights,
            network=network,
            strata=strata,
        )
        asked = model.opinion.network.digest if isinstance(model, FittedGaussian) and model.opinion else None
        looked_up = replace(model.match(question.lifted(coarse)), mode=learning.mode, notes=notes, network=asked)
        if effort == "fast" or not isinstance(model, FittedGaussian):
            return looked_up
        judges = (network if asked else None, strata if isinstance(model, FittedGaussian) and model.witness else None)
        refit = Refit(self._matrix, model, learning, question.speed, question.weights, *judges)
        return merged(looked_up, refit.match(question.sensing, question.feature, question.watched, looked_up))

    def _notes(self, learning: Learning) -> tuple[str, ...]:
        if learning.mode == "trusted" or any(len(self._matrix.rows(h.label, "wide")) for h in self._matrix.hypotheses):
            return ()
        return (
            "the catalogue holds no draws of uncertain machines: only flexible modes and levels are taken as uncertain",
        )


@dataclass(frozen=True, eq=False)
class _Question:
    """What is asked of a library."""

    sensing: Sensing
    feature: FloatArray
    watched: BoolArray
    speed: float | None
    weights: FloatArray | None

    def lifted(self, coarse: Sensing) -> FloatArray:
        """Features (d,) with the noise filled up to that of a coarser sensing."""
        missing = np.maximum(coarse.noise - self.sensing.noise, 0.0)
        found: FloatArray = with_more_noise(self.feature[None, :], missing, coarse.alike)[0]
        return found
