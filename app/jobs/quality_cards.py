"""Quality cards: made at the end of a build or when somebody asks, and as text."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

from jointplay.app.rows import length
from jointplay.app.tables import indent, table
from jointplay.catalogue.errors import CatalogueError

if TYPE_CHECKING:
    from jointplay.catalogue.diagnosing.quality_card import NoiseQuality, QualityCard

log = logging.getLogger(__name__)

HEAD = ("joint", "wear shows from", "worn and seen", "seen and worn")


def made_card(folder: Path) -> tuple[QualityCard | None, str]:
    """Return the card of a catalogue, or why there is none; it is no reason to call a build a failure."""
    from jointplay.catalogue.diagnosing.quality import card_of
    from jointplay.catalogue.storage.store import Catalogue

    try:
        card = card_of(Catalogue.open(folder))
    except CatalogueError as error:
        log.warning("no quality card: %s", error)
        return None, str(error)
    return card, "" if card is not None else "the machine has no sensors that see its frame move"


def share(value: float | None) -> str:
    """Return a share in per cent; a dash for one of nothing."""
    return "–" if value is None else f"{100 * value:.0f} %"


def joint_cells(quality: NoiseQuality) -> list[tuple[str, ...]]:
    """Return what is seen of each joint: name, clearance from which on wear shows, share seen, share rightly called."""
    rows: list[tuple[str, ...]] = []
    for name, found in quality.joints.items():
        least = "–" if found.detectable_from_um is None else length(found.detectable_from_um)
        rows.append((name, least, share(found.seen), share(found.called)))
    return rows


def quality_line(quality: NoiseQuality) -> str:
    """Return the figures of all joints together, in one line."""
    return (
        f"sensor noise {quality.sensor_noise_m_s2:g} m/s2: {share(quality.right)} of {quality.draws} answers name"
        f" exactly the worn joints; {share(quality.interval_coverage)} of {quality.intervals} intervals of 90 % hold"
        " the clearance"
    )


def card_text(card: QualityCard) -> str:
    """Return a card as plain text."""
    lines = [
        f"quality, by draws of the catalogue that it has not learned from, {card.revolutions:g} revolutions"
        " (`jointplay evaluate` simulates anew):"
    ]
    for quality in card.noises:
        lines += [
            indent(quality_line(quality)),
            indent(table(HEAD, joint_cells(quality), frozenset({1, 2, 3})), "    "),
        ]
    last = card.noises[-1]
    confusion = [(name, *map(str, row)) for name, row in zip(last.classes, last.confusion, strict=True)]
    head = (f"at {last.sensor_noise_m_s2:g} m/s2: true, and said", *last.classes)
    return "\n".join([*lines, indent(table(head, confusion, frozenset(range(1, len(head)))))])
