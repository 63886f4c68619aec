"""Training sets from catalogues, and fitted matchers kept for the next measurement of about the same noise."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
from threadpoolctl import threadpool_limits

from catalogue.errors import DiagnosisError
from catalogue.matching import BoolArray, Draws, FittedMatcher, IntArray, Matcher, TrainingSet
from catalogue.observation import Discrepancy, Sensing, observe
from catalogue.store import Catalogue

PRIOR_OF_ANOTHER_JOINT = 0.15
"""How much less likely a hypothesis becomes with every joint beyond the first: joints rarely wear out together."""


@dataclass(frozen=True)
class Learning:
    """How a training set is made of a catalogue.

    Parameters
    ----------
    discrepancy : Discrepancy
        What is drawn on every copy of an entry.
    rows : int
        Rows of a hypothesis, at least: hypotheses with few entries get more copies of each.
    most : int
        Entries of a hypothesis that are learned from, at most: the first draws.
    without : tuple of str
        Hypotheses that are left out.
    seed : int
        Of everything drawn.
    """

    discrepancy: Discrepancy = field(default_factory=Discrepancy)
    rows: int = 500
    most: int = 10**9
    without: tuple[str, ...] = ()
    seed: int = 0


def prior(joints: tuple[str, ...]) -> float:
    """Return the weight of a hypothesis before the measurement; singles, healthy and as-new have 1."""
    return PRIOR_OF_ANOTHER_JOINT ** max(0, len(joints) - 1)


def training_set(catalogue: Catalogue, sensing: Sensing, watched: BoolArray, learning: Learning) -> TrainingSet:
    """Turn every entry of a catalogue into feature vectors as the sensors would report them.

    Parameters
    ----------
    catalogue : Catalogue
    sensing : Sensing
        Of the measurement that is to be compared.
    watched : ndarray of bool, shape (features,)
        Features checked one by one, see :class:`TrainingSet`.
    learning : Learning

    Raises
    ------
    DiagnosisError
        The catalogue has no entry, or only one of some hypothesis.
    """
    entries = catalogue.entries
    if len(entries) == 0:
        raise DiagnosisError(f"catalogue {catalogue.path}: holds no spectrum yet")
    labels = [label for label in catalogue.hypotheses if label not in learning.without]
    chosen = np.zeros(len(entries), dtype=np.bool_)
    for label in labels:
        rows = np.flatnonzero(entries.hypothesis == label)
        chosen[rows[np.argsort(entries.draw[rows], kind="stable")[: learning.most]]] = True
    counts = {label: int(np.sum(chosen & (entries.hypothesis == label))) for label in labels}
    for label, count in counts.items():
        if count < 3:
            raise DiagnosisError(
                f"catalogue {catalogue.path}: {count} entries of hypothesis {label}: at least 3 needed"
            )
    copies = np.array([math.ceil(learning.rows / counts.get(label, 1)) for label in entries.hypothesis]) * chosen
    features, entry = observe(catalogue.power(), sensing, learning.discrepancy, copies, learning.seed)
    hypothesis = entries.hypothesis[entry]
    sets = []
    for label in labels:
        rows = np.flatnonzero(hypothesis == label)
        joints = entries.worn_of(int(entry[rows[0]]))
        columns: IntArray = np.array([entries.joints.index(joint) for joint in joints], dtype=np.int64)
        log_clearance = np.log(entries.clearance[entry[rows]][:, columns])
        sets.append(Draws(label, joints, features[rows], log_clearance, entry[rows], prior(joints)))
    return TrainingSet(tuple(sets), watched)


class MatcherCache:
    """The matchers fitted last, by everything that went into them; safe to share between threads.

    Parameters
    ----------
    size : int
        How many are kept (a few MB each).
    """

    def __init__(self, size: int = 16) -> None:
        self._size = size
        self._lock = threading.Lock()
        self._known: OrderedDict[tuple[object, ...], FittedMatcher] = OrderedDict()

    def fitted(
        self, catalogue: Catalogue, sensing: Sensing, watched: BoolArray, matcher: Matcher, learning: Learning
    ) -> FittedMatcher:
        """Return the matcher fitted to this catalogue and sensing; fits it if it is not known."""
        key = (catalogue.id, sensing.key, watched.tobytes(), matcher, learning)
        with self._lock:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        # Fitted outside the lock: two threads may fit the same, which costs time but nothing else.
        # On one thread: the matrices are small, and threads that wait for each other cost eleven times the time of the
        # sums they share (measured on two busy cores: 11 s against 1 s).
        with threadpool_limits(limits=1, user_api="blas"):
            fitted = matcher.fit(training_set(catalogue, sensing, watched, learning))
        with self._lock:
            self._known[key] = fitted
            while len(self._known) > self._size:
                self._known.popitem(last=False)
        return fitted
