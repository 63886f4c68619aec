"""The evidence of a diagnosis, channel by channel: measured and matched levels over orders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

NAMES = {"x": "x of the frame", "y": "y of the frame", "theta": "rotation of the frame"}
MOST_DECIDING = 8
UNITS = {"theta": "rad/s²"}


@dataclass(frozen=True)
class Band:
    """One band: its centre as an order of the drive, levels in dB, and what it says for the best hypothesis."""

    order: float
    measured_db: float
    predicted_db: float
    spread_db: float
    z: float
    rival_db: float | None = None
    favours_best: float = 0.0


@dataclass(frozen=True)
class Comparison:
    """One channel.

    Parameters
    ----------
    channel : str
        x, y, theta, or the name of a sensor.
    bands : tuple of Band
        In rising order.
    """

    channel: str
    bands: tuple[Band, ...]

    @property
    def title(self) -> str:
        """What the channel is called."""
        return NAMES.get(self.channel, self.channel)

    @property
    def label(self) -> str:
        """What the levels are."""
        return f"dB re 1 {UNITS.get(self.channel, 'm/s²')}"


def comparisons(result: Mapping[str, Any]) -> list[Comparison]:
    """Return the evidence of a diagnosis by channel, in the order of its appearance.

    Parameters
    ----------
    result : Mapping
        The members of a diagnosis.
    """
    found: dict[str, list[Band]] = {}
    for entry in (*result["evidence"]["orders"], *result["evidence"]["bands"]):
        band = Band(
            float(entry["order"]),
            float(entry["measured_db"]),
            float(entry["predicted_db"]),
            float(entry["spread_db"]),
            float(entry["z"]),
            entry.get("rival_db"),  # diagnoses of before have none
            float(entry.get("favours_best") or 0.0),
        )
        found.setdefault(entry["channel"], []).append(band)
    return [Comparison(channel, tuple(sorted(bands, key=lambda band: band.order))) for channel, bands in found.items()]


def deciding(found: Sequence[Comparison]) -> list[tuple[Comparison, Band]]:
    """Return the bands that decided, the strongest first: the fewest that hold half of what speaks for the best.

    Parameters
    ----------
    found : sequence of Comparison
        All channels of a diagnosis.
    """
    speaking = [(comparison, band) for comparison in found for band in comparison.bands if band.favours_best > 0]
    speaking.sort(key=lambda pair: -pair[1].favours_best)
    half = 0.5 * sum(band.favours_best for _, band in speaking)
    chosen: list[tuple[Comparison, Band]] = []
    for pair in speaking[:MOST_DECIDING]:
        chosen.append(pair)
        half -= pair[1].favours_best
        if half <= 0:
            break
    return chosen
