"""Networks: training, what they answer, where they are kept, and how far their opinion counts."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from spectra_model import WATCHED, SpectraModel, sensing

from jointplay.catalogue.building.executors import InProcess
from jointplay.catalogue.building.network_building import train_networks
from jointplay.catalogue.errors import BuildError, CatalogueFileError
from jointplay.catalogue.matching.calibration import fit_shares, is_held_out, split_held_out
from jointplay.catalogue.matching.coherence import with_more_noise
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.matching.learning import Learning, band_widths, training_set
from jointplay.catalogue.matching.matcher import TrainingSet
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.modelfile import read_network, write_network
from jointplay.catalogue.matching.network import Network, NetworkTraining, Opinion
from jointplay.catalogue.matching.network_shelf import NetworkShelf, arrangement
from jointplay.catalogue.matching.observation import Sensing, observe
from jointplay.catalogue.storage.store import Catalogue

MODEL = SpectraModel(300, wide=200)
SMALL = NetworkTraining(rows=6000, blocks=10, layers=(32,), epochs=(4, 2), least_cases=256)
TRUSTED = Learning.of("trusted")


class OneNetwork(NetworkShelf):
    """Has one network of hypotheses, whatever is asked, or none."""

    network: Network | None = None

    def get(self, sensing: Sensing, learning: Learning, speed: float | None) -> Network | None:
        return self.network if learning.subject == "hypotheses" else None


@pytest.fixture(scope="module")
def trained() -> Network:
    return SMALL.train(MODEL, sensing(), TRUSTED)


def held_rows(noise: float = 1e-5) -> TrainingSet:
    """Rows of entries that no network has seen, of a noise density."""
    return split_held_out(training_set(MODEL, sensing(noise), WATCHED, TRUSTED))[1]


@pytest.mark.parametrize("noise", [1e-8, 1e-6, 1e-5])
def test_tells_hypotheses_apart_at_every_noise_it_was_trained_for(trained: Network, noise: float) -> None:
    held = held_rows(noise)
    features, index = held.stack()
    opinion = trained.opinion(sensing(noise), band_widths(MODEL))
    assert opinion is not None
    found = opinion.log_evidences(features, held.labels).argmax(axis=1)
    assert np.mean(found == index) > 0.9  # measured: 0.97 to 1.00; chance is 0.25


def test_noise_below_the_trained_is_raised_and_above_it_is_refused(trained: Network) -> None:
    width = band_widths(MODEL)
    quiet, loud = sensing(1e-12), sensing(1.0)
    opinion = trained.opinion(quiet, width)
    assert opinion is not None
    assert np.mean(opinion.noise_db) == pytest.approx(trained.quietest)
    assert (opinion.missing > 0.0).all()
    least = trained.opinion(replace(quiet, noise=quiet.noise + opinion.missing), width)
    features = held_rows(1e-12).stack()[0]
    raised = with_more_noise(features, opinion.missing, quiet.alike)
    assert not np.allclose(raised, features)
    assert least is not None
    np.testing.assert_allclose(
        opinion.log_evidences(features, trained.labels), least.log_evidences(raised, trained.labels), atol=1e-9
    )
    assert trained.opinion(loud, width) is None


def test_the_same_training_gives_the_same_network_and_files_give_it_back(trained: Network, tmp_path: Path) -> None:
    again = SMALL.train(MODEL, sensing(), TRUSTED)
    assert again.digest == trained.digest
    assert replace(trained, loudest=0.0).digest != trained.digest
    write_network(tmp_path, "key", trained)
    kept = read_network(tmp_path, "key")
    assert isinstance(kept, Network)
    assert kept.digest == trained.digest
    (tmp_path / "key.npz").write_bytes(b"PK")
    assert read_network(tmp_path, "key") is None


def test_a_network_of_two_hypotheses_answers_for_both() -> None:
    learning = Learning.of("trusted", without=("B", "C"))
    network = SMALL.train(MODEL, sensing(), learning)
    assert network.labels == ("healthy", "A")
    held = split_held_out(training_set(MODEL, sensing(), WATCHED, learning))[1]
    features, index = held.stack()
    opinion = network.opinion(sensing(), band_widths(MODEL))
    assert opinion is not None
    assert np.mean(opinion.log_evidences(features, held.labels).argmax(axis=1) == index) > 0.9


def test_a_case_is_seen_no_more_often_than_it_has_to_say(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[np.ndarray] = []
    packed = SpectraModel.packed

    def noted(self: SpectraModel, rows: np.ndarray) -> np.ndarray:
        seen.append(rows)
        return packed(self, rows)

    monkeypatch.setattr(SpectraModel, "packed", noted)
    monkeypatch.setattr("jointplay.catalogue.matching.network.CASE_ROWS", 2)
    SMALL.train(MODEL, sensing(), TRUSTED)
    learned = np.sum(~is_held_out(np.arange(len(MODEL.label))))
    assert 1.5 * learned < sum(map(len, seen)) <= 2 * learned < SMALL.rows


def test_never_learns_from_entries_that_calibration_holds_out(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: set[int] = set()
    packed = SpectraModel.packed

    def noted(self: SpectraModel, rows: np.ndarray) -> np.ndarray:
        seen.update(rows.tolist())
        return packed(self, rows)

    monkeypatch.setattr(SpectraModel, "packed", noted)
    replace(SMALL, rows=24_000, blocks=40).train(MODEL, sensing(), TRUSTED)
    rows = np.array(sorted(seen))
    every = np.arange(len(MODEL.label))
    seldom = (MODEL.stratum == "wide") | is_held_out(every)
    assert not is_held_out(rows).any()
    assert set(every[~seldom]) < set(rows)  # all others are seen, and machines that differ, too


def test_held_out_entries_are_a_fifth_and_no_pattern_of_the_sequence() -> None:
    apart = is_held_out(np.arange(40_000))
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


def test_a_shelf_keeps_what_it_trained(tmp_path: Path) -> None:
    first = shelf(tmp_path)
    assert [learning.mode for learning, _ in first.missing()] == ["trusted", "robust"]
    assert first.get(sensing(), TRUSTED, None) is None
    assert first.applies(sensing(), TRUSTED, None)
    told: list[tuple[int, int]] = []
    first.train(TRUSTED, MODEL.nominal_speed, lambda done, total: told.append((done, total)))
    assert told[-1][0] == told[-1][1] > 10
    assert [learning.mode for learning, _ in first.missing()] == ["robust"]
    found = [each.get(sensing(1e-7), TRUSTED, MODEL.nominal_speed) for each in (first, shelf(tmp_path))]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].digest == found[1].digest
    # What sees fewer hypotheses asks the same network; what has seen fewer draws is another one.
    assert first.get(sensing(), Learning.of("trusted", without=("A",)), MODEL.nominal_speed) is found[0]
    assert first.get(sensing(), Learning.of("trusted", most=280), MODEL.nominal_speed) is None


def test_where_no_file_can_be_written_a_network_lives_with_its_shelf(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    for folder in (None, blocked):
        one = shelf(folder)
        one.train(TRUSTED, MODEL.nominal_speed)
        assert one.get(sensing(), TRUSTED, MODEL.nominal_speed) is not None
        assert shelf(folder).get(sensing(), TRUSTED, MODEL.nominal_speed) is None
    with pytest.raises(CatalogueFileError, match="cannot be written"):
        shelf(blocked).train(TRUSTED, MODEL.nominal_speed, lasting=True)


def test_there_is_no_network_of_few_cases_or_for_other_sensors() -> None:
    few = shelf(training=replace(SMALL, least_cases=301))
    assert not few.applies(sensing(), TRUSTED, None)
    assert list(few.missing()) == []
    turned = replace(sensing(), transform=np.eye(3)[::-1].copy())
    assert not shelf().applies(turned, TRUSTED, None)
    assert not NetworkShelf(MODEL, None, None, SMALL).applies(sensing(), TRUSTED, None)
    # One healthy case cannot be both learned from and held out.
    lonely = SpectraModel(300)
    kept = np.flatnonzero((lonely.label != "healthy") | (np.arange(len(lonely.label)) == 0))
    lonely.label, lonely.stratum = lonely.label[kept], lonely.stratum[kept]
    lonely.clearances, lonely.powers = lonely.clearances[kept], lonely.powers[kept]
    assert not NetworkShelf(lonely, sensing(), None, SMALL).applies(sensing(), TRUSTED, None)


def test_speeds_of_a_catalogue_have_networks_of_their_own() -> None:
    class Two(SpectraModel):
        speeds = (0.5, 1.0)

        def nearest_speed(self, speed: float) -> float:
            return 0.5 if speed < 0.7 * self.nominal_speed else 1.0

    both = NetworkShelf(Two(300), sensing(), None, SMALL)
    assert [speed / MODEL.nominal_speed for _, speed in both.missing()] == [0.5, 1.0] * 2
    both.train(TRUSTED, 0.5 * MODEL.nominal_speed)
    assert both.get(sensing(), TRUSTED, 0.69 * MODEL.nominal_speed) is not None
    assert both.get(sensing(), TRUSTED, 0.72 * MODEL.nominal_speed) is None


def test_an_untrained_catalogue_answers_by_curves_and_says_so() -> None:
    feature = held_rows().hypotheses[1].features[0]
    answer = ModelLibrary(MODEL, networks=shelf()).answer(sensing(), feature, WATCHED, "fast", "trusted")
    plain = ModelLibrary(MODEL).answer(sensing(), feature, WATCHED, "fast", "trusted")
    assert [h.probability for h in answer.hypotheses] == [h.probability for h in plain.hypotheses]
    assert answer.network is None
    assert any("not trained yet" in note for note in answer.notes)
    assert plain.notes == ()


def test_no_case_of_a_small_hypothesis_is_on_both_sides() -> None:
    training = training_set(MODEL, sensing(), WATCHED, TRUSTED)
    for count in (2, 5, 12):
        draws = training.hypotheses[0]
        first = np.isin(draws.entry, np.unique(draws.entry)[:count])
        learned, held = split_held_out(TrainingSet((draws.rows(first),), training.watched))
        assert len(held.hypotheses[0].entry) > 0
        assert not set(learned.hypotheses[0].entry) & set(held.hypotheses[0].entry)


def test_building_trains_what_is_missing_and_forgets_former_states(
    small_catalogue: Catalogue, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(small_catalogue.path, folder)
    assert train_networks(folder) == ()  # too few cases
    monkeypatch.setattr(
        "jointplay.catalogue.matching.network_shelf.NetworkTraining", lambda: replace(SMALL, least_cases=10)
    )
    networks = Catalogue.open(folder).layout.networks
    networks.mkdir()
    (networks / "another-state.npz").write_bytes(b"")
    told: list[tuple[int, int]] = []
    modes = train_networks(folder, progress=lambda done, total: told.append((done, total)))
    assert modes == ("trusted", "robust")
    assert told == [(0, 2), (1, 2), (2, 2)]
    names = {file.name[:12] for file in networks.iterdir()}
    assert names == {small_catalogue.id[:12]}
    assert train_networks(folder) == ()


def test_a_network_that_is_lost_ends_a_build(
    small_catalogue: Catalogue, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(small_catalogue.path, folder)
    monkeypatch.setattr(
        "jointplay.catalogue.matching.network_shelf.NetworkTraining", lambda: replace(SMALL, least_cases=10)
    )
    networks = Catalogue.open(folder).layout.networks
    networks.write_text("no folder")
    with pytest.raises(CatalogueFileError, match=r"networks.*: cannot be written"):
        train_networks(folder)

    class Dying(InProcess):
        def submit(self, task: Any, argument: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.set_exception(BrokenProcessPool("a child was terminated"))
            return future

        def is_loss(self, error: BaseException) -> bool:
            return isinstance(error, BrokenProcessPool)

    monkeypatch.setattr("jointplay.catalogue.building.network_building.InProcess", Dying)
    with pytest.raises(BuildError, match="a process that trains a network died; building again"):
        train_networks(folder)


def test_no_more_networks_are_trained_at_a_time_than_there_are_processes(
    small_catalogue: Catalogue, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    under_way: list[Future[None]] = []
    most: list[int] = []

    class Counting:
        def __init__(self, workers: int) -> None:
            self.capacity = workers

        def submit(self, task: object, argument: tuple[str, Learning, float]) -> Future[None]:
            under_way.append(Future())
            running = [future for future in under_way if not future.done()]
            most.append(len(running))
            if len(running) == self.capacity:
                running[0].set_result(None)
            return under_way[-1]

        def is_loss(self, error: BaseException) -> bool:
            return False

        def close(self, *, at_once: bool = False) -> None:
            assert not at_once

    wanted = [(TRUSTED, speed) for speed in (1.0, 2.0, 3.0, 4.0)]
    monkeypatch.setattr("jointplay.catalogue.building.network_building.LocalProcesses", Counting)
    monkeypatch.setattr(NetworkShelf, "missing", lambda self: iter(wanted))
    told: list[tuple[int, int]] = []

    def progress(done: int, total: int) -> None:
        told.append((done, total))
        if total - done == 1:
            under_way[-1].set_result(None)

    assert train_networks(small_catalogue.path, workers=2, progress=progress) == ("trusted",) * 4
    assert most == [1, 2, 2, 2]
    assert told == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]


def test_the_order_of_columns_does_not_matter_where_motions_are_compared() -> None:
    generator = np.random.default_rng(1)
    transform = generator.normal(size=(4, 3))
    four = replace(sensing(), transform=transform, channels=np.linalg.pinv(transform))
    order = [2, 0, 3, 1]
    other = replace(four, transform=transform[order], channels=four.channels[:, order])
    assert arrangement(other) == arrangement(four)
    assert arrangement(replace(four, transform=transform[order])) != arrangement(four)
    three = replace(four, transform=transform[:3], channels=np.linalg.inv(transform[:3]))
    swapped = replace(three, transform=three.transform[[1, 0, 2]], channels=three.channels[:, [1, 0, 2]])
    assert arrangement(swapped) == arrangement(three)
    # Sensors that are compared themselves are features in their order.
    alone = replace(four, transform=transform[:2], channels=np.eye(2), noise=four.noise[:, :2])
    assert arrangement(replace(alone, transform=transform[[1, 0]])) != arrangement(alone)


def test_its_opinion_counts_in_both_efforts(trained: Network) -> None:
    feature = held_rows().hypotheses[1].features[0]
    wrong = replace(trained, biases=(*trained.biases[:-1], trained.biases[-1] + np.array([0.0, 0.0, 500.0, 0.0])))

    networks = OneNetwork(MODEL, sensing(), None, SMALL)
    for effort in ("fast", "standard"):
        answers = []
        for network in (None, trained, wrong):
            networks.network = network
            library = ModelLibrary(MODEL, networks=networks)
            answers.append(library.answer(sensing(), feature, WATCHED, effort, "trusted"))  # type: ignore[arg-type]
        none, right, misled = answers
        assert none.best.label == right.best.label == misled.best.label == "A"
        assert right.best.probability != none.best.probability
        # What always says the same tells nothing, and held-out draws show it: it has no share, or next to none.
        assert misled.best.probability > 0.9


def test_beside_a_network_a_refit_is_made_only_of_more_entries_than_the_model_has(
    trained: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    feature = held_rows().hypotheses[1].features[0]

    refits: list[tuple[str, ...]] = []

    def spied(*arguments: Any, rows: Mapping[str, np.ndarray], **settings: Any) -> TrainingSet:
        refits.append(tuple(rows))
        return training_set(*arguments, rows=rows, **settings)

    monkeypatch.setattr("jointplay.catalogue.matching.refit.training_set", spied)
    networks = OneNetwork(MODEL, sensing(), None, SMALL)
    library = ModelLibrary(MODEL, networks=networks)
    library.answer(sensing(), feature, WATCHED, "standard", "trusted")
    assert len(refits) == 1, "without a network"
    networks.network = trained
    library.answer(sensing(), feature, WATCHED, "standard", "trusted")
    assert len(refits) == 1, "the model has learned from all entries"
    of = Learning.of
    monkeypatch.setattr(Learning, "of", lambda mode, **asked: replace(of(mode, **asked), most=200))
    library.answer(sensing(), feature, WATCHED, "standard", "trusted")
    assert len(refits) == 2, "it has not"


def test_an_opinion_is_of_the_hypotheses_it_is_asked_of(trained: Network) -> None:
    features, _ = observe(MODEL.packed(np.arange(3)), sensing(), Discrepancy(), np.ones(3, np.int64))
    opinion = trained.opinion(sensing(), band_widths(MODEL))
    assert isinstance(opinion, Opinion)
    both = opinion.log_evidences(features, ("C", "A"))
    every = opinion.log_evidences(features, trained.labels)
    np.testing.assert_array_equal(both, every[:, [3, 1]])
