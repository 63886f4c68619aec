"""What a recording says beside those of the same machine in order: how both are seen, learned from, and asked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from spectra_model import GROUPS, WATCHED, FloatArray, IntArray, SpectraModel, sensing

from jointplay.catalogue.errors import DiagnosisError
from jointplay.catalogue.matching.calibration import is_held_out
from jointplay.catalogue.matching.discrepancy import Discrepancy
from jointplay.catalogue.matching.learning import Learning, band_widths, training_set, with_past
from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.modelfile import read_network, write_network
from jointplay.catalogue.matching.network import Network, NetworkTraining
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.matching.observation import Sensing, observe

COUNT = 300
OF_MACHINES, OF_DAYS = 5.0, 0.5
"""Decibels that levels scatter by."""


class Remembered(SpectraModel):
    """Machines that differ much, each the same in order and worn; two in three of those in order are there twice."""

    def __init__(self) -> None:
        super().__init__(COUNT)
        generator = np.random.default_rng(8)
        machines = 10.0 ** (0.1 * OF_MACHINES * generator.normal(size=(COUNT, GROUPS, 3)))
        self.machine = np.tile(np.arange(COUNT), len(self.hypotheses))
        again = np.arange(2 * COUNT // 3)
        self.label = np.concatenate([self.label, np.full(len(again), "healthy")])
        self.stratum = np.concatenate([self.stratum, np.full(len(again), "trusted")])
        self.machine = np.concatenate([self.machine, again])
        self.clearances = np.concatenate([self.clearances, self.clearances[again]])
        self.powers = 0.0 * np.concatenate([self.powers, self.powers[again]])
        joints = len(self.joints)
        level = np.full((len(self.label), GROUPS, 3), 1e-2)
        for j in range(joints):
            # Small wear: three bands of its own rise by some decibels.
            risen = slice(4 * j + 1, 4 * j + 4)
            growth = np.log(np.maximum(self.clearances[:, j], 1e-12)) - np.log(30e-6)
            level[:, risen] *= np.where(growth > 0.0, 10.0 ** (0.1 * (1.5 + growth)), 1.0)[:, None, None]
        days = 10.0 ** (0.1 * OF_DAYS * generator.normal(size=level.shape))
        self.powers[..., :3] = level * machines[self.machine] * days

    def individuals(self, rows: IntArray) -> IntArray:
        """The same in order and worn."""
        return self.machine[rows]

    def in_order(self, rows: IntArray) -> IntArray:
        """On another day."""
        twice = {int(m): (int(m), int(row)) for row, m in enumerate(self.machine) if row >= 4 * COUNT}
        found = []
        for row in rows.tolist():
            days = twice.get(int(self.machine[row]), (int(self.machine[row]),))
            found.append(next((day for day in days if day != row), -1))
        return np.array(found)


MODEL = Remembered()
SPEED = MODEL.nominal_speed
BESIDE = replace(sensing(), past=True)
SMALL = NetworkTraining(rows=24_000, blocks=20, layers=(32,), epochs=(4, 2), least_cases=200)
TRUSTED = Learning.of("trusted")
SINCE = replace(TRUSTED, subject="since")
HELD = np.flatnonzero(is_held_out(MODEL.machine) & (MODEL.in_order(np.arange(len(MODEL.label))) >= 0))


@pytest.fixture(scope="module")
def shelf() -> NetworkShelf:
    found = NetworkShelf(MODEL, sensing(), None, SMALL)
    for learning in (TRUSTED, SINCE):
        found.train(learning, SPEED)
    return found


def seen(rows: IntArray, sensing: Sensing = BESIDE) -> FloatArray:
    """Features (n, d) of rows beside those of the same machines in order."""
    past = MODEL.packed(MODEL.in_order(rows))
    return observe(MODEL.packed(rows), sensing, TRUSTED.discrepancy, np.ones(len(rows), np.int64), 7, past=past)[0]


def test_gains_and_what_the_model_does_not_know_are_those_of_both() -> None:
    unknown = Discrepancy(gain=0.3, level_db=6.0, noise_level_db=0.0, cyclic=0.0)
    still = replace(BESIDE, noise=1e-12 * BESIDE.noise, degrees_of_freedom=np.full(GROUPS, 1e9))
    rows = MODEL.rows("B")[:40]
    past = MODEL.packed(MODEL.in_order(rows))
    found, _ = observe(MODEL.packed(rows), still, unknown, np.ones(40, np.int64), 3, past=past)
    levels = still.noise.size
    now, before = found[:, :levels], found[:, still.own_count :][:, :levels]
    true = 10.0 * np.log10(MODEL.packed(rows)[..., :3] / past[..., :3]).reshape(40, -1)
    np.testing.assert_allclose(now - before, true, atol=1e-3)
    assert np.std(now - 10.0 * np.log10(MODEL.packed(rows)[..., :3]).reshape(40, -1)) > 3.0


def test_the_past_is_given_where_it_is_compared_and_nowhere_else() -> None:
    rows = MODEL.rows("B")[:4]
    once = np.ones(4, np.int64)
    for asked, past in ((BESIDE, None), (sensing(), MODEL.packed(rows))):
        with pytest.raises(DiagnosisError, match="spectra of the past: needed where they are compared"):
            observe(MODEL.packed(rows), asked, Discrepancy(), once, past=past)
    with pytest.raises(DiagnosisError, match="0 entries of hypothesis healthy"):
        training_set(SpectraModel(10), BESIDE, WATCHED, TRUSTED)


def test_small_wear_is_told_from_what_the_machine_was_and_not_from_others(shelf: NetworkShelf) -> None:
    features = seen(HELD)
    truth = MODEL.label[HELD]
    right = {}
    for learning in (TRUSTED, SINCE):
        network = shelf.get(sensing(), learning, SPEED)
        assert isinstance(network, Network)
        assert network.past == (learning is SINCE)
        opinion = network.opinion(BESIDE, band_widths(MODEL))
        assert opinion is not None
        found = np.array(network.labels)[opinion.log_evidences(features, network.labels).argmax(axis=1)]
        right[learning.subject] = np.mean(found == truth)
    assert right["since"] > 0.9 > 0.7 > right["hypotheses"], right


def test_recordings_that_end_below_the_highest_bands_are_heard_beside_their_past(shelf: NetworkShelf) -> None:
    ends = GROUPS - 2
    fewer = replace(
        BESIDE,
        cuts=BESIDE.cuts[: ends + 1],
        noise=BESIDE.noise[:ends],
        degrees_of_freedom=BESIDE.degrees_of_freedom[:ends],
    )
    network = shelf.get(fewer, SINCE, SPEED)
    assert network is not None
    opinion = network.opinion(fewer, band_widths(MODEL))
    assert opinion is not None
    found = opinion.log_evidences(seen(HELD, fewer), network.labels).argmax(axis=1)
    assert np.mean(np.array(network.labels)[found] == MODEL.label[HELD]) > 0.9  # measured: 0.99


def test_both_opinions_count_alike_and_files_give_them_back(shelf: NetworkShelf, tmp_path: Path) -> None:
    networks = shelf.every(BESIDE, TRUSTED, SPEED)
    assert shelf.every(sensing(), TRUSTED, SPEED).since is None
    assert networks.hypotheses is not None and networks.since is not None
    opinion, _ = networks.opinions(BESIDE, band_widths(MODEL))
    own, _ = replace(networks, since=None).opinions(BESIDE, band_widths(MODEL))
    since = networks.since.opinion(BESIDE, band_widths(MODEL))
    assert opinion is not None and own is not None and since is not None
    features, labels = seen(HELD), networks.hypotheses.labels
    both = [each.log_evidences(features, labels) for each in (own, since)]
    np.testing.assert_allclose(opinion.log_evidences(features, labels), both[0] + both[1])
    assert len({opinion.digest, own.digest, since.digest}) == 3
    write_network(tmp_path, "since", networks.since)
    kept = read_network(tmp_path, "since")
    assert kept is not None and kept.past and kept.digest == networks.since.digest


def test_a_library_answers_beside_the_past_by_what_has_learned_it(shelf: NetworkShelf) -> None:
    library = ModelLibrary(MODEL, networks=shelf)
    assert library.hears_past(sensing(), SPEED)
    assert not ModelLibrary(MODEL).hears_past(sensing(), SPEED)
    features = seen(HELD)
    own = sensing().own_count
    losses = []
    for asked, shown in ((sensing(), features[:, :own]), (BESIDE, features)):
        answers = [library.answer(asked, row, WATCHED, "fast", "trusted", speed=SPEED) for row in shown[::3]]
        losses.append(
            -np.mean([np.log(a.probability(k)) for a, k in zip(answers, MODEL.label[HELD][::3], strict=True)])
        )
    assert losses[1] < 0.5 * losses[0], losses


def test_more_noise_is_added_to_both(shelf: NetworkShelf) -> None:
    """A noise below what was trained for is raised in the recording and in those before."""
    network = shelf.get(sensing(), SINCE, SPEED)
    assert network is not None
    quiet = replace(BESIDE, noise=1e-7 * BESIDE.noise)
    opinion = network.opinion(quiet, band_widths(MODEL))
    assert opinion is not None and opinion.missing.all()
    features = seen(HELD[:5])
    raised = replace(quiet, noise=quiet.noise + opinion.missing).with_more_noise(features, opinion.missing)
    levels, own = quiet.noise.size, quiet.own_count
    for part in (slice(0, levels), slice(own, own + levels)):
        assert (raised[:, part] > features[:, part]).all()
    differs = raised[:, : quiet.plain_count] - raised[:, own : own + quiet.plain_count]
    np.testing.assert_allclose(
        opinion.log_evidences(features, network.labels), network.log_likelihoods(differs, opinion.noise_db), atol=1e-9
    )


def test_networks_beside_the_past_are_trained_where_machines_are_there_in_order() -> None:
    asked = [(learning.mode, learning.subject) for learning, _ in NetworkShelf(MODEL, sensing(), None, SMALL).missing()]
    assert asked == [("trusted", "hypotheses"), ("trusted", "since"), ("robust", "hypotheses"), ("robust", "since")]
    others = NetworkShelf(SpectraModel(300), sensing(), None, SMALL)
    assert {learning.subject for learning, _ in others.missing()} == {"hypotheses"}
    assert len(with_past(MODEL, MODEL.rows("healthy"))) == 4 * COUNT // 3


def test_machines_that_are_there_under_several_loads_have_no_network_beside_their_past() -> None:
    """One in order has another load on its other day, a worn one has not always: that would tell them apart."""
    several = NetworkShelf(MODEL, sensing(), None, SMALL, remembers=False)
    assert {learning.subject for learning, _ in several.missing()} == {"hypotheses"}
    assert not several.applies(sensing(), SINCE, SPEED)
