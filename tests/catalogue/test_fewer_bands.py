"""Networks and recordings that end below their highest bands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from spectra_model import WATCHED, SpectraModel, sensing

from jointplay.catalogue.matching.calibration import split_held_out
from jointplay.catalogue.matching.coherence import compose, cyclic_bands, highest_there_are
from jointplay.catalogue.matching.learning import Learning, band_widths, training_set
from jointplay.catalogue.matching.network import Network, NetworkTraining
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.matching.observation import Sensing

MODEL = SpectraModel(300, wide=200)
SMALL = NetworkTraining(rows=6000, blocks=10, layers=(32,), epochs=(4, 2), least_cases=256)
TRUSTED = Learning.of("trusted")


@pytest.fixture(scope="module")
def trained() -> Network:
    return SMALL.train(MODEL, sensing(), TRUSTED)


def fewer_bands(noise: float, bands: int) -> Sensing:
    """Of recordings that end below the highest bands."""
    whole = sensing(noise)
    return replace(
        whole,
        cuts=whole.cuts[: bands + 1],
        noise=whole.noise[:bands],
        degrees_of_freedom=whole.degrees_of_freedom[:bands],
    )


@pytest.mark.parametrize("bands", [17, 19, 20, 21, 30])
def test_bands_that_a_recording_does_not_have_lie_as_its_highest(bands: int) -> None:
    generator = np.random.default_rng(1)
    power = generator.uniform(1.0, 2.0, (5, 34, 2))
    cross, cyclic = (
        0.3 * generator.normal(size=(5, count, width, 2)) @ np.array([1.0, 1.0j])
        for count, width in ((34, 1), (len(cyclic_bands(34).band), 2))
    )
    kept = cyclic_bands(34).band < bands
    whole = compose(power, cross, cyclic)
    some = compose(power[:, :bands], cross[:, :bands], cyclic[:, kept])
    place, own = highest_there_are(bands, 34, 2)
    np.testing.assert_allclose(some[:, place], whole[:, own])
    there = own == np.arange(whole.shape[1])
    # Below the wide bands the highest order has no other beside it: of both channels, two parts.
    lacking = 4 if bands < 20 else 0
    assert there.sum() == some.shape[1] - lacking == len(set(place[there].tolist()))
    # A level above is that of the highest band in the same channel.
    assert own[2 * 33 : 2 * 34].tolist() == [2 * (bands - 1), 2 * (bands - 1) + 1]


def test_recordings_that_end_below_the_highest_bands_are_heard(trained: Network) -> None:
    """All of them right, as of those that do not, even with half of the bands; chance is 0.25."""
    width, shares = band_widths(MODEL), []
    for bands in (len(width), len(width) - 1, len(width) // 2):
        seen = fewer_bands(1e-6, bands)
        held = split_held_out(training_set(MODEL, seen, WATCHED[: 3 * bands], TRUSTED))[1]
        features, index = held.stack()
        opinion = trained.opinion(seen, width)
        assert opinion is not None
        shares.append(np.mean(opinion.log_evidences(features, held.labels).argmax(axis=1) == index))
    assert min(shares) > 0.9


def test_a_network_serves_recordings_with_half_of_its_bands() -> None:
    one = NetworkShelf(MODEL, sensing(), None, SMALL)
    one.train(TRUSTED, MODEL.nominal_speed)
    count = len(band_widths(MODEL))
    for bands, there in ((count - 1, True), ((count + 1) // 2, True), ((count - 1) // 2, False)):
        seen = fewer_bands(1e-6, bands)
        assert one.applies(seen, TRUSTED, None) is there
        assert (one.get(seen, TRUSTED, MODEL.nominal_speed) is not None) is there
    # Other bands are others, however many.
    joined = replace(fewer_bands(1e-6, count - 1), cuts=(0, *sensing().cuts[2:]))
    assert not one.applies(joined, TRUSTED, None)
