"""The quality card of a catalogue: what its own held-out draws show of the answers it will give.

No network and no curve has learned from these draws; how sure answers are was calibrated on them, so that a card is a
little kinder than recordings simulated anew (``jointplay evaluate``). It takes seconds in place of an hour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointplay.catalogue.diagnosing.joint_states import joint_posteriors, plays_of_fits
from jointplay.catalogue.diagnosing.quality_card import VERSIONS, JointQuality, NoiseQuality, QualityCard, kept_card
from jointplay.catalogue.matching.calibration import is_held_out
from jointplay.catalogue.matching.learning import Learning, band_widths, rows_of
from jointplay.catalogue.matching.matcher import MatchResult
from jointplay.catalogue.matching.model_library import library_of
from jointplay.catalogue.matching.network import FULL_BAND
from jointplay.catalogue.matching.network_shelf import own_sensing
from jointplay.catalogue.matching.observation import Sensing, observe
from jointplay.catalogue.matching.sightings import SEEN_ABOVE, Sightings
from jointplay.catalogue.plans.entry import Hypothesis
from jointplay.catalogue.storage.directory import publish
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.arrays import FloatArray

NOISES = (0.005, 0.02, 0.1)
"""Noise of each sensor up to 5 kHz, m/s2 rms."""

REVOLUTIONS = 40.0
"""Length of the recordings, that of `jointplay evaluate`."""

MOST = 60
"""Draws of a hypothesis, at most."""

IN_ORDER, SEVERAL = "in order", "several"


def card_of(catalogue: Catalogue) -> QualityCard | None:
    """Return the card of a catalogue, made now and kept in its folder where there is none of its present state.

    None for a machine whose sensors see nothing.

    Raises
    ------
    DiagnosisError
        The catalogue holds too little.
    CatalogueFileError
        The card cannot be written.
    """
    kept = kept_card(catalogue)
    if kept is not None:
        return kept
    made = make_card(catalogue)
    if made is not None:
        publish(catalogue.layout.quality, (made.model_dump_json(indent=1) + "\n").encode())
    return made


def make_card(catalogue: Catalogue) -> QualityCard | None:
    """Ask a catalogue about its own held-out draws, at each noise; None for a machine whose sensors see nothing."""
    own = own_sensing(catalogue.machine, catalogue.matrix.cuts)
    if own is None:
        return None
    found = tuple(_at_noise(catalogue, own, noise) for noise in NOISES)
    return QualityCard(catalogue=catalogue.id, versions=VERSIONS, revolutions=REVOLUTIONS, noises=found)


def _at_noise(catalogue: Catalogue, own: Sensing, noise: float) -> NoiseQuality:
    matrix, library = catalogue.matrix, library_of(catalogue)
    width = band_widths(matrix)[: own.bands]
    edges = np.array(matrix.edges) * abs(matrix.nominal_speed) / (2.0 * math.pi)
    density = noise**2 / FULL_BAND * np.sum(own.channels**2, axis=1)
    seconds = REVOLUTIONS * 2.0 * math.pi / abs(matrix.nominal_speed)
    sensing = replace(own, noise=width[:, None] * density, degrees_of_freedom=2.0 * np.maximum(1.0, seconds * width))
    watched = np.zeros(sensing.features_count, dtype=bool)
    learning, counted = Learning.of("trusted"), _Counted.of(catalogue)
    for number, known in enumerate(matrix.hypotheses):
        rows = rows_of(matrix, known.label, learning, matrix.nominal_speed)
        rows = rows[is_held_out(matrix.individuals(rows))][:MOST]
        ones = np.ones(len(rows), dtype=np.int64)
        features, _ = observe(matrix.packed(rows), sensing, learning.discrepancy, ones, (len(NOISES), number), edges)
        for feature, clearance in zip(features, matrix.clearance(rows), strict=True):
            result = library.answer(sensing, feature, watched, "fast", speed=matrix.nominal_speed)
            counted.count(known, dict(zip(matrix.joints, clearance.tolist(), strict=True)), result)
    return counted.quality(noise)


class _Counted:
    """Answers to draws, counted."""

    def __init__(self, joints: Sequence[str], fits: dict[str, FloatArray], classes: Sequence[str]) -> None:
        self._joints, self._fits, self._classes = joints, fits, tuple(classes)
        self._confusion = np.zeros((len(classes), len(classes)), dtype=np.int64)
        self._worn, self._called, self._both = (dict.fromkeys(joints, 0) for _ in range(3))
        self._right = self._held = self._intervals = 0
        self._sightings: Sightings | None = None

    @classmethod
    def of(cls, catalogue: Catalogue) -> _Counted:
        hypotheses = catalogue.matrix.hypotheses
        joints = sorted({joint for known in hypotheses for joint in known.joints})
        classes = [IN_ORDER, *(joint for joint in joints)]
        if any(len(known.joints) > 1 for known in hypotheses):
            classes.append(SEVERAL)
        return cls(joints, {joint: plays_of_fits(catalogue, joint) for joint in joints}, classes)

    def count(self, known: Hypothesis, clearance: dict[str, float], result: MatchResult) -> None:
        first = result.best
        if self._sightings is None or result.mode == "trusted":  # of machines as in their file, as the draws are
            self._sightings = result.sightings
        self._right += set(first.joints) == set(known.joints)
        self._confusion[self._class(known.joints), self._class(first.joints)] += 1
        for joint, posterior in joint_posteriors(result, self._fits).items():
            worn, called = joint in known.joints, posterior.p_worn >= SEEN_ABOVE
            self._worn[joint] += worn
            self._called[joint] += called
            self._both[joint] += worn and called
            if worn and called:
                self._intervals += 1
                self._held += posterior.quantile(0.05) <= clearance[joint] <= posterior.quantile(0.95)

    def _class(self, joints: Sequence[str]) -> int:
        name = SEVERAL if len(joints) > 1 else joints[0] if joints else IN_ORDER
        return self._classes.index(name)

    def quality(self, noise: float) -> NoiseQuality:
        draws = int(self._confusion.sum())
        sightings = self._sightings
        joints = {}
        for joint in self._joints:
            least = sightings.detectable_from(joint, {}) if sightings and joint in sightings.joints else None
            joints[joint] = JointQuality(
                detectable_from_um=None if least is None else 1e6 * least,
                seen=_share(self._both[joint], self._worn[joint]),
                called=_share(self._both[joint], self._called[joint]),
            )
        return NoiseQuality(
            sensor_noise_m_s2=noise,
            draws=draws,
            right=_share(self._right, draws) or 0.0,
            classes=self._classes,
            confusion=tuple(tuple(row) for row in self._confusion.tolist()),
            joints=joints,
            interval_coverage=_share(self._held, self._intervals),
            intervals=self._intervals,
        )


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
