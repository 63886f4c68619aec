"""The evidence of a diagnosis, channel by channel: measured and matched levels over orders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jointplay.catalogue.diagnosing.answer import Answer, BandEvidence

NAMES = {"x": "x of the frame", "y": "y of the frame", "theta": "rotation of the frame"}
MOST_DECIDING = 8
UNITS = {"theta": "rad/s²"}


@dataclass(frozen=True)
class Comparison:
    """One channel.

    Parameters
    ----------
    channel : str
        x, y, theta, or the name of a sensor.
    bands : tuple of BandEvidence
        In rising order.
    """

    channel: str
    bands: tuple[BandEvidence, ...]

    @property
    def title(self) -> str:
        """What the channel is called."""
        return NAMES.get(self.channel, self.channel)

    @property
    def label(self) -> str:
        """What the levels are."""
        return f"dB re 1 {UNITS.get(self.channel, 'm/s²')}"


def comparisons(result: Answer) -> list[Comparison]:
    """Return the evidence of a diagnosis by channel, in the order of its appearance.

    Parameters
    ----------
    result : Answer
    """
    found: dict[str, list[BandEvidence]] = {}
    for band in (*result.evidence.orders, *result.evidence.bands):
        found.setdefault(band.channel, []).append(band)
    return [Comparison(channel, tuple(sorted(bands, key=lambda band: band.order))) for channel, bands in found.items()]


def deciding(found: Sequence[Comparison]) -> list[tuple[Comparison, BandEvidence]]:
    """Return the bands that decided, the strongest first: the fewest that hold half of what speaks for the best.

    Parameters
    ----------
    found : sequence of Comparison
        All channels of a diagnosis.
    """
    speaking = [
        (favour, comparison, band)
        for comparison in found
        for band in comparison.bands
        if (favour := band.favours_best or 0.0) > 0
    ]
    speaking.sort(key=lambda each: -each[0])
    half = 0.5 * sum(favour for favour, _, _ in speaking)
    chosen: list[tuple[Comparison, BandEvidence]] = []
    for favour, comparison, band in speaking[:MOST_DECIDING]:
        chosen.append((comparison, band))
        half -= favour
        if half <= 0:
            break
    return chosen
