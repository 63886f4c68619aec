"""Fitted models kept for the next recording, and answers at an effort: looked up, or refitted to the recording."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from cachetools import LRUCache, cached
from threadpoolctl import ThreadpoolController

from jointplay.catalogue import FEATURES_VERSION, MATCHER_VERSION
from jointplay.catalogue.matching.gaussian import NAME, FittedGaussian, fit_gaussian
from jointplay.catalogue.matching.learning import Learning, SpectraSource, band_widths, training_set
from jointplay.catalogue.matching.matcher import DOUBTED_BELOW, MatchResult, TrainingSet
from jointplay.catalogue.matching.modelfile import age_key, as_read, read_model, write_model
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.network_shelf import Networks, NetworkShelf
from jointplay.catalogue.matching.observation import Sensing, round_sensing
from jointplay.catalogue.matching.refit import Refit, blend, merge
from jointplay.catalogue.plans.entry import content_digest
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import BoolArray, FloatArray

NOISE_STEP_DB = 3.0
"""Steps a noise floor is rounded up to, so that a learned model serves all recordings of about the same noise."""

LOADED = 4
"""Models read from files at once when a server starts: two modes at two steps of noise, some 100 MB."""

CATALOGUES = 4
"""Catalogues whose models are kept in memory."""


class ModelLibrary:
    """Models fitted to one catalogue, in memory and as files; safe to share between threads.

    An answer is a function of catalogue, recording and settings alone: what is kept only saves time.

    Parameters
    ----------
    matrix : SpectraSource
        Feature matrix of the catalogue.
    folder : Path, optional
        Where models are kept as files; nothing is written unless given. Files may be deleted at any time.
    networks : NetworkShelf, optional
        Networks that give a second opinion; none without it.
    size : int
        Models kept in memory (some 10 MB each with 17 hypotheses).
    """

    name = NAME
    version = str(MATCHER_VERSION)
    simulates_anew = True
    """Whether effort thorough may put what it simulates in the place of an answer."""

    def __init__(
        self, matrix: SpectraSource, folder: Path | None = None, networks: NetworkShelf | None = None, *, size: int = 16
    ) -> None:
        self._matrix, self._folder, self._networks = matrix, folder, networks
        self._lock = threading.Lock()
        self._known: LRUCache[str, FittedGaussian] = LRUCache(size)

    @property
    def matrix(self) -> SpectraSource:
        """What its models are fitted to."""
        return self._matrix

    def answer(
        self,
        sensing: Sensing,
        feature: FloatArray,
        watched: BoolArray,
        effort: Effort = "standard",
        mode: ModeAsked = "auto",
        *,
        speed: float | None = None,
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
            to the recording's noise where no network knows that, or where there are more entries than the model has
            learned from; ``thorough`` does the same here (what it does beyond is no matter of models).
        mode : {"auto", "trusted", "robust"}
            ``auto`` trusts the model unless the recording then has a p-value below 0.05; both modes are then heard.
        speed : float, optional
            Drive speed, rad/s: which entries are used where the catalogue has several speeds.
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
            The catalogue holds too little.
        MatchingError
            The feature vector does not fit the sensing.
        """
        observed = Observed(sensing, feature, watched, speed, weights)
        with one_thread():
            if mode == "robust":
                return self.match(observed, effort, Learning.of(mode, without=without, most=most))
            trusted = self.match(observed, effort, Learning.of("trusted", without=without, most=most))
            if mode == "trusted" or trusted.p_value >= DOUBTED_BELOW:
                return replace(trusted, trusted_p_value=trusted.p_value)
            robust = self.match(observed, effort, Learning.of("robust", without=without, most=most))
        return blend(trusted, robust)

    def hears_past(self, sensing: Sensing, speed: float) -> bool:
        """Whether it has learned what machines differ by from their own past, as such sensors of such noise see it."""
        if self._networks is None:
            return False
        networks = self._networks.every(replace(sensing, past=True), Learning.of("trusted"), speed)
        found, _ = networks.opinions(sensing, band_widths(self._matrix))
        return found is not None and found.since is not None

    def fit(
        self,
        observed: Observed,
        learning: Learning,
        networks: Networks | None = None,
    ) -> FittedGaussian:
        """Return a model fitted to exactly this sensing; from memory or a file if it is known."""
        opinion, witness = (networks or Networks()).opinions(observed.sensing, band_widths(self._matrix))
        judges = [None if each is None else each.digest for each in (opinion, witness)]
        key = self.key(observed, learning, judges)
        with self._lock:
            known = self._known.get(key)
        if known is not None:
            return known
        # Fitted outside the lock: two threads may fit the same, which costs time but nothing else.
        folder = self._folder if observed.weights is None else None
        found = None if folder is None else read_model(folder, key)
        if found is None:
            training = self.training(observed, learning)
            found = as_read(fit_gaussian(training, opinion=opinion, witness=witness))
            if folder is not None:
                write_model(folder, key, found)
        with self._lock:
            self._known[key] = found
        return found

    def training(self, observed: Observed, learning: Learning) -> TrainingSet:
        """Return what a model for a recording is fitted to."""
        return training_set(
            self._matrix,
            observed.sensing,
            observed.watched,
            learning,
            speed=observed.speed,
            weights=observed.weights,
        )

    def key(self, observed: Observed, learning: Learning, judges: Sequence[str | None] = ()) -> str:
        """Return what tells a model from others: all that it depends on, of the recording as little as that is."""
        place = None if observed.speed is None else self._matrix.nearest_speed(observed.speed)
        weighed = None if observed.weights is None else np.asarray(observed.weights, np.float64).tobytes().hex()
        asked = [observed.sensing.digest, observed.watched.tolist(), repr(learning), place, weighed, list(judges)]
        versions = [FEATURES_VERSION, self.name, self.version]
        return f"{self._state}-{content_digest([self._matrix.id, *versions, *asked])}"

    def load(self, most: int = LOADED) -> int:
        """Read models that were kept as files for this state of the catalogue, those written last; return how many.

        The next recordings are likely to be as noisy as the last ones. It only saves time: what is not loaded here is
        read when it is needed.
        """
        if self._folder is None:
            return 0
        files = sorted(self._folder.glob(f"{self._state}-*.npz"), key=age_key, reverse=True)
        most = min(most, int(self._known.maxsize))
        found = [(file.stem, read_model(self._folder, file.stem)) for file in files[:most]]
        with self._lock:
            for key, model in found:
                if model is not None and key not in self._known and len(self._known) < self._known.maxsize:
                    self._known[key] = model
        return sum(model is not None for _, model in found)

    @property
    def _state(self) -> str:
        """Beginning of the names of models of this state of the catalogue."""
        return self._matrix.id[:12]

    def match(self, observed: Observed, effort: Effort, learning: Learning) -> MatchResult:
        """Return the answer of one mode."""
        coarse = self.coarse(observed)
        sensing, speed, weights = observed.sensing, observed.speed, observed.weights
        networks, notes = Networks(), self.notes(learning)
        # Where entries have weights none counts: a network has learned all entries alike.
        if self._networks is not None and weights is None:
            networks = self._networks.every(sensing, learning, speed)
            if networks.hypotheses is None and self._networks.applies(sensing, learning, speed):
                notes = (*notes, "the catalogue's networks are not trained yet: building it again does that")
        model = self.fit(coarse, learning, networks)
        asked = model.opinion.digest if model.opinion else None
        beside = model.opinion is not None and model.opinion.since is not None
        found = model.match(coarse.feature)
        looked_up = replace(found, mode=learning.mode, notes=notes, network=asked, beside=beside)
        refit = Refit(self._matrix, model, learning, speed, weights, networks if asked else Networks())
        # A network knows any noise: beside it a refit tells more only where there is more to learn from.
        if effort == "fast" or (asked and not refit.has_more_entries(looked_up)):
            return looked_up
        return merge(looked_up, refit.match(sensing, observed.feature, observed.watched, looked_up))

    def coarse(self, observed: Observed) -> Observed:
        """Return a recording with noise filled up to the next step, so that few models serve all recordings."""
        sensing = round_sensing(observed.sensing, band_widths(self._matrix), NOISE_STEP_DB)
        missing = np.maximum(sensing.noise - observed.sensing.noise, 0.0)
        lifted = sensing.with_more_noise(observed.feature[None, :], missing)[0]
        return replace(observed, sensing=sensing, feature=lifted)

    def notes(self, learning: Learning) -> tuple[str, ...]:
        """Return what is doubtful about a mode in this catalogue."""
        if learning.mode == "trusted" or any(len(self._matrix.rows(h.label, "wide")) for h in self._matrix.hypotheses):
            return ()
        return (
            "the catalogue holds no draws of uncertain machines: only flexible modes and levels are taken as uncertain",
        )


@dataclass(frozen=True, eq=False)
class Observed:
    """A recording as a library is asked about it: its sensing and features, and the rest as :meth:`ModelLibrary.answer`
    has it.
    """

    sensing: Sensing
    feature: FloatArray
    watched: BoolArray
    speed: float | None = None
    weights: FloatArray | None = None


@cached(LRUCache(CATALOGUES), key=lambda catalogue: (str(catalogue.path), catalogue.id), lock=threading.Lock())
def library_of(catalogue: Catalogue) -> ModelLibrary:
    """Return the library of a catalogue in its present state; the same one for the same state of the same folder."""
    return ModelLibrary(catalogue.matrix, catalogue.layout.models, NetworkShelf.of(catalogue))


def one_thread() -> AbstractContextManager[Any]:
    """Return a context in which linear algebra takes one thread.

    The matrices of a diagnosis are small, and threads that wait for each other cost eleven times the time of the sums
    they share (measured on two busy cores: 11 s against 1 s).
    """
    limits: AbstractContextManager[Any] = _libraries().limit(limits=1, user_api="blas")
    return limits


@lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """The libraries of linear algebra, loaded with this module; looking for them takes 2 ms, a fifth of an answer."""
    return ThreadpoolController()
