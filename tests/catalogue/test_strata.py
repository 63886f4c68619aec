"""The network that says whether a machine is as its file has it: training, and what it makes of p-values."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spectra_model import WATCHED, SpectraModel, sensing

from jointplay.catalogue.matching.calibration import is_held_out
from jointplay.catalogue.matching.gaussian import FittedGaussian, fit_gaussian
from jointplay.catalogue.matching.learning import Learning, band_widths, training_set
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.modelfile import as_read
from jointplay.catalogue.matching.network import AS_FILED, DIFFERS, Network, NetworkTraining, Opinion
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.matching.observation import observe
from jointplay.solver.arrays import FloatArray

AMOUNT = 1.5
"""Decibels."""


class Differing(SpectraModel):
    """Machines that differ from their file are off by up to some decibels, all in the same pattern of bands."""

    def __init__(self, count: int) -> None:
        super().__init__(2 * count)
        for known in self.hypotheses:
            self.stratum[self.rows(known.label)[count:]] = "wide"
        generator = np.random.default_rng(9)
        pattern, amount = generator.normal(size=(16, 3)), generator.uniform(-AMOUNT, AMOUNT, (len(self.label), 1, 1))
        off = self.stratum == "wide"
        self.powers[off, :, :3] *= 10.0 ** (0.1 * (amount * pattern)[off])


MODEL = Differing(300)
#: Of four times as many recordings as levels alone take: coherences say nothing here, which must be learned, too.
SMALL = NetworkTraining(rows=96_000, blocks=10, layers=(64, 32), strata_epochs=(8, 4))
#: What is kept and asked is so whatever it knows.
LITTLE = replace(SMALL, rows=16_000)
TRUSTED = Learning.of("trusted")
STRATA = Learning(discrepancy=TRUSTED.discrepancy, subject="strata")


@pytest.fixture(scope="module")
def strata() -> Network:
    return SMALL.train(MODEL, sensing(), STRATA)


def opinion_of(network: Network) -> Opinion:
    found = network.opinion(sensing(), band_widths(MODEL))
    assert found is not None
    return found


def unseen(label: str, stratum: str, copies: int = 2) -> FloatArray:
    """Levels of entries that were held out, seen anew."""
    rows = np.flatnonzero((MODEL.label == label) & (MODEL.stratum == stratum))
    rows = rows[is_held_out(rows)]
    return observe(MODEL.packed(rows), sensing(), TRUSTED.discrepancy, np.full(len(rows), copies), 7)[0]


@pytest.mark.long
def test_doubts_machines_that_differ_from_their_file(strata: Network) -> None:
    assert strata.labels == (AS_FILED, DIFFERS)
    opinion = opinion_of(strata)
    for label in ("A", "B", "C"):  # the healthy machine of this model is below the noise
        as_filed, differs = (opinion.doubts(unseen(label, stratum)) for stratum in ("trusted", "wide"))
        assert np.mean(as_filed[:, None] < differs) > 0.8  # measured: 0.84 to 0.88; a network that knows nothing: 0.5


def test_learns_from_both_strata_and_from_nothing_that_is_held_out(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: set[int] = set()
    packed = SpectraModel.packed

    def noted(self: SpectraModel, rows: np.ndarray) -> np.ndarray:
        seen.update(rows.tolist())
        return packed(self, rows)

    monkeypatch.setattr(SpectraModel, "packed", noted)
    # What is read does not depend on how much is made of it.
    replace(SMALL, layers=(4,), strata_epochs=(1, 1)).train(MODEL, sensing(), STRATA)
    every = np.arange(len(MODEL.label))
    assert seen == set(every[~is_held_out(every)].tolist())


def p_values(model: FittedGaussian, label: str, stratum: str) -> FloatArray:
    return np.array(
        [next(h.p_value for h in model.match(each).hypotheses if h.label == label) for each in unseen(label, stratum)]
    )


@pytest.mark.long
def test_what_it_doubts_is_not_explained(strata: Network) -> None:
    training = training_set(MODEL, sensing(), WATCHED, TRUSTED)
    plain = fit_gaussian(training)
    both = as_read(fit_gaussian(training, witness=opinion_of(strata)))
    assert len(both.calibration.doubts) == len(training.hypotheses)
    for label in ("A", "B"):
        # Of machines as filed no more are rejected than were agreed upon (measured: 0.02, 0.06; standard error 0.02).
        assert np.mean(p_values(both, label, "trusted") < 0.05) < 0.12
        rejected = [np.mean(p_values(model, label, "wide") < 0.05) for model in (plain, both)]
        assert rejected[1] > rejected[0] + 0.1  # measured: 0.63 instead of 0.43, 0.53 instead of 0.26
        # What the distances see stays seen: a p-value rises by a quarter at most.
        for stratum in ("trusted", "wide"):
            before, after = (p_values(model, label, stratum) for model in (plain, both))
            assert (after <= np.minimum(1.0, 1.2500001 * before)).all()
            assert (after > before).any()
    first, second = (model.match(unseen("A", "trusted")[0]) for model in (plain, both))
    # What is likely it does not judge; files change the last digits of sums.
    assert [h.probability for h in first.hypotheses] == pytest.approx([h.probability for h in second.hypotheses])


def test_a_catalogue_without_machines_that_differ_has_none() -> None:
    one = NetworkShelf(SpectraModel(300), sensing(), None, SMALL)
    assert [learning.subject for learning, _ in one.missing()] == ["hypotheses"] * 2
    assert one.get(sensing(), STRATA, MODEL.nominal_speed) is None


def test_a_shelf_keeps_it_beside_the_others_and_the_trusted_mode_asks_it(tmp_path: Path) -> None:
    shelf = NetworkShelf(MODEL, sensing(), tmp_path, LITTLE)
    assert [(each.mode, each.subject) for each, _ in shelf.missing()] == [
        ("trusted", "hypotheses"),
        ("trusted", "strata"),
        ("robust", "hypotheses"),
    ]
    feature = unseen("A", "trusted")[0]
    before = ModelLibrary(MODEL, networks=shelf).answer(
        sensing(), feature, WATCHED, "fast", "trusted", speed=MODEL.nominal_speed
    )
    shelf.train(STRATA, MODEL.nominal_speed)
    assert [each.subject for each, _ in shelf.missing()] == ["hypotheses"] * 2
    again = NetworkShelf(MODEL, sensing(), tmp_path, LITTLE)
    assert again.get(sensing(), TRUSTED, MODEL.nominal_speed) is None
    library = ModelLibrary(MODEL, networks=again)
    for effort in ("fast", "standard"):
        trusted = library.answer(sensing(), feature, WATCHED, effort, "trusted", speed=MODEL.nominal_speed)
        assert trusted.best.label == "A"
        assert trusted.best.p_value != before.best.p_value
    robust = library.answer(sensing(), feature, WATCHED, "fast", "robust", speed=MODEL.nominal_speed)
    plain = ModelLibrary(MODEL).answer(sensing(), feature, WATCHED, "fast", "robust", speed=MODEL.nominal_speed)
    assert [h.p_value for h in robust.hypotheses] == [h.p_value for h in plain.hypotheses]
