"""Networks: training, what they answer, where they are kept, and how far their opinion counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spectra_model import WATCHED, SpectraModel, sensing

from catalogue.calibration import fit_shares, held_out, kept_apart
from catalogue.learning import Learning, training_set
from catalogue.matching import TrainingSet
from catalogue.model_library import ModelLibrary
from catalogue.modelfile import read_network, write_model
from catalogue.nearest import NearestEntry
from catalogue.network import Network, Opinion
from catalogue.network_shelf import NetworkShelf, arrangement
from catalogue.network_training import NetworkTraining
from catalogue.observation import Discrepancy, observe
from catalogue.spectra import band_widths

MODEL = SpectraModel(300, wide=200)
SMALL = NetworkTraining(rows=6000, blocks=10, layers=(32,), epochs=(4, 2))
TRUSTED = Learning.of("trusted")
NETWORK = SMALL.train(MODEL, sensing(), TRUSTED)


def held_rows(noise: float = 1e-5) -> TrainingSet:
    """Rows of entries that no network has seen, of a noise density."""
    return kept_apart(training_set(MODEL, sensing(noise), WATCHED, TRUSTED))[1]


@pytest.mark.parametrize("noise", [1e-8, 1e-6, 1e-5])
def test_tells_hypotheses_apart_at_every_noise_it_was_trained_for(noise: float) -> None:
    held = held_rows(noise)
    features, index = held.stacked()
    opinion = NETWORK.opinion(sensing(noise).noise, band_widths(MODEL))
    assert opinion is not None
    found = opinion.log_evidences(features, held.labels).argmax(axis=1)
    assert np.mean(found == index) > 0.9  # measured: 0.97 to 1.00; chance is 0.25


def test_noise_below_the_trained_is_raised_and_above_it_is_refused() -> None:
    width = band_widths(MODEL)
    quiet, loud = sensing(1e-12), sensing(1.0)
    opinion = NETWORK.opinion(quiet.noise, width)
    assert opinion is not None
    assert np.mean(opinion.noise_db) == pytest.approx(NETWORK.quietest)
    assert (opinion.missing > 0.0).all()
    least = NETWORK.opinion(quiet.noise + opinion.missing.reshape(quiet.noise.shape), width)
    features = held_rows(1e-12).stacked()[0]
    raised = 10.0 * np.log10(10.0 ** (0.1 * features) + opinion.missing)
    assert least is not None
    np.testing.assert_allclose(
        opinion.log_evidences(features, NETWORK.labels), least.log_evidences(raised, NETWORK.labels), atol=1e-9
    )
    assert NETWORK.opinion(loud.noise, width) is None


def test_the_same_training_gives_the_same_network_and_files_give_it_back(tmp_path: Path) -> None:
    again = SMALL.train(MODEL, sensing(), TRUSTED)
    assert again.digest == NETWORK.digest
    assert replace(NETWORK, loudest=0.0).digest != NETWORK.digest
    assert write_model(tmp_path, "key", NETWORK)
    kept = read_network(tmp_path, "key")
    assert isinstance(kept, Network)
    assert kept.digest == NETWORK.digest
    (tmp_path / "key.npz").write_bytes(b"PK")
    assert read_network(tmp_path, "key") is None


def test_a_network_of_two_hypotheses_answers_for_both() -> None:
    learning = Learning.of("trusted", without=("B", "C"))
    network = SMALL.train(MODEL, sensing(), learning)
    assert network.labels == ("healthy", "A")
    held = kept_apart(training_set(MODEL, sensing(), WATCHED, learning))[1]
    features, index = held.stacked()
    opinion = network.opinion(sensing().noise, band_widths(MODEL))
    assert opinion is not None
    assert np.mean(opinion.log_evidences(features, held.labels).argmax(axis=1) == index) > 0.9


def test_never_learns_from_entries_that_calibration_holds_out(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: set[int] = set()
    packed = SpectraModel.packed

    def noted(self: SpectraModel, rows: np.ndarray) -> np.ndarray:
        seen.update(rows.tolist())
        return packed(self, rows)

    monkeypatch.setattr(SpectraModel, "packed", noted)
    SMALL.train(MODEL, sensing(), TRUSTED)
    rows = np.array(sorted(seen))
    every = np.flatnonzero(MODEL.stratum == "trusted")
    assert set(rows) == set(every[~held_out(every)])  # all others are seen


def test_held_out_entries_are_a_fifth_and_no_pattern_of_the_sequence() -> None:
    apart = held_out(np.arange(40_000))
    assert np.mean(apart) == pytest.approx(0.2, abs=0.01)
    for modulus in (2, 3, 4, 5, 8, 64):
        shares = [np.mean(apart[start::modulus]) for start in range(modulus)]
        assert np.ptp(shares) < 0.1  # measured: at most 0.07, of 64 parts


def test_shares_of_two_opinions_are_those_of_least_loss() -> None:
    generator = np.random.default_rng(3)
    truth = generator.integers(3, size=4000)
    informed = 2.0 * np.eye(3)[truth] + generator.normal(size=(4000, 3))
    nonsense = generator.normal(size=(4000, 3))
    weights = np.full(4000, 1.0 / 4000)
    first, second = fit_shares(informed, nonsense, truth, weights)
    # Evidence of a normal deviate of unit variance about 0 or 2 is twice the deviate.
    assert first == pytest.approx(2.0, abs=0.15)
    assert second == pytest.approx(0.0, abs=0.1)
    assert fit_shares(nonsense, 0.5 * informed, truth, weights)[1] == pytest.approx(2.0)  # as much as there may be


def shelf(folder: Path | None = None, training: NetworkTraining = SMALL) -> NetworkShelf:
    return NetworkShelf(MODEL, sensing(), folder, training)


def test_a_shelf_keeps_what_it_trained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "another-state.npz").write_bytes(b"")
    first = shelf(tmp_path)
    wanted = [learning.mode for learning, _ in first.wanted()]
    assert wanted == ["trusted", "robust"]
    told: list[tuple[int, int]] = []
    found = first.get(sensing(1e-7), TRUSTED, None, lambda done, total: told.append((done, total)))
    assert found is not None
    assert told[-1][0] == told[-1][1] > 10
    assert not (tmp_path / "another-state.npz").exists()
    assert [learning.mode for learning, _ in first.wanted()] == ["robust"]
    monkeypatch.setattr(NetworkTraining, "train", None)  # nothing can be trained any more
    for again in (first, shelf(tmp_path)):
        kept = again.get(sensing(), TRUSTED, MODEL.nominal_speed)
        assert kept is not None
        assert kept.digest == found.digest


def test_there_is_no_network_of_few_cases_or_for_other_sensors() -> None:
    assert shelf(training=replace(SMALL, least_cases=301)).get(sensing(), TRUSTED, None) is None
    assert list(shelf(training=replace(SMALL, least_cases=301)).wanted()) == []
    turned = replace(sensing(), transform=np.eye(3)[::-1].copy())
    assert shelf().get(turned, TRUSTED, None) is None
    assert NetworkShelf(MODEL, None, None, SMALL).get(sensing(), TRUSTED, None) is None


def test_the_order_of_columns_does_not_matter_where_motions_are_compared() -> None:
    generator = np.random.default_rng(1)
    transform = generator.normal(size=(4, 3))
    four = replace(sensing(), transform=transform, channels=np.linalg.pinv(transform))
    order = [2, 0, 3, 1]
    other = replace(four, transform=transform[order], channels=four.channels[:, order])
    assert arrangement(other) == arrangement(four)
    assert arrangement(replace(four, transform=transform[order])) != arrangement(four)


def test_its_opinion_counts_in_both_efforts_and_not_for_other_methods() -> None:
    feature = held_rows().hypotheses[1].features[0]
    wrong = replace(NETWORK, biases=(*NETWORK.biases[:-1], NETWORK.biases[-1] + np.array([0.0, 0.0, 500.0, 0.0])))

    class Shelf(NetworkShelf):
        def get(self, *_: object) -> Network | None:  # type: ignore[override]
            return self.network

        network: Network | None = None

    networks = Shelf(MODEL, sensing(), None, SMALL)
    for effort in ("fast", "standard"):
        answers = []
        for network in (None, NETWORK, wrong):
            networks.network = network
            library = ModelLibrary(MODEL, networks=networks)
            answers.append(library.answer(sensing(), feature, WATCHED, effort, "trusted"))  # type: ignore[arg-type]
        none, right, misled = answers
        assert none.best.label == right.best.label == misled.best.label == "A"
        assert right.best.probability != none.best.probability
        # What always says the same tells nothing, and held-out draws show it: it has no share, or next to none.
        assert misled.best.probability > 0.9
    networks.network = wrong
    library = ModelLibrary(MODEL, networks=networks)
    by_nearest = library.answer(sensing(), feature, WATCHED, "fast", "trusted", matcher=NearestEntry())
    plain = ModelLibrary(MODEL).answer(sensing(), feature, WATCHED, "fast", "trusted", matcher=NearestEntry())
    assert [h.probability for h in by_nearest.hypotheses] == [h.probability for h in plain.hypotheses]


def test_an_opinion_is_of_the_hypotheses_it_is_asked_of() -> None:
    features, _ = observe(MODEL.packed(np.arange(3)), sensing(), Discrepancy(), np.ones(3, np.int64))
    opinion = NETWORK.opinion(sensing().noise, band_widths(MODEL))
    assert isinstance(opinion, Opinion)
    both = opinion.log_evidences(features, ("C", "A"))
    every = opinion.log_evidences(features, NETWORK.labels)
    np.testing.assert_array_equal(both, every[:, [3, 1]])
