"""Frozen features and answers: whether they still are those of ``FEATURES_VERSION`` and ``MATCHER_VERSION``.

A failure means that the same recording, or the same entry, is compared by other numbers than the version says, or
answered otherwise. If that is meant, raise the version in ``jointplay.catalogue`` by one and freeze anew,
``python tests/catalogue/test_versions.py``, in the same commit. If it is not meant, the change is wrong.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

sys.path.append(str(Path(__file__).parents[1]))  # where this is run as a program

from recordings import unpacked
from spectra_model import WATCHED, SpectraModel, sensing

from jointplay import catalogue
from jointplay.catalogue.diagnosing.comparison import exact_sensing, features_of
from jointplay.catalogue.matching.learning import Learning, band_widths, training_set
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.modes import Effort, ModeAsked
from jointplay.catalogue.matching.network import NetworkTraining
from jointplay.catalogue.matching.observation import observe
from jointplay.catalogue.measurements.measured_spectrum import read_recording
from jointplay.catalogue.signals.features import prepare
from jointplay.catalogue.storage.cross_power import COLUMNS
from jointplay.solver.arrays import FloatArray
from jointplay.solver.machines.machine import shipped_machine

FROZEN = Path(__file__).parents[1] / "data" / "numbers" / "versions.npz"

#: Decibels; logarithms of probabilities and clearances. Libraries held to AVX-512, AVX2 and SSE2 differed by 5e-7 at
#: most; changes of the method give 30 times the bound and more, see below.
CLOSE = 1e-4
MODEL = SpectraModel(200, pairs=True, wide=120)
TRAINING = NetworkTraining(rows=3000, blocks=5, layers=(16,), epochs=(2, 1), least_cases=100)


def of_recording(name: str, machine: str) -> FloatArray:
    """Features and noise of a recording."""
    prepared = prepare(read_recording(unpacked(name), name=name), shipped_machine(machine))
    sensing = exact_sensing(prepared)
    return np.concatenate([features_of(prepared, sensing), 10.0 * np.log10(sensing.noise.ravel())])


def of_entries(mode: str) -> FloatArray:
    """Features of entries with everything in their spectra, as they are drawn to be learned from."""
    generator = np.random.default_rng(3)
    packed = MODEL.packed(np.arange(4)).repeat(2, axis=0)
    packed[..., 3:] = 0.3 * packed[..., :1] * generator.uniform(-1.0, 1.0, (*packed.shape[:2], COLUMNS - 3))
    learning = Learning.of("trusted" if mode == "trusted" else "robust")
    edges = np.array(MODEL.edges) * MODEL.nominal_speed / (2.0 * np.pi)
    return observe(packed, sensing(), learning.discrepancy, np.full(len(packed), 2), 1, edges)[0].ravel()


def of_answer(effort: Effort, mode: ModeAsked) -> FloatArray:
    """Probabilities, p-values and clearances of all hypotheses for a loud, noisy recording of a pair."""
    seen = sensing(0.1)
    held = SpectraModel(3, pairs=True, seed=2)
    feature = training_set(held, seen, WATCHED, Learning.of("trusted")).hypotheses[4].features[0].copy()
    feature[: len(WATCHED)] += 3.0
    found = ModelLibrary(MODEL).answer(seen, feature, WATCHED, effort, mode)
    numbers = []
    for match in sorted(found.hypotheses, key=lambda match: match.label):
        numbers += [np.log(max(match.probability, 1e-12)), np.log(match.p_value), match.distance_db]
        numbers += [np.log(value) for each in match.clearances for value in (each.low, each.median, each.high)]
    return np.array(numbers)


def of_network() -> FloatArray:
    """What a network says of a few held-out rows."""
    trained = TRAINING.train(MODEL, sensing(), Learning.of("trusted"))
    opinion = trained.opinion(sensing(), band_widths(MODEL))
    assert opinion is not None
    asked = training_set(SpectraModel(3, seed=2), sensing(), WATCHED, Learning.of("trusted")).stack()[0][::40]
    return opinion.log_evidences(asked, trained.labels).ravel()


CASES: dict[str, Callable[[], FloatArray]] = {
    "features: recording": lambda: of_recording("slider-crank-02.csv", "slider-crank"),
    "features: recording of a table with hum": lambda: of_recording("quick-return-05.csv", "quick-return"),
    "features: spectrum": lambda: of_recording("four-bar-02-spectrum.csv", "four-bar"),
    "features: entries, trusted": lambda: of_entries("trusted"),
    "features: entries, robust": lambda: of_entries("robust"),
    "matcher: fast, trusted": lambda: of_answer("fast", "trusted"),
    "matcher: standard, auto": lambda: of_answer("standard", "auto"),
    "matcher: standard, robust": lambda: of_answer("standard", "robust"),
    "matcher: network": of_network,
}
VERSIONS = {"features": "FEATURES_VERSION", "matcher": "MATCHER_VERSION"}


def kept() -> dict[str, npt.NDArray[np.float64]]:
    with np.load(FROZEN) as file:
        return {name: file[name] for name in file.files}


def off(name: str) -> float:
    """How far a case is off what was frozen."""
    before, now = kept()[name], CASES[name]()
    return float(np.abs(now - before).max()) if now.shape == before.shape else np.inf


def test_what_is_frozen_is_of_these_versions() -> None:
    found = kept()
    assert set(found) == {*CASES, *VERSIONS}
    for name, constant in VERSIONS.items():
        assert int(found[name]) == getattr(catalogue, constant)


@pytest.mark.parametrize("name", CASES)
def test_what_is_compared_and_answered_is_as_frozen(name: str) -> None:
    constant = VERSIONS[name.partition(":")[0]]
    assert off(name) < CLOSE, f"raise jointplay.catalogue.{constant}, see above"


@pytest.mark.parametrize(
    ("name", "where", "what"),
    [
        ("features: recording", "signals.noise.WINDOW", 0.0256),
        ("features: entries, robust", "matching.coherence.SCALE", 10.1),
        ("matcher: fast, trusted", "matching.gaussian.BROADBAND_SHARE", 0.79),
        ("matcher: standard, auto", "matching.refit.AS_FILED_BEFORE", 0.89),
        ("matcher: standard, robust", "matching.learning.WIDE_SHARE", 0.66),
        ("matcher: network", "matching.network.FULL_BAND", 5050.0),
    ],
)
def test_changes_of_the_method_show(name: str, where: str, what: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(f"jointplay.catalogue.{where}", what)
    assert off(name) > 30.0 * CLOSE


if __name__ == "__main__":
    frozen = {name: make() for name, make in CASES.items()}
    versions = {name: getattr(catalogue, constant) for name, constant in VERSIONS.items()}
    np.savez_compressed(FROZEN, **frozen, **versions)
