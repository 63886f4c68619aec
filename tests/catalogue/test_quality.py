"""Quality cards: made of the catalogue's own held-out draws, kept in its folder, made anew when it has changed."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from jointplay.catalogue.diagnosing import quality
from jointplay.catalogue.diagnosing.quality import card_of, make_card
from jointplay.catalogue.diagnosing.quality_card import QualityCard, kept_card
from jointplay.catalogue.matching.calibration import is_held_out
from jointplay.catalogue.storage.store import Catalogue


@pytest.fixture(scope="module")
def catalogue(small_catalogue: Catalogue, tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    folder = tmp_path_factory.mktemp("quality") / "slider-crank"
    shutil.copytree(small_catalogue.path, folder)
    return Catalogue.open(folder)


@pytest.fixture(scope="module")
def card(catalogue: Catalogue) -> QualityCard:
    made = make_card(catalogue)
    assert made is not None
    return made


@pytest.mark.long
def test_every_held_out_draw_is_asked_about_at_every_noise(card: QualityCard, catalogue: Catalogue) -> None:
    matrix = catalogue.matrix
    held = {h.label: int(np.sum(is_held_out(matrix.individuals(matrix.rows(h.label))))) for h in matrix.hypotheses}
    assert [each.sensor_noise_m_s2 for each in card.noises] == list(quality.NOISES)
    for each in card.noises:
        assert each.classes == ("in order", "A", "B", "O")
        assert [sum(row) for row in each.confusion] == [held["healthy"], held["A"], held["B"], held["O"]]
        assert each.draws == sum(held.values())
        right = sum(each.confusion[k][k] for k in range(4))
        assert each.right == right / each.draws


def test_a_machine_that_is_told_apart_nearly_always_has_a_good_card(card: QualityCard) -> None:
    quiet = card.noises[0]
    assert quiet.right >= 0.8
    assert quiet.interval_coverage is not None
    assert quiet.interval_coverage >= 0.7
    for joint in quiet.joints.values():
        assert joint.seen is not None
        assert joint.seen >= 0.8
    # In so small a catalogue a single case that is taken for another makes the limit of its joint unknown.
    limits = [joint.detectable_from_um for joint in quiet.joints.values() if joint.detectable_from_um is not None]
    assert len(limits) >= 2
    assert all(40.0 <= limit <= 200.0 for limit in limits)


def test_noise_that_hides_everything_is_seen_on_the_card(catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quality, "NOISES", (1000.0,))
    made = make_card(catalogue)
    assert made is not None
    (loud,) = made.noises
    assert loud.right < 0.8
    assert all(joint.detectable_from_um is None for joint in loud.joints.values())


def test_a_card_is_kept_until_the_catalogue_is_another(catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quality, "NOISES", (0.02,))
    assert kept_card(catalogue) is None
    first = card_of(catalogue)
    assert first == kept_card(catalogue)
    monkeypatch.setattr(quality, "make_card", lambda _: pytest.fail("it was there"))
    assert card_of(catalogue) == first
    content = json.loads(catalogue.layout.quality.read_text())
    catalogue.layout.quality.write_text(json.dumps({**content, "catalogue": "another"}))
    assert kept_card(catalogue) is None
    catalogue.layout.quality.write_text("{")
    assert kept_card(catalogue) is None


def test_a_machine_without_sensors_has_none(catalogue: Catalogue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quality, "own_sensing", lambda *_: None)
    assert make_card(catalogue) is None
